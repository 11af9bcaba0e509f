"""Straight parts of an outline: flat sides, or dents that the palms bridge. Pure.

What palms feel is the convex hull, on which a dent is a chord: the contact jumps along it while the object does not
turn. So does it along a flat side, and no touch tells one from the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray

STRAIGHT = 4.0
"""Radius of curvature, in mean radii, from which on an outline is called straight: ellipses of 2 to 1 have 2.7."""
LEAST_M = 1e-3
"""A shorter chord is none."""
MEANT = "flat side, or dent bridged"


@dataclass(frozen=True, slots=True)
class Chord:
    """A straight part of the hull: its outward normal (rad), and both ends (x, y) in m, counter-clockwise."""

    normal: float
    begin: tuple[float, float]
    end: tuple[float, float]

    @property
    def length(self) -> float:
        """In m."""
        return math.dist(self.begin, self.end)


def chords_of(theta: FloatArray, h: FloatArray, touched: npt.NDArray[np.bool_]) -> tuple[Chord, ...]:
    """The straight parts, as far as they were touched, of a support function h (m) on normals evenly spaced.

    Between the tangents at neighbouring normals the outline is the polygon that they cut out: the edge on tangent i is
    (h_(i−1) + h_(i+1) − 2 h_i cos Δ)/sin Δ long. theta (rad) goes once round.
    """
    n, step = len(h), math.tau / len(h)
    before, after = np.roll(h, 1), np.roll(h, -1)
    edge = (before + after - 2 * h * math.cos(step)) / math.sin(step)
    straight = edge > STRAIGHT * float(np.mean(h)) * step
    if straight.all() or not straight.any():
        return ()
    slope = (after - h * math.cos(step)) / math.sin(step)  # where the tangents at i and at i + 1 meet, along the former
    corner = np.stack(
        [h * np.cos(theta) - slope * np.sin(theta), h * np.sin(theta) + slope * np.cos(theta)], axis=1
    ).tolist()
    found = []
    for first in np.flatnonzero(straight & ~np.roll(straight, 1)).tolist():
        last = first + int(np.argmin(np.roll(straight, -first))) - 1
        (x0, y0), (x1, y1) = corner[(first - 1) % n], corner[last % n]
        chord = Chord(math.atan2(x0 - x1, y1 - y0), (x0, y0), (x1, y1))
        if chord.length > LEAST_M and touched[np.arange(first, last + 1) % n].any():
            found.append(chord)
    return tuple(found)
