"""What JSON has no form for: numbers that are none."""

from __future__ import annotations

import math
from typing import Any


def or_none(value: Any) -> Any:
    """The same value with None for every number that is not finite, in lists and maps too."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):  # a plain number needs no call: most are
        return {
            name: each if type(each) is float and math.isfinite(each) else or_none(each) for name, each in value.items()
        }
    if isinstance(value, list):
        return [each if type(each) is float and math.isfinite(each) else or_none(each) for each in value]
    return value
