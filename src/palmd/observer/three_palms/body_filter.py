"""Extended Kalman filter of a body between three palms; starts from a smoother's answer. Safe in the loop.

States are rotation, spin and all parameters of the body. A step solves the equations of motion linearised about its
beginning (linearly implicit midpoint rule: second order, stable for any stiffness of friction). Computed by
`body_filter.c`.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import EXPORTED
from palmd.model.spherical import count, order_of
from palmd.model.three_palms import BODY, PALM_INPUTS, RIG_INPUTS, filter_library
from palmd.observer.three_palms.body import SPIN_NOISE, SPIN_NOISE_BY_SPIN, TURN_NOISE
from palmd.observer.three_palms.joint_track import JointTrack
from palmd.system.three_palms import GAP_S, JOINTS, BodyAnswer, ThreePalmsRig
from palmd.system.vibration import VibrationLaw

LONGEST_STEP_S = 5e-3
GATE = 15.0  # NIS per number of a reading, above which it is not fused
NIS_S = 0.5  # time constant of the mean NIS
NIS_GAIN = 1.0 / (300.0 * NIS_S)  # weight of one reading in the mean NIS, at some 300 readings a second
SHORT_AXES = 1e-6  # scale of a pad's axes in a reading of the centre of mass, by which the contact's offset vanishes
STATES, GEOMETRY, OUTPUTS, MOST = 6, 24, 10, 256  # sizes, as in `body_filter.c`


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


class _Model(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("acceleration", "reading")),
        *((name, ctypes.c_long) for name in ("parameters", "harmonics")),
        ("rig", ctypes.c_double * RIG_INPUTS),
        *((name, ctypes.c_double) for name in ("gate", "nis_gain", "turn", "spin", "by_spin")),
    )  # fmt: skip


class _Track(ctypes.Structure):
    _fields_ = (
        ("t", ctypes.c_void_p), ("reports", ctypes.c_void_p), ("count", ctypes.c_long), ("longest", ctypes.c_double),
    )  # fmt: skip

    @classmethod
    def of(cls, joints: JointTrack) -> _Track:
        return cls(joints.times.ctypes.data, joints.reports.ctypes.data, joints.count, GAP_S)


class CompiledSteps:
    """The functions of `body_filter.c` for one degree of the outline and one rig.

    `body`: R by rows, ω, mean NIS, p, concatenated; P: covariance of states and parameters. Both are C-contiguous and
    changed in place.
    """

    def __init__(self, order: int, law: VibrationLaw, acting: tuple[float, ...]) -> None:
        """`acting`: `ThreePalmsRig.kernel_constants`.

        Raises RuntimeError if the library's sizes differ, ValueError if the degree is too high.
        """
        library = filter_library(order, law, str(Path(__file__).with_name("body_filter.c"))).opened()
        sizes = (STATES, PALM_INPUTS, RIG_INPUTS, GEOMETRY, OUTPUTS, MOST, 3 * len(JOINTS))
        if tuple((ctypes.c_long * len(sizes)).in_dll(library, "body_filter_sizes")) != sizes:
            raise RuntimeError("the sizes in body_filter.c differ from the model's")
        if STATES + count(order) + BODY > MOST:
            raise ValueError(f"at most {MOST} states and parameters are supported, too few for degree {order}")
        kernels = (ctypes.cast(library[EXPORTED + name], ctypes.c_void_p) for name in ("acceleration", "reading"))
        self._model = _Model(
            *(each.value for each in kernels), count(order) + BODY, count(order), acting,
            gate=GATE, nis_gain=NIS_GAIN, turn=TURN_NOISE, spin=SPIN_NOISE, by_spin=SPIN_NOISE_BY_SPIN,
        )  # fmt: skip
        self._at = ctypes.addressof(self._model)
        pointer, number, integer = ctypes.c_void_p, ctypes.c_double, ctypes.c_long
        self._carry, self._seen = library.body_carry, library.body_seen
        self._carry.argtypes = (*(pointer,) * 4, number, pointer, integer, number, number, number)
        self._carry.restype = number
        self._seen.argtypes, self._seen.restype = (*(pointer,) * 4, number, number, *(pointer,) * 4), None

    def propagate(
        self, body: FloatArray, P: FloatArray, t: float, joints: JointTrack, readings: FloatArray,
        variance: float, until: float, longest_s: float,
    ) -> float:  # fmt: skip
        """Propagate from `t` to `until` in steps of `longest_s` at most, fusing readings (N, 4): t, a, b, pad.

        variance: of a reading (m²). Returns the time reached (s).
        """
        state = body.ctypes.data, P.ctypes.data, t, readings.ctypes.data, len(readings)
        reached: float = self._carry(self._at, ctypes.byref(_Track.of(joints)), *state, variance, until, longest_s)
        return reached

    def outputs(
        self, body: FloatArray, P: FloatArray, joints: JointTrack, t: float, shrunk: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Raw outputs at `t` (s): y (OUTPUTS,), covariance, palms and forces; see `body_seen` in `body_filter.c`."""
        shapes: tuple[tuple[int, ...], ...] = ((OUTPUTS,), (OUTPUTS, OUTPUTS), (PALM_INPUTS,), (3,))
        y, covariance, palms, force = map(np.empty, shapes)
        out = (each.ctypes.data for each in (y, covariance, palms, force))
        self._seen(self._at, ctypes.byref(_Track.of(joints)), body.ctypes.data, P.ctypes.data, t, shrunk, *out)
        return y, covariance, palms, force


_steps = cache(CompiledSteps)


def filter_steps(order: int, rig: ThreePalmsRig) -> CompiledSteps:
    """The compiled functions of a filter for outlines up to degree `order`; cached."""
    return _steps(order, rig.vibration.law, tuple(rig.kernel_constants))


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
        rows = np.array([(each.t, each.a, each.b, each.pad) for each in readings]).reshape(-1, 4)
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
