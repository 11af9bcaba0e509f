"""Write a closed triangle mesh (mm) for other programs: binary STL, PLY or Wavefront OBJ as text."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray

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
