"""Quantities derived from a body's parameters and motion: inertia, contact normals, centre of mass."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray
from palmd.model.spherical import Y00, evaluator, order_of
from palmd.model.three_palms import MOMENT

ORDER = 12
"""Degree of estimated outlines."""
FINER_ORDERS_LIVE = (16,)
"""Finer degrees of a live body that is confirmed, but not explained to its noise by `ORDER`."""
FINER_ORDERS = (20, 26)
"""Finer degrees for whole records, tried one after the other."""

SPIN_NOISE, SPIN_NOISE_BY_SPIN, TURN_NOISE = 1e-3, 1e-2, 1e-7
"""Process noise as spectral densities: of the spin ((rad/s)²/s), its increase by |ω|² (1/s), of the rotation (rad²/s).
"""


def inertia(p: FloatArray) -> FloatArray:
    """(3, 3) inertia in the body's frame, per unit mass (m²)."""
    first, low, second, lowest, lower, third = p[-9:-3].tolist()
    L = np.array([[math.exp(first), 0.0, 0.0], [low, math.exp(second), 0.0], [lowest, lower, math.exp(third)]])
    root = MOMENT * Y00 * p[0] * L
    moment = root @ root.T
    about: FloatArray = (moment[0, 0] + moment[1, 1] + moment[2, 2]) * np.eye(3) - moment
    return about


def contact_normals(R: FloatArray, palms: FloatArray) -> FloatArray:
    """(T, 3 palms, 3) outward normals at the contacts, in the body's frame; rotations R (T, 3, 3), palms (T, 36)."""
    return np.asarray(-np.einsum("tji,tnj->tni", R, palms[:, :9].reshape(-1, 3, 3)))


def centres_of(R: FloatArray, palms: FloatArray, p: FloatArray) -> FloatArray:
    """(T, 3) centres of mass (m, world) for rotations (T, 3, 3) between palms (T, 36)."""
    n = len(p) - 9
    h = (evaluator(order_of(n))(contact_normals(R, palms).reshape(-1, 3))[0] @ p[:n]).reshape(-1, 3)
    return np.asarray(np.linalg.solve(palms[:, :9].reshape(-1, 3, 3), h[..., None])[..., 0])
