"""Re-estimate a body's outline from its touched surface alone. Pure; not for the loop.

A fit with few harmonics compensates truncation errors of the touched surface elsewhere: over surface that was never
touched, overconfident coefficients predict bumps of a millimetre and hollows that no body has. A prediction from them
would roll over edges that do not exist.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from palmd.events import FloatArray
from palmd.model.icosphere import icosphere
from palmd.model.spherical import Y00, count, evaluator, order_of
from palmd.model.three_palms import BODY
from palmd.observer.three_palms.beliefs import Bools, shape_variance, truncation_sd
from palmd.observer.three_palms.smoother import BodyPrior

NEAR = math.cos(math.radians(4.0))
_DIAGONAL, _BESIDE = -BODY + np.array([0, 2, 5]), -BODY + np.array([1, 3, 4])
"""Indices of the inertia's parameters, in radii (`body.inertia`): logarithms of the diagonal; off-diagonal entries."""


def directions_near(normals: FloatArray) -> Bools:
    """(D,) which directions of `icosphere` lie within 4 degrees of any of `normals` (N, 3)."""
    directions, _ = icosphere()
    touched = np.zeros(len(directions), dtype=bool)
    for chunk in np.array_split(normals, max(len(normals) // 1000, 1)):
        touched |= (directions @ chunk.T).max(axis=1) >= NEAR
    return touched


@cache
def outline_rows(order: int) -> tuple[FloatArray, FloatArray]:
    """`evaluator` of all directions of `icosphere`."""
    return evaluator(order)(icosphere()[0])


def touched_outline(
    p: FloatArray, covariance: FloatArray, touched: Bools, order: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Replace the outline in p (m,) and the covariance (6 + m, 6 + m) of turn, spin and p by its touched part.

    touched: (D,) of `icosphere`, at least one. The new outline is the prior of any body, updated with the heights at
    touched directions as the fit has them, with the truncation error added once per lobe of the next degree (Woodbury's
    formula for both). Everything else keeps its distribution, the inertia in m², independent of the outline. order: the
    new outline's degree, not above the old one.
    """
    n = len(p) - BODY
    order = order_of(n) if order is None else order
    first, m = len(covariance) - len(p), count(order)
    old_rows, rows = outline_rows(order_of(n))[0][touched], outline_rows(order)[0][touched]
    heights = old_rows @ p[:n]
    radius = float(heights.mean())
    mean = np.zeros(m)
    mean[0] = radius / Y00
    weight = (order + 2) ** 2 / (len(touched) * float(truncation_sd(radius, order, touched).min()) ** 2)
    fitted = np.linalg.inv(covariance[first : first + n, first : first + n]) + weight * old_rows.T @ old_rows
    weighted_rows = weight * (rows - weight * old_rows @ np.linalg.solve(fitted, old_rows.T @ rows))
    outline_covariance = np.linalg.inv(rows.T @ weighted_rows + np.diag(1.0 / shape_variance(radius, order)))
    outline_covariance = 0.5 * (outline_covariance + outline_covariance.T)
    outline = mean + outline_covariance @ (weighted_rows.T @ (heights - rows @ mean))
    growth = abs(float(outline[0] / p[0]))  # the inertia depends on |radius| only
    mean_p = np.concatenate([outline, p[n:]])
    mean_p[_BESIDE] /= growth
    mean_p[_DIAGONAL] -= math.log(growth)
    in_metres = np.delete(np.eye(len(covariance)), slice(first, first + n), axis=0)
    in_metres[:, first] = _by_radius(p)
    in_metres[_BESIDE] /= growth
    to_radii = np.eye(first + len(mean_p))
    shape = slice(first, first + m)
    others = np.delete(np.arange(len(to_radii)), shape)
    to_radii[others, first] = -_by_radius(mean_p)
    joint = np.zeros_like(to_radii)
    joint[shape, shape] = outline_covariance
    joint[np.ix_(others, others)] = in_metres @ covariance @ in_metres.T
    joint = to_radii @ joint @ to_radii.T
    return mean_p, joint


def predictive_belief(belief: BodyPrior, touched: Bools) -> BodyPrior:
    """The prior for the rest of a record, with the outline of `touched_outline`; unchanged if that is singular."""
    try:
        covariance = np.asarray(np.linalg.inv(belief.information), np.float64)
        mean, covariance = touched_outline(belief.mean, covariance, touched)
        return BodyPrior(belief.R, belief.spin, mean, np.asarray(np.linalg.inv(covariance), np.float64))
    except np.linalg.LinAlgError:
        return belief


def _by_radius(p: FloatArray) -> FloatArray:
    """(6 + BODY,) derivatives of turn, spin and the inertia's parameters in metres by p[0], at fixed λ."""
    by_radius = np.zeros(6 + BODY)
    by_radius[_BESIDE] = p[_BESIDE]
    by_radius[_DIAGONAL] = 1.0
    return by_radius / float(p[0])
