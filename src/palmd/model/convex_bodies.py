"""Make Gaussian beliefs of a body convex: over untouched surface, their mean and draws may be hollow. Pure."""

from __future__ import annotations

from functools import cache

import numpy as np

from palmd.events import FloatArray
from palmd.model.icosphere import icosphere
from palmd.model.spherical import hessian_rows, order_of

HALVINGS = 3  # icosphere subdivisions of the directions that are tested: 642
LEAST_RADIUS = 0.1  # required radius of curvature, relative to the body's mean radius
CONSTRAINT_SD = 0.05  # 1σ of that constraint, relative to the mean radius
MOST_CONSTRAINTS = 96  # directions constrained at once, the most hollow ones
ROUNDS = 4  # iterations


def curvature_rows(order: int, u: FloatArray) -> FloatArray:
    """(D, 3, n) rows of ∇²H in two axes normal to each unit normal u (D, 3): both second derivatives, and the mixed."""
    hessian = hessian_rows(order, u)
    return np.stack([hessian[:, 0, 0], hessian[:, 1, 1], hessian[:, 1, 0]], axis=1)


@cache
def _rows_everywhere(order: int) -> FloatArray:
    return curvature_rows(order, icosphere(HALVINGS)[0])


def least_radii(c: FloatArray, along: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """(D,) smaller principal radius of curvature (m) in each direction, and (D, n) rows that map c to it.

    along: (D, 3, n) `curvature_rows` of these directions; default: 642 directions over the whole body.
    """
    along = _rows_everywhere(order_of(len(c))) if along is None else along
    first, second, mixed = (along @ c).T
    angle = 0.5 * np.arctan2(2.0 * mixed, first - second) + 0.5 * np.pi  # direction of the smaller radius
    weights = np.stack([np.cos(angle) ** 2, np.sin(angle) ** 2, np.sin(2.0 * angle)], axis=1)
    rows = np.einsum("dk,dkn->dn", weights, along)
    return np.asarray(rows @ c, np.float64), rows


def nearest_convex(x: FloatArray, covariance: FloatArray, shape: slice, along: FloatArray | None = None) -> FloatArray:
    """Move x (m,), the mean or a draw of a belief with this covariance (m, m), to the nearest convex body.

    Each hollow direction is fused as a measurement of its radius, so that well-known directions stay. shape: the
    outline's coefficients within x. along: as in `least_radii`, the directions to be made convex.
    """
    x = x.copy()
    mean = x[shape][0] / np.sqrt(4.0 * np.pi)
    least, noise = LEAST_RADIUS * mean, (CONSTRAINT_SD * mean) ** 2
    for _ in range(ROUNDS):
        radii, rows = least_radii(x[shape], along)
        hollow = np.argsort(radii)[:MOST_CONSTRAINTS]
        hollow = hollow[radii[hollow] < 0.5 * least]
        if not len(hollow):
            break
        gain_rows = covariance[:, shape] @ rows[hollow].T
        innovation = rows[hollow] @ gain_rows[shape]
        innovation[np.diag_indices_from(innovation)] += noise
        x += gain_rows @ np.linalg.solve(innovation, least - radii[hollow])
    return x
