"""Extended Kalman filter of a body between three palms; starts from a smoother's answer. Safe in the loop.

States are rotation, spin and all parameters of the body. A step solves the equations of motion linearised about its
beginning (linearly implicit midpoint rule: second order, stable for any stiffness of friction). Computed by
`body_filter.c`.
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
GATE = 15.0  # NIS per number of a reading, above which it is not fused
NIS_S = 0.5  # time constant of the mean NIS
SHORT_AXES = 1e-6  # scale of a pad's axes in a reading of the centre of mass, by which the contact's offset vanishes


@dataclass(frozen=True, slots=True)
class PlaneReading:
    """A reading of pad 0 to 2 at `t` (s): both coordinates (m)."""

    t: float
    pad: int
    a: float
    b: float


@dataclass(frozen=True, slots=True)
class FilterOutputs:
    """Quantities derived from a filter at one instant, as (values, 1σ).

    contacts: (3 palms, 2) (m). centre: (3,) (m). heights: (3,) of the centre of mass over each palm (m). force: (3,)
    per unit mass (m/s²), without 1σ.
    """

    contacts: tuple[FloatArray, FloatArray]
    centre: tuple[FloatArray, FloatArray]
    heights: tuple[FloatArray, FloatArray]
    force: FloatArray


class BodyFilter:
    """Mean and covariance `P` at `t`; error states are the turn in the world, spin, and the body's parameters."""

    def __init__(self, answer: BodyAnswer, rig: ThreePalmsRig) -> None:
        """Start from the smoother's answer."""
        self.t = answer.t
        self.P: FloatArray = np.array(answer.covariance, order="C")
        self._body: FloatArray = np.concatenate([answer.R.ravel(), answer.omega, [1.0], answer.p])
        self._variance = rig.pad.reading_variance + answer.unexplained_sd**2
        self._compiled = filter_steps(order_of(len(answer.p) - BODY), rig)

    @property
    def R(self) -> FloatArray:
        """(3, 3) rotation from body to world."""
        return self._body[:9].reshape(3, 3)

    @property
    def omega(self) -> FloatArray:
        """(3,) spin in the world (rad/s)."""
        return self._body[9:12]

    @property
    def nis(self) -> float:
        """Mean normalised innovation squared over `NIS_S`."""
        return float(self._body[12])

    @property
    def p(self) -> FloatArray:
        """(m,) parameters as in `model.three_palms`."""
        return self._body[13:]

    def copy(self) -> BodyFilter:
        """Independent copy."""
        other = object.__new__(BodyFilter)
        other.__dict__.update(self.__dict__)
        other.P, other._body = self.P.copy(), self._body.copy()
        return other

    def propagate(
        self, readings: Sequence[PlaneReading], until: float, joints: JointTrack, longest_s: float = LONGEST_STEP_S
    ) -> None:
        """Propagate to `until` (s) and fuse these readings, which are ordered by time."""
        rows = np.array([(each.t, each.a, each.b, each.pad) for each in readings]).reshape(-1, READING)
        self.t = self._compiled.propagate(self._body, self.P, self.t, joints, rows, self._variance, until, longest_s)

    def outputs(self, joints: JointTrack, t: float) -> FilterOutputs:
        """Contacts, centre, heights and forces with the palms at `t` (s), the filter's time."""
        y, covariance, palms, force = self._compiled.outputs(self._body, self.P, joints, t, SHORT_AXES)
        normal = palms[:9].reshape(3, 3)
        sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)).reshape(5, 2)
        y = y.reshape(5, 2)
        p, p_covariance = y[3:].ravel()[:3], covariance[6:9, 6:9]
        heights_sd = np.sqrt(np.maximum(((normal @ p_covariance) * normal).sum(axis=1), 0.0))
        return FilterOutputs((y[:3], sd[:3]), (p, sd[3:].ravel()[:3]), (normal @ p, heights_sd), force)


def filter_steps(order: int, rig: ThreePalmsRig) -> compiled_filter.CompiledSteps:
    """The compiled functions of a filter for outlines up to degree `order`."""
    return compiled_filter.compiled_steps(
        order, rig.vibration.law, tuple(rig.kernel_constants),
        gate=GATE, nis_gain=NIS_GAIN, turn=TURN, spin=SPIN, by_spin=BY_SPIN,
    )  # fmt: skip


NIS_GAIN = 1.0 / (300.0 * NIS_S)
"""Weight of one reading in the mean NIS, at some 300 readings a second."""
