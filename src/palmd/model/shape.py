"""The outline as a Fourier series: support function, its derivatives, and its prior.

h(θ) = a0 + Σ_k a_k cos kθ + b_k sin kθ about the centre of mass, θ the direction of the outward normal in the
object's frame. Then r = h, d = −h′, v = h + h″ (CMU-CS-01-107, section 3.1). The first harmonic is not a gauge
freedom: it gives the position of the centre of mass in the body, on which gravity acts.
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
    """Return (1, cos θ, sin θ, cos 2θ, …) up to harmonic `order` for each of `theta`: (len(theta), 2·order + 1)."""
    k = np.arange(1, order + 1)
    angles = np.multiply.outer(np.asarray(theta, dtype=np.float64), k)
    rows = np.ones((angles.shape[0], 2 * order + 1))
    rows[:, 1::2], rows[:, 2::2] = np.cos(angles), np.sin(angles)
    return rows


def slope_of(rows: FloatArray) -> FloatArray:
    """Return the rows of h′ from those of h (`basis`), without computing sines again."""
    slope, k = np.zeros_like(rows), np.arange(1, rows.shape[1] // 2 + 1)
    slope[:, 1::2], slope[:, 2::2] = -k * rows[:, 2::2], k * rows[:, 1::2]
    return slope


def tangential_basis(theta: FloatArray, order: int = HARMONICS) -> FloatArray:
    """Return −d/dθ of `basis`, which maps coefficients to the tangential offset d = −h′."""
    return -slope_of(basis(theta, order))


def gauge_free_basis(theta: FloatArray, touched: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Return rows that map small errors of `coefficients` to errors of h at `theta`, apart from a common rotation.

    h(θ) − h′(θ)·ε, ε the least-squares rotation over the normals `touched` (rad), if there are any.
    """
    order = (len(coefficients) - 1) // 2
    rows, touched_rows = (basis(at, order) for at in (theta, touched))
    return gauge_free_rows((rows, -slope_of(rows)), (touched_rows, -slope_of(touched_rows)), coefficients)


def gauge_free_rows(
    rows: tuple[FloatArray, FloatArray], touched: tuple[FloatArray, FloatArray], coefficients: FloatArray
) -> FloatArray:
    """`gauge_free_basis` from `basis` and `tangential_basis` of the normals (`rows`) and of those touched."""
    if not len(touched[0]):
        return rows[0]
    slope = -touched[1] @ coefficients
    turn = slope @ touched[0] / max(float(slope @ slope), 1e-30)
    free: FloatArray = rows[0] + np.outer(rows[1] @ coefficients, turn)
    return free


def coefficients_of(h: FloatArray, order: int = HARMONICS) -> FloatArray:
    """Return the coefficients (m) up to harmonic `order` of a support function on evenly spaced normals from 0.

    a_k + i b_k = 2/n Σ_j h(θ_j) e^{ikθ_j}, exact for a band-limited h on more than 2·order normals.
    """
    rows = basis(np.arange(len(h), dtype=np.float64) * (2 * np.pi / len(h)), order)
    coefficients: FloatArray = rows.T @ h * (2 / len(h))
    coefficients[0] /= 2
    return coefficients


def contact_rows(*joints: float) -> tuple[FloatArray, FloatArray]:
    """Return rows that map coefficients to both radii and to both readings, at these joint angles (rad) and ψ = 0.

    (3.13) and (3.14), linear in the outline.
    """
    theta = np.array(normal_directions(joints, 0.0))
    r, d = basis(theta), tangential_basis(theta)
    opening = joints[OPENING]
    lever = (r * np.cos(opening) + r[::-1]) / np.sin(opening)
    return r, lever + np.array([[-1.0], [1.0]]) * d


def curvature_rows() -> FloatArray:
    """Return rows that map the coefficients of h to those of v = h + h″, harmonics 0, 2, 3, … (the first vanishes)."""
    k = harmonic_of_coefficient()
    rows: FloatArray = np.diag(1 - k**2)[k != 1]
    return rows


def harmonic_of_coefficient(order: int = HARMONICS) -> FloatArray:
    """Return k of each coefficient, in the order of `basis`: 0, 1, 1, 2, 2, …"""
    return np.repeat(np.arange(order + 1), 2)[1:].astype(np.float64)


def prior_sd(mean_radius: float, order: int = HARMONICS) -> FloatArray:
    """Return the prior standard deviation of each coefficient (m), 0 for the mean radius, which has its own prior.

    Describes smooth convex lumps: an elongation of several percent, then falling like k^−1.7; v ≥ 0 holds nearly
    always, although harmonic k enters v with k² − 1.
    """
    k = harmonic_of_coefficient(order)
    sd = 0.045 * mean_radius * (2.0 / np.maximum(k, 1.0)) ** 1.7
    sd[k == 1] = 0.03 * mean_radius
    sd[0] = 0.0
    return sd


def harmonics(theta: SX, order: int = HARMONICS) -> Iterator[tuple[int, SX, SX]]:
    """Yield (k, cos kθ, sin kθ) for each harmonic, by the addition theorem: two libm calls instead of 2·order."""
    cos1, sin1 = ca.cos(theta), ca.sin(theta)
    cos, sin = cos1, sin1
    for k in range(1, order + 1):
        yield k, cos, sin
        cos, sin = cos * cos1 - sin * sin1, sin * cos1 + cos * sin1


def contact_at(theta: SX, coefficients: SX) -> Contact:
    """Return r, d, v of the outline at outward normal `theta`; any odd number of coefficients."""
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
    """Return the matrix that maps the coefficients of h(θ) to those of h(θ + turn), turn in rad."""
    k = np.arange(1, order + 1)
    cos, sin = np.cos(k * turn), np.sin(k * turn)
    matrix = np.zeros((2 * order + 1, 2 * order + 1))
    matrix[0, 0] = 1.0
    even, odd = 2 * k - 1, 2 * k
    matrix[even, even], matrix[even, odd] = cos, sin
    matrix[odd, even], matrix[odd, odd] = -sin, cos
    return matrix
