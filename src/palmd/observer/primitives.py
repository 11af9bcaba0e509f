"""Simple shapes as support functions: circle, ellipse, rectangle, regular polygons. Pure.

Each is h(θ) = f(θ; lengths, turn) + x cos θ + y sin θ: the centre of mass may differ from the shape's own centre, which
is at (−x, −y) from it. Corners are arcs of a radius. All but the ellipse are linear in their lengths.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray

Lengths = Sequence[float] | FloatArray
_SIZE_SD_M, _CORNER_SD_M = 10e-3, 3e-3


@dataclass(frozen=True, slots=True)
class Primitive:
    """One shape.

    linear: rows (n, m) whose product with the lengths (m) is h on n normals (rad) for a turn (rad); for an ellipse to
    first order in the difference of its axes. sd: prior 1σ of each length. sizes: dimensions as a person would measure
    them, (name, index of the length, factor). period_rad: the turn after which the shape looks the same; 0: any turn.
    has_corners: the last length is the corners' radius.
    """

    name: str
    linear: Callable[[FloatArray, float], FloatArray]
    sd: tuple[float, ...]
    sizes: tuple[tuple[str, int, float], ...]
    period_rad: float
    has_corners: bool = False

    def support(self, theta: FloatArray, lengths: Lengths, turn: float) -> FloatArray:
        """h (m) on normals `theta` (rad) about the shape's own centre."""
        if self.name == ELLIPSE:
            h: FloatArray = np.hypot(lengths[0] * np.cos(theta - turn), lengths[1] * np.sin(theta - turn))
            return h
        straight: FloatArray = self.linear(theta, turn) @ np.asarray(lengths)
        return straight

    def nearest(self, lengths: Lengths) -> FloatArray:
        """The closest valid lengths: in descending order, no corner wider than its side."""
        return np.minimum.accumulate(
            np.maximum(np.asarray(lengths, dtype=np.float64), 0.0 if self.has_corners else 1e-3)
        )


def _round(theta: FloatArray, _turn: float) -> FloatArray:
    return np.ones((len(theta), 1))


def _oval(theta: FloatArray, turn: float) -> FloatArray:
    return np.stack([np.cos(theta - turn) ** 2, np.sin(theta - turn) ** 2], axis=1)


def _oblong(theta: FloatArray, turn: float) -> FloatArray:
    c, s = np.abs(np.cos(theta - turn)), np.abs(np.sin(theta - turn))
    return np.stack([c, s, 1.0 - c - s], axis=1)


def _regular(sides: int, name: str) -> Primitive:
    half = math.pi / sides

    def linear(theta: FloatArray, turn: float) -> FloatArray:
        """`turn`: normal of a side."""
        reach = np.cos(np.remainder(theta - turn, 2.0 * half) - half) / math.cos(half)
        return np.stack([reach, 1.0 - reach], axis=1)

    # with an odd number of sides, the inscribed circle is measured
    size = "across flats" if sides % 2 == 0 else "inscribed circle"
    sizes = ((size, 0, 2.0), ("corner radius", 1, 1.0))
    return Primitive(name, linear, (_SIZE_SD_M, _CORNER_SD_M), sizes, 2.0 * half, has_corners=True)


ELLIPSE = "ellipse"
PRIMITIVES: tuple[Primitive, ...] = (
    Primitive("circle", _round, (_SIZE_SD_M,), (("across", 0, 2.0),), 0.0),
    Primitive(
        ELLIPSE, _oval, (_SIZE_SD_M, _SIZE_SD_M), (("long axis", 0, 2.0), ("short axis", 1, 2.0)), math.pi
    ),
    Primitive(
        "rectangle", _oblong, (_SIZE_SD_M, _SIZE_SD_M, _CORNER_SD_M),
        (("long side", 0, 2.0), ("short side", 1, 2.0), ("corner radius", 2, 1.0)), math.pi, has_corners=True,
    ),
    _regular(3, "regular triangle"),
    _regular(4, "square"),
    _regular(5, "regular pentagon"),
    _regular(6, "regular hexagon"),
    _regular(8, "regular octagon"),
)  # fmt: skip
"""All shapes that are classified."""
