"""A body's surface in space from its support function on the icosphere's directions: points, and shadows. Pure."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray
from palmd.model.icosphere import icosphere

PLANES = {"x, y": (0, 1), "x, z": (0, 2), "y, z": (1, 2)}
"""The body's axes in each plane that a shadow is cast on."""
NORMALS = 180
"""Of a shadow's outline, evenly spread from 0."""

NEAREST = 4


def surface_points(h: FloatArray, halvings: int) -> FloatArray:
    """The surface's point (D, 3) (m) with each direction as its normal: h n and the slope of h (m) there."""
    n, triangles = icosphere(halvings)
    i, j = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).T
    step = n[j] - n[i] * np.sum(n[i] * n[j], axis=1)[:, None]
    rise: FloatArray = h[j] - h[i] * np.sum(n[i] * n[j], axis=1)
    normal = np.zeros((len(n), 3, 3))
    right = np.zeros((len(n), 3))
    np.add.at(normal, i, step[:, :, None] * step[:, None, :])
    np.add.at(right, i, step * rise[:, None])
    normal += n[:, :, None] * n[:, None, :]  # the slope has no part along the normal
    slope = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    points: FloatArray = h[:, None] * n + slope
    return points


def shadow(values: FloatArray, halvings: int, plane: str) -> FloatArray:
    """What holds on the directions within a plane: (NORMALS,) of `values` (D,), between the nearest directions.

    Of a support function it is that of the body's shadow on the plane.
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
