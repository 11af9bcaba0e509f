"""A body's surface in space from its support function on the icosphere's directions: points and projections. Pure."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray
from palmd.model.icosphere import icosphere

PLANES = {"x, y": (0, 1), "x, z": (0, 2), "y, z": (1, 2)}
"""The body's axes that span each projection plane."""
NORMALS = 180
"""Number of normals of a projected outline, evenly spaced from 0."""

NEAREST = 4  # directions of the icosphere used for interpolation


def surface_points(h: FloatArray, halvings: int) -> FloatArray:
    """The surface points (D, 3) (m) with the directions n as normals: h n + ∇h, the gradient by least squares."""
    n, triangles = icosphere(halvings)
    i, j = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).T
    step = n[j] - n[i] * np.sum(n[i] * n[j], axis=1)[:, None]
    rise: FloatArray = h[j] - h[i] * np.sum(n[i] * n[j], axis=1)
    gram = np.zeros((len(n), 3, 3))
    moment = np.zeros((len(n), 3))
    np.add.at(gram, i, step[:, :, None] * step[:, None, :])
    np.add.at(moment, i, step * rise[:, None])
    gram += n[:, :, None] * n[:, None, :]  # the gradient has no component along n
    slope = np.linalg.solve(gram, moment[:, :, None])[:, :, 0]
    points: FloatArray = h[:, None] * n + slope
    return points


def shadow(values: FloatArray, halvings: int, plane: str) -> FloatArray:
    """Interpolate `values` (D,) at the directions within a plane: (NORMALS,).

    For a support function the result is the support function of the body's projection onto the plane.
    """
    n, _ = icosphere(halvings)
    theta = np.arange(NORMALS) * (math.tau / NORMALS)
    wanted = np.zeros((NORMALS, 3))
    first, second = PLANES[plane]
    wanted[:, first], wanted[:, second] = np.cos(theta), np.sin(theta)
    near = np.argsort(-wanted @ n.T, axis=1)[:, :NEAREST]
    weights = (np.linalg.pinv(np.swapaxes(n[near], 1, 2)) @ wanted[:, :, None])[:, :, 0]
    found: FloatArray = np.sum(weights * values[near], axis=1)
    return found
