"""The motion of a body between three palms carried from a smoother's belief to the present, reading by reading.

An extended Kalman filter on the rotation, the spin and all parameters of the body. A step solves the equations of motion
linearised about its beginning (the linearly implicit midpoint rule: second order, stable however stiff friction is).
Safe in the loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model.three_palms import BODY
from palmd.observer.three_palms import kernels, rotation
from palmd.observer.three_palms.kernels import by_columns, palm_inputs, reading_geometry
from palmd.observer.three_palms.motion_noise import BY_SPIN, SPIN, TURN
from palmd.system.three_palms import PALMS, BodyAnswer, PalmPlanes, ThreePalmsRig

LONGEST_STEP_S = 5e-3
STATES = 6  # turn in the world, spin
GATE = 15.0  # of a reading's squared sigmas, over its two numbers: beyond it is not fused
NIS_S = 0.5  # over which the mean is taken
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
    """Mean and covariance at `t`."""

    def __init__(self, answer: BodyAnswer, rig: ThreePalmsRig) -> None:
        """As the smoother believes."""
        self.t, self.R, self.omega, self.p = answer.t, answer.R, answer.omega, answer.p
        self.P: FloatArray = answer.covariance
        self.nis = 1.0
        self._rig = rig
        order = math.isqrt(len(self.p) - BODY) - 1
        self._shape = slice(STATES, STATES + len(self.p) - BODY)
        self._acceleration, self._reading = kernels.acceleration(order), kernels.reading(order)

    def copy(self) -> BodyFilter:
        """Another one, which goes on by itself."""
        other = object.__new__(BodyFilter)
        other.__dict__.update(self.__dict__)
        return other

    def times(
        self, readings: Sequence[PlaneReading], until: float, longest_s: float = LONGEST_STEP_S
    ) -> list[float]:
        """The instants at which `carry` must be told the palms: middles of its steps, and each reading's own."""
        found, t = [], self.t
        for end in (*(each.t for each in readings), until):
            found += [middle for middle, _ in _steps(t, end, longest_s)]
            t = max(t, end)
        return [*found, *(each.t for each in readings)]

    def carry(
        self,
        readings: Sequence[PlaneReading],
        until: float,
        palms: PalmPlanes,
        longest_s: float = LONGEST_STEP_S,
    ) -> None:
        """On to `until` (s) past these readings, in their order; palms at `times` of the same."""
        inputs = palm_inputs(palms)
        steps, taken = len(inputs) - len(readings), 0
        own = PalmPlanes(*(getattr(palms, name)[steps:] for name in PalmPlanes.__dataclass_fields__))
        geometry = reading_geometry(own, np.array([each.pad for each in readings], dtype=np.int64)) if readings else None
        for number, end in enumerate((*(each.t for each in readings), until)):
            for _, h in _steps(self.t, end, longest_s):
                self._step(h, inputs[taken : taken + 1])
                taken += 1
            if geometry is not None and number < len(readings):
                self._correct(readings[number], geometry[number : number + 1])

    def seen(self, palms: PalmPlanes) -> Seen:
        """What there is at `t`, for the palms then."""
        normal = palms.normal[0]
        inputs, pads = palm_inputs(palms), np.arange(len(PALMS))
        geometry = reading_geometry(PalmPlanes(*(np.repeat(getattr(palms, name), 3, axis=0) for name in _PLANES)), pads)
        centre = np.repeat(geometry[:1], 2, axis=0)
        centre[:, 9:18] /= SHORT
        centre[:, 18:] = SHORT * np.array([[1, 0, 0, 0, 1, 0], [0, 0, 1, 0, 0, 0]])
        turned = np.repeat(by_columns(self.R[None]), 5, axis=0)
        y, by_turn, by_c = self._reading((turned, np.concatenate([geometry, centre])), (self.p[: self._shape.stop - 6],))
        H = np.zeros((10, len(self.P)))
        H[:, :3], H[:, self._shape] = by_turn.reshape(10, 3), by_c.reshape(10, -1)
        covariance = H @ self.P @ H.T
        sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)).reshape(5, 2)
        p, of_p = y[3:].ravel()[:3], covariance[6:9, 6:9]
        heights_sd = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", normal, of_p, normal), 0.0))
        force = self._acceleration((by_columns(self.R[None]), self.omega[None], inputs), (self.p, self._rig.gravity))[1]
        return Seen((y[:3], sd[:3]), (p, sd[3:].ravel()[:3]), (normal @ p, heights_sd), force[0])

    def _step(self, h: float, palms: FloatArray) -> None:
        shared = (self.p, self._rig.gravity)
        out = self._acceleration((by_columns(self.R[None]), self.omega[None], palms), shared)
        alpha, by_turn, by_omega, by_p = (out[i][0] for i in (0, 2, 3, 4))
        J = np.zeros((STATES, STATES))
        J[:3, :3], J[:3, 3:], J[3:, :3], J[3:, 3:] = rotation.skew(self.omega), np.eye(3), by_turn, by_omega
        M = np.linalg.inv(np.eye(STATES) - 0.5 * h * J)
        rate = M @ np.concatenate([self.omega, alpha])
        onward, through = M @ (np.eye(STATES) + 0.5 * h * J), h * M[:, 3:] @ by_p
        self.R = rotation.exp(h * rate[:3]) @ self.R
        self.omega = self.omega + h * rate[3:]
        self.t += h
        P = self.P.copy()
        P[:STATES] = onward @ self.P[:STATES] + through @ self.P[STATES:]
        P[:, :STATES] = P[:, :STATES] @ onward.T + P[:, STATES:] @ through.T
        spin = h * (SPIN + BY_SPIN * float(self.omega @ self.omega))
        P[range(STATES), range(STATES)] += np.repeat([h * TURN, spin], 3)
        self.P = P

    def _correct(self, reading: PlaneReading, geometry: FloatArray) -> None:
        y, by_turn, by_c = self._reading((by_columns(self.R[None]), geometry), (self.p[: self._shape.stop - 6],))
        H = np.zeros((2, len(self.P)))
        H[:, :3], H[:, self._shape] = by_turn[0], by_c[0]
        PH = self.P @ H.T
        S = H @ PH + self._rig.pad.reading_variance * np.eye(2)
        miss = np.array([reading.a, reading.b]) - y[0]
        weighed = np.linalg.solve(S, np.column_stack([miss, PH.T]))
        strange = 0.5 * float(miss @ weighed[:, 0])
        self.nis += (min(strange, GATE) - self.nis) * LEARNT
        if strange > GATE:
            return
        step = PH @ weighed[:, 0]
        P = self.P - PH @ weighed[:, 1:]
        self.P = 0.5 * (P + P.T)
        self.R = rotation.exp(step[:3]) @ self.R
        self.omega = self.omega + step[3:STATES]
        self.p = self.p + step[STATES:]


_PLANES = tuple(PalmPlanes.__dataclass_fields__)
LEARNT = 1.0 / (300.0 * NIS_S)
"""Share of one reading in the mean of the NIS, of some 300 a second."""


def _steps(start: float, end: float, longest_s: float) -> list[tuple[float, float]]:
    """(middle, length) of the steps from `start` to `end` (s); none backwards."""
    span = end - start
    if span <= 1e-9:
        return []
    count = math.ceil(span / longest_s)
    h = span / count
    return [(start + (k + 0.5) * h, h) for k in range(count)]
