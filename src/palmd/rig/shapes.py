"""Convex bodies of the emulated rig: outline, centre of mass, radius of gyration, mass. Pure, no I/O.

A body is described by its support function h(θ) about its centre of mass (COM), θ the direction of the outward normal
in the body's frame. The boundary point at θ is h·u + h′·u′ with u = (cos θ, sin θ), the radius of curvature h + h″.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol, Self, get_args

import numpy as np

from palmd.events import FloatArray

Kind = Literal["nominal", "friction", "rig", "odd", "ellipse"]
KINDS: tuple[Kind, ...] = ("nominal", "friction", "rig", "odd")
"""The kinds of bodies in studies and simulated logs."""
EVERY_KIND: tuple[Kind, ...] = get_args(Kind)

_NODES = 2048  # a third-order Taylor step of at most π/2048 is exact to 1e-12 m
_NODES_PER_RAD = _NODES / math.tau
_MAX_HARMONIC = 40  # enough for the flattest ellipse drawn here
_MIN_CURVATURE_RADIUS = 6.5e-3
_STRONG_CURVATURE_RADIUS = (2.5e-3, 6.5e-3)
_HARMONIC_STD = {2: 0.65e-3, 3: 0.28e-3, 4: 0.18e-3, 5: 0.14e-3, 6: 0.08e-3}


class SupportFunction(Protocol):
    """A support function about the COM, in any representation."""

    def at(self, theta: float) -> tuple[float, float, float]:
        """h, h′, h″ (m) at the normal theta (rad, any branch)."""

    def room(self, theta: float) -> float:
        """Angle (rad) by which the normal theta may turn before h″ jumps, at least a share of a side; inf if smooth."""

    def sample(self, theta: FloatArray, order: int = 0) -> FloatArray:
        """The derivative of the given order, at most the second, at many normals (m per rad^order)."""

    def turned(self, angle: float) -> Self:
        """The outline turned by `angle` (rad, counter-clockwise) in its own frame."""

    def moved(self, dx: float, dy: float) -> Self:
        """The outline moved by (dx, dy) metres in its own frame."""


@dataclass(frozen=True, slots=True)
class Support:
    """A support function as a Fourier series, tabulated for speed; h(θ) = Re Σ c_k e^{ikθ}, metres."""

    coefficients: tuple[complex, ...]
    table: tuple[tuple[float, float, float, float], ...]

    @classmethod
    def from_coefficients(cls, coefficients: tuple[complex, ...]) -> Support:
        """The series with its table of h, h′, h″/2, h‴/6 at evenly spaced normals."""
        h, h1, h2, h3 = (_on_nodes(coefficients, order) for order in range(4))
        rows = zip(h.tolist(), h1.tolist(), (h2 / 2).tolist(), (h3 / 6).tolist(), strict=True)
        return cls(coefficients, tuple(rows))

    def at(self, theta: float) -> tuple[float, float, float]:
        """h, h′, h″ (m) at the normal theta (rad, any branch); from the nearest node, h to 1e-12 m."""
        position = theta * _NODES_PER_RAD
        node = round(position)
        e = (position - node) / _NODES_PER_RAD
        h, h1, half_h2, sixth_h3 = self.table[node % _NODES]
        return (
            h + e * (h1 + e * (half_h2 + e * sixth_h3)),
            h1 + e * (2.0 * half_h2 + e * 3.0 * sixth_h3),
            2.0 * half_h2 + e * 6.0 * sixth_h3,
        )

    def room(self, theta: float) -> float:
        """See `SupportFunction`: h″ never jumps."""
        del theta
        return math.inf

    def sample(self, theta: FloatArray, order: int = 0) -> FloatArray:
        """The derivative of the given order at many normals (m per rad^order)."""
        k = np.arange(len(self.coefficients))
        weights = np.asarray(self.coefficients) * (1j * k) ** order
        return np.asarray((np.exp(1j * np.outer(theta, k)) @ weights).real, dtype=np.float64)

    def turned(self, angle: float) -> Support:
        """The outline turned by `angle` (rad, counter-clockwise) in its own frame."""
        return Support.from_coefficients(
            tuple(c * complex(math.cos(k * angle), -math.sin(k * angle)) for k, c in enumerate(self.coefficients))
        )

    def moved(self, dx: float, dy: float) -> Support:
        """The outline moved by (dx, dy) metres in its own frame."""
        c = list(self.coefficients)
        c[1] += complex(dx, -dy)
        return Support.from_coefficients(tuple(c))

    @property
    def min_curvature_radius(self) -> float:
        """Smallest radius of curvature (m) over the table's normals; positive for a strictly convex outline."""
        return min(h + 2.0 * half_h2 for h, _, half_h2, _ in self.table)


@dataclass(frozen=True, slots=True)
class Body:
    """One object: outline about its COM, radius of gyration rho (m), mass (kg)."""

    shape: str
    support: SupportFunction
    rho: float
    mass: float

    def turned(self, angle: float) -> Body:
        """The body with its frame chosen so that the outline appears turned by `angle` (rad)."""
        return Body(self.shape, self.support.turned(angle), self.rho, self.mass)


def cylinder(radius: float, mass: float) -> Body:
    """A solid cylinder lying on its side: radius in m, mass in kg."""
    return Body("cylinder", Support.from_coefficients((complex(radius),)), radius / math.sqrt(2.0), mass)


