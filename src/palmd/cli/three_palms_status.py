"""Three palms in space, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from palmd.cli.glance import known_in_words
from palmd.quantities import PALM3
from palmd.system.three_palms import JOINTS


def status_lines(result: Mapping[str, Any]) -> list[str]:
    """Where the palms are, and what is known of the body between them, as a status tells it."""
    told = result["estimate"]
    places = [f"{joint} {math.degrees(result[joint + '_rad']):.1f}°" for joint in JOINTS if joint + "_rad" in result]
    known = known_in_words(PALM3, told)
    word = "valid" if told["valid"] else f"not valid: {told['reason']}"
    lines = [f"palms   {', '.join(places)}"] if places else []
    lines.append(f"object  {word}; {told['touched']:.0%} of the directions felt")
    return [*lines, f"        {known}"] if known else lines
