"""Binding of `body_filter.c` for `BodyFilter`; safe in the loop."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import EXPORTED
from palmd.model.spherical import count
from palmd.model.three_palms import BODY, PALM_INPUTS, RIG_INPUTS, filter_library
from palmd.observer.three_palms.joint_track import JointTrack
from palmd.system.three_palms import GAP_S, JOINTS
from palmd.system.vibration import VibrationLaw

STATES = 6
GEOMETRY = 24
OUTPUTS = 10
MOST = 256
READING = 4  # t, a, b, pad


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


class CompiledSteps:
    """The functions of `body_filter.c` for one degree of the outline and one rig.

    `body`: R by rows, ω, mean NIS, p, concatenated; P: covariance of states and parameters. Both are C-contiguous and
    changed in place.
    """

    def __init__(self, library: ctypes.CDLL, order: int, acting: tuple[float, ...], **constants: float) -> None:
        """`acting`: `ThreePalmsRig.kernel_constants`; `constants` are named as in `body_filter.c`.

        Raises RuntimeError if the library's sizes differ, ValueError if the degree is too high.
        """
        sizes = (STATES, PALM_INPUTS, RIG_INPUTS, GEOMETRY, OUTPUTS, MOST, 3 * len(JOINTS))
        if tuple((ctypes.c_long * len(sizes)).in_dll(library, "body_filter_sizes")) != sizes:
            raise RuntimeError("the sizes in body_filter.c differ from the model's")
        if STATES + count(order) + BODY > MOST:
            raise ValueError(f"at most {MOST} states and parameters are supported, too few for degree {order}")
        kernels = (ctypes.cast(library[EXPORTED + name], ctypes.c_void_p) for name in ("acceleration", "reading"))
        self._model = _Model(*(each.value for each in kernels), count(order) + BODY, count(order), acting, **constants)
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
        """Propagate from `t` to `until` in steps of `longest_s` at most, fusing readings (N, `READING`).

        variance: of a reading (m²). Returns the time reached (s).
        """
        state = body.ctypes.data, P.ctypes.data, t, readings.ctypes.data, len(readings)
        reached: float = self._carry(self._at, ctypes.byref(_track(joints)), *state, variance, until, longest_s)
        return reached

    def outputs(
        self, body: FloatArray, P: FloatArray, joints: JointTrack, t: float, shrunk: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Raw outputs at `t` (s): y (OUTPUTS,), covariance, palms and forces; see `body_seen` in `body_filter.c`."""
        y, covariance, palms, force = (
            np.empty(OUTPUTS),
            np.empty((OUTPUTS, OUTPUTS)),
            np.empty(PALM_INPUTS),
            np.empty(3),
        )
        out = (each.ctypes.data for each in (y, covariance, palms, force))
        of_track = ctypes.byref(_track(joints))
        self._seen(self._at, of_track, body.ctypes.data, P.ctypes.data, t, shrunk, *out)
        return y, covariance, palms, force


def _track(joints: JointTrack) -> _Track:
    return _Track(joints.times.ctypes.data, joints.reports.ctypes.data, joints.count, GAP_S)


@cache
def compiled_steps(order: int, law: VibrationLaw, acting: tuple[float, ...], **constants: float) -> CompiledSteps:
    """The compiled functions for outlines up to degree `order`; cached."""
    library = filter_library(order, law, str(Path(__file__).with_name("body_filter.c"))).opened()
    return CompiledSteps(library, order, acting, **constants)
