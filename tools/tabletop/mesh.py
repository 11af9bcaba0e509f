"""Triangle meshes of the printed parts: reading of STL files, and checks for printing and assembly. Pure."""

from __future__ import annotations

import math
import struct
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_SAME_MM = 1e-4
_RAY = np.array([0.0137, 0.0291])  # mm: offset of rays from the grid on which edges lie


@dataclass(frozen=True, slots=True)
class Mesh:
    """`triangles` (n, 3 corners, 3 coordinates) in mm, counterclockwise seen from outside."""

    triangles: Array

    @property
    def size(self) -> Array:
        """Size of the bounding box (mm)."""
        corners = self.triangles.reshape(-1, 3)
        extent: Array = corners.max(axis=0) - corners.min(axis=0)
        return extent

    @property
    def volume(self) -> float:
        """Volume in mm³; positive if the triangles face outwards."""
        a, b, c = self.triangles.transpose(1, 0, 2)
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0

    def moved(self, turn: Array, shift: Array) -> Mesh:
        """Return the mesh rotated by the matrix `turn` and translated by `shift` (mm)."""
        return Mesh(self.triangles @ turn.T + shift)


def turned(axis: str, angle_deg: float) -> Array:
    """Return the rotation matrix about `y` (from z to x) or `z` (from x to y)."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    rows = {"y": [[c, 0, s], [0, 1, 0], [-s, 0, c]], "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}
    return np.array(rows[axis], dtype=float)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    """Return a closed box between two corners (mm)."""
    faces = ((0, 2, 6, 4), (1, 5, 7, 3), (0, 4, 5, 1), (2, 3, 7, 6), (0, 1, 3, 2), (4, 6, 7, 5))
    ends = np.array([low, high])
    corners = np.array([[ends[i >> 2 & 1, 0], ends[i >> 1 & 1, 1], ends[i & 1, 2]] for i in range(8)])
    triangles = [corners[[a, b, c]] for f in faces for a, b, c in ((f[0], f[1], f[2]), (f[0], f[2], f[3]))]
    return Mesh(np.array(triangles))


def read_stl(path: Path) -> Mesh:
    """Read a binary or text STL file; raises ValueError for other files."""
    data = path.read_bytes()
    if len(data) >= 84 and len(data) == 84 + 50 * struct.unpack_from("<I", data, 80)[0]:
        records = np.frombuffer(data, dtype=np.dtype([("v", "<f4", (4, 3)), ("a", "<u2")]), offset=84)
        return Mesh(records["v"][:, 1:].astype(float))
    words = [line.split() for line in data.decode("ascii", "replace").splitlines() if "vertex" in line]
    if not words or len(words) % 3:
        raise ValueError(f"{path} is no STL file")
    return Mesh(np.array([[float(value) for value in each[1:4]] for each in words]).reshape(-1, 3, 3))


def open_edges(mesh: Mesh) -> int:
    """Count the edges that are not shared by exactly two triangles in opposite directions; 0: watertight."""
    keys = [tuple(corner) for corner in np.round(mesh.triangles.reshape(-1, 3) / _SAME_MM).astype(np.int64).tolist()]
    ways: Counter[tuple[tuple[int, ...], tuple[int, ...]]] = Counter()
    for i in range(0, len(keys), 3):
        for a, b in ((i, i + 1), (i + 1, i + 2), (i + 2, i)):
            ways[keys[a], keys[b]] += 1
    return sum(count != 1 or ways[end, start] != 1 for (start, end), count in ways.items())


def fits(mesh: Mesh, bed_mm: float) -> bool:
    """Whether the bounding box fits into a cube of the bed's side."""
    return bool(np.all(mesh.size <= bed_mm))


def surface_points(mesh: Mesh, spacing_mm: float, depth_mm: float) -> Array:
    """Return points over the whole surface, at most `spacing_mm` apart, each `depth_mm` below it."""
    found = []
    for a, b, c in mesh.triangles:
        normal = np.cross(b - a, c - a)
        area = float(np.linalg.norm(normal))
        if area < 1e-9:
            continue
        longest = max(map(np.linalg.norm, (b - a, c - b, a - c)))
        n = max(1, math.ceil(float(longest) / spacing_mm))
        steps = np.array([(i, j) for i in range(n) for j in range(n - i)])
        u, v = ((steps + 1 / 3) / n).T
        found.append(a + np.outer(u, b - a) + np.outer(v, c - a) - depth_mm * normal / area)
    return np.concatenate(found)


def inside(mesh: Mesh, points: Array) -> npt.NDArray[np.bool_]:
    """Return which points are inside a closed mesh: an upward ray from each crosses it an odd number of times."""
    corners = mesh.triangles.reshape(-1, 3)
    within = np.all((points >= corners.min(axis=0)) & (points <= corners.max(axis=0)), axis=1)
    result = np.zeros(len(points), dtype=np.bool_)
    crossings = np.zeros(int(within.sum()), dtype=np.int64)
    x, y, z = points[within].T
    x, y = x + _RAY[0] * 1e-3, y + _RAY[1] * 1e-3
    for a, b, c in mesh.triangles:
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        near = (
            (x >= min(a[0], b[0], c[0])) & (x <= max(a[0], b[0], c[0]))
            & (y >= min(a[1], b[1], c[1])) & (y <= max(a[1], b[1], c[1]))
        ).nonzero()[0]  # fmt: skip
        px, py = x[near], y[near]
        u = ((px - a[0]) * (c[1] - a[1]) - (py - a[1]) * (c[0] - a[0])) / area
        v = ((b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0])) / area
        height = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
        crossings[near] += (u >= 0) & (v >= 0) & (u + v <= 1) & (height > z[near])
    result[within] = crossings % 2 == 1
    return result


def overlaps(one: Mesh, other: Mesh, *, spacing_mm: float = 1.0, depth_mm: float = 0.05) -> bool:
    """Whether a part of either surface is more than `depth_mm` inside the other mesh."""
    for a, b in ((one, other), (other, one)):
        near = _reaching(a, b)
        if len(near.triangles) and inside(b, surface_points(near, spacing_mm, depth_mm)).any():
            return True
    return False


def _reaching(one: Mesh, other: Mesh) -> Mesh:
    """Return the triangles of `one` whose bounding boxes intersect that of `other`."""
    corners = other.triangles.reshape(-1, 3)
    low, high = one.triangles.min(axis=1), one.triangles.max(axis=1)
    return Mesh(one.triangles[np.all((high >= corners.min(axis=0)) & (low <= corners.max(axis=0)), axis=1)])
