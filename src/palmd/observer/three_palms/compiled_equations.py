"""Binding of `body_equations.c`, which computes `equations` of one record."""

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
        ("parameters", ctypes.c_long), ("harmonics", ctypes.c_long), ("rig", ctypes.c_double * RIG_INPUTS),
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
    """The equations of one record, for outlines up to degree `order`."""

    def __init__(self, record: BodyRecord, noise: Noise, rig: ThreePalmsRig, order: int) -> None:
        self._assemble, self._harmonics = c_library().body_equations, count(order)
        addresses, acting = _addresses(order, rig.vibration.law), tuple(rig.kernel_constants)
        self._full_model = _BlockKernels(*addresses[:2], count(order) + BODY, count(order), acting)
        self._motion_model = _BlockKernels(*addresses[2:], 0, 0, acting)
        K, S = len(record.middle_palms), len(record.interval)
        first = np.searchsorted(record.interval, np.arange(K + 1)).astype(np.int64)
        inputs = (record.node_palms, record.middle_palms, record.geometry, record.share, record.readings.value, first)
        self._inputs = tuple(map(np.ascontiguousarray, inputs))
        arrays = (each.ctypes.data for each in self._inputs)
        self._record = _Record(*arrays, K, record.spacing, noise.reading, noise.spin, noise.by_spin, noise.turn)
        self._intervals, self._readings = K, S
        self._row_buffers: dict[int, tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = {}

    def at(self, motion: BodyMotion, *, nodes_alone: bool = False) -> SumOfSquares:
        """Evaluate at `motion`; `nodes_alone`: with fixed parameters, which is faster."""
        m, model = (0, self._motion_model) if nodes_alone else (len(motion.p), self._full_model)
        arrow = Arrow.empty(self._intervals + 1, m)
        residual, force = np.empty((self._readings, 2)), np.empty((self._intervals + 1, 3))
        r, sides, by, work = self._rows(m)
        outputs = (arrow.diagonal, arrow.upper, arrow.border, arrow.nodes_gradient, arrow.gradient, residual, force)
        filled = _Equations(*(each.ctypes.data for each in (r, sides, by, *outputs)))
        R, omega, p = (np.ascontiguousarray(each) for each in (motion.R, motion.omega, motion.p))
        squares: float = self._assemble(
            ctypes.byref(model), ctypes.byref(self._record), R.ctypes.data, omega.ctypes.data, p.ctypes.data,
            ctypes.byref(filled), work.ctypes.data,
        )  # fmt: skip
        arrow.corner += by.T @ by
        return SumOfSquares(arrow, squares, residual, force)

    def _rows(self, m: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Reused buffers: residuals, Jacobians in the nodes on both sides and in m parameters, kernel workspace."""
        if m not in self._row_buffers:
            rows = OF_STEP * self._intervals + 2 * self._readings
            work = np.empty(CHUNK * (6 * m + 2 * self._harmonics))
            self._row_buffers[m] = np.empty(rows), np.empty((rows, 2 * STATES)), np.empty((rows, m)), work
        return self._row_buffers[m]


@cache
def _addresses(order: int, law: VibrationLaw) -> tuple[int | None, ...]:
    """Addresses of the kernels of accelerations and readings, then of those without parameter Jacobians."""
    kernels = library(order, law).opened()
    names = (f"{EXPORTED}{what}{of}_block" for of in ("", "_of_motion") for what in ("acceleration", "reading"))
    return tuple(ctypes.cast(kernels[name], ctypes.c_void_p).value for name in names)


@cache
def c_library() -> ctypes.CDLL:
    """Load `body_equations.c`; raises RuntimeError if its sizes differ from the model's."""
    found = load("body_equations", list, written=[str(Path(__file__).with_name("body_equations.c"))]).opened()
    sizes = (STATES, PALM_INPUTS, RIG_INPUTS, GEOMETRY, OF_STEP, CHUNK)
    if tuple((ctypes.c_long * len(sizes)).in_dll(found, "body_equations_sizes")) != sizes:
        raise RuntimeError("the sizes in body_equations.c differ from the model's")
    found.body_equations.argtypes, found.body_equations.restype = (ctypes.c_void_p,) * 7, ctypes.c_double
    return found
