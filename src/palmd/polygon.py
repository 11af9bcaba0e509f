"""Geometry of measured closed convex curves: checks of the points, and a fit of a smooth support function. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray

ORDER = 24  # harmonics of a fitted outline
COEFFICIENTS = 2 * ORDER + 1
_GRID = 720  # normals of the grid search for a point's nearest one
_SETTLED_M = 1e-9
_MOST_ITERATIONS = 50
_FIRST_RMS_M = 1e-4
_COARSE = 0.02  # share of the extent: step in which a curve is tested for crossings


@dataclass(frozen=True, slots=True)
class Lamina:
    """A uniform plate: area (m²), centroid (m), and radius of gyration about the centroid (m)."""

    area: float
    centroid: tuple[float, float]
    rho: float


@dataclass(frozen=True, slots=True)
class PolygonFit:
    """A support function h (360,) in m on the normals 0, 1, …, 359 degrees, and the points' RMS distance (m)."""

    h: FloatArray
    rms: float


def degrees() -> FloatArray:
    """The normals of 0, 1, …, 359 degrees (rad)."""
    return np.arange(360, dtype=np.float64) * (math.tau / 360)


def normals(theta: FloatArray) -> FloatArray:
    """Unit vectors (cos θ, sin θ): (len(theta), 2)."""
    return np.stack([np.cos(theta), np.sin(theta)], axis=1)


