"""The arithmetic of the smoother's normal equations: readings weighed, assembled, and reduced to the constants.

Compiled in `model/normal_equations.c`; a twin in NumPy and SciPy serves without a compiler, and to check it
against. Rows are `wide` enough for what they are in the constants, then the right-hand side, then zeros. A matrix in
the nodes is banded, (BAND, n) as LAPACK's lower form. Not for use inside the loop.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Protocol

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


class Arithmetic(Protocol):
    """What is compiled, and its twin."""

    def weighed(self, predicted: FloatArray, value: FloatArray, variance: FloatArray, weight: FloatArray) -> Weighed:
        """Readings beside their predictions; `weight` is what each counts."""

    def assembled(self, steps: StepRows, readings: Sequence[ReadingRows]) -> Assembled:
        """The normal equations of these residuals."""

    def reduced(self, banded: FloatArray, damping: FloatArray, rows: FloatArray, corner: FloatArray) -> Reduced:
        """The matrix with `damping` (NODE) on its diagonal factored; corner − rowsᵀ matrix⁻¹ rows is left.

        `rows` (n, w), w a multiple of `LANES`. Raises LinAlgError where the matrix is not positive definite.
        """

    def back(self, reduced: Reduced, by: FloatArray) -> FloatArray:
        """L⁻ᵀ (rows · by): the nodes (n)."""


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


class Compiled:
    """See `Arithmetic`."""

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
        """See `Arithmetic`."""
        n = len(value)
        residual, root, room, told = np.empty(n), np.empty(n), np.empty(n), np.empty(4)
        given = (_at(each, n) for each in (predicted, value, variance, weight))
        self._weigh(n, *given, GATE, *map(_at, (residual, root, room, told)))
        cost, chi2, outliers, astray = told.tolist()
        chi2 = (math.inf if outliers == n else chi2) if n else 0.0
        return Weighed(residual, root, cost, chi2, outliers / max(n, 1), int(astray))

    def assembled(self, steps: StepRows, readings: Sequence[ReadingRows]) -> Assembled:
        """See `Arithmetic`."""
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
        """See `Arithmetic`."""
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
        """See `Arithmetic`."""
        n, width = reduced.rows.shape
        x = np.zeros(n)
        self._back(_at(reduced.factor), n, _at(reduced.rows), width, _at(by, width), _at(x))
        return x


def _at(array: FloatArray | IntArray, *shape: int) -> int:
    """The address of an array, of this shape where one is given; ValueError for others, which C would not notice."""
    if not array.flags.c_contiguous or array.itemsize != 8 or (shape and array.shape != shape):
        raise ValueError(f"an array is {array.dtype} {array.shape}, not of {shape or 'numbers one after the other'}")
    return array.ctypes.data


class Twin:
    """See `Arithmetic`: the same in NumPy and SciPy, slowly."""

    def weighed(self, predicted: FloatArray, value: FloatArray, variance: FloatArray, weight: FloatArray) -> Weighed:
        """See `Arithmetic`."""
        n = len(value)
        residual = value - predicted
        nis = residual**2 / variance
        # far from the answer all residuals are large: only what stands out from the others is an outlier
        gate = GATE * max(1.0, float(np.median(nis)) / 0.455) if n else GATE
        outlier = nis > gate
        root = np.sqrt(np.where(outlier, gate / np.maximum(nis, gate), 1.0) * weight / variance)
        cost = weight * np.where(outlier, gate * (1.0 + np.log(np.maximum(nis, gate) / gate)), nis)
        # of what is no outlier: those are counted, and have no say in how well the others are explained
        chi2 = float(nis[~outlier].mean()) if n and not outlier.all() else math.inf
        outliers = float(outlier.sum()) / max(n, 1)
        return Weighed(residual, root, float(cost.sum()), chi2 if n else 0.0, outliers, _longest_run(outlier))

    def assembled(self, steps: StepRows, readings: Sequence[ReadingRows]) -> Assembled:
        """See `Arithmetic`."""
        from scipy.sparse import csr_matrix

        count, n, side_at, width = len(steps.end), steps.x.size, steps.constants, wide(steps.constants)
        J = steps.jacobian.transpose(0, 2, 1).reshape(count * NODE, NODE + side_at)
        root = steps.root.ravel()
        # every residual is a row, divided by its one-sigma: first the steps' ends, then the readings
        in_nodes = [np.column_stack([J[:, :NODE], np.full(len(J), -1.0)]).ravel() * np.repeat(root, NODE + 1)]
        in_constants = [J[:, NODE:] * root[:, None]]
        residual = [(steps.end - steps.x[1:]).ravel() * root]
        slack = float(residual[0] @ residual[0])
        for each in readings:
            in_nodes.append((each.gradient[:, : 2 * NODE] * each.root[:, None]).ravel())
            in_constants.append(each.gradient[:, 2 * NODE :] * each.root[:, None])
            residual.append(-each.residual * each.root)
        border, side = np.concatenate(in_constants), np.concatenate(residual)
        shape = (len(side), n)
        sparse = csr_matrix((np.concatenate(in_nodes), *_pattern(count, [each.step for each in readings])), shape=shape)
        across = sparse.T.tocsr()
        normal = across @ sparse
        banded, rows, corner = np.zeros((BAND, n)), np.zeros((n, width)), np.zeros((width, width))
        for k in range(BAND):
            banded[k, : n - k] = normal.diagonal(-k)
        rows[:, :side_at], rows[:, side_at] = across @ border, -(across @ side)
        corner[:side_at, :side_at] = border.T @ border
        corner[side_at, :side_at] = corner[:side_at, side_at] = -(border.T @ side)
        corner[side_at, side_at] = side @ side
        return Assembled(banded, rows, corner, slack)

    def reduced(self, banded: FloatArray, damping: FloatArray, rows: FloatArray, corner: FloatArray) -> Reduced:
        """See `Arithmetic`."""
        from scipy.linalg import cholesky_banded, solve_banded

        damped = banded.copy()
        damped[0] += np.tile(damping, damped.shape[1] // NODE)
        try:
            factor = cholesky_banded(damped, lower=True)
        except ValueError as error:  # what scipy says of numbers that are not finite
            raise np.linalg.LinAlgError(str(error)) from error
        solved = solve_banded((BAND - 1, 0), factor, rows)
        return Reduced(factor, solved, corner - solved.T @ solved)

    def back(self, reduced: Reduced, by: FloatArray) -> FloatArray:
        """See `Arithmetic`."""
        from scipy.linalg import solve_banded

        upper = np.zeros_like(reduced.factor)
        for k in range(BAND):
            upper[BAND - 1 - k, k:] = reduced.factor[k, : reduced.factor.shape[1] - k]
        x: FloatArray = solve_banded((0, BAND - 1), upper, reduced.rows @ by)
        return x


def _longest_run(flags: npt.NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.intp), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _pattern(steps: int, readings: Sequence[IntArray]) -> tuple[IntArray, IntArray]:
    """Columns and row starts of the residuals' Jacobian in the nodes, as `Twin` fills it."""
    k = np.arange(steps)
    ends = np.stack([np.stack([2 * k, 2 * k + 1, 2 * k + 2 + i], axis=1) for i in range(NODE)], axis=1)
    columns = [np.add.outer(NODE * step, np.arange(2 * NODE)) for step in readings]
    lengths = np.concatenate([np.full(NODE * len(k), NODE + 1), *(np.full(len(each), 2 * NODE) for each in readings)])
    starts = np.concatenate([[0], np.cumsum(lengths)])
    return np.concatenate([ends.ravel(), *(each.ravel() for each in columns)]), starts


@cache
def arithmetic() -> Arithmetic:
    """What is compiled, else its twin."""
    path = smoothing.library().path
    return Twin() if path is None else Compiled(ctypes.CDLL(str(path)))
