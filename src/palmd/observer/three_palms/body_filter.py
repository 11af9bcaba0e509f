"""The motion of a body between three palms carried from a smoother's belief to the present, reading by reading.

An extended Kalman filter on rotation, spin and all parameters of the body. A step solves the equations as they are
about its beginning (the linearly implicit midpoint rule: second order, stable however stiff friction is). Computed by
`body_filter.c`. Safe in the loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model.spherical import order_of
from palmd.model.three_palms import BODY
from palmd.observer.three_palms import compiled_filter
from palmd.observer.three_palms.compiled_filter import READING
from palmd.observer.three_palms.joint_track import JointTrack
from palmd.observer.three_palms.motion_noise import BY_SPIN, SPIN, TURN
from palmd.system.three_palms import BodyAnswer, ThreePalmsRig

LONGEST_STEP_S = 5e-3
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
    """Mean and covariance at `t`; states are turn in the world and spin, then the body's parameters."""

    def __init__(self, answer: BodyAnswer, rig: ThreePalmsRig) -> None:
        """As the smoother believes."""
        self.t = answer.t
        self.P: FloatArray = np.array(answer.covariance, order="C")
        self._body: FloatArray = np.concatenate([answer.R.ravel(), answer.omega, [1.0], answer.p])
        self._variance = rig.pad.reading_variance + answer.rough**2
        self._does = steps(order_of(len(answer.p) - BODY), rig)

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
        rows = np.array([(each.t, each.a, each.b, each.pad) for each in readings]).reshape(-1, READING)
        self.t = self._does.carry(self._body, self.P, self.t, joints, rows, self._variance, until, longest_s)

    def seen(self, joints: JointTrack, t: float) -> Seen:
        """What there is, with the palms as they are at `t` (s), which is the filter's time."""
        y, covariance, palms, force = self._does.seen(self._body, self.P, joints, t, SHORT)
        normal = palms[:9].reshape(3, 3)
        sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)).reshape(5, 2)
        y = y.reshape(5, 2)
        p, of_p = y[3:].ravel()[:3], covariance[6:9, 6:9]
        heights_sd = np.sqrt(np.maximum(((normal @ of_p) * normal).sum(axis=1), 0.0))
        return Seen((y[:3], sd[:3]), (p, sd[3:].ravel()[:3]), (normal @ p, heights_sd), force)


def steps(order: int, rig: ThreePalmsRig) -> compiled_filter.CompiledSteps:
    """What is compiled of a filter for outlines up to this degree."""
    return compiled_filter.steps(
        order, rig.vibration.law, tuple(rig.acting), gate=GATE, learnt=LEARNT, turn=TURN, spin=SPIN, by_spin=BY_SPIN,
    )  # fmt: skip


LEARNT = 1.0 / (300.0 * NIS_S)
"""Share of one reading in the mean of the NIS, of some 300 a second."""
