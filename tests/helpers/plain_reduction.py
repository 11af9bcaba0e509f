"""Independent normal-equation arithmetic of the smoother in NumPy and SciPy; see `palmd.observer.reduction`."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.linalg import cholesky_banded, solve_banded
from scipy.sparse import csr_matrix

from palmd.events import FloatArray
from palmd.model.smoothing import NODE
from palmd.observer.reduction import BAND, GATE, Assembled, IntArray, ReadingRows, Reduced, StepRows, Weighed, wide


class PlainArithmetic:
    """See `reduction.Arithmetic`."""

    def weighed(self, predicted: FloatArray, value: FloatArray, variance: FloatArray, weight: FloatArray) -> Weighed:
        """See `Arithmetic`."""
        n = len(value)
        residual = value - predicted
        nis = residual**2 / variance
        # far from the solution all residuals are large; only values that differ from the rest are outliers
        gate = GATE * max(1.0, float(np.median(nis)) / 0.455) if n else GATE
        outlier = nis > gate
        root = np.sqrt(np.where(outlier, gate / np.maximum(nis, gate), 1.0) * weight / variance)
        cost = weight * np.where(outlier, gate * (1.0 + np.log(np.maximum(nis, gate) / gate)), nis)
        # statistics of inliers only; outliers are counted separately
        chi2 = float(nis[~outlier].mean()) if n and not outlier.all() else math.inf
        outliers = float(outlier.sum()) / max(n, 1)
        return Weighed(residual, root, float(cost.sum()), chi2 if n else 0.0, outliers, _longest_run(outlier))

    def assembled(self, steps: StepRows, readings: Sequence[ReadingRows]) -> Assembled:
        """See `Arithmetic`."""
        count, n, side_at, width = len(steps.end), steps.x.size, steps.constants, wide(steps.constants)
        J = steps.jacobian.transpose(0, 2, 1).reshape(count * NODE, NODE + side_at)
        root = steps.root.ravel()
        # each residual is a row divided by its 1σ: first the steps' ends, then the readings
        in_nodes = [np.column_stack([J[:, :NODE], np.full(len(J), -1.0)]).ravel() * np.repeat(root, NODE + 1)]
        in_constants = [J[:, NODE:] * root[:, None]]
        residual = [(steps.end - steps.x[1:]).ravel() * root]
        process_cost = float(residual[0] @ residual[0])
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
        return Assembled(banded, rows, corner, process_cost)

    def reduced(self, banded: FloatArray, damping: FloatArray, rows: FloatArray, corner: FloatArray) -> Reduced:
        """See `Arithmetic`."""
        damped = banded.copy()
        damped[0] += np.tile(damping, damped.shape[1] // NODE)
        try:
            factor = cholesky_banded(damped, lower=True)
        except ValueError as error:  # raised by SciPy for numbers that are not finite
            raise np.linalg.LinAlgError(str(error)) from error
        solved = solve_banded((BAND - 1, 0), factor, rows)
        return Reduced(factor, solved, corner - solved.T @ solved)

    def back(self, reduced: Reduced, by: FloatArray) -> FloatArray:
        """See `Arithmetic`."""
        upper = np.zeros_like(reduced.factor)
        for k in range(BAND):
            upper[BAND - 1 - k, k:] = reduced.factor[k, : reduced.factor.shape[1] - k]
        x: FloatArray = solve_banded((0, BAND - 1), upper, reduced.rows @ by)
        return x


def _longest_run(flags: npt.NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.intp), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _pattern(steps: int, readings: Sequence[IntArray]) -> tuple[IntArray, IntArray]:
    """Columns and row starts of the residuals' Jacobian in the nodes, as `PlainArithmetic` fills it."""
    k = np.arange(steps)
    ends = np.stack([np.stack([2 * k, 2 * k + 1, 2 * k + 2 + i], axis=1) for i in range(NODE)], axis=1)
    columns = [np.add.outer(NODE * step, np.arange(2 * NODE)) for step in readings]
    lengths = np.concatenate([np.full(NODE * len(k), NODE + 1), *(np.full(len(each), 2 * NODE) for each in readings)])
    starts = np.concatenate([[0], np.cumsum(lengths)])
    return np.concatenate([ends.ravel(), *(each.ravel() for each in columns)]), starts
