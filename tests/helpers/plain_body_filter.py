"""Independent filter of a body between three palms in NumPy; see `palmd.observer.three_palms.body_filter`."""

import math
from types import SimpleNamespace

import numpy as np
from plain_body_equations import acceleration_kernel

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.model.spherical import order_of
from palmd.model.three_palms import BODY
from palmd.observer.three_palms import kernels
from palmd.observer.three_palms.arrow import STATES
from palmd.observer.three_palms.body import SPIN_NOISE, SPIN_NOISE_BY_SPIN, TURN_NOISE
from palmd.observer.three_palms.body_filter import GATE, LONGEST_STEP_S, NIS_GAIN, SHORT_AXES, BodyFilter, PlaneReading
from palmd.observer.three_palms.joint_track import JointTrack
from palmd.observer.three_palms.kernels import by_columns, palm_inputs, reading_geometry
from palmd.system.three_palms import PALMS, BodyAnswer, PalmPlanes, ThreePalmsRig

LEAST_S = 1e-9  # shorter intervals are skipped
_PLANES = tuple(PalmPlanes.__dataclass_fields__)


class PlainFilter(BodyFilter):
    """Same interface as `BodyFilter`."""

    def __init__(self, answer: BodyAnswer, rig: ThreePalmsRig) -> None:
        super().__init__(answer, rig)
        self._rig = rig
        self._order = order_of(len(answer.p) - BODY)
        self._shape = slice(STATES, STATES + len(answer.p) - BODY)
        self._compiled = SimpleNamespace(
            outputs=lambda _body, _P, joints, t, _short: self._seen(joints.palms(np.array([t])))
        )

    def propagate(self, readings, until: float, joints: JointTrack, longest_s: float = LONGEST_STEP_S) -> None:
        """See `BodyFilter.carry`."""
        for number, end in enumerate((*(each.t for each in readings), until)):
            middles, h = _steps(self.t, end, longest_s)
            for palms in palm_inputs(joints.palms(middles)):
                self._step(h, palms)
                self.t += h
            if number < len(readings):
                pad = np.array([readings[number].pad])
                self._correct(readings[number], reading_geometry(joints.palms(np.array([end])), pad)[0])

    def _step(self, h: float, palms: FloatArray) -> None:
        """One step of h (s), with the palms at its middle."""
        shared = (self.p, self._rig.kernel_constants)
        acceleration = acceleration_kernel(self._order, self._rig.vibration.law)
        out = acceleration((by_columns(self.R[None]), self.omega[None], palms[None]), shared)
        alpha, by_turn, by_omega, by_p = (out[i][0] for i in (0, 2, 3, 4))
        J = np.zeros((STATES, STATES))
        J[:3, :3], J[:3, 3:], J[3:, :3], J[3:, 3:] = rotation.skew(self.omega), np.eye(3), by_turn, by_omega
        M = np.linalg.inv(np.eye(STATES) - 0.5 * h * J)
        rate = M @ np.concatenate([self.omega, alpha])
        onward, through = M @ (np.eye(STATES) + 0.5 * h * J), h * M[:, 3:] @ by_p
        spin = h * (SPIN_NOISE + SPIN_NOISE_BY_SPIN * float(self.omega @ self.omega))
        self.R[:] = rotation.exp(h * rate[:3]) @ self.R
        self.omega[:] += h * rate[3:]
        P = self.P.copy()
        P[:STATES] = onward @ self.P[:STATES] + through @ self.P[STATES:]
        P[:, :STATES] = P[:, :STATES] @ onward.T + P[:, STATES:] @ through.T
        P[range(STATES), range(STATES)] += np.repeat([h * TURN_NOISE, spin], 3)
        self.P = P

    def _correct(self, reading: PlaneReading, geometry: FloatArray) -> None:
        y, H = self._looked(geometry[None])
        PH = self.P @ H.T
        S = H @ PH + self._variance * np.eye(2)
        miss = np.array([reading.a, reading.b]) - y
        weighed = np.linalg.solve(S, np.column_stack([miss, PH.T]))
        strange = 0.5 * float(miss @ weighed[:, 0])
        self._body[12] += (min(strange, GATE) - self.nis) * NIS_GAIN
        if strange > GATE:
            return
        step = PH @ weighed[:, 0]
        P = self.P - PH @ weighed[:, 1:]
        self.P = 0.5 * (P + P.T)
        self.R[:] = rotation.exp(step[:3]) @ self.R
        self._body[9:12] += step[3:STATES]
        self._body[13:] += step[STATES:]

    def _looked(self, geometry: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Predicted readings of geometries (T, 24), (2T,), and their Jacobian (2T, states and parameters)."""
        turned = np.repeat(by_columns(self.R[None]), len(geometry), axis=0)
        y, by_turn, by_c = kernels.reading(self._order, self._rig.vibration.law)((turned, geometry), (self.p[:-BODY],))
        H = np.zeros((2 * len(geometry), len(self.P)))
        H[:, :3], H[:, self._shape] = by_turn.reshape(-1, 3), by_c.reshape(len(H), -1)
        return y.ravel(), H

    def _seen(self, palms: PalmPlanes) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Contacts per palm and the centre of mass, (10,) with one spare number; their covariance, palms and forces."""
        repeated = PalmPlanes(*(np.repeat(getattr(palms, name), len(PALMS), axis=0) for name in _PLANES))
        geometry = reading_geometry(repeated, np.arange(len(PALMS)))
        centre = np.repeat(geometry[:1], 2, axis=0)
        centre[:, 9:18] /= SHORT_AXES
        centre[:, 18:] = SHORT_AXES * np.array([[1, 0, 0, 0, 1, 0], [0, 0, 1, 0, 0, 0]])
        y, H = self._looked(np.concatenate([geometry, centre]))
        inputs = palm_inputs(palms)
        shared = (self.p, self._rig.kernel_constants)
        acceleration = acceleration_kernel(self._order, self._rig.vibration.law)
        force = acceleration((by_columns(self.R[None]), self.omega[None], inputs), shared)[1]
        return y, H @ self.P @ H.T, inputs[0], force[0]


def _steps(start: float, end: float, longest_s: float) -> tuple[FloatArray, float]:
    """Middles and length of the steps from `start` to `end` (s); none if `end` is earlier."""
    span = end - start
    if span <= LEAST_S:
        return np.zeros(0), 0.0
    count = math.ceil(span / longest_s)
    return start + (np.arange(count) + 0.5) * span / count, span / count
