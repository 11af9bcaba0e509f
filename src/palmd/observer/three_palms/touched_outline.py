"""A body's outline as the surface that was felt tells it. Pure; not for the loop.

A fit holds on to every reading with what few harmonics there are. What harmonics beyond the last leave out of the felt
surface it makes up for elsewhere: where nothing was touched, coefficients that are known too well by far tell bumps of
a millimetre and hollows that no body has. Whoever goes on by them, or looks ahead, rolls over edges that are none.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from palmd.events import FloatArray
from palmd.model.icosphere import icosphere
from palmd.model.spherical import Y00, count, evaluator, order_of
from palmd.model.three_palms import BODY
from palmd.observer.three_palms.beliefs import Bools, beyond_sd, shape_variance
from palmd.observer.three_palms.smoother import BodyPrior

NEAR = math.cos(math.radians(4.0))
_DIAGONAL, _BESIDE = -BODY + np.array([0, 2, 5]), -BODY + np.array([1, 3, 4])
"""Of what tells the inertia, in radii (`body.inertia`): logarithms on the diagonal, and what is beside it."""


def near(felt: FloatArray) -> Bools:
    """(D,) which of the directions of `icosphere` lie within 4 degrees of these (N, 3)."""
    directions, _ = icosphere()
    touched = np.zeros(len(directions), dtype=bool)
    for chunk in np.array_split(felt, max(len(felt) // 1000, 1)):
        touched |= (directions @ chunk.T).max(axis=1) >= NEAR
    return touched


@cache
def everywhere(order: int) -> tuple[FloatArray, FloatArray]:
    """As `evaluator`, of all directions of `icosphere`."""
    return evaluator(order)(icosphere()[0])


def felt_outline(
    p: FloatArray, covariance: FloatArray, touched: Bools, order: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """The parameters p (m,) and the covariance (6 + m, 6 + m) of turn, spin and p, the outline known by what was felt.

    touched: (D,) of `icosphere`, not none. Heights there, of a body as it is before any reading, are known as they are
    and to what harmonics leave out besides, once for each lobe of the degree after the last (both by Woodbury's
    formula). All else stays as it is believed, the inertia in m², apart from the outline. order: the degree up to which
    that goes from now on, no higher than it does.
    """
    n = len(p) - BODY
    order = order_of(n) if order is None else order
    first, m = len(covariance) - len(p), count(order)
    told_rows, rows = everywhere(order_of(n))[0][touched], everywhere(order)[0][touched]
    heights = told_rows @ p[:n]
    radius = float(heights.mean())
    mean = np.zeros(m)
    mean[0] = radius / Y00
    weight = (order + 2) ** 2 / (len(touched) * float(beyond_sd(radius, order, touched).min()) ** 2)
    fitted = np.linalg.inv(covariance[first : first + n, first : first + n]) + weight * told_rows.T @ told_rows
    weighed = weight * (rows - weight * told_rows @ np.linalg.solve(fitted, told_rows.T @ rows))
    known = np.linalg.inv(rows.T @ weighed + np.diag(1.0 / shape_variance(radius, order)))
    known = 0.5 * (known + known.T)
    outline = mean + known @ (weighed.T @ (heights - rows @ mean))
    larger = abs(float(outline[0] / p[0]))  # the inertia is as if the radius were positive
    told = np.concatenate([outline, p[n:]])
    told[_BESIDE] /= larger
    told[_DIAGONAL] -= math.log(larger)
    in_metres = np.delete(np.eye(len(covariance)), slice(first, first + n), axis=0)
    in_metres[:, first] = _by_radius(p)
    in_metres[_BESIDE] /= larger
    back = np.eye(first + len(told))
    shape = slice(first, first + m)
    others = np.delete(np.arange(len(back)), shape)
    back[others, first] = -_by_radius(told)
    apart = np.zeros_like(back)
    apart[shape, shape] = known
    apart[np.ix_(others, others)] = in_metres @ covariance @ in_metres.T
    apart = back @ apart @ back.T
    return told, apart


def foretelling(ahead: BodyPrior, touched: Bools) -> BodyPrior:
    """The belief that a record goes on with, its outline as `felt_outline` has it; as it is where it cannot be told."""
    try:
        covariance = np.asarray(np.linalg.inv(ahead.information), np.float64)
        mean, covariance = felt_outline(ahead.mean, covariance, touched)
        return BodyPrior(ahead.R, ahead.spin, mean, np.asarray(np.linalg.inv(covariance), np.float64))
    except np.linalg.LinAlgError:
        return ahead


def _by_radius(p: FloatArray) -> FloatArray:
    """(6 + BODY,) by how much turn, spin and what tells the inertia in metres change with p[0], the λ kept."""
    by_radius = np.zeros(6 + BODY)
    by_radius[_BESIDE] = p[_BESIDE]
    by_radius[_DIAGONAL] = 1.0
    return by_radius / float(p[0])
