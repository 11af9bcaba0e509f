"""Outlines that rest in many poses on the same palms with the same readings (CMU-CS-01-107, figure 3.8).

Equal readings s1, s2 on equal palms mean equal contact points and an equal centre of rotation c_r (3.18). A pose
balances when its centre of mass is above or below c_r (3.22), at any height; height and readings then fix r and d at
both contacts, (3.13) and (3.14). Turn the object to each wanted ψ, ask for that r and d at the normals (3.1) it then
touches with, for enough curvature there (3.24) and for a convex outline everywhere: linear equations and
inequalities in the Fourier coefficients of the support function. Of the outlines that satisfy them the roundest is
taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import nnls

from palmd.events import FloatArray
from palmd.model.shape import basis, harmonic_of_coefficient, tangential_basis
from palmd.model.stable_poses import centre_of_rotation
from palmd.system.mechanism import normal_directions

ORDER = 24
_SHARPEST = 0.1  # of the mean radius: the smallest radius of curvature allowed
_HOLD = 0.4  # of the mean radius: the least second derivative of the height in a wanted pose
_NORMALS_PER_HARMONIC = 16  # where convexity is asked for
_CONTRADICTION = 1e-9
_OPENING = 1.7  # rad: about where the palms are opened for many poses
_LEAN = 0.15  # rad
_LIFT = 1.5
_GOLDEN = 2.4  # rad: heights that do not repeat


@dataclass(frozen=True, slots=True)
class Ambiguous:
    """An outline and its stable poses with equal readings: coefficients (m), ψ (rad), palms (rad), s1 and s2 (m).

    height: Y of the centre of mass from the hinge in each pose (m); it tells the poses apart, but no sensor sees it.
    """

    coefficients: FloatArray
    psi: FloatArray
    height: FloatArray
    phi1: float
    phi2: float
    s1: float
    s2: float


def ambiguous_outline(
    phi1: float, phi2: float, s1: float, s2: float, psi: FloatArray, height: FloatArray, order: int = ORDER
) -> Ambiguous:
    """The roundest convex outline that rests at each ψ (rad) with its COM at that height (m) and reads s1, s2 (m).

    phi1, phi2 in rad. Roundest: least integral of the squared derivative of the radius of curvature. Raises
    ValueError when no convex outline of this order has all those stable poses: fewer poses, more equal heights, or
    normals that are further apart help.
    """
    phi12 = phi1 + phi2
    x = _rotation_centre(phi1, phi2, s1, s2)[0]
    r = np.stack([height * np.cos(phi1) - x * np.sin(phi1), x * np.sin(phi12) - height * np.cos(phi12)])
    d1 = (r[0] * np.cos(phi2) + r[1]) / np.sin(phi2) - s1
    d2 = s2 - (r[1] * np.cos(phi2) + r[0]) / np.sin(phi2)
    theta = np.concatenate(normal_directions((np.asarray(phi1), np.asarray(phi2)), psi))
    mean_radius = float(r.mean())

    rows = basis(theta, order)
    equal = np.concatenate([rows, tangential_basis(theta, order)])
    values = np.concatenate([r.ravel(), d1, d2])
    k = harmonic_of_coefficient(order)
    held = (-(k**2) * rows).reshape(2, len(psi), -1)
    hold = (held[0] * np.sin(phi12) + held[1] * np.sin(phi1)) / np.sin(phi2)
    everywhere = np.linspace(0.0, 2 * np.pi, _NORMALS_PER_HARMONIC * order, endpoint=False)
    convex = basis(everywhere, order) * (1 - k**2)
    least = np.concatenate([np.full(len(psi), _HOLD * mean_radius), np.full(len(convex), _SHARPEST * mean_radius)])
    weight = np.maximum(k * np.abs(1 - k**2), 1.0)
    coefficients = _smallest(weight, (equal, values), (np.concatenate([hold, convex]), least), mean_radius)
    return Ambiguous(coefficients, np.mod(psi, 2 * np.pi), height, phi1, phi2, s1, s2)


def many_poses(count: int, mean_radius: float = 0.02) -> Ambiguous:
    """An object of about this mean radius (m) with `count` stable poses, evenly turned, and equal readings.

    The palms are opened so that the normals of all poses interleave, and leant, so that nothing is symmetric; the
    heights scatter by as much as stays convex. Found for 2 to 12 poses; raises ValueError where there is none.
    """
    halves = np.arange(1, 2 * count, 2)
    phi2 = np.pi * float(1 - halves[np.argmin(np.abs(np.pi - np.pi * halves / count - _OPENING))] / count)
    phi1 = (np.pi - phi2) / 2 - _LEAN
    s = mean_radius / np.tan(phi2 / 2)
    number = np.arange(count)
    lift = _LIFT * mean_radius / max(count, 4) ** 2 * np.cos(_GOLDEN * number + 1)
    height = _rotation_centre(phi1, phi2, s, s)[1] + lift
    order = max(ORDER, 5 * count)
    return ambiguous_outline(phi1, phi2, s, s, 2 * np.pi * number / count, height, order)


def _rotation_centre(phi1: float, phi2: float, s1: float, s2: float) -> FloatArray:
    """c_r (m), (2,), from the readings: (3.18)."""
    return centre_of_rotation(np.asarray(s1), np.asarray(s2), np.asarray(phi1), np.asarray(phi2))


def _smallest(
    weight: FloatArray, equal: tuple[FloatArray, FloatArray], least: tuple[FloatArray, FloatArray], unit: float
) -> FloatArray:
    """The x of least |weight · x| with E x = e and G x ≥ g, all of size `unit`; raises ValueError when there is none.

    Lawson and Hanson's least distance programming: with x = p + Z y, Z spanning the null space of E, the shortest y
    with H y ≥ b comes from the residual of the non-negative least squares of [Hᵀ; bᵀ] u ≈ (0, 1).
    """
    matrix, wanted = equal[0] / weight, equal[1] / unit
    particular = np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    if np.abs(matrix @ particular - wanted).max() > _CONTRADICTION:
        raise ValueError("the wanted poses contradict each other: two of them touch with the same normal")
    free = null_space(matrix)
    inequality = least[0] / weight
    bound = least[1] / unit - inequality @ particular
    system = np.vstack([(inequality @ free).T, bound])
    target = np.zeros(len(system))
    target[-1] = 1.0
    multipliers, distance = nnls(system, target)
    if distance < _CONTRADICTION:
        raise ValueError("no convex outline of this order has all the wanted stable poses")
    residual = system @ multipliers - target
    return np.asarray((particular - free @ residual[:-1] / residual[-1]) / weight * unit)
