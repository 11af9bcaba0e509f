"""A body's surface in space: points and projections of a support function; its mesh as STL, PLY or OBJ (mm). Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.icosphere import icosphere

Triangles = npt.NDArray[np.int64]
Colours = npt.NDArray[np.uint8]
_HEADER = b"palmd".ljust(80, b"\0")

SD_RANGE_M = (3e-6, 3e-4)
"""Standard deviations at both ends of the logarithmic colour scale."""
SD_COLOURS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]])
UNTOUCHED = np.array([176, 176, 176])


@dataclass(frozen=True, slots=True)
class Mesh:
    """Points (P, 3) in m and triangles (F, 3), counterclockwise seen from outside.

    sd: (P,) standard deviation of the height (m); touched: (P,) whether a palm touched there. None if unknown.
    """

    points: FloatArray
    triangles: Triangles
    sd: FloatArray | None = None
    touched: npt.NDArray[np.bool_] | None = None


def sd_colours(sd: FloatArray, touched: npt.NDArray[np.bool_]) -> Colours:
    """(P, 3) red, green, blue: by standard deviation where touched (dark is small), grey elsewhere."""
    low, high = np.log(SD_RANGE_M)
    fraction = (np.log(np.maximum(sd, 1e-12)) - low) / (high - low)
    steps = np.linspace(0.0, 1.0, len(SD_COLOURS))
    mixed = np.stack([np.interp(fraction, steps, SD_COLOURS[:, k]) for k in range(3)], axis=1)
    return np.where(touched[:, None], mixed, UNTOUCHED).round().astype(np.uint8)


def as_stl(mesh: Mesh) -> bytes:
    """A mesh as binary STL."""
    triangles = mesh.triangles
    corners = 1e3 * mesh.points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    rows = np.zeros(len(triangles), dtype=[("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
    rows["vectors"][:, 0], rows["vectors"][:, 1:] = normals, corners
    return _HEADER + np.uint32(len(triangles)).tobytes() + rows.tobytes()


def as_ply(mesh: Mesh) -> bytes:
    """A mesh as PLY, coloured by standard deviation; its value in mm is each vertex's `quality`."""
    head = ["ply", "format ascii 1.0", "comment mm", f"element vertex {len(mesh.points)}"]
    head += [f"property double {axis}" for axis in "xyz"]
    rows = [" ".join(f"{value:.6f}" for value in point) for point in 1e3 * mesh.points]
    if mesh.sd is not None and mesh.touched is not None:
        head += [f"property uchar {colour}" for colour in ("red", "green", "blue")] + ["property double quality"]
        colours = sd_colours(mesh.sd, mesh.touched).tolist()
        rows = [
            f"{row} {red} {green} {blue} {1e3 * sd:.6f}"
            for row, (red, green, blue), sd in zip(rows, colours, mesh.sd, strict=True)
        ]
    head += [f"element face {len(mesh.triangles)}", "property list uchar int vertex_indices", "end_header"]
    rows += ["3 " + " ".join(map(str, triangle)) for triangle in mesh.triangles.tolist()]
    return ("\n".join([*head, *rows]) + "\n").encode()


def as_obj(mesh: Mesh) -> bytes:
    """A mesh as Wavefront OBJ."""
    rows = ["v " + " ".join(f"{value:.6f}" for value in point) for point in 1e3 * mesh.points]
    rows += ["f " + " ".join(str(corner + 1) for corner in triangle) for triangle in mesh.triangles.tolist()]
    return ("\n".join(rows) + "\n").encode()


MESHES: Mapping[str, Callable[[Mesh], bytes]] = {".stl": as_stl, ".ply": as_ply, ".obj": as_obj}
"""Writers by file suffix."""


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
