"""Straight parts of an outline: flat sides, or dents that the palms bridge. Pure.

Palms touch the convex hull, on which a dent is a chord: the contact jumps along it while the object does not turn. It
does the same along a flat side, and no contact distinguishes the two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray

STRAIGHT = 4.0
"""Radius of curvature, in mean radii, from which on an outline counts as straight; ellipses of 2 to 1 reach 2.7."""
LEAST_M = 1e-3
"""Shortest chord."""
STRAIGHT_LABEL = "flat side, or dent bridged"


@dataclass(frozen=True, slots=True)
class Chord:
    """A straight part of the hull: its outward normal (rad) and its ends (x, y) in m, counter-clockwise."""

    normal: float
    begin: tuple[float, float]
    end: tuple[float, float]

    @property
    def length(self) -> float:
        """In m."""
        return math.dist(self.begin, self.end)


def chords_of(theta: FloatArray, h: FloatArray, touched: npt.NDArray[np.bool_]) -> tuple[Chord, ...]:
    """The touched straight parts of a support function h (m) on evenly spaced normals.

    Between the tangents at neighbouring normals the outline is taken as their polygon: the edge on tangent i has length
    (h_(i−1) + h_(i+1) − 2 h_i cos Δ)/sin Δ. theta (rad) covers a full turn.
    """
    n, step = len(h), math.tau / len(h)
    before, after = np.roll(h, 1), np.roll(h, -1)
    edge = (before + after - 2 * h * math.cos(step)) / math.sin(step)
    straight = edge > STRAIGHT * float(np.mean(h)) * step
    if straight.all() or not straight.any():
        return ()
    slope = (after - h * math.cos(step)) / math.sin(step)  # along tangent i to where it meets tangent i + 1
    corner = np.stack(
        [h * np.cos(theta) - slope * np.sin(theta), h * np.sin(theta) + slope * np.cos(theta)], axis=1
    ).tolist()
    chords = []
    for first in np.flatnonzero(straight & ~np.roll(straight, 1)).tolist():
        last = first + int(np.argmin(np.roll(straight, -first))) - 1
        (x0, y0), (x1, y1) = corner[(first - 1) % n], corner[last % n]
        chord = Chord(math.atan2(x0 - x1, y1 - y0), (x0, y0), (x1, y1))
        if chord.length > LEAST_M and touched[np.arange(first, last + 1) % n].any():
            chords.append(chord)
    return tuple(chords)
