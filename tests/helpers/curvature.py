"""Radii of curvature of a body between three palms, as eigenvalues of its Hessian."""

import numpy as np

from palmd.model.spherical import hessian_rows, order_of


def curvatures(c, u):
    """(T, 2) radii (m), the smaller one first, at outward unit normals (T, 3)."""
    bend = hessian_rows(order_of(len(c)), u) @ c
    return np.linalg.eigvalsh(0.5 * (bend + bend.transpose(0, 2, 1)))
