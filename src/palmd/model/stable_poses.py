"""Stable poses of an object between two palms without friction (CMU-CS-01-107, section 3.2), for many palm poses.

A stable pose is a local minimum over ψ of the height Y of the centre of mass. With n1·c = r1, n2·c = r2 that height is

    Y = (r1 sin φ12 + r2 sin φ1) / sin φ2,    r_i = h(θ_i),  dθ_i/dψ = −1 (3.1),

so for an outline h(θ) = Re Σ z_k e^{ikθ} it is a Fourier series in ψ. Its slope is the horizontal distance of the
centre of mass from the centre of rotation (3.21), which is zero in balance (3.22). Heights are in the hinge's frame;
lengths in m, angles in rad; palms must have φ1 > 0, φ2 > 0 and φ12 < π.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.shape import basis, harmonic_of_coefficient, slope_of
from palmd.system.mechanism import normal_directions

ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

SCAN = 180  # values of ψ scanned for sign changes of the slope; more for outlines of high order
_SCAN_PER_HARMONIC = 16
_SETTLED = 1e-13  # rad, Newton step at which a root has converged
_MAX_ITERATIONS = 60  # bisection alone needs 45
_ROWS = 512  # palm poses per batch, so that their scan fits into the processor's cache
_FLAT = 1e-12  # slope, relative to the mean radius, below which it is rounding


@dataclass(frozen=True, slots=True)
class TouchedPoint:
    """Both contacts of a pose: r, d, v (m) of section 3.1, and the readings s1, s2 (m)."""

    r1: FloatArray
    d1: FloatArray
    v1: FloatArray
    r2: FloatArray
    d2: FloatArray
    v2: FloatArray
    s1: FloatArray
    s2: FloatArray


@dataclass(frozen=True, slots=True)
class Basins:
    """Extrema of the height in ψ for many palm poses, (…, K) each, ascending in [0, 2π).

    Rows with fewer than K extrema end in NaN; every row has as many maxima as minima. The object slides from any ψ
    to the minimum between the same two maxima.
    """

    minima: FloatArray
    maxima: FloatArray

    @property
    def count(self) -> IntArray:
        """Number of stable poses of each palm pose, (…)."""
        return cast(IntArray, np.isfinite(self.minima).sum(axis=-1))

    def at(self, where: tuple[slice | int, ...]) -> Basins:
        """Return the extrema of the selected palm poses."""
        return Basins(self.minima[where], self.maxima[where])

    def index(self, psi: FloatArray) -> IntArray:
        """Return the index of the minimum that each ψ (…, P), on any branch, slides to; −1 if its row has none."""
        turned = np.mod(psi, 2 * np.pi)
        passed = (self.maxima[..., None, :] <= turned[..., None]).sum(axis=-1)
        count = self.count[..., None]
        maximum_first = self.maxima[..., :1] < self.minima[..., :1]
        return np.where(count > 0, (passed - maximum_first) % np.maximum(count, 1), -1)


def outline_at(coefficients: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return r = h, d = −h′ and v = h + h″ (m) at normals of any array shape; any odd number of coefficients."""
    order = (len(coefficients) - 1) // 2
    bend = coefficients * (1 - harmonic_of_coefficient(order) ** 2)
    rows = basis(np.ravel(theta), order)
    r, v = (rows @ np.stack([coefficients, bend], axis=1)).T
    d = -slope_of(rows) @ coefficients
    shape = np.shape(theta)
    return r.reshape(shape), d.reshape(shape), v.reshape(shape)


def touch(coefficients: FloatArray, phi1: FloatArray, phi2: FloatArray, psi: FloatArray) -> TouchedPoint:
    """Return contacts and readings of poses, stable or not, which broadcast together: (3.1), (3.13), (3.14)."""
    theta1, theta2 = normal_directions((phi1, phi2), psi)
    r1, d1, v1 = outline_at(coefficients, theta1)
    r2, d2, v2 = outline_at(coefficients, theta2)
    cos, sin = np.cos(phi2), np.sin(phi2)
    return TouchedPoint(r1, d1, v1, r2, d2, v2, (r1 * cos + r2) / sin - d1, (r2 * cos + r1) / sin + d2)


