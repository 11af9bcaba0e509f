"""A closed surface of triangles as a file other programs read: binary STL, or PLY and Wavefront OBJ as text; in mm."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray

Triangles = npt.NDArray[np.int64]
Mesh = tuple[FloatArray, Triangles]
"""Points (P, 3) in m, and triangles (F, 3) between them, counterclockwise seen from outside."""
_HEADER = b"palmd".ljust(80, b"\0")


def as_stl(mesh: Mesh) -> bytes:
    """A mesh as binary STL."""
    points, triangles = mesh
    corners = 1e3 * points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    rows = np.zeros(len(triangles), dtype=[("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
    rows["vectors"][:, 0], rows["vectors"][:, 1:] = normals, corners
    return _HEADER + np.uint32(len(triangles)).tobytes() + rows.tobytes()


def as_ply(mesh: Mesh) -> bytes:
    """The same as PLY."""
    points, triangles = mesh
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    head += [f"property double {axis}" for axis in "xyz"]
    head += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(f"{value:.6f}" for value in point) for point in 1e3 * points]
    rows += ["3 " + " ".join(map(str, triangle)) for triangle in triangles.tolist()]
    return ("\n".join([*head, *rows]) + "\n").encode()


def as_obj(mesh: Mesh) -> bytes:
    """The same as OBJ."""
    points, triangles = mesh
    rows = ["v " + " ".join(f"{value:.6f}" for value in point) for point in 1e3 * points]
    rows += ["f " + " ".join(str(corner + 1) for corner in triangle) for triangle in triangles.tolist()]
    return ("\n".join(rows) + "\n").encode()


MESHES: Mapping[str, Callable[[Mesh], bytes]] = {".stl": as_stl, ".ply": as_ply, ".obj": as_obj}
"""What makes a mesh of which suffix."""
