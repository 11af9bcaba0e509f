"""What `body_equations.c` computes of one record: see `equations`."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import EXPORTED, load
from palmd.model.spherical import count
from palmd.model.three_palms import BODY, PALM_INPUTS, RIG_INPUTS, library
from palmd.observer.three_palms.arrow import STATES, Arrow
from palmd.observer.three_palms.equations import BodyMotion, Noise, SumOfSquares
from palmd.observer.three_palms.record import BodyRecord
from palmd.system.three_palms import ThreePalmsRig
from palmd.system.vibration import VibrationLaw

GEOMETRY, OF_STEP, CHUNK = 24, 6, 32


class _BlockKernels(ctypes.Structure):
    _fields_ = (
        ("acceleration", ctypes.c_void_p), ("reading", ctypes.c_void_p),
        ("parameters", ctypes.c_long), ("harmonics", ctypes.c_long), ("acting", ctypes.c_double * RIG_INPUTS),
    )  # fmt: skip


class _Record(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("node_palms", "middle_palms", "geometry", "share", "value", "first")),
        ("intervals", ctypes.c_long),
        *((name, ctypes.c_double) for name in ("spacing", "reading", "spin", "by_spin", "turn")),
    )  # fmt: skip


_FILLED = "r", "sides", "by", "diagonal", "upper", "border", "nodes_gradient", "gradient", "residual", "force"


class _Equations(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_void_p) for name in _FILLED)


class CompiledEquations:
    """Of one record, for outlines up to degree `order`."""

    def __init__(self, record: BodyRecord, noise: Noise, rig: ThreePalmsRig, order: int) -> None:
        self._assemble, self._harmonics = written().body_equations, count(order)
        addresses, acting = _addresses(order, rig.vibration.law), tuple(rig.acting)
        self._of_all = _BlockKernels(*addresses[:2], count(order) + BODY, count(order), acting)
        self._of_motion = _BlockKernels(*addresses[2:], 0, 0, acting)
        K, S = len(record.middle_palms), len(record.interval)
        first = np.searchsorted(record.interval, np.arange(K + 1)).astype(np.int64)
        given = (record.node_palms, record.middle_palms, record.geometry, record.share, record.readings.value, first)
        self._held = tuple(map(np.ascontiguousarray, given))
        arrays = (each.ctypes.data for each in self._held)
        self._record = _Record(*arrays, K, record.spacing, noise.reading, noise.spin, noise.by_spin, noise.turn)
        self._intervals, self._readings = K, S
        self._of_rows: dict[int, tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = {}

    def at(self, motion: BodyMotion, *, nodes_alone: bool = False) -> SumOfSquares:
        """At `motion`; `nodes_alone`: as if the parameters were known, in less time."""
        m, model = (0, self._of_motion) if nodes_alone else (len(motion.p), self._of_all)
        arrow = Arrow.empty(self._intervals + 1, m)
        residual, force = np.empty((self._readings, 2)), np.empty((self._intervals + 1, 3))
        r, sides, by, work = self._rows(m)
        told = (arrow.diagonal, arrow.upper, arrow.border, arrow.nodes_gradient, arrow.gradient, residual, force)
        filled = _Equations(*(each.ctypes.data for each in (r, sides, by, *told)))
        R, omega, p = (np.ascontiguousarray(each) for each in (motion.R, motion.omega, motion.p))
        squares: float = self._assemble(
            ctypes.byref(model), ctypes.byref(self._record), R.ctypes.data, omega.ctypes.data, p.ctypes.data,
            ctypes.byref(filled), work.ctypes.data,
        )  # fmt: skip
        arrow.corner += by.T @ by
        return SumOfSquares(arrow, squares, residual, force)

    def _rows(self, m: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Residuals, their Jacobians in the nodes on both sides and in m parameters, room for kernels; kept."""
        if m not in self._of_rows:
            rows = OF_STEP * self._intervals + 2 * self._readings
            work = np.empty(CHUNK * (6 * m + 2 * self._harmonics))
            self._of_rows[m] = np.empty(rows), np.empty((rows, 2 * STATES)), np.empty((rows, m)), work
        return self._of_rows[m]


@cache
def _addresses(order: int, law: VibrationLaw) -> tuple[int | None, ...]:
    """Of the kernels of accelerations and readings, then of those of the motion alone."""
    kernels = library(order, law).opened()
    names = (f"{EXPORTED}{what}{of}_block" for of in ("", "_of_motion") for what in ("acceleration", "reading"))
    return tuple(ctypes.cast(kernels[name], ctypes.c_void_p).value for name in names)


@cache
def written() -> ctypes.CDLL:
    """`body_equations.c`; RuntimeError where it has other sizes than the model."""
    found = load("body_equations", list, written=[str(Path(__file__).with_name("body_equations.c"))]).opened()
    sizes = (STATES, PALM_INPUTS, RIG_INPUTS, GEOMETRY, OF_STEP, CHUNK)
    if tuple((ctypes.c_long * len(sizes)).in_dll(found, "body_equations_sizes")) != sizes:
        raise RuntimeError("body_equations.c has other sizes than the model")
    found.body_equations.argtypes, found.body_equations.restype = (ctypes.c_void_p,) * 7, ctypes.c_double
    return found
