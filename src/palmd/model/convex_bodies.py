"""Beliefs of a body made convex: a Gaussian belief of what was never felt folds over, and no body does. Pure."""

from __future__ import annotations

from functools import cache

import numpy as np

from palmd.events import FloatArray
from palmd.model.icosphere import icosphere
from palmd.model.spherical import bends, order_of

HALVINGS = 3  # of the directions in which a draw is to be convex: 642
LEAST_RADIUS = 0.1  # of curvature anywhere, as a share of the body's mean radius
KEPT_SD = 0.05  # share by which that is asked for
MOST_ASKED = 96  # directions at once, the most hollow ones
ROUNDS = 4


def bending(order: int, u: FloatArray) -> FloatArray:
    """(D, 3, n) rows of ∇²H along two axes across each unit normal u (D, 3): of both, and of the mixed derivative."""
    along = bends(order, u)
    return np.stack([along[:, 0, 0], along[:, 1, 1], along[:, 1, 0]], axis=1)


@cache
def _everywhere(order: int) -> FloatArray:
    return bending(order, icosphere(HALVINGS)[0])


def least_radii(c: FloatArray, along: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """(D,) the smaller radius of curvature (m) in each direction, and (D, n) the rows that tell it of c.

    along: (D, 3, n) `bending` in these directions; without it in 642 all over the body.
    """
    along = _everywhere(order_of(len(c))) if along is None else along
    first, second, mixed = (along @ c).T
    angle = 0.5 * np.arctan2(2.0 * mixed, first - second) + 0.5 * np.pi  # of the axis along which it is
    weights = np.stack([np.cos(angle) ** 2, np.sin(angle) ** 2, np.sin(2.0 * angle)], axis=1)
    rows = np.einsum("dk,dkn->dn", weights, along)
    return np.asarray(rows @ c, np.float64), rows


def convex(x: FloatArray, covariance: FloatArray, shape: slice, along: FloatArray | None = None) -> FloatArray:
    """A draw x (m,) of a belief, or its mean, moved as little as its covariance (m, m) allows until it is convex.

    shape: where in x the coefficients of the outline are. along: as for `least_radii`, where it is to be convex. What
    is known well stays: each direction that is hollow counts as a measurement of its radius.
    """
    x = x.copy()
    mean = x[shape][0] / np.sqrt(4.0 * np.pi)
    least, noise = LEAST_RADIUS * mean, (KEPT_SD * mean) ** 2
    for _ in range(ROUNDS):
        radii, rows = least_radii(x[shape], along)
        hollow = np.argsort(radii)[:MOST_ASKED]
        hollow = hollow[radii[hollow] < 0.5 * least]
        if not len(hollow):
            break
        across = covariance[:, shape] @ rows[hollow].T
        told = rows[hollow] @ across[shape]
        told[np.diag_indices_from(told)] += noise
        x += across @ np.linalg.solve(told, least - radii[hollow])
    return x
