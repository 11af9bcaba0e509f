"""Outline of flat sides and round corners: the convex hull of discs. Pure.

p holds the discs' centres x, y relative to the centre of mass, counter-clockwise, then their radii (m): 3 n numbers in
the last axis of any array. Side j joins disc j to the next one: along its normal both have the same support.
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
MOST_TAPER = 0.999  # largest difference of two adjacent radii, relative to the distance of their centres


def discs(p: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Centres x + iy and radii (..., n; m)."""
    x, y, radii = np.split(p, 3, axis=-1)
    return x + 1j * y, radii


def side_normals(p: FloatArray) -> FloatArray:
    """Normal of each side (..., n; rad), not wrapped."""
    centres, radii = discs(p)
    along = np.roll(centres, -1, axis=-1) - centres
    steps = (radii - np.roll(radii, -1, axis=-1)) / np.abs(along)
    normals: FloatArray = np.angle(along) - np.arccos(np.clip(steps, -MOST_TAPER, MOST_TAPER))
    return normals


def mode_parameters(p: FloatArray, sides: IntArray, corners: IntArray, palms: Sequence[int] | IntArray) -> FloatArray:
    """Mode parameters Y, ρ, a, H (..., r, 4; m), see `mode_model`, of r contact modes.

    The object lies on side `sides` (..., r) on palm `palms` (r); corner `corners` (..., r) touches the other palm.
    """
    (centres, radii), normals = discs(p), side_normals(p)
    normal = np.take_along_axis(normals, sides, -1)
    on, opposite = (np.take_along_axis(centres, each, -1) * np.exp(-1j * normal) for each in (sides, corners))
    height = on.real + np.take_along_axis(radii, sides, -1)
    mirror = 1.0 - 2.0 * np.asarray(palms)
    radius = np.take_along_axis(radii, corners, -1)
    return np.stack([height - opposite.real, radius, -mirror * opposite.imag, height], axis=-1)


def support(p: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """h and h′ (m) on normals theta (n; rad), and the rows dh/dp (n, len(p))."""
    centres, radii = discs(p)
    rotated = centres * np.exp(-1j * theta[:, None])
    corner = np.argmax(rotated.real + radii, axis=1)
    at, count = np.arange(len(theta)), len(radii)
    rows = np.zeros((len(theta), 3 * count))
    rows[at, corner], rows[at, count + corner], rows[at, 2 * count + corner] = np.cos(theta), np.sin(theta), 1.0
    return rows @ p, rotated.imag[at, corner], rows


def turned(p: FloatArray, turn: float) -> FloatArray:
    """The same outline in a frame in which all normals are greater by `turn` (rad)."""
    centres, radii = discs(p)
    rotated = centres * np.exp(1j * turn)
    return np.concatenate([rotated.real, rotated.imag, radii])


def regular(count: int, height: float, radius: float) -> FloatArray:
    """Regular outline with `count` corners of this radius, whose sides are `height` from the centre (m)."""
    centres = (height - radius) / math.cos(math.pi / count) * np.exp(2j * math.pi / count * np.arange(count))
    return np.concatenate([centres.real, centres.imag, np.full(count, radius)])


def normal_violation(
    p: FloatArray, sides: IntArray, corners: IntArray, palms: IntArray, openings: FloatArray
) -> FloatArray:
    """By how much (..., r, 2; rad, ≤ 0) the other palm's normals leave the range of the corner's normals.

    For the least and the greatest normal over openings (r, 2; rad); 0 where they stay inside.
    """
    normals, count = side_normals(p), p.shape[-1] // 3
    normal = np.take_along_axis(normals, sides, -1)
    first, last = (np.take_along_axis(normals, (corners + shift) % count, -1) - normal for shift in (-1, 0))
    ends = -(1.0 - 2.0 * palms)[:, None] * (math.pi - openings)
    low, high = ends.min(axis=1), ends.max(axis=1)
    middle, half = (low + high) / 2, (high - low) / 2
    below, above = wrapped(middle - first) - half, wrapped(last - middle) - half
    out: FloatArray = np.minimum(np.stack([below, above], axis=-1), 0.0)
    return out
