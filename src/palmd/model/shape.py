"""The outline as a Fourier series: support function, its derivatives, and what is known of it beforehand.

h(θ) = a0 + Σ_k a_k cos kθ + b_k sin kθ about the centre of mass, θ the direction of the outward normal in the
object's frame. Then r = h, d = −h′, v = h + h″ (CMU-CS-01-107, section 3.1). The first harmonic is not gauge:
it is where the centre of mass lies in the body, and gravity feels it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from palmd.events import FloatArray
from palmd.model.contact import Contact
from palmd.model.symbolic import SX, ca
from palmd.system.mechanism import OPENING, normal_directions

HARMONICS = 7
COEFFICIENTS = 2 * HARMONICS + 1


def basis(theta: FloatArray, order: int = HARMONICS) -> FloatArray:
    """Values of (1, cos θ, sin θ, cos 2θ, …) up to harmonic `order` on each of `theta`: (len(theta), 2·order + 1)."""
    k = np.arange(1, order + 1)
    angles = np.multiply.outer(np.asarray(theta, dtype=np.float64), k)
    rows = np.ones((angles.shape[0], 2 * order + 1))
    rows[:, 1::2], rows[:, 2::2] = np.cos(angles), np.sin(angles)
    return rows


def slope_of(rows: FloatArray) -> FloatArray:
    """Rows of h′ from those of h by `basis`, without another sine."""
    slope, k = np.zeros_like(rows), np.arange(1, rows.shape[1] // 2 + 1)
    slope[:, 1::2], slope[:, 2::2] = -k * rows[:, 2::2], k * rows[:, 1::2]
    return slope


def tangential_basis(theta: FloatArray, order: int = HARMONICS) -> FloatArray:
    """−d/dθ of `basis`: what maps coefficients to the tangential offset d = −h′."""
    return -slope_of(basis(theta, order))


def gauge_free_basis(theta: FloatArray, touched: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Rows mapping small errors of `coefficients` to those of h on `theta`, whatever the orientation.

    h(θ) − h′(θ)·ε, ε the rotation by least squares over the normals `touched` (rad), if there are any.
    """
    order = (len(coefficients) - 1) // 2
    rows, felt = (basis(at, order) for at in (theta, touched))
    return gauge_free_rows((rows, -slope_of(rows)), (felt, -slope_of(felt)), coefficients)


def gauge_free_rows(
    rows: tuple[FloatArray, FloatArray], felt: tuple[FloatArray, FloatArray], coefficients: FloatArray
) -> FloatArray:
    """The same from `basis` and `tangential_basis` on these normals, `rows`, and on those touched, `felt`."""
    if not len(felt[0]):
        return rows[0]
    slope = -felt[1] @ coefficients
    turn = slope @ felt[0] / max(float(slope @ slope), 1e-30)
    free: FloatArray = rows[0] + np.outer(rows[1] @ coefficients, turn)
    return free


def coefficients_of(h: FloatArray, order: int = HARMONICS) -> FloatArray:
    """Coefficients (m) up to harmonic `order` of a support function given on evenly spaced normals from 0.

    a_k + i b_k = 2/n Σ_j h(θ_j) e^{ikθ_j}, exact for a band-limited h on more than 2·order normals.
    """
    rows = basis(np.arange(len(h), dtype=np.float64) * (2 * np.pi / len(h)), order)
    coefficients: FloatArray = rows.T @ h * (2 / len(h))
    coefficients[0] /= 2
    return coefficients


def contact_rows(*joints: float) -> tuple[FloatArray, FloatArray]:
    """(radii, readings): rows mapping coefficients to both radii and both readings at these joint angles (rad), ψ = 0.

    (3.13) and (3.14), linear in the outline.
    """
    theta = np.array(normal_directions(joints, 0.0))
    r, d = basis(theta), tangential_basis(theta)
    opening = joints[OPENING]
    lever = (r * np.cos(opening) + r[::-1]) / np.sin(opening)
    return r, lever + np.array([[-1.0], [1.0]]) * d


def curvature_rows() -> FloatArray:
    """Rows mapping the coefficients of h to those of v = h + h″: harmonics 0, 2, 3, … (the first vanishes)."""
    k = harmonic_of_coefficient()
    rows: FloatArray = np.diag(1 - k**2)[k != 1]
    return rows


def harmonic_of_coefficient(order: int = HARMONICS) -> FloatArray:
    """k of each coefficient, in the order of `basis`: 0, 1, 1, 2, 2, …"""
    return np.repeat(np.arange(order + 1), 2)[1:].astype(np.float64)


def prior_sd(mean_radius: float, order: int = HARMONICS) -> FloatArray:
    """One-sigma of each coefficient (m) before anything is felt; the mean radius itself is not covered here.

    A smooth convex lump: an elongation of several percent, then falling like k^−1.7; v ≥ 0 follows nearly
    always, since harmonic k enters v with k² − 1.
    """
    k = harmonic_of_coefficient(order)
    sd = 0.045 * mean_radius * (2.0 / np.maximum(k, 1.0)) ** 1.7
    sd[k == 1] = 0.03 * mean_radius
    sd[0] = 0.0
    return sd


def harmonics(theta: SX, order: int = HARMONICS) -> Iterator[tuple[int, SX, SX]]:
    """(k, cos kθ, sin kθ) for each harmonic, by the addition theorem: two calls of libm instead of 2·order."""
    cos1, sin1 = ca.cos(theta), ca.sin(theta)
    cos, sin = cos1, sin1
    for k in range(1, order + 1):
        yield k, cos, sin
        cos, sin = cos * cos1 - sin * sin1, sin * cos1 + cos * sin1


def contact_at(theta: SX, coefficients: SX) -> Contact:
    """r, d, v of the outline where its outward normal is `theta`; any odd number of coefficients."""
    r, d, v, v_rate = coefficients[0], SX(0), coefficients[0], SX(0)
    for k, cos, sin in harmonics(theta, (coefficients.shape[0] - 1) // 2):
        a, b = coefficients[2 * k - 1], coefficients[2 * k]
        even, odd = a * cos + b * sin, a * sin - b * cos
        r = r + even
        d = d + k * odd
        v = v + (1 - k**2) * even
        v_rate = v_rate - (1 - k**2) * k * odd
    return Contact(r, d, v, v_rate)


def turned(turn: float, order: int = HARMONICS) -> FloatArray:
    """The matrix that maps coefficients of h(θ) to those of h(θ + turn), turn in rad."""
    k = np.arange(1, order + 1)
    cos, sin = np.cos(k * turn), np.sin(k * turn)
    matrix = np.zeros((2 * order + 1, 2 * order + 1))
    matrix[0, 0] = 1.0
    even, odd = 2 * k - 1, 2 * k
    matrix[even, even], matrix[even, odd] = cos, sin
    matrix[odd, even], matrix[odd, odd] = -sin, cos
    return matrix
