"""How an object rests between palms that vibrate: where the mean of what friction does to it vanishes.

Without friction it rests where its centre of mass is lowest (`stable_poses`). Vibration hides friction of first order
in μ at rest, and leaves one of second order: the normal forces alternate together with the signs of slip, so that
E[s f] ≠ 0 (docs/theory/vibration.md). That turns the rest by some degrees, which way depends on the phase between the
palms. For palms that are arcs the angles are those of the tangents at the contacts. Pure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model.friction import effective_directions, normal_forces
from palmd.model.stable_poses import outline_at
from palmd.system.mechanism import directions, normal_directions

SCAN = 720  # values of ψ among which changes of sign are looked for
_HALVINGS = 40


@dataclass(frozen=True, slots=True)
class Rubbed:
    """A body that friction acts on: radius of gyration ρ (m), coefficient of friction of each palm.

    kappa: E[s1 s2] at rest: 0 for independent vibrations, −1 in phase, 1 in antiphase. transmission: λ.
    """

    rho: float
    mu: tuple[float, float]
    kappa: float = 0.0
    transmission: float = 1.0


@dataclass(frozen=True, slots=True)
class AtRest:
    """Of objects that are still at orientations ψ (…): α0 (rad/s²), f1 and f2 per unit mass (m/s²), on the average."""

    alpha0: FloatArray
    force: tuple[FloatArray, FloatArray]


def at_rest(
    coefficients: FloatArray, phi1: float, phi2: float, psi: FloatArray, body: Rubbed, gravity: float = 9.81
) -> AtRest:
    """What palms at φ1, φ2 that vibrate do to a still object (rad): ρ²α0 = −Σ f_i (d_i + μ_i σ_eff,i r_i)."""
    angles = directions((phi1, phi2))
    sides = 1.0, -1.0
    n = [np.array([-side * math.sin(a), side * math.cos(a)]) for side, a in zip(sides, angles, strict=True)]
    t = [np.array([side * math.cos(a), side * math.sin(a)]) for side, a in zip(sides, angles, strict=True)]
    theta = normal_directions((phi1, phi2), psi)
    (r1, d1, _), (r2, d2, _) = (outline_at(coefficients, np.asarray(each)) for each in theta)
    r, d, rho2 = (r1, r2), (d1, d2), body.rho**2
    A = [[n[i] @ n[j] + d[i] * d[j] / rho2 for j in range(2)] for i in range(2)]
    B = [[n[i] @ t[j] - d[i] * r[j] / rho2 for j in range(2)] for i in range(2)]
    b = [np.full(np.shape(psi), gravity * each[1]) for each in n]
    still = [np.zeros(np.shape(psi))] * 2
    sigma = effective_directions(A, B, b, body.mu, still, body.kappa, body.transmission, np)
    friction = [mu * each for mu, each in zip(body.mu, sigma, strict=True)]
    force = normal_forces(A, B, b, friction, np)
    torque = -sum(f * (d_i + k * r_i) for f, d_i, k, r_i in zip(force, d, friction, r, strict=True))
    return AtRest(torque / rho2, force)


def resting_poses(coefficients: FloatArray, phi1: float, phi2: float, body: Rubbed) -> FloatArray:
    """All stable ψ of one palm pose (rad), ascending in [0, 2π): where α0 falls through zero."""

    def pulled(psi: FloatArray) -> FloatArray:
        return at_rest(coefficients, phi1, phi2, psi, body).alpha0

    width = math.tau / SCAN
    low: FloatArray = np.arange(SCAN, dtype=np.float64) * width
    forward = pulled(low) > 0
    low = low[forward & ~np.roll(forward, -1)]
    high = low + width
    for _ in range(_HALVINGS):
        middle: FloatArray = (low + high) / 2
        ahead = pulled(middle) > 0
        low, high = np.where(ahead, middle, low), np.where(ahead, high, middle)
    return np.sort(np.mod(low, math.tau))
