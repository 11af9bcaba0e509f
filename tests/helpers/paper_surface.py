"""Stable poses in the paper's notation (CMU-CS-01-107, section 3.2): height, stable poses, inside boundary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model.stable_poses import TouchedPoint, basins, outline_at, touch
from palmd.model.stable_surface import SurfaceLimits

_FOLD_SCAN = 720  # samples of θ1 in the search for boundaries


@dataclass(frozen=True, slots=True)
class Height:
    """Y of the centre of mass (m), and its first two derivatives in ψ (m/rad, m/rad²)."""

    y: FloatArray
    slope: FloatArray
    curvature: FloatArray


def centre_of_mass(touch: TouchedPoint, phi1: FloatArray) -> FloatArray:
    """c_m = s1 t1 − R x1 from the hinge (m), (…, 2): (3.17), with R x1 = −(r1 n1 + d1 t1)."""
    along, across = touch.s1 + touch.d1, touch.r1
    return np.stack(
        [along * np.cos(phi1) - across * np.sin(phi1), along * np.sin(phi1) + across * np.cos(phi1)], axis=-1
    )


def centre_of_rotation(s1: FloatArray, s2: FloatArray, phi1: FloatArray, phi2: FloatArray) -> FloatArray:
    """c_r = s1 t1 − d̃2 n1 / sin φ2 (m), (…, 2), where the contacts' normals meet: (3.18), d̃2 as in (3.6)."""
    across = (s2 - s1 * np.cos(phi2)) / np.sin(phi2)
    return np.stack([s1 * np.cos(phi1) - across * np.sin(phi1), s1 * np.sin(phi1) + across * np.cos(phi1)], axis=-1)


def height(coefficients: FloatArray, phi1: FloatArray, phi2: FloatArray, psi: FloatArray) -> Height:
    """Potential energy per unit weight and its derivatives, for poses that broadcast against each other.

    Y = (r1 sin φ12 + r2 sin φ1) / sin φ2, the Y of (3.17); slope (d1 sin φ12 + d2 sin φ1) / sin φ2, which is
    the left side of (3.23); curvature ((v1 − r1) sin φ12 + (v2 − r2) sin φ1) / sin φ2, that of (3.24) with r̃2 and
    x1 written out.
    """
    at = touch(coefficients, phi1, phi2, psi)
    one, two = np.sin(phi1 + phi2) / np.sin(phi2), np.sin(phi1) / np.sin(phi2)
    return Height(
        at.r1 * one + at.r2 * two, at.d1 * one + at.d2 * two, (at.v1 - at.r1) * one + (at.v2 - at.r2) * two
    )  # fmt: skip


def stable_poses(coefficients: FloatArray, phi1: float, phi2: float) -> FloatArray:
    """All stable ψ of one palm pose (rad), ascending in [0, 2π), to 1e-9: local minima of the height (3.22)–(3.24).

    Raises ValueError as `height_series` does.
    """
    minima = basins(coefficients, np.asarray(phi1), np.asarray(phi2)).minima
    return minima[np.isfinite(minima)]


def inside_boundary(coefficients: FloatArray, limits: SurfaceLimits, phi2: FloatArray) -> FloatArray:
    """Poses (φ1, φ2, ψ) (rad) at which a minimum vanishes, for each of the given φ2 (rad): (F, 3), within the limits.

    Balance needs d1 + λ d2 = 0 and a vanishing minimum h1″ + λ h2″ = 0, both with λ = sin φ1 / sin φ12: so
    d1 h2″ = d2 h1″ ((3.23) and (3.24) without φ1), which θ1 and φ2 decide alone; then λ = −d1/d2 gives
    φ1 = atan2(λ sin φ2, 1 − λ cos φ2).
    """
    theta = np.linspace(0.0, 2 * np.pi, _FOLD_SCAN + 1)
    start1, start2 = np.meshgrid(theta, phi2)
    value = _fold(coefficients, start1, start2)
    row, cell = np.nonzero((value[:, 1:] >= 0) != (value[:, :-1] >= 0))
    at, low, high = np.asarray(phi2)[row], theta[cell], theta[cell + 1]
    rising = value[row, cell + 1] >= 0
    for _ in range(40):
        middle = 0.5 * (low + high)
        below = (_fold(coefficients, middle, at) >= 0) != rising
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    theta1 = 0.5 * (low + high)
    d1 = outline_at(coefficients, theta1)[1]
    d2 = outline_at(coefficients, theta1 + at - np.pi)[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = -d1 / d2
    phi1 = np.arctan2(ratio * np.sin(at), 1 - ratio * np.cos(at))
    psi = np.mod(phi1 - theta1 - np.pi / 2, 2 * np.pi)
    inside = (ratio > 0) & (phi1 >= limits.phi1[0]) & (phi1 <= limits.phi1[1]) & (phi1 + at < limits.phi12_max)
    poses = np.stack([phi1, at, psi], axis=1)[inside]
    contacts = touch(coefficients, *poses.T)
    return poses[limits.on_pads(contacts.s1, contacts.s2)]


def _fold(coefficients: FloatArray, theta1: FloatArray, phi2: FloatArray) -> FloatArray:
    """d1 h2″ − d2 h1″ (m²), with h″ = v − r."""
    r1, d1, v1 = outline_at(coefficients, theta1)
    r2, d2, v2 = outline_at(coefficients, theta1 + phi2 - np.pi)
    return d1 * (v2 - r2) - d2 * (v1 - r1)