def boundary(h: FloatArray) -> FloatArray:
    """Points of the outline (n, 2) in m: x = h n + h′ dn/dθ, with h′ from trigonometric interpolation.

    h (m) is given on n evenly spaced normals from 0 over the full circle, n even.
    """
    n = len(h)
    theta = np.arange(n, dtype=np.float64) * (math.tau / n)
    slope = np.fft.irfft(1j * np.append(np.arange(n // 2), 0) * np.fft.rfft(h), n)
    return np.asarray(h[:, None] * normals(theta) + slope[:, None] * normals(theta + math.pi / 2))


def resampled(h: FloatArray, n: int) -> FloatArray:
    """A support function on n normals beginning with the same one, by trigonometric interpolation; n is even."""
    return np.asarray(np.fft.irfft(np.fft.rfft(h), n) * (n / len(h)))


def closed_outline(theta: FloatArray, h: FloatArray) -> FloatArray:
    """The closed outline (361, 2) in m of a support function h (m) on any number of normals spread over a full turn.

    The first and last point have the normal theta[0] (rad); trigonometric interpolation between the samples.
    """
    points = boundary(resampled(h, 360)) @ turned(float(theta[0]))
    return np.concatenate([points, points[:1]])


def turned(angle: float) -> FloatArray:
    """The matrix that rotates points in rows by `angle` (rad): points @ turned(angle)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s], [-s, c]])


def lamina(points: FloatArray) -> Lamina:
    """The plate within a closed polygon `points` (n, 2) in m, counter-clockwise; the area is negative if clockwise.

    Green's theorem, edge by edge: A = ½ Σ c with c = x_i × x_{i+1}; centroid and second moment by similar sums.
    """
    middle = points.mean(axis=0)
    a = points - middle
    b = np.roll(a, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    area = float(cross.sum()) / 2
    centroid = ((a + b) * cross[:, None]).sum(axis=0) / (6 * area)
    second = float((cross * (a * a + a * b + b * b).sum(axis=1)).sum()) / (12 * area)
    rho = math.sqrt(max(second - float(centroid @ centroid), 0.0))
    x, y = (middle + centroid).tolist()
    return Lamina(area, (x, y), rho)


def gaps(points: FloatArray) -> FloatArray:
    """Distance (m) from each point to the next; the last one's to the first."""
    return np.asarray(np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1))


def crossing(points: FloatArray) -> tuple[int, int] | None:
    """Two edges of the closed polygon that cross, as indices of the points where they begin; None if none cross.

    Points are first thinned to steps of `_COARSE` of the extent, because noise makes closer ones step back and forth.
    """
    kept = _thinned(points)
    a = points[kept]
    b = np.roll(a, -1, axis=0)
    edge = b - a
    # [i, j]: side of edge i's line on which edge j begins
    side = edge[:, :1] * (a[None, :, 1] - a[:, None, 1]) - edge[:, 1:] * (a[None, :, 0] - a[:, None, 0])
    apart = side * np.roll(side, -1, axis=1) < 0
    found = np.argwhere(apart & apart.T)
    return (int(kept[found[0, 0]]), int(kept[found[0, 1]])) if len(found) else None


def winding(points: FloatArray) -> float:
    """How many times the closed polygon winds round the mean of its points, positive counter-clockwise."""
    away = points - points.mean(axis=0)
    angle = np.arctan2(away[:, 1], away[:, 0])
    steps = np.angle(np.exp(1j * (np.roll(angle, -1) - angle)))
    return float(steps.sum()) / math.tau


def depths(points: FloatArray) -> FloatArray:
    """Depth (m) of each point inside the convex hull of all points; 0 on the hull."""
    along = points @ normals(_grid()).T
    return np.asarray((along.max(axis=0) - along).min(axis=1))


def fitted(points: FloatArray) -> PolygonFit:
    """The outline of `ORDER` harmonics with the least RMS distance to `points` (n, 2) in m.

    A point p lies outside a convex outline by max over θ of p·n(θ) − h(θ), negative inside. This is linear in the
    coefficients of h for given θ, and by the envelope theorem its slope is the same if θ is the maximiser:
    Gauss–Newton, under v = h + h″ ≥ 0. Harmonics from the second on have the prior of a smooth shape, weighted by the
    points' own distance from the fit: exact points are followed, noise is not. Raises ValueError for fewer points than
    coefficients.
    """
    if len(points) < COEFFICIENTS:
        raise ValueError(f"{len(points)} points do not determine {COEFFICIENTS} coefficients")
    middle = points.mean(axis=0)
    centred = points - middle
    grid = _grid()
    on_grid = _waves(grid)
    along = centred @ normals(grid).T
    coefficients = np.linalg.lstsq(on_grid, along.max(axis=0), rcond=None)[0]
    k = np.concatenate([np.arange(ORDER + 1), np.arange(1, ORDER + 1)])
    prior_sd = 0.045 * coefficients[0] * (2.0 / np.maximum(k, 1)) ** 1.7
    prior_information = np.diag(np.where(k > 1, prior_sd**-2, 0.0))
    curvature = on_grid * (1 - k**2)
    rms = _FIRST_RMS_M
    for _ in range(_MOST_ITERATIONS):
        theta = _at_maximum(along - coefficients @ on_grid.T)
        rows = _waves(theta)
        offset = (centred * normals(theta)).sum(axis=1)
        before = coefficients
        coefficients = _least_squares(rows.T @ rows + rms**2 * prior_information, rows.T @ offset, curvature)
        rms = float(np.sqrt(np.mean((offset - rows @ coefficients) ** 2)))
        if np.abs(coefficients - before).max() < _SETTLED_M:
            break
    h = _waves(degrees()) @ coefficients + normals(degrees()) @ middle
    return PolygonFit(np.asarray(h), rms)


def _least_squares(normal: FloatArray, right: FloatArray, bounds: FloatArray) -> FloatArray:
    """The c that minimises ½ cᵀN c − gᵀc under B c ≥ 0, by its dual: c = N⁻¹(g + Bᵀλ), λ ≥ 0, a non-negative fit."""
    from scipy.optimize import nnls  # imported here: processes beside the loop read outlines but fit none

    lower = np.linalg.cholesky(normal)
    multipliers, _ = nnls(np.linalg.solve(lower, bounds.T), -np.linalg.solve(lower, right))
    return np.asarray(np.linalg.solve(normal, right + bounds.T @ multipliers))


def _grid() -> FloatArray:
    return np.arange(_GRID, dtype=np.float64) * (math.tau / _GRID)


def _waves(theta: FloatArray) -> FloatArray:
    """1, cos θ, …, cos ORDER·θ, sin θ, …, sin ORDER·θ for each of theta: (len(theta), COEFFICIENTS)."""
    waves = np.exp(1j * np.outer(theta, np.arange(ORDER + 1)))
    return np.concatenate([waves.real, waves.imag[:, 1:]], axis=1)


def _at_maximum(values: FloatArray) -> FloatArray:
    """Angle (rad) of each row's maximum over the grid's normals, by a parabola through three values."""
    rows = np.arange(len(values))
    top = values.argmax(axis=1)
    before, centre, after = (values[rows, (top + i) % _GRID] for i in (-1, 0, 1))
    bend = np.minimum(before - 2 * centre + after, -1e-15)
    return np.asarray((top + np.clip((before - after) / (2 * bend), -0.5, 0.5)) * (math.tau / _GRID))


def _thinned(points: FloatArray) -> FloatArray:
    """Indices of points that are at least a coarse step from the previously kept one."""
    step = _COARSE * float(np.ptp(points, axis=0).max())
    kept = [0]
    for i in range(1, len(points)):
        if math.dist(points[i], points[kept[-1]]) >= step:
            kept.append(i)
    return np.array(kept)