def height_series(coefficients: FloatArray, phi1: FloatArray, phi2: FloatArray) -> ComplexArray:
    """Return y_k (m), (…, order + 1), of Y(ψ) = Re Σ y_k e^{−ikψ}, for palm angles that broadcast together.

    y_k = z_k (sin φ12 e^{ik(φ1 − π/2)} + sin φ1 e^{ik(φ12 − 3π/2)}) / sin φ2. Raises ValueError for palms that
    cannot hold an object.
    """
    phi1, phi2 = np.broadcast_arrays(np.asarray(phi1, dtype=np.float64), np.asarray(phi2, dtype=np.float64))
    phi12 = phi1 + phi2
    if not (np.all(phi1 > 0) and np.all(phi2 > 0) and np.all(phi12 < np.pi)):
        raise ValueError("palms hold an object only with phi1 > 0, phi2 > 0 and phi1 + phi2 < 180°")
    z = np.concatenate([coefficients[:1] + 0j, coefficients[1::2] - 1j * coefficients[2::2]])
    ik = 1j * np.arange(len(z))
    theta1, theta2 = normal_directions((phi1, phi2), np.zeros(()))
    one = (np.sin(phi12) / np.sin(phi2))[..., None] * np.exp(ik * theta1[..., None])
    two = (np.sin(phi1) / np.sin(phi2))[..., None] * np.exp(ik * theta2[..., None])
    return cast(ComplexArray, z * (one + two))


def basins(coefficients: FloatArray, phi1: FloatArray, phi2: FloatArray) -> Basins:
    """Find all stable and unstable equilibria of palm poses of broadcast shape (…): (3.22), (3.24), ψ to 1e-9 rad.

    Scans the slope's sign on a grid of ψ, and between grid points wherever the slope might cross zero twice; Newton's
    method refines within each bracket. A circle about its centre of mass balances everywhere and has no extrema. A
    thousand palm poses take about 6 ms: not for the loop. Raises ValueError as `height_series` does.
    """
    series = height_series(coefficients, phi1, phi2)
    shape = series.shape[:-1]
    flat = series.reshape(-1, series.shape[-1])
    parts = [_extrema(flat, first, coefficients[0]) for first in range(0, max(len(flat), 1), _ROWS)]
    row, roots, lowest = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    minima, maxima = (_table(row[kind], roots[kind], len(flat)) for kind in (lowest, ~lowest))
    return Basins(minima.reshape(*shape, -1), maxima.reshape(*shape, -1))


def nearest_turn(psi: FloatArray, reference: FloatArray) -> FloatArray:
    """Return `psi` plus the multiple of 2π that brings it nearest to `reference` (rad)."""
    return reference + np.mod(psi - reference + np.pi, 2 * np.pi) - np.pi


@dataclass(frozen=True, slots=True)
class _Brackets:
    """Intervals (rad) in which the height's slope of palm pose `row` changes sign once; `rising`: from − to +."""

    row: IntArray
    low: FloatArray
    high: FloatArray
    rising: BoolArray


def _derivatives(series: ComplexArray, order: int) -> list[ComplexArray]:
    """Return the series and its derivatives by ψ up to `order`."""
    factor = -1j * np.arange(series.shape[-1])
    return [series * factor**n for n in range(order + 1)]


def _value(series: ComplexArray, psi: FloatArray) -> FloatArray:
    """Re Σ y_k e^{−ikψ}, by Horner's rule; `psi` broadcasts against the series' leading shape."""
    turn = np.exp(-1j * psi)
    total = np.zeros((), dtype=np.complex128)
    for k in range(series.shape[-1] - 1, -1, -1):
        total = total * turn + series[..., k]
    return total.real


def _on_circle(series: ComplexArray, psi: FloatArray) -> FloatArray:
    """Values of each row's series at the same ψ: (rows, len(psi))."""
    k = np.arange(series.shape[-1])
    angles = np.multiply.outer(k, psi)
    return series.real @ np.cos(angles) + series.imag @ np.sin(angles)


