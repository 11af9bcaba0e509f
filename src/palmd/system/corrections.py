"""Correction of a pad's readings by a measured map: a natural cubic spline through its points. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

LEAST_POINTS = 2  # (derivation: a line needs as many)
CLOSEST_MM = 1e-3  # smallest distance of two points (derivation: finer than any pad's resolution)
FARTHEST_MM = (
    1000.0  # largest distance of a point from the hinge, and largest correction (convention: no pad is longer)
)
STEEPEST = 0.2
"""Largest slope of corrections along a pad (convention; from 1 on readings run backwards and have no unique position).
"""


def fault_of(points_mm: Sequence[tuple[float, float]]) -> str:
    """Why these pairs (mm) are not a valid map of a pad; empty if they are."""
    if len(points_mm) < LEAST_POINTS:
        return f"must have {LEAST_POINTS} pairs [place_mm, correction_mm] or more"
    if any(not abs(value) <= FARTHEST_MM for point in points_mm for value in point):
        return f"must have no position or correction beyond {FARTHEST_MM:g} mm"
    for (position, correction), (next_position, next_correction) in pairwise(points_mm):
        if next_position < position + CLOSEST_MM:
            return f"must be in order of position, {CLOSEST_MM:g} mm apart or more; {next_position:g} mm is not"
        if abs(next_correction - correction) > STEEPEST * (next_position - position):
            return f"must have a slope of {STEEPEST:.0%} at most; {position:g} to {next_position:g} mm is steeper"
    return ""


def corrections(points: Sequence[tuple[float, float]], places: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Corrections to add to readings at `places` (n,), from `points` of (position, correction) in order of position.

    In the points' units. Constant beyond the first and the last point, where the second derivative is zero (natural
    spline; de Boor, A Practical Guide to Splines, 1978, chapter IV).
    """
    at, values = np.array(points, dtype=np.float64).T
    steps, rises = np.diff(at), np.diff(values)
    bends = np.zeros(len(at))  # second derivatives
    if len(at) > LEAST_POINTS:
        inner = np.diag(2.0 * (steps[:-1] + steps[1:])) + np.diag(steps[1:-1], 1) + np.diag(steps[1:-1], -1)
        bends[1:-1] = np.linalg.solve(inner, 6.0 * np.diff(rises / steps))
    x = np.clip(np.asarray(places, dtype=np.float64), at[0], at[-1])
    k = np.clip(np.searchsorted(at, x, side="right") - 1, 0, len(steps) - 1)
    u, step = (x - at[k]) / steps[k], steps[k]
    cubic = (u**3 - u) * bends[k + 1] + ((1.0 - u) ** 3 - (1.0 - u)) * bends[k]
    interpolated: npt.NDArray[np.float64] = values[k] + u * rises[k] + step**2 / 6.0 * cubic
    return interpolated
