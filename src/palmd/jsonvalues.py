"""JSON values for numbers that JSON cannot represent."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt


def or_none(value: Any) -> Any:
    """The same value with None for every number that is not finite, also within lists, tuples (as lists) and maps."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):  # most values are plain numbers and need no recursive call
        return {
            name: each if type(each) is float and math.isfinite(each) else or_none(each) for name, each in value.items()
        }
    if isinstance(value, list | tuple):
        return [each if type(each) is float and math.isfinite(each) else or_none(each) for each in value]
    return value


def column(values: npt.NDArray[np.float64] | None) -> Any:
    """An array as lists, with None for every number that is not finite; None for no array."""
    return None if values is None else or_none(values.tolist())
