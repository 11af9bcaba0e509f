"""Directions evenly spread over the sphere, with triangles between them: a subdivided icosahedron."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.system.three_palms import HALVINGS


@cache
def icosphere(halvings: int = HALVINGS) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """(unit vectors (10·4^k + 2, 3), triangles (20·4^k, 3), counterclockwise from outside) for k = `halvings`."""
    g = (1.0 + np.sqrt(5.0)) / 2.0
    corners = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)]
    corners += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6)]
    faces += [(7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10)]
    faces += [(8, 6, 7), (9, 8, 1)]
    points, triangles = np.array(corners) / np.hypot(1.0, g), np.array(faces)
    for _ in range(halvings):
        a, b, c = triangles.T
        edges = np.sort(np.concatenate([np.stack(pair, axis=1) for pair in ((a, b), (b, c), (c, a))]), axis=1)
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = len(points) + which.reshape(3, -1)
        middles = points[unique].sum(1)
        points = np.concatenate([points, middles / np.linalg.norm(middles, axis=1)[:, None]])
        parts = ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return points, triangles
