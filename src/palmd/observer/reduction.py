"""Arithmetic of the smoother's normal equations: weigh readings, assemble, and reduce to the constants.

Compiled in `model/normal_equations.c`. Rows have the entries of the constants, then the right-hand side, then zeros up
to `wide`. A matrix of the nodes is banded, (BAND, n) as LAPACK's lower form. Not for use inside the loop.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model import smoothing
from palmd.model.compiled import LANES
from palmd.model.smoothing import NODE

IntArray = npt.NDArray[np.intp]

GATE = 16.0  # squared normalised residual beyond which a reading's weight decreases: 4σ
BAND = 2 * NODE  # diagonals, from the main one down
MOST_WIDE = 128


def wide(constants: int) -> int:
    """Width of rows for this number of constants."""
    return -(-(constants + 1) // LANES) * LANES


@dataclass(frozen=True, slots=True)
class StepRows:
    """End of each step (K, 2), its Jacobian (K, 2 + constants, 2) and 1/σ of it (K, 2), at nodes x."""

    x: FloatArray
    end: FloatArray
    jacobian: FloatArray
    root: FloatArray

    @property
    def constants(self) -> int:
        """Number of constants."""
        return int(self.jacobian.shape[1]) - NODE


@dataclass(frozen=True, slots=True)
class ReadingRows:
    """Readings of one kind: the step of each, gradient (n, 4 + constants), value − prediction, and 1/σ."""

    step: IntArray
    gradient: FloatArray
    residual: FloatArray
    root: FloatArray


@dataclass(frozen=True, slots=True)
class Weighed:
    """Readings of one kind: value − prediction, 1/σ (reduced for outliers), and the parts of the cost.

    chi2: mean square of the normalised residuals without outliers; infinite where all are outliers, 0 without readings.
    outliers: their share. outlier_run: the longest run of them.
    """

    residual: FloatArray
    root: FloatArray
    cost: float
    chi2: float
    outliers: float
    outlier_run: int


@dataclass(frozen=True, slots=True)
class Assembled:
    """banded (BAND, n), rows (n, w), corner (w, w), and the sum of the steps' squares."""

    banded: FloatArray
    rows: FloatArray
    corner: FloatArray
    process_cost: float


@dataclass(frozen=True, slots=True)
class Reduced:
    """Cholesky factor L (BAND, n) of a banded matrix, `rows` = L⁻¹ rows (n, w), and the reduced corner."""

    factor: FloatArray
    rows: FloatArray
    left: FloatArray


class _Steps(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("x", "end", "jacobian", "root")),
        *((name, ctypes.c_long) for name in ("steps", "constants", "width")),
    )


class _ReadingsStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("gradient", "residual", "root", "step")),
        ("count", ctypes.c_long),
    )


