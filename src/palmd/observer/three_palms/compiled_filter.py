"""What `body_filter.c` computes for a `BodyFilter`; safe inside the loop."""

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
SEEN = 10
MOST = 256
READING = 4  # t, a, b, pad


class _Model(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("acceleration", "reading")),
        *((name, ctypes.c_long) for name in ("parameters", "harmonics")),
        ("acting", ctypes.c_double * RIG_INPUTS),
        *((name, ctypes.c_double) for name in ("gate", "learnt", "turn", "spin", "by_spin")),
    )  # fmt: skip


class _Track(ctypes.Structure):
    _fields_ = (
        ("t", ctypes.c_void_p), ("told", ctypes.c_void_p), ("count", ctypes.c_long), ("longest", ctypes.c_double),
    )  # fmt: skip


class CompiledSteps:
    """The functions of `body_filter.c` for outlines up to one degree and one rig.

    `body`: R by rows, ω, mean NIS, p, one after the other; P: states and parameters, square. Both C-contiguous, and
    changed in place.
    """

    def __init__(self, library: ctypes.CDLL, order: int, acting: tuple[float, ...], **constants: float) -> None:
        """`acting` is of `ThreePalmsRig`, constants are named as in `body_filter.c`.

        RuntimeError where the library has other sizes.
        """
        sizes = (STATES, PALM_INPUTS, RIG_INPUTS, GEOMETRY, SEEN, MOST, 3 * len(JOINTS))
        if tuple((ctypes.c_long * len(sizes)).in_dll(library, "body_filter_sizes")) != sizes:
            raise RuntimeError("body_filter.c has other sizes than the model")
        if STATES + count(order) + BODY > MOST:
            raise ValueError(f"there is room for {MOST} states and parameters, not for degree {order}")
        kernels = (ctypes.cast(library[EXPORTED + name], ctypes.c_void_p) for name in ("acceleration", "reading"))
        self._model = _Model(*(each.value for each in kernels), count(order) + BODY, count(order), acting, **constants)
        self._at = ctypes.addressof(self._model)
        pointer, number, integer = ctypes.c_void_p, ctypes.c_double, ctypes.c_long
        self._carry, self._seen = library.body_carry, library.body_seen
        self._carry.argtypes = (*(pointer,) * 4, number, pointer, integer, number, number, number)
        self._carry.restype = number
        self._seen.argtypes, self._seen.restype = (*(pointer,) * 4, number, number, *(pointer,) * 4), None

    def carry(
        self, body: FloatArray, P: FloatArray, t: float, joints: JointTrack, readings: FloatArray,
        variance: float, until: float, longest_s: float,
    ) -> float:  # fmt: skip
        """From `t` past readings (N, `READING`) to `until`, by steps of `longest_s` at most; where that is (s).

        variance: of a reading (m²).
        """
        at = body.ctypes.data, P.ctypes.data, t, readings.ctypes.data, len(readings)
        told: float = self._carry(self._at, ctypes.byref(_track(joints)), *at, variance, until, longest_s)
        return told

    def seen(
        self, body: FloatArray, P: FloatArray, joints: JointTrack, t: float, shrunk: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """As `BodyFilter._seen` at `t` (s)."""
        y, covariance, palms, force = np.empty(SEEN), np.empty((SEEN, SEEN)), np.empty(PALM_INPUTS), np.empty(3)
        out = (each.ctypes.data for each in (y, covariance, palms, force))
        of_track = ctypes.byref(_track(joints))
        self._seen(self._at, of_track, body.ctypes.data, P.ctypes.data, t, shrunk, *out)
        return y, covariance, palms, force


def _track(joints: JointTrack) -> _Track:
    return _Track(joints.times.ctypes.data, joints.told.ctypes.data, joints.count, GAP_S)


@cache
def steps(order: int, law: VibrationLaw, acting: tuple[float, ...], **constants: float) -> CompiledSteps:
    """Those for outlines up to this degree."""
    library = filter_library(order, law, str(Path(__file__).with_name("body_filter.c"))).opened()
    return CompiledSteps(library, order, acting, **constants)
