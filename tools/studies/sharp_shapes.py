"""Convex bodies with corners and flat sides for the emulated rig: exact arcs, or a smooth outline with a chord. Pure.

A corner is an arc of small radius. A flat side is an arc of so large a radius that the body rolls over it within
`FLAT_RAD`: the contact moves from one end of the side to the other with hardly any rotation. A flat palm cannot touch a
dent; the hull has a chord there, i.e. a flat side of an otherwise smooth outline.
"""

from __future__ import annotations

import cmath
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.rig.shapes import Body, Support

FLAT_RAD = 2e-3  # rotation over a flat side
SHARE = 0.1  # largest share of a flat side that one simulation step should pass
_BOUNDARY = 20_000  # points on the outline for area and moments
Point = tuple[float, float]
Disc = tuple[Point, float]


@dataclass(frozen=True, slots=True)
class ArcSupport:
    """Consecutive arcs: from normal `starts[j]` on, in [0, 2π), radius `radii[j]` about `centres[j]` (m)."""

    starts: tuple[float, ...]
    radii: tuple[float, ...]
    centres: tuple[Point, ...]

    def at(self, theta: float) -> tuple[float, float, float]:
        """h, h′, h″ (m) at the normal theta (rad, any branch): h = q·u + v on an arc of radius v about q."""
        j = bisect_right(self.starts, theta % math.tau) - 1
        (x, y), v = self.centres[j], self.radii[j]
        c, s = math.cos(theta), math.sin(theta)
        along = x * c + y * s
        return along + v, y * c - x * s, -along

    def room(self, theta: float) -> float:
        """Largest step (rad) at theta: half the way to the nearer end of its arc, or a share of the arc."""
        theta %= math.tau
        j = bisect_right(self.starts, theta) - 1
        start = self.starts[j] if j else self.starts[-1] - math.tau
        end = self.starts[j + 1] if j + 1 < len(self.starts) else self.starts[1] + math.tau
        return max(min(0.5 * (theta - start), 0.5 * (end - theta), SHARE * (end - start)), SHARE * FLAT_RAD)

    def sample(self, theta: FloatArray, order: int = 0) -> FloatArray:
        """The derivative of the given order, up to the second, at many normals (m per rad^order)."""
        return np.array([self.at(float(each))[order] for each in theta])

    def turned(self, angle: float) -> ArcSupport:
        """The same outline turned by `angle` (rad, counter-clockwise) in its own frame."""
        c, s = math.cos(angle), math.sin(angle)
        centres = [(c * x - s * y, s * x + c * y) for x, y in self.centres]
        return _in_order([start + angle for start in self.starts], self.radii, centres)

    def moved(self, dx: float, dy: float) -> ArcSupport:
        """The same outline moved by (dx, dy) metres in its own frame."""
        return ArcSupport(self.starts, self.radii, tuple((x + dx, y + dy) for x, y in self.centres))


@dataclass(frozen=True, slots=True)
class ChordSupport:
    """A smooth outline with a flat side of `length` (m) about the normal `normal` (rad), passed within `width` (rad).

    The side is balanced all around: h gains G with G + G″ = box − cos/π, so that the outline stays closed.
    """

    smooth: Support
    normal: float
    length: float
    width: float

    def at(self, theta: float) -> tuple[float, float, float]:
        """h, h′, h″ (m) at the normal theta (rad, any branch)."""
        h, h1, h2 = self.smooth.at(theta)
        g, g1, v = self._chord(math.remainder(theta - self.normal, math.tau))
        return h + g, h1 + g1, h2 + v - g

    def room(self, theta: float) -> float:
        """Largest step (rad) at theta: half the way to the nearer end of the side, or a share of it."""
        away = abs(math.remainder(theta - self.normal, math.tau)) - 0.5 * self.width
        return max(0.5 * away, SHARE * self.width)

    def _chord(self, y: float) -> tuple[float, float, float]:
        """The side's contribution to h, h′ and h + h″."""
        c, s, half = math.cos(y), math.sin(y), 0.5 * self.width
        if abs(y) < half:
            edge = math.cos(half) / self.width
            g, g1, box = 1.0 / self.width - edge * c, edge * s, 1.0 / self.width
        else:
            rest = 0.5 * math.copysign(math.sin(half) / half, y)
            g, g1, box = rest * s, rest * c, 0.0
        return (
            self.length * (g - y * s / math.tau - c / (2 * math.tau)),
            self.length * (g1 - (s + y * c) / math.tau + s / (2 * math.tau)),
            self.length * (box - c / math.pi),
        )

    def sample(self, theta: FloatArray, order: int = 0) -> FloatArray:
        """The derivative of the given order, up to the second, at many normals (m per rad^order)."""
        return np.array([self.at(float(each))[order] for each in theta])

    def turned(self, angle: float) -> ChordSupport:
        """The same outline turned by `angle` (rad, counter-clockwise) in its own frame."""
        return ChordSupport(self.smooth.turned(angle), self.normal + angle, self.length, self.width)

    def moved(self, dx: float, dy: float) -> ChordSupport:
        """The same outline moved by (dx, dy) metres in its own frame."""
        return ChordSupport(self.smooth.moved(dx, dy), self.normal, self.length, self.width)