class Arithmetic:
    """The functions of `model/normal_equations.c`."""

    def __init__(self, library: ctypes.CDLL):
        """Raises RuntimeError where the library's sizes are not those of the model."""
        wanted = [NODE, LANES, MOST_WIDE]
        if list((ctypes.c_long * len(wanted)).in_dll(library, "normal_equations_sizes")) != wanted:
            raise RuntimeError(
                "the sizes in model/normal_equations.c differ from those in model/smoothing.py; build it again"
            )
        pointer, number = ctypes.c_void_p, ctypes.c_long
        self._assemble, self._reduce, self._back = library.assemble, library.reduce, library.back
        self._weigh = library.weigh
        self._weigh.argtypes = (number, *(pointer,) * 4, ctypes.c_double, *(pointer,) * 4)
        self._weigh.restype = None
        self._assemble.argtypes = (pointer, pointer, number, pointer, pointer, pointer)
        self._assemble.restype = ctypes.c_double
        self._reduce.argtypes = (pointer, number, number, pointer, pointer, pointer, number, pointer)
        self._back.argtypes, self._back.restype = (pointer, number, pointer, number, pointer, pointer), None

    def weighed(self, predicted: FloatArray, value: FloatArray, variance: FloatArray, weight: FloatArray) -> Weighed:
        """Residuals and weights of readings; `weight` is that of each reading."""
        n = len(value)
        residual, root, workspace, sums = np.empty(n), np.empty(n), np.empty(n), np.empty(4)
        inputs = (_at(each, n) for each in (predicted, value, variance, weight))
        self._weigh(n, *inputs, GATE, *map(_at, (residual, root, workspace, sums)))
        cost, chi2, outliers, outlier_run = sums.tolist()
        chi2 = (math.inf if outliers == n else chi2) if n else 0.0
        return Weighed(residual, root, cost, chi2, outliers / max(n, 1), int(outlier_run))

    def assembled(self, steps: StepRows, readings: Sequence[ReadingRows]) -> Assembled:
        """The normal equations of these residuals."""
        count, n, constants, width = len(steps.end), steps.x.size, steps.constants, wide(steps.constants)
        if width > MOST_WIDE:
            raise ValueError(f"too many constants: {constants}; the limit is {MOST_WIDE - 1}")
        steps_struct = _Steps(
            _at(steps.x, count + 1, NODE), _at(steps.end, count, NODE),
            _at(steps.jacobian, count, NODE + constants, NODE), _at(steps.root, count, NODE), count, constants, width,
        )  # fmt: skip
        kinds = (_ReadingsStruct * max(len(readings), 1))()
        for kind, each in zip(kinds, readings, strict=False):
            kind.count = readings_of_kind = len(each.step)
            if readings_of_kind and not 0 <= each.step.min() <= each.step.max() < count:
                raise ValueError("a reading is in no step")
            kind.gradient, kind.step = (
                _at(each.gradient, readings_of_kind, 2 * NODE + constants),
                _at(each.step, readings_of_kind),
            )
            kind.residual, kind.root = _at(each.residual, readings_of_kind), _at(each.root, readings_of_kind)
        banded, rows, corner = np.zeros((BAND, n)), np.zeros((n, width)), np.zeros((width, width))
        process_cost = self._assemble(
            ctypes.byref(steps_struct), kinds, len(readings), _at(banded), _at(rows), _at(corner)
        )
        return Assembled(banded, rows, corner, process_cost)

    def reduced(self, banded: FloatArray, damping: FloatArray, rows: FloatArray, corner: FloatArray) -> Reduced:
        """Factor the matrix with `damping` (NODE) on its diagonal; the reduced corner is corner − rowsᵀ matrix⁻¹ rows.

        rows (n, w), w a multiple of `LANES`. Raises LinAlgError where the matrix is not positive definite.
        """
        banded = np.ascontiguousarray(banded)
        n, width = rows.shape
        if width % LANES:
            raise ValueError(f"the number of columns must be a multiple of {LANES}, not {width}")
        factor, rows, left = np.zeros((BAND, n)), rows.copy(), corner.copy()
        result, matrix = (_at(factor), _at(rows), width, _at(left, width, width)), _at(banded, BAND, n)
        if self._reduce(matrix, n, n, _at(damping, NODE), *result):
            raise np.linalg.LinAlgError("not positive definite")
        return Reduced(factor, rows, left)

    def back(self, reduced: Reduced, by: FloatArray) -> FloatArray:
        """Back substitution L⁻ᵀ (rows · by): the nodes (n)."""
        n, width = reduced.rows.shape
        x = np.zeros(n)
        self._back(_at(reduced.factor), n, _at(reduced.rows), width, _at(by, width), _at(x))
        return x


def _at(array: FloatArray | IntArray, *shape: int) -> int:
    """Address of an array, of this shape where one is given; ValueError for others, which C would not notice."""
    if not array.flags.c_contiguous or array.itemsize != 8 or (shape and array.shape != shape):
        raise ValueError(f"an array is {array.dtype} {array.shape}, not contiguous of shape {shape or 'any'}")
    return array.ctypes.data


@cache
def arithmetic() -> Arithmetic:
    """The arithmetic in the smoother's library."""
    return Arithmetic(smoothing.library().opened())
