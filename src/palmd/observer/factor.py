"""Quadratic costs of the constants and of one node: a prior, or what marginalisation leaves.

y = (p, x): the smoother's constants and a node (ψ, ω0). Pure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from palmd.events import FloatArray
from palmd.model.smoothing import CONSTANTS, NODE, C

SIZE = CONSTANTS + NODE
GAUGE_SD = 1e-7  # rad, of ψ at the first node


@dataclass(frozen=True, slots=True)
class Terms:
    """A cost at one y and its second-order expansion there: cost − 2 sideᵀδ + δᵀ matrix δ for y + δ.

    excess: by how much the cost exceeds its minimum.
    """

    cost: float
    excess: float
    matrix: FloatArray
    side: FloatArray


class Knowledge(Protocol):
    """Knowledge of (p, x) before the readings of a record; x is the record's first node."""

    @property
    def scale(self) -> FloatArray:
        """Scale (CONSTANTS) of a step of the constants in the damping."""

    def terms(self, p: FloatArray, x: FloatArray) -> Terms:
        """The cost and its expansion at (p, x)."""


@dataclass(frozen=True, slots=True)
class Prior:
    """Independent Gaussian prior of the constants and of ω0 (rad/s); ψ is gauge: 0.

    In place of ln ρ, B and w, `mean` and `sd` are of ln(ρ/h0), h0 the mean radius, of μ and of ln u_d.
    information: what other records of the object determine of the constants.
    """

    mean: FloatArray
    sd: FloatArray
    omega0_sd: float
    information: Factor | None = None

    @property
    def scale(self) -> FloatArray:
        """See `Knowledge`."""
        scale = self.sd.copy()
        dither = math.exp(self.mean[C.SATURATION])
        scale[C.DRAG] /= dither
        scale[C.SATURATION] *= 2.0 / dither**2
        return scale

    def terms(self, p: FloatArray, x: FloatArray) -> Terms:
        """See `Knowledge`."""
        miss = np.concatenate([p - self.mean, x])
        dither = p[C.SATURATION] ** -0.5
        mu = p[C.DRAG] * dither
        miss[C.LN_RHO] -= math.log(p[C.SHAPE])
        miss[C.DRAG] = mu - self.mean[C.DRAG]
        miss[C.SATURATION] = math.log(dither) - self.mean[C.SATURATION]
        sd = np.concatenate([self.sd, [GAUGE_SD, self.omega0_sd]])
        rows = np.diag(1.0 / sd)
        rows[C.LN_RHO, C.SHAPE] = -1.0 / (p[C.SHAPE] * self.sd[C.LN_RHO])
        rows[C.DRAG, [C.DRAG, C.SATURATION]] = np.array([dither, -0.5 * mu * dither**2]) / self.sd[C.DRAG]
        rows[C.SATURATION, C.SATURATION] = -0.5 * dither**2 / self.sd[C.SATURATION]
        miss /= sd
        cost, matrix, side = float(miss @ miss), rows.T @ rows, -(rows.T @ miss)
        if self.information is not None:
            added = self.information.moved(p[:CONSTANTS])
            cost += added.cost - self.information.cost
            matrix[:CONSTANTS, :CONSTANTS] += added.matrix
            side[:CONSTANTS] += added.side
        return Terms(cost, cost, matrix, side)


