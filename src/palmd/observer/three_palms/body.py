"""What follows from a body's parameters and motion: inertia, where palms touch it, its centre of mass between them."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray
from palmd.model.spherical import Y00, evaluator, order_of
from palmd.model.three_palms import MOMENT

ORDER = 12
"""The degree up to which outlines are estimated."""
FINER_LIVE = (16,)
"""The same of a live body that is found twice, but not explained to its noise by that."""
FINER = (20, 26)
"""The same of a whole record, one after the other."""


def inertia(p: FloatArray) -> FloatArray:
    """(3, 3) in the body's frame, per unit mass (m²)."""
    first, low, second, lowest, lower, third = p[-9:-3].tolist()
    L = np.array([[math.exp(first), 0.0, 0.0], [low, math.exp(second), 0.0], [lowest, lower, math.exp(third)]])
    root = MOMENT * Y00 * p[0] * L
    moment = root @ root.T
    about: FloatArray = (moment[0, 0] + moment[1, 1] + moment[2, 2]) * np.eye(3) - moment
    return about


def touching(R: FloatArray, palms: FloatArray) -> FloatArray:
    """(T, 3 palms, 3) outward normals, in the body's frame, where palms (T, 36) touch what is turned by R (T, 3, 3)."""
    return np.asarray(-np.einsum("tji,tnj->tni", R, palms[:, :9].reshape(-1, 3, 3)))


def centres_of(R: FloatArray, palms: FloatArray, p: FloatArray) -> FloatArray:
    """(T, 3) centres of mass (m, world) for rotations (T, 3, 3) between palms (T, 36)."""
    n = len(p) - 9
    h = (evaluator(order_of(n))(touching(R, palms).reshape(-1, 3))[0] @ p[:n]).reshape(-1, 3)
    return np.asarray(np.linalg.solve(palms[:, :9].reshape(-1, 3, 3), h[..., None])[..., 0])
