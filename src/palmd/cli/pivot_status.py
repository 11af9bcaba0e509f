"""A pivoting grasp in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from palmd.cli.glance import known_in_words
from palmd.quantities import PIVOT
from palmd.system.pivot import AXES


def status_lines(result: Mapping[str, Any]) -> list[str]:
    """Where the gripper is, and what is known of the body in it, as a status tells it."""
    told = result["estimate"]
    places = [f"{axis} {result[axis + '_m'] * 1e3:.1f} mm" for axis in AXES if axis + "_m" in result]
    known = known_in_words(PIVOT, told)
    word = "valid" if told["valid"] else f"not valid: {told['reason']}"
    lines = [f"pivot   {', '.join(places)}"] if places else []
    lines.append(f"object  {word}; {told['touched']:.0%} of the normals felt")
    return [*lines, f"        {known}"] if known else lines
