"""Status of three palms as text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from palmd.cli.glance import status_of
from palmd.system.three_palms import JOINTS
from palmd.three_palms_quantities import PALM3


def status_lines(result: Mapping[str, Any]) -> list[str]:
    """Return the palms' angles and the estimate from a status reply, as text lines."""
    positions = [f"{joint} {math.degrees(result[joint + '_rad']):.1f}°" for joint in JOINTS if joint + "_rad" in result]
    return status_of(PALM3, result["estimate"], "directions", "palms", positions)