@dataclass(frozen=True, slots=True)
class Factor:
    """A quadratic cost of y: cost − 2 sideᵀ(y − about) + (y − about)ᵀ matrix (y − about).

    y may be longer than (p, x): the constants and several nodes.
    """

    about: FloatArray
    cost: float
    matrix: FloatArray
    side: FloatArray
    scale: FloatArray

    def terms(self, p: FloatArray, x: FloatArray) -> Terms:
        """See `Knowledge`."""
        here = self.moved(np.concatenate([p, x]))
        return Terms(here.cost, here.excess(), here.matrix, here.side)

    def moved(self, about: FloatArray) -> Factor:
        """The same cost, expanded about another point."""
        step = about - self.about
        pull = self.matrix @ step
        cost = self.cost - 2.0 * float(self.side @ step) + float(step @ pull)
        return Factor(about, cost, self.matrix, self.side - pull, self.scale)

    def plus(self, other: Factor) -> Factor:
        """The sum of both costs."""
        other = other.moved(self.about)
        matrix, side = self.matrix + other.matrix, self.side + other.side
        return Factor(self.about, self.cost + other.cost, matrix, side, self.scale)

    def minus(self, other: Factor) -> Factor:
        """The cost without `other`, which is a part of it."""
        other = other.moved(self.about)
        matrix, side = self.matrix - other.matrix, self.side - other.side
        return Factor(self.about, self.cost - other.cost, matrix, side, self.scale)

    def excess(self) -> float:
        """By how much the cost at `about` exceeds its minimum."""
        return float(self.side @ self.solved(self.side))

    def solved(self, sides: FloatArray) -> FloatArray:
        """matrix⁻¹ sides; raises LinAlgError where the cost does not determine y."""
        return cholesky_solved(self.matrix, sides)

    def log_determinant(self) -> float:
        """Log-determinant of the matrix; raises LinAlgError as `solved`."""
        with np.errstate(invalid="ignore"):
            scale = 1.0 / np.sqrt(np.diagonal(self.matrix))
        root = np.linalg.cholesky(self.matrix * np.outer(scale, scale))
        return 2.0 * float(np.log(np.diagonal(root)).sum() - np.log(scale).sum())

    def marginalised(self, dropped: slice) -> Factor:
        """The cost with the entries `dropped` of y marginalised."""
        is_dropped = np.zeros(len(self.about), dtype=np.bool_)
        is_dropped[dropped] = True
        across = self.matrix[np.ix_(is_dropped, ~is_dropped)]
        solved = cholesky_solved(
            self.matrix[np.ix_(is_dropped, is_dropped)], np.column_stack([across, self.side[is_dropped]])
        )
        matrix = self.matrix[np.ix_(~is_dropped, ~is_dropped)] - across.T @ solved[:, :-1]
        return Factor(
            self.about[~is_dropped],
            self.cost - float(self.side[is_dropped] @ solved[:, -1]),
            (matrix + matrix.T) / 2,
            self.side[~is_dropped] - across.T @ solved[:, -1],
            self.scale,
        )


def marginal_of_constants(known: Knowledge, p: FloatArray) -> Factor:
    """The marginal of the constants, expanded at `p`; raises LinAlgError where the node is not observed."""
    node = np.zeros(NODE)
    at = known.terms(p, node)
    whole = Factor(np.concatenate([p, node]), at.cost, at.matrix, at.side, known.scale)
    return whole.marginalised(slice(CONSTANTS, SIZE))


def conditional_covariance(covariance: FloatArray, known: slice, wanted: slice) -> FloatArray:
    """Covariance of the part `wanted` when the part `known` is known exactly: the Schur complement."""
    across = covariance[known, wanted]
    scale = np.sqrt(np.diagonal(covariance)[known])[:, None]
    solved = np.linalg.solve(covariance[known, known] / (scale * scale.T), across / scale)
    own: FloatArray = covariance[wanted, wanted]
    return own - (across / scale).T @ solved


def friction_of(p: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """μ and its 1σ, from the constants and their covariance (which may have more entries)."""
    dither = p[C.SATURATION] ** -0.5
    gradient = np.array([dither, -0.5 * p[C.DRAG] * dither**3])
    at = [C.DRAG, C.SATURATION]
    return float(p[C.DRAG] * dither), math.sqrt(float(gradient @ covariance[np.ix_(at, at)] @ gradient))


def cholesky_solved(matrix: FloatArray, sides: FloatArray) -> FloatArray:
    """matrix⁻¹ sides by Cholesky factorisation of the matrix scaled to a unit diagonal.

    Entries differ by twenty orders of magnitude. Raises LinAlgError where the matrix is not positive definite.
    """
    with np.errstate(invalid="ignore"):
        scale = 1.0 / np.sqrt(np.diagonal(matrix))
    root = np.linalg.cholesky(matrix * np.outer(scale, scale))
    column = scale if sides.ndim == 1 else scale[:, None]
    solved: FloatArray = column * np.linalg.solve(root.T, np.linalg.solve(root, column * sides))
    return solved
