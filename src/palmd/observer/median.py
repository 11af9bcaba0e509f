"""Median identical to NumPy's to the last bit, without its masked arrays (15 ms to import). Safe in the loop."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray


def median(values: FloatArray) -> float:
    """Median of at least one value (N,); NaN where a value is NaN."""
    if np.isnan(values).any():
        return math.nan
    half = len(values) // 2
    ordered = np.partition(values, half)
    if len(values) % 2:
        return float(ordered[half])
    return float(ordered[:half].max() + ordered[half]) / 2
