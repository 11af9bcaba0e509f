"""Everyday objects as bodies for the emulated rig: die, nut, coin, block and others. Pure.

Sizes are drawn from commercial ranges. A palm touches the convex hull of each; mass and inertia are those of the object
itself. On request a hidden weight moves the centre of mass.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palmd.rig.shapes import Body, Support
from tools.studies.sharp_shapes import ArcSupport, Disc, Point, hull_of_discs, rounded_polygon, uniform_body

Random = np.random.Generator
_ELLIPSE_ORDER = 60


@dataclass(frozen=True, slots=True)
class RealObject:
    """A body with its name; `size_m`: the lengths that its shape classification reports, if any (m)."""

    body: Body
    name: str
    size_m: tuple[float, ...] = ()


def real_object(name: str, random: Random, off_centre_m: float = 0.0) -> RealObject:
    """One of `REAL_OBJECTS` of random size and mass, its centre of mass moved in a random direction."""
    body, size = REAL_OBJECTS[name](random, float(random.uniform(0.04, 0.2)))
    angle = float(random.uniform(0.0, math.tau))
    if off_centre_m:
        body = _weighted(body, off_centre_m, angle)
    return RealObject(body, name, size)


def _die(random: Random, mass: float) -> tuple[Body, tuple[float, ...]]:
    side, radius = float(random.uniform(14e-3, 20e-3)), float(random.uniform(0.5e-3, 2e-3))
    return uniform_body("die", _rectangle(side, side, radius), mass), (side,)


def _nut(random: Random, mass: float) -> tuple[Body, tuple[float, ...]]:
    across = float(random.choice([24e-3, 27e-3, 30e-3]))  # M16, M18, M20
    radius = float(random.uniform(0.3e-3, 1e-3))
    outline = rounded_polygon(_regular(6, (across / 2 - radius) / math.cos(math.pi / 6)), radius)
    return uniform_body("hexagon nut", outline, mass), (across,)


def _coin(random: Random, mass: float) -> tuple[Body, tuple[float, ...]]:
    radius = float(random.uniform(9e-3, 13e-3))
    outline = Support.from_coefficients((complex(radius), 0j))
    return Body("coin", outline, radius / math.sqrt(2.0), mass), (2 * radius,)


def _ellipse(random: Random, mass: float) -> tuple[Body, tuple[float, ...]]:
    a, ratio = float(random.uniform(16e-3, 24e-3)), float(random.uniform(0.6, 0.9))
    b = a * ratio
    theta = np.arange(2048) * (math.tau / 2048)
    spectrum = np.fft.rfft(np.hypot(a * np.cos(theta), b * np.sin(theta))) / 2048
    coefficients = np.concatenate([spectrum[:1], 2.0 * spectrum[1 : _ELLIPSE_ORDER + 1]])
    outline = Support.from_coefficients(tuple(complex(c) for c in coefficients))
    return Body("ellipse", outline, math.hypot(a, b) / 2, mass), (2 * a, 2 * b)


def _rounded_triangle(random: Random, mass: float) -> tuple[Body, tuple[float, ...]]:
    radius = float(random.uniform(3e-3, 6e-3))
    outline = rounded_polygon(_regular(3, float(random.uniform(20e-3, 26e-3)) - 2 * radius), radius)
    return uniform_body("rounded triangle", outline, mass), ()


def _block(random: Random, mass: float) -> tuple[Body, tuple[float, ...]]:
    del random
    return uniform_body("block", _rectangle(10e-3, 30e-3, 0.5e-3), mass), (10e-3, 30e-3)


def _d_profile(random: Random, mass: float) -> tuple[Body, tuple[float, ...]]:
    big, radius = float(random.uniform(14e-3, 20e-3)), 0.5e-3
    cut = big * float(random.uniform(0.4, 0.8))
    half = math.sqrt((big - radius) ** 2 - (cut - radius) ** 2)
    discs: list[Disc] = [((cut - radius, half), radius), ((0.0, 0.0), big), ((cut - radius, -half), radius)]
    return uniform_body("D-profile", hull_of_discs(discs), mass), ()


def _l_profile(random: Random, mass: float) -> tuple[Body, tuple[float, ...]]:
    leg, wall, radius = float(random.uniform(25e-3, 30e-3)), float(random.uniform(6e-3, 10e-3)), 0.5e-3
    inner, thick = leg - radius, wall - radius
    ring = [(radius, radius), (inner, radius), (inner, thick), (thick, inner), (radius, inner)]
    lower, upper = leg * wall, (leg - wall) * wall
    area = lower + upper
    centroid = (lower * leg / 2 + upper * wall / 2) / area
    second = (lower * (leg**2 + wall**2) + upper * (wall**2 + wall**2 + wall * leg + leg**2)) / 3
    rho = math.sqrt(second / area - 2 * centroid**2)
    outline = rounded_polygon(ring, radius).moved(-centroid, -centroid)
    return Body("L-profile", outline, rho, mass), ()


def _gear(random: Random, mass: float) -> tuple[Body, tuple[float, ...]]:
    teeth, radius = int(random.integers(20, 33)), float(random.uniform(14e-3, 18e-3))
    tip = 0.3e-3
    return uniform_body("gear", rounded_polygon(_regular(teeth, radius - tip), tip), mass), (2 * radius,)


REAL_OBJECTS: Mapping[str, Callable[[Random, float], tuple[Body, tuple[float, ...]]]] = {
    "die": _die,
    "nut": _nut,
    "coin": _coin,
    "ellipse": _ellipse,
    "triangle": _rounded_triangle,
    "block": _block,
    "D-profile": _d_profile,
    "L-profile": _l_profile,
    "gear": _gear,
}
"""For each name a function that draws the body and its characteristic lengths (m)."""


def _weighted(body: Body, shift: float, angle: float) -> Body:
    """The body with a point mass at ρ from its centre of mass that moves the centre of mass by `shift` (m).

    With a share β of the mass at p = ρ: shift = βρ, and ρ² = (1 − β)(ρ² + βρ²).
    """
    share = shift / body.rho
    rho = body.rho * math.sqrt((1.0 - share) * (1.0 + share))
    moved = body.support.moved(-shift * math.cos(angle), -shift * math.sin(angle))
    return Body(f"{body.shape}, off-centre mass", moved, rho, body.mass)


def _regular(corners: int, radius: float) -> Sequence[Point]:
    angles = np.arange(corners) * (math.tau / corners)
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles.tolist()]


def _rectangle(width: float, height: float, radius: float) -> ArcSupport:
    x, y = width / 2 - radius, height / 2 - radius
    return rounded_polygon([(x, -y), (x, y), (-x, y), (-x, -y)], radius)
