"""What a measured map adds to a pad's readings: a natural cubic spline through its points. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

LEAST_POINTS = 2  # (derivation: a line has as many)
CLOSEST_MM = 1e-3  # of two points (derivation: less than any pad resolves)
FARTHEST_MM = 1000.0  # of a point from the hinge, and of a correction (convention: longer is no pad)
STEEPEST = 0.2
"""Of corrections along a pad (convention; from 1 on readings run backwards, and a reading has no place of its own)."""


def fault_of(points_mm: Sequence[tuple[float, float]]) -> str:
    """Why these pairs (mm) are no map of a pad; empty where they are one."""
    if len(points_mm) < LEAST_POINTS:
        return f"must have {LEAST_POINTS} pairs [place_mm, correction_mm] or more"
    if any(not abs(value) <= FARTHEST_MM for point in points_mm for value in point):
        return f"must have no place or correction beyond {FARTHEST_MM:g} mm"
    for (place, correction), (next_place, next_correction) in pairwise(points_mm):
        if next_place < place + CLOSEST_MM:
            return f"must be in order of place, {CLOSEST_MM:g} mm apart or more, and {next_place:g} mm is not"
        if abs(next_correction - correction) > STEEPEST * (next_place - place):
            return f"must change by {STEEPEST:.0%} of the way at most, and from {place:g} to {next_place:g} mm does not"
    return ""


def corrections(points: Sequence[tuple[float, float]], places: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """What is added to readings at `places` (n,), by `points` of (place, correction) in order of place.

    In the points' units. Beyond the first and the last point it is as there. The second derivative is zero at both
    (natural spline; de Boor, A Practical Guide to Splines, 1978, chapter IV).
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
    found: npt.NDArray[np.float64] = values[k] + u * rises[k] + step**2 / 6.0 * cubic
    return found
