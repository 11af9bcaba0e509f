"""Three palms in space, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from palmd.cli.glance import status_of
from palmd.system.three_palms import JOINTS
from palmd.three_palms_quantities import PALM3


def status_lines(result: Mapping[str, Any]) -> list[str]:
    """Where the palms are, and what is known of the body between them, as a status tells it."""
    places = [f"{joint} {math.degrees(result[joint + '_rad']):.1f}°" for joint in JOINTS if joint + "_rad" in result]
    return status_of(PALM3, result["estimate"], "directions", "palms", places)
