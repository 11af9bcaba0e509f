"""Status of a pivoting grasp as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from palmd.cli.glance import status_of
from palmd.pivot_quantities import PIVOT
from palmd.system.pivot import AXES


def status_lines(result: Mapping[str, Any]) -> list[str]:
    """Return the gripper's position and the estimate from a status reply, as text lines."""
    positions = [f"{axis} {result[axis + '_m'] * 1e3:.1f} mm" for axis in AXES if axis + "_m" in result]
    return status_of(PIVOT, result["estimate"], "normals", "pivot", positions)
