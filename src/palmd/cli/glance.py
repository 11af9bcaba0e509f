"""Status of the systems other than two palms as text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from palmd.pivot_quantities import PIVOT
from palmd.quantities import Topic
from palmd.system.pivot import AXES
from palmd.system.three_palms import JOINTS
from palmd.three_palms_quantities import PALM3


def pivot_status(result: Mapping[str, Any]) -> list[str]:
    """Return the gripper's position and the estimate from a status reply, as text lines."""
    positions = [f"{axis} {result[axis + '_m'] * 1e3:.1f} mm" for axis in AXES if axis + "_m" in result]
    return _status(PIVOT, result["estimate"], "normals", "pivot", positions)


def three_palms_status(result: Mapping[str, Any]) -> list[str]:
    """Return the palms' angles and the estimate from a status reply, as text lines."""
    positions = [f"{joint} {math.degrees(result[joint + '_rad']):.1f}°" for joint in JOINTS if joint + "_rad" in result]
    return _status(PALM3, result["estimate"], "directions", "palms", positions)


def _status(
    topic: Topic, estimate: Mapping[str, Any], directions: str, label: str, positions: Sequence[str]
) -> list[str]:
    """Status as text lines: the joints' `positions` labelled `label`, validity, and coverage of `directions`."""
    word = "valid" if estimate["valid"] else f"not valid: {estimate['reason']}"
    lines = [f"{label:7} {', '.join(positions)}"] if positions else []
    lines.append(f"object  {word}; {estimate['touched']:.0%} of the {directions} touched")
    values = []
    for each in topic.quantities:
        if each.glance and estimate[each.name] is not None:
            factor, digits, unit = each.shown.factor, each.shown.digits, each.shown.unit
            sd = estimate["sd"].get(each.name)
            band = "" if sd is None else f" ± {sd * factor:.{digits}f}"
            values.append(f"{each.symbol} {estimate[each.name] * factor:.{digits}f}{band} {unit}".rstrip())
    return [*lines, f"        {', '.join(values)}"] if values else lines
