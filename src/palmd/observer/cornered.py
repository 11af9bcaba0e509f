"""An outline of flat sides between round corners: the hull of discs. Pure.

p holds the discs' centres x, y about the centre of mass, counter-clockwise, and their radii (m): 3 n numbers, in the
last axis of any array. Side j goes from disc j to the next one: along its normal both reach as far.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.outline import wrapped
from palmd.observer.record import IntArray

ComplexArray = npt.NDArray[np.complex128]
STEPPED = 0.999  # of how much two radii may differ, by their distance


def discs(p: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Centres x + iy and radii (..., n)."""
    x, y, radii = np.split(p, 3, axis=-1)
    return x + 1j * y, radii


def side_normals(p: FloatArray) -> FloatArray:
    """Of each side (..., n; rad), not wrapped."""
    centres, radii = discs(p)
    along = np.roll(centres, -1, axis=-1) - centres
    steps = (radii - np.roll(radii, -1, axis=-1)) / np.abs(along)
    normals: FloatArray = np.angle(along) - np.arccos(np.clip(steps, -STEPPED, STEPPED))
    return normals


def seats(p: FloatArray, sides: IntArray, corners: IntArray, palms: Sequence[int] | IntArray) -> FloatArray:
    """Y, ρ, a, H (..., r, 4; m) of what lies on these sides (..., r), each on its palm (r), a corner on the other."""
    (centres, radii), normals = discs(p), side_normals(p)
    normal = np.take_along_axis(normals, sides, -1)
    on, opposite = (np.take_along_axis(centres, each, -1) * np.exp(-1j * normal) for each in (sides, corners))
    height = on.real + np.take_along_axis(radii, sides, -1)
    mirror = 1.0 - 2.0 * np.asarray(palms)
    radius = np.take_along_axis(radii, corners, -1)
    return np.stack([height - opposite.real, radius, -mirror * opposite.imag, height], axis=-1)


def supported(p: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """h and h′ (m) on normals theta (n; rad), and the rows d(h)/d(p): (n, len(p))."""
    centres, radii = discs(p)
    there = centres * np.exp(-1j * theta[:, None])
    corner = np.argmax(there.real + radii, axis=1)
    at, count = np.arange(len(theta)), len(radii)
    rows = np.zeros((len(theta), 3 * count))
    rows[at, corner], rows[at, count + corner], rows[at, 2 * count + corner] = np.cos(theta), np.sin(theta), 1.0
    return rows @ p, there.imag[at, corner], rows


def turned(p: FloatArray, turn: float) -> FloatArray:
    """The same in a frame in which all normals are greater by `turn` (rad)."""
    centres, radii = discs(p)
    there = centres * np.exp(1j * turn)
    return np.concatenate([there.real, there.imag, radii])


def regular(count: int, height: float, radius: float) -> FloatArray:
    """A regular outline of so many corners of this radius, its sides so high (m)."""
    centres = (height - radius) / math.cos(math.pi / count) * np.exp(2j * math.pi / count * np.arange(count))
    return np.concatenate([centres.real, centres.imag, np.full(count, radius)])


def beyond(p: FloatArray, sides: IntArray, corners: IntArray, palms: IntArray, openings: FloatArray) -> FloatArray:
    """By how much (..., r, 2; rad, ≤ 0) the other palm's normals leave those of the corner, at openings (r, 2; rad).

    At the least normal and at the greatest, 0 where they do not.
    """
    normals, count = side_normals(p), p.shape[-1] // 3
    normal = np.take_along_axis(normals, sides, -1)
    first, last = (np.take_along_axis(normals, (corners + by) % count, -1) - normal for by in (-1, 0))
    ends = -(1.0 - 2.0 * palms)[:, None] * (math.pi - openings)
    low, high = ends.min(axis=1), ends.max(axis=1)
    middle, half = (low + high) / 2, (high - low) / 2
    below, above = wrapped(middle - first) - half, wrapped(last - middle) - half
    out: FloatArray = np.minimum(np.stack([below, above], axis=-1), 0.0)
    return out