def _extrema(series: ComplexArray, first: int, mean_radius: float) -> tuple[IntArray, FloatArray, BoolArray]:
    """Return row, ψ in [0, 2π), and is-minimum of the extrema of `_ROWS` heights from `first` on."""
    _, slope, curvature = _derivatives(series[first : first + _ROWS], 2)
    found = _brackets(slope, curvature, mean_radius)
    psi = _refine(slope[found.row], curvature[found.row], found)
    return first + found.row, np.mod(psi, 2 * np.pi), found.rising


def _brackets(slope: ComplexArray, curvature: ComplexArray, mean_radius: float) -> _Brackets:
    """Return intervals with one root of a row's slope: sign changes on a grid of ψ, and pairs between grid points."""
    count = max(SCAN, _SCAN_PER_HARMONIC * (slope.shape[-1] - 1))
    width = 2 * np.pi / count
    psi = np.arange(count + 1) * width
    slopes, bends = _on_circle(slope, psi[:-1]), _on_circle(curvature, psi[:-1])
    slopes, bends = (np.concatenate([values, values[:, :1]], axis=1) for values in (slopes, bends))
    uphill = slopes >= 0
    live = np.abs(slopes).max(axis=1, keepdims=True) > _FLAT * abs(mean_radius)
    row, cell = np.nonzero(live & (uphill[:, 1:] != uphill[:, :-1]))
    crossing = _Brackets(row, psi[cell], psi[cell + 1], uphill[row, cell + 1])

    # a slope that bends towards zero and back within a cell, and whose tangents cross zero there, may have two roots
    sign = np.where(uphill, 1.0, -1.0)
    left, right = sign[:, :-1], sign[:, 1:]
    towards = (left == right) & (left * bends[:, :-1] < 0) & (right * bends[:, 1:] > 0)
    near = (left * (slopes[:, :-1] + width * bends[:, :-1]) < 0) & (right * (slopes[:, 1:] - width * bends[:, 1:]) < 0)
    row, cell = np.nonzero(live & towards & near)
    turning = _refine(
        curvature[row],
        _derivatives(curvature[row], 1)[1],
        _Brackets(row, psi[cell], psi[cell + 1], uphill[row, cell]),
    )
    twice = (_value(slope[row], turning) >= 0) != uphill[row, cell]
    row, cell, turning = row[twice], cell[twice], turning[twice]
    first = _Brackets(row, psi[cell], turning, ~uphill[row, cell])
    second = _Brackets(row, turning, psi[cell + 1], uphill[row, cell])
    parts = (crossing, first, second)
    return _Brackets(
        np.concatenate([part.row for part in parts]),
        np.concatenate([part.low for part in parts]),
        np.concatenate([part.high for part in parts]),
        np.concatenate([part.rising for part in parts]),
    )


def _refine(value: ComplexArray, derivative: ComplexArray, start: _Brackets) -> FloatArray:
    """Return the root of each series in its bracket (rad): Newton's method, safeguarded by bisection."""
    low, high = start.low.copy(), start.high.copy()
    psi = 0.5 * (low + high)
    active = np.arange(len(psi))
    for _ in range(_MAX_ITERATIONS):
        if not len(active):
            break
        here = psi[active]
        error = _value(value[active], here)
        below = (error < 0) == start.rising[active]
        low[active] = np.where(below, here, low[active])
        high[active] = np.where(below, high[active], here)
        with np.errstate(divide="ignore", invalid="ignore"):
            wanted = here - error / _value(derivative[active], here)
        inside = (wanted >= low[active]) & (wanted <= high[active])
        psi[active] = np.where(inside, wanted, 0.5 * (low[active] + high[active]))
        active = active[np.abs(psi[active] - here) > _SETTLED]
    return psi


def _table(row: IntArray, roots: FloatArray, rows: int) -> FloatArray:
    """Return the roots of each row, ascending, padded with NaN to the longest row."""
    order = np.lexsort((roots, row))
    row, roots = row[order], roots[order]
    count = np.bincount(row, minlength=rows)
    place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    table = np.full((rows, int(count.max(initial=1))), np.nan)
    table[row, place] = roots
    return table
