"""Condition a Gaussian belief on an inequality, such as the outline's v = h + h″ ≥ 0. Pure and safe inside the loop."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray


def cut_off(x: FloatArray, P: FloatArray, row: FloatArray) -> bool:
    """Condition the belief (mean x, covariance P, in place) on row·x ≥ 0; False where row·x has no variance.

    Mean and covariance become those of the normal distribution truncated at 0, exactly. For a mean below 0.
    """
    Ph = P @ row
    variance = float(row @ Ph)
    if not variance > 0.0:
        return False
    sd = math.sqrt(variance)
    depth = -float(row @ x) / sd
    rise = _mills(depth)
    x += Ph * (rise / sd)
    P -= np.outer(Ph, Ph) * (rise * (rise - depth) / variance)
    return True


def _mills(a: float) -> float:
    """Mean of the standard normal distribution truncated to values above `a` ≥ 0."""
    if a > 20.0:
        return a + 1.0 / a - 2.0 / a**3
    return math.exp(-a * a / 2) / (math.sqrt(math.pi / 2) * math.erfc(a / math.sqrt(2.0)))