def random_body(kind: Kind, rng: np.random.Generator) -> Body:
    """A random body of the kind.

    `odd`: an ellipse, a strongly curved body, or one with an off-centre mass. `ellipse`: an ellipse with an off-centre
    COM. All others: gently curved and of uniform density.
    """
    mass = float(rng.uniform(0.06, 0.25))
    if kind == "ellipse":
        return with_slug(uniform_body_of("ellipse", _ellipse(rng), mass), rng)
    if kind != "odd":
        return uniform_body_of("random", _random_outline(rng, 1.0, _MIN_CURVATURE_RADIUS), mass)
    match int(rng.integers(3)):
        case 0:
            return uniform_body_of("ellipse", _ellipse(rng), mass)
        case 1:
            low = float(rng.uniform(*_STRONG_CURVATURE_RADIUS))
            return uniform_body_of("strongly curved", _random_outline(rng, 1.5, low), mass)
        case _:
            body = uniform_body_of("random", _random_outline(rng, 1.0, _MIN_CURVATURE_RADIUS), mass)
            return with_slug(body, rng)


def area_moments(support: Support) -> tuple[float, float, float, float]:
    """Area (m²), centroid x, y (m), and radius of gyration about the origin (m) of the uniform outline.

    Green's theorem along the boundary x = h·u + h′·u′ with element (h + h″)·u′ dθ.
    """
    theta = np.arange(_NODES) / _NODES_PER_RAD
    h, h1, h2 = (_on_nodes(support.coefficients, order) for order in range(3))
    cos, sin = np.cos(theta), np.sin(theta)
    x, y = h * cos - h1 * sin, h * sin + h1 * cos
    dx, dy = -(h + h2) * sin, (h + h2) * cos
    step = math.tau / _NODES
    area = 0.5 * step * float(np.sum(x * dy - y * dx))
    centroid_x = 0.5 * step * float(np.sum(x * x * dy)) / area
    centroid_y = -0.5 * step * float(np.sum(y * y * dx)) / area
    second = step * float(np.sum(x**3 * dy) - np.sum(y**3 * dx)) / 3.0
    return area, centroid_x, centroid_y, math.sqrt(second / area)


def _on_nodes(coefficients: tuple[complex, ...], order: int) -> FloatArray:
    """The order-th derivative of Re Σ c_k e^{ikθ} on the table's nodes, by one fast Fourier transform."""
    k = np.arange(len(coefficients))
    spectrum = np.zeros(_NODES // 2 + 1, dtype=complex)
    spectrum[: len(k)] = np.asarray(coefficients) * (1j * k) ** order * (_NODES / 2)
    spectrum[0] *= 2.0
    return np.fft.irfft(spectrum, _NODES)


def uniform_body_of(shape: str, outline: Support, mass: float) -> Body:
    """A body of uniform density: COM at the area's centroid."""
    _, cx, cy, _ = area_moments(outline)
    centred = outline.moved(-cx, -cy)
    return Body(shape, centred, area_moments(centred)[3], mass)


def with_slug(body: Body, rng: np.random.Generator) -> Body:
    """The body with a heavy point mass near its rim: the COM moves by up to 2 mm, and rho changes.

    With a fraction β of the mass at distance p: offset e = βp, ρ² = (1−β)(ρ_uniform² + βp²).
    """
    offset = float(rng.uniform(0.3e-3, 2.0e-3))
    distance = body.rho * float(rng.uniform(0.95, 1.25))
    angle = float(rng.uniform(0.0, math.tau))
    beta = offset / distance
    moved = body.support.moved(-offset * math.cos(angle), -offset * math.sin(angle))
    rho = math.sqrt((1.0 - beta) * (body.rho**2 + beta * distance**2))
    return Body("off-centre mass", moved, rho, body.mass)


def _random_outline(rng: np.random.Generator, scale: float, min_radius: float) -> Support:
    """Mean radius 16–24 mm and random harmonics 2…6, drawn again until no radius of curvature is below `min_radius`."""
    while True:
        coefficients = [complex(rng.uniform(16e-3, 24e-3)), 0j]
        coefficients += [scale * std * complex(*rng.standard_normal(2)) for std in _HARMONIC_STD.values()]
        outline = Support.from_coefficients(tuple(coefficients))
        if outline.min_curvature_radius >= min_radius:
            return outline


def _ellipse(rng: np.random.Generator) -> Support:
    """An ellipse with h = √(a² cos² + b² sin²), mean radius 16–24 mm, b/a in 0.75…0.95."""
    mean, ratio = float(rng.uniform(16e-3, 24e-3)), float(rng.uniform(0.75, 0.95))
    return ellipse(2.0 * mean / (1.0 + ratio), 2.0 * mean * ratio / (1.0 + ratio))


def ellipse(a: float, b: float) -> Support:
    """An ellipse about its centre with half axis a (m) along the body's first axis: h = √(a² cos² + b² sin²)."""
    theta = np.arange(_NODES) / _NODES_PER_RAD
    spectrum = np.fft.rfft(np.hypot(a * np.cos(theta), b * np.sin(theta))) / _NODES
    coefficients = 2.0 * spectrum[: _MAX_HARMONIC + 1]
    coefficients[0] /= 2.0
    return Support.from_coefficients(tuple(complex(c) for c in coefficients))
