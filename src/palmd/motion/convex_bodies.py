"""Beliefs of a body made convex: a Gaussian belief of what was never felt folds over, and no body does. Pure."""

from __future__ import annotations

from functools import cache

import numpy as np

from palmd.events import FloatArray
from palmd.model.icosphere import icosphere
from palmd.model.spherical import evaluator

HALVINGS = 3  # of the directions in which a draw is to be convex: 642
STEP_RAD = 1e-4  # of the difference that second derivatives are taken by
LEAST_RADIUS = 0.1  # of curvature anywhere, as a share of the body's mean radius
KEPT_SD = 0.05  # share by which that is asked for
MOST_ASKED = 96  # directions at once, the most hollow ones
ROUNDS = 4


@cache
def _bends(order: int) -> FloatArray:
    """(D, 3, n) rows of ∇²H along two axes across each direction: of both, and of the mixed derivative."""
    u = icosphere(HALVINGS)[0]
    one = np.cross(u, np.eye(3)[np.abs(u).argmin(axis=1)])
    one /= np.linalg.norm(one, axis=1)[:, None]
    axes = np.stack([one, np.cross(u, one)])
    slopes = []
    for axis in axes:
        ahead, behind = (u + sign * STEP_RAD * axis for sign in (1.0, -1.0))
        ends = [each / np.linalg.norm(each, axis=1)[:, None] for each in (ahead, behind)]
        slopes.append((evaluator(order)(ends[0])[1] - evaluator(order)(ends[1])[1]) / (2.0 * STEP_RAD))
    pairs = ((0, 0), (1, 1), (0, 1))
    return np.stack([np.einsum("di,din->dn", axes[k], slopes[j]) for j, k in pairs], axis=1)


def least_radii(c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(D,) the smaller radius of curvature (m) in each direction, and (D, n) the rows that tell it of c."""
    bends = _bends(round(np.sqrt(len(c))) - 1)
    first, second, mixed = (bends @ c).T
    angle = 0.5 * np.arctan2(2.0 * mixed, first - second) + 0.5 * np.pi  # of the axis along which it is
    weights = np.stack([np.cos(angle) ** 2, np.sin(angle) ** 2, np.sin(2.0 * angle)], axis=1)
    rows = np.einsum("dk,dkn->dn", weights, bends)
    return np.asarray(rows @ c, np.float64), rows


def convex(x: FloatArray, covariance: FloatArray, shape: slice) -> FloatArray:
    """A draw x (m,) of a belief, or its mean, moved as little as its covariance (m, m) allows until it is convex.

    shape: where in x the coefficients of the outline are. What is known well stays: each direction that is hollow
    counts as a measurement of its radius.
    """
    x = x.copy()
    mean = x[shape][0] / np.sqrt(4.0 * np.pi)
    least, noise = LEAST_RADIUS * mean, (KEPT_SD * mean) ** 2
    for _ in range(ROUNDS):
        radii, rows = least_radii(x[shape])
        hollow = np.argsort(radii)[:MOST_ASKED]
        hollow = hollow[radii[hollow] < 0.5 * least]
        if not len(hollow):
            break
        across = covariance[:, shape] @ rows[hollow].T
        told = rows[hollow] @ across[shape]
        told[np.diag_indices_from(told)] += noise
        x += across @ np.linalg.solve(told, least - radii[hollow])
    return x
