"""The arithmetic of the smoother's normal equations: readings weighed, assembled, and reduced to the constants.

Compiled in `model/normal_equations.c`. Rows are `wide` enough for what they are in the constants, then the right-hand
side, then zeros. A matrix in the nodes is banded, (BAND, n) as LAPACK's lower form. Not for use inside the loop.
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

GATE = 16.0  # squared normalised residual beyond which a reading's pull falls off: 4 sigma
BAND = 2 * NODE  # diagonals, from the main one down
MOST_WIDE = 128


def wide(constants: int) -> int:
    """How wide rows are for so many constants."""
    return -(-(constants + 1) // LANES) * LANES


@dataclass(frozen=True, slots=True)
class StepRows:
    """Each step's end (K, 2), its Jacobian (K, 2 + constants, 2) and one over its one-sigma (K, 2), at nodes x."""

    x: FloatArray
    end: FloatArray
    jacobian: FloatArray
    root: FloatArray

    @property
    def constants(self) -> int:
        """How many there are."""
        return int(self.jacobian.shape[1]) - NODE


@dataclass(frozen=True, slots=True)
class ReadingRows:
    """Readings of one kind: the step of each, gradient (n, 4 + constants), value − prediction, one over one-sigma."""

    step: IntArray
    gradient: FloatArray
    residual: FloatArray
    root: FloatArray


@dataclass(frozen=True, slots=True)
class Weighed:
    """Readings of one kind: value − prediction, one over one-sigma (less for outliers), and what the cost is made of.

    chi2: the mean square of what is no outlier, in sigmas; infinite where all are, 0 where there is none. outliers: the
    share of those. astray: the longest run of them.
    """

    residual: FloatArray
    root: FloatArray
    cost: float
    chi2: float
    outliers: float
    astray: int


@dataclass(frozen=True, slots=True)
class Assembled:
    """banded (BAND, n), rows (n, w), corner (w, w), and the sum of the steps' squares."""

    banded: FloatArray
    rows: FloatArray
    corner: FloatArray
    slack: float


@dataclass(frozen=True, slots=True)
class Reduced:
    """Cholesky's factor L (BAND, n) of a banded matrix, `rows` = L⁻¹ rows (n, w), and what is left of a corner."""

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
    """What `model/normal_equations.c` computes."""

    def __init__(self, library: ctypes.CDLL):
        """Raises RuntimeError where the library's sizes are not the model's."""
        wanted = [NODE, LANES, MOST_WIDE]
        if list((ctypes.c_long * len(wanted)).in_dll(library, "normal_equations_sizes")) != wanted:
            raise RuntimeError("model/normal_equations.c has other sizes than model/smoothing.py")
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
        """Readings beside their predictions; `weight` is what each counts."""
        n = len(value)
        residual, root, room, told = np.empty(n), np.empty(n), np.empty(n), np.empty(4)
        given = (_at(each, n) for each in (predicted, value, variance, weight))
        self._weigh(n, *given, GATE, *map(_at, (residual, root, room, told)))
        cost, chi2, outliers, astray = told.tolist()
        chi2 = (math.inf if outliers == n else chi2) if n else 0.0
        return Weighed(residual, root, cost, chi2, outliers / max(n, 1), int(astray))

    def assembled(self, steps: StepRows, readings: Sequence[ReadingRows]) -> Assembled:
        """The normal equations of these residuals."""
        count, n, constants, width = len(steps.end), steps.x.size, steps.constants, wide(steps.constants)
        if width > MOST_WIDE:
            raise ValueError(f"there is room for {MOST_WIDE - 1} constants, not {constants}")
        told = _Steps(
            _at(steps.x, count + 1, NODE), _at(steps.end, count, NODE),
            _at(steps.jacobian, count, NODE + constants, NODE), _at(steps.root, count, NODE), count, constants, width,
        )  # fmt: skip
        kinds = (_ReadingsStruct * max(len(readings), 1))()
        for kind, each in zip(kinds, readings, strict=False):
            kind.count = many = len(each.step)
            if many and not 0 <= each.step.min() <= each.step.max() < count:
                raise ValueError("a reading lies in no step")
            kind.gradient, kind.step = _at(each.gradient, many, 2 * NODE + constants), _at(each.step, many)
            kind.residual, kind.root = _at(each.residual, many), _at(each.root, many)
        banded, rows, corner = np.zeros((BAND, n)), np.zeros((n, width)), np.zeros((width, width))
        slack = self._assemble(ctypes.byref(told), kinds, len(readings), _at(banded), _at(rows), _at(corner))
        return Assembled(banded, rows, corner, slack)

    def reduced(self, banded: FloatArray, damping: FloatArray, rows: FloatArray, corner: FloatArray) -> Reduced:
        """The matrix with `damping` (NODE) on its diagonal factored; corner − rowsᵀ matrix⁻¹ rows is left.

        `rows` (n, w), w a multiple of `LANES`. Raises LinAlgError where the matrix is not positive definite.
        """
        banded = np.ascontiguousarray(banded)
        n, width = rows.shape
        if width % LANES:
            raise ValueError(f"rows are of a multiple of {LANES} columns, not {width}")
        factor, rows, left = np.zeros((BAND, n)), rows.copy(), corner.copy()
        result, matrix = (_at(factor), _at(rows), width, _at(left, width, width)), _at(banded, BAND, n)
        if self._reduce(matrix, n, n, _at(damping, NODE), *result):
            raise np.linalg.LinAlgError("not positive definite")
        return Reduced(factor, rows, left)

    def back(self, reduced: Reduced, by: FloatArray) -> FloatArray:
        """L⁻ᵀ (rows · by): the nodes (n)."""
        n, width = reduced.rows.shape
        x = np.zeros(n)
        self._back(_at(reduced.factor), n, _at(reduced.rows), width, _at(by, width), _at(x))
        return x


def _at(array: FloatArray | IntArray, *shape: int) -> int:
    """The address of an array, of this shape where one is given; ValueError for others, which C would not notice."""
    if not array.flags.c_contiguous or array.itemsize != 8 or (shape and array.shape != shape):
        raise ValueError(f"an array is {array.dtype} {array.shape}, not of {shape or 'numbers one after the other'}")
    return array.ctypes.data


@cache
def arithmetic() -> Arithmetic:
    """That of the smoother's library."""
    return Arithmetic(smoothing.library().opened())
