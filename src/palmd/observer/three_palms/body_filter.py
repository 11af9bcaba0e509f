"""The motion of a body between three palms carried from a smoother's belief to the present, reading by reading.

An extended Kalman filter on rotation, spin and all parameters of the body. A step solves the equations as they are
about its beginning (the linearly implicit midpoint rule: second order, stable however stiff friction is). What is here
in NumPy serves where nothing can be compiled; else `body_filter.c` does. Safe in the loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.model.spherical import order_of
from palmd.model.three_palms import BODY
from palmd.observer.three_palms import compiled_filter, kernels
from palmd.observer.three_palms.compiled_filter import READING, STATES
from palmd.observer.three_palms.joint_track import JointTrack
from palmd.observer.three_palms.kernels import by_columns, palm_inputs, reading_geometry
from palmd.observer.three_palms.motion_noise import BY_SPIN, SPIN, TURN
from palmd.system.three_palms import PALMS, BodyAnswer, PalmPlanes, ThreePalmsRig

LONGEST_STEP_S = 5e-3
GATE = 15.0  # of a reading's squared sigmas, over its two numbers: beyond it is not fused
NIS_S = 0.5  # over which the mean is taken
LEAST_S = 1e-9  # shorter spans are none
SHORT = 1e-6  # of a pad's axes, beside which the contact vanishes and the centre of mass is left


@dataclass(frozen=True, slots=True)
class PlaneReading:
    """Of pad 0 to 2 at `t` (s): both coordinates (m)."""

    t: float
    pad: int
    a: float
    b: float


@dataclass(frozen=True, slots=True)
class Seen:
    """What follows from a filter at one instant; (value, one-sigma) or (values, one-sigmas).

    contacts: (3 palms, 2) (m). centre: (3,) (m). heights: (3,) (m). force: (3,) per unit mass (m/s²), without bands.
    """

    contacts: tuple[FloatArray, FloatArray]
    centre: tuple[FloatArray, FloatArray]
    heights: tuple[FloatArray, FloatArray]
    force: FloatArray


class BodyFilter:
    """Mean and covariance at `t`; states are turn in the world and spin, then the body's parameters."""

    def __init__(self, answer: BodyAnswer, rig: ThreePalmsRig, *, compiled: bool = True) -> None:
        """As the smoother believes; in NumPy where not `compiled`."""
        self.t = answer.t
        self.P: FloatArray = np.array(answer.covariance, order="C")
        self._body: FloatArray = np.concatenate([answer.R.ravel(), answer.omega, [1.0], answer.p])
        self._rig = rig
        self._variance = rig.pad.reading_variance + answer.rough**2
        self._order = order_of(len(answer.p) - BODY)
        self._shape = slice(STATES, STATES + len(answer.p) - BODY)
        self._does = steps(self._order, rig) if compiled else None

    @property
    def R(self) -> FloatArray:
        """(3, 3) body to world."""
        return self._body[:9].reshape(3, 3)

    @property
    def omega(self) -> FloatArray:
        """(3,) in the world (rad/s)."""
        return self._body[9:12]

    @property
    def nis(self) -> float:
        """The mean normalized innovation squared of half a second."""
        return float(self._body[12])

    @property
    def p(self) -> FloatArray:
        """(m,) parameters of `model.three_palms`."""
        return self._body[13:]

    def copy(self) -> BodyFilter:
        """Another one, which goes on by itself."""
        other = object.__new__(BodyFilter)
        other.__dict__.update(self.__dict__)
        other.P, other._body = self.P.copy(), self._body.copy()
        return other

    def carry(
        self, readings: Sequence[PlaneReading], until: float, joints: JointTrack, longest_s: float = LONGEST_STEP_S
    ) -> None:
        """On to `until` (s) past these readings, in their order."""
        if self._does is not None:
            rows = np.array([(each.t, each.a, each.b, each.pad) for each in readings]).reshape(-1, READING)
            self.t = self._does.carry(self._body, self.P, self.t, joints, rows, self._variance, until, longest_s)
            return
        for number, end in enumerate((*(each.t for each in readings), until)):
            middles, h = _steps(self.t, end, longest_s)
            for palms in palm_inputs(joints.palms(middles)):
                self._step(h, palms)
                self.t += h
            if number < len(readings):
                pad = np.array([readings[number].pad])
                self._correct(readings[number], reading_geometry(joints.palms(np.array([end])), pad)[0])

    def seen(self, joints: JointTrack, t: float) -> Seen:
        """What there is, with the palms as they are at `t` (s), which is the filter's time."""
        if self._does is not None:
            y, covariance, palms, force = self._does.seen(self._body, self.P, joints, t, SHORT)
        else:
            y, covariance, palms, force = self._seen(joints.palms(np.array([t])))
        normal = palms[:9].reshape(3, 3)
        sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)).reshape(5, 2)
        y = y.reshape(5, 2)
        p, of_p = y[3:].ravel()[:3], covariance[6:9, 6:9]
        heights_sd = np.sqrt(np.maximum(((normal @ of_p) * normal).sum(axis=1), 0.0))
        return Seen((y[:3], sd[:3]), (p, sd[3:].ravel()[:3]), (normal @ p, heights_sd), force)

    def _step(self, h: float, palms: FloatArray) -> None:
        """One step of h (s), the palms as in its middle."""
        shared = (self.p, self._rig.acting)
        acceleration = kernels.acceleration(self._order, self._rig.vibration.law)
        out = acceleration((by_columns(self.R[None]), self.omega[None], palms[None]), shared)
        alpha, by_turn, by_omega, by_p = (out[i][0] for i in (0, 2, 3, 4))
        J = np.zeros((STATES, STATES))
        J[:3, :3], J[:3, 3:], J[3:, :3], J[3:, 3:] = rotation.skew(self.omega), np.eye(3), by_turn, by_omega
        M = np.linalg.inv(np.eye(STATES) - 0.5 * h * J)
        rate = M @ np.concatenate([self.omega, alpha])
        onward, through = M @ (np.eye(STATES) + 0.5 * h * J), h * M[:, 3:] @ by_p
        spin = h * (SPIN + BY_SPIN * float(self.omega @ self.omega))
        self.R[:] = rotation.exp(h * rate[:3]) @ self.R
        self.omega[:] += h * rate[3:]
        P = self.P.copy()
        P[:STATES] = onward @ self.P[:STATES] + through @ self.P[STATES:]
        P[:, :STATES] = P[:, :STATES] @ onward.T + P[:, STATES:] @ through.T
        P[range(STATES), range(STATES)] += np.repeat([h * TURN, spin], 3)
        self.P = P

    def _correct(self, reading: PlaneReading, geometry: FloatArray) -> None:
        y, H = self._looked(geometry[None])
        PH = self.P @ H.T
        S = H @ PH + self._variance * np.eye(2)
        miss = np.array([reading.a, reading.b]) - y
        weighed = np.linalg.solve(S, np.column_stack([miss, PH.T]))
        strange = 0.5 * float(miss @ weighed[:, 0])
        self._body[12] += (min(strange, GATE) - self.nis) * LEARNT
        if strange > GATE:
            return
        step = PH @ weighed[:, 0]
        P = self.P - PH @ weighed[:, 1:]
        self.P = 0.5 * (P + P.T)
        self.R[:] = rotation.exp(step[:3]) @ self.R
        self._body[9:12] += step[3:STATES]
        self._body[13:] += step[STATES:]

    def _looked(self, geometry: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What geometries (T, 24) read, (2T,), and its Jacobian (2T, states and parameters)."""
        turned = np.repeat(by_columns(self.R[None]), len(geometry), axis=0)
        y, by_turn, by_c = kernels.reading(self._order, self._rig.vibration.law)((turned, geometry), (self.p[:-BODY],))
        H = np.zeros((2 * len(geometry), len(self.P)))
        H[:, :3], H[:, self._shape] = by_turn.reshape(-1, 3), by_c.reshape(len(H), -1)
        return y.ravel(), H

    def _seen(self, palms: PalmPlanes) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """(10,) contacts by palms and the centre of mass, a number to spare; their covariance, palms and forces."""
        repeated = PalmPlanes(*(np.repeat(getattr(palms, name), len(PALMS), axis=0) for name in _PLANES))
        geometry = reading_geometry(repeated, np.arange(len(PALMS)))
        centre = np.repeat(geometry[:1], 2, axis=0)
        centre[:, 9:18] /= SHORT
        centre[:, 18:] = SHORT * np.array([[1, 0, 0, 0, 1, 0], [0, 0, 1, 0, 0, 0]])
        y, H = self._looked(np.concatenate([geometry, centre]))
        inputs = palm_inputs(palms)
        shared = (self.p, self._rig.acting)
        acceleration = kernels.acceleration(self._order, self._rig.vibration.law)
        force = acceleration((by_columns(self.R[None]), self.omega[None], inputs), shared)[1]
        return y, H @ self.P @ H.T, inputs[0], force[0]


def steps(order: int, rig: ThreePalmsRig) -> compiled_filter.CompiledSteps | None:
    """What is compiled of a filter; None where nothing can be."""
    return compiled_filter.steps(
        order, rig.vibration.law, tuple(rig.acting), gate=GATE, learnt=LEARNT, turn=TURN, spin=SPIN, by_spin=BY_SPIN,
    )  # fmt: skip


_PLANES = tuple(PalmPlanes.__dataclass_fields__)
LEARNT = 1.0 / (300.0 * NIS_S)
"""Share of one reading in the mean of the NIS, of some 300 a second."""


def _steps(start: float, end: float, longest_s: float) -> tuple[FloatArray, float]:
    """Middles and length of the steps from `start` to `end` (s); none backwards."""
    span = end - start
    if span <= LEAST_S:
        return np.zeros(0), 0.0
    count = math.ceil(span / longest_s)
    return start + (np.arange(count) + 0.5) * span / count, span / count