def rounded_polygon(corners: Sequence[Point], radius: float) -> ArcSupport:
    """The hull of discs of `radius` (m) about `corners` (m), counter-clockwise and strictly convex."""
    return hull_of_discs([(corner, radius) for corner in corners])


def hull_of_discs(discs: Sequence[Disc]) -> ArcSupport:
    """The hull of discs, each (centre, radius) in m, counter-clockwise in their order along the outline.

    There is no flat side between two discs that touch internally.
    """
    starts, radii, centres = [], [], []
    for (here, r1), (there, r2) in zip(discs, [*discs[1:], discs[0]], strict=True):
        edge = complex(*there) - complex(*here)
        if abs(edge) <= abs(r1 - r2) * (1.0 + 1e-9):
            starts.append(cmath.phase(edge if r1 > r2 else -edge))
        else:
            # an arc of radius `wide` about c = here + (r1 - wide) u(first) = there + (r2 - wide) u(first + FLAT_RAD)
            turn = cmath.exp(1j * FLAT_RAD)
            rotation_step, difference = turn - 1.0, r1 - r2 * turn
            half = (rotation_step.conjugate() * difference).real / abs(rotation_step) ** 2
            wide = math.sqrt(half**2 + (abs(edge) ** 2 - abs(difference) ** 2) / abs(rotation_step) ** 2) - half
            first = cmath.phase(edge / (wide * rotation_step + difference))
            centre = complex(*here) + (r1 - wide) * cmath.exp(1j * first)
            starts += [first, first + FLAT_RAD]
            radii.append(wide)
            centres.append((centre.real, centre.imag))
        radii.append(r2)
        centres.append(there)
    return _in_order(starts, radii, centres)


def uniform_body(name: str, outline: ArcSupport | ChordSupport, mass: float, com: Point = (0.0, 0.0)) -> Body:
    """A body of uniform density, its centre of mass moved by `com` (m) from the centroid by a hidden weight."""
    theta = np.linspace(0.0, math.tau, _BOUNDARY, endpoint=False) + 1e-5
    h, h1 = (np.array(each) for each in zip(*((outline.at(float(a))[:2]) for a in theta), strict=True))
    x, y = h * np.cos(theta) - h1 * np.sin(theta), h * np.sin(theta) + h1 * np.cos(theta)
    nx, ny = np.roll(x, -1), np.roll(y, -1)
    cross = x * ny - nx * y
    area = 0.5 * cross.sum()
    cx, cy = ((x + nx) * cross).sum() / (6 * area), ((y + ny) * cross).sum() / (6 * area)
    second = ((x * x + x * nx + nx * nx + y * y + y * ny + ny * ny) * cross).sum() / (12 * area)
    rho = math.sqrt(second - cx * cx - cy * cy)
    return Body(name, outline.moved(-cx - com[0], -cy - com[1]), rho, mass)


def _in_order(starts: Sequence[float], radii: Sequence[float], centres: Sequence[Point]) -> ArcSupport:
    """The arcs sorted by normals in [0, 2π); the last arc also starts at 0."""
    order = sorted(range(len(starts)), key=lambda j: starts[j] % math.tau)
    last = order[-1]
    return ArcSupport(
        (0.0, *(starts[j] % math.tau for j in order)),
        (radii[last], *(radii[j] for j in order)),
        (centres[last], *(centres[j] for j in order)),
    )
