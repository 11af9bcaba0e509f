"""The quasistatic system (CMU-CS-01-107, chapter 3): shape and motion of an object that is always in balance.

Pure NumPy with broadcasting: readings at one instant (floats) or at many, one guess of the radii or many. SI units.
Inputs are the readings s1, s2, the palms' motion and their rates; unknowns are r1, r2 and ψ, which are determined by
the two initial radii. Without friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray

Values = FloatArray | float


@dataclass(frozen=True, slots=True)
class QuasistaticReadings:
    """Readings s1, s2 (m) and palm angles φ1, φ2 (rad) with their rates, at one instant or at many."""

    s1: Values
    s2: Values
    phi1: Values
    phi2: Values
    s1_dot: Values
    s2_dot: Values
    omega1: Values
    omega2: Values

    @property
    def joints(self) -> tuple[Values, ...]:
        """φ1 and φ2."""
        return self.phi1, self.phi2

    @property
    def joint_rates(self) -> tuple[Values, ...]:
        """ω1 and ω2."""
        return self.omega1, self.omega2

    @property
    def contacts(self) -> tuple[Values, ...]:
        """s1 and s2."""
        return self.s1, self.s2

    @property
    def phi12(self) -> Values:
        """φ1 + φ2."""
        return self.phi1 + self.phi2

    @property
    def omega12(self) -> Values:
        """ω1 + ω2."""
        return self.omega1 + self.omega2


@dataclass(frozen=True, slots=True)
class Generalized:
    """Generalized contact support functions (3.6), projections of the vector between the contacts, and their rates."""

    r1: Values
    d1: Values
    r2: Values
    d2: Values
    r1_dot: Values
    r2_dot: Values
    d2_dot: Values


def generalized(readings: QuasistaticReadings) -> Generalized:
    """(3.6): r̃1 = s2 sin φ2, d̃1 = s2 cos φ2 − s1, r̃2 = −s1 sin φ2, d̃2 = s1 cos φ2 − s2 (m), and their rates (m/s)."""
    sin, cos = np.sin(readings.phi2), np.cos(readings.phi2)
    return Generalized(
        r1=readings.s2 * sin,
        d1=readings.s2 * cos - readings.s1,
        r2=-readings.s1 * sin,
        d2=readings.s1 * cos - readings.s2,
        r1_dot=readings.s2_dot * sin + readings.s2 * cos * readings.omega2,
        r2_dot=-readings.s1_dot * sin - readings.s1 * cos * readings.omega2,
        d2_dot=readings.s1_dot * cos - readings.s1 * sin * readings.omega2 - readings.s2_dot,
    )


def offsets(readings: QuasistaticReadings, r1: Values, r2: Values) -> tuple[Values, Values]:
    """Return (d1, d2) (m) from radii and readings: (3.13), (3.14), with the sign of d2 that the geometry requires."""
    sin, cos = np.sin(readings.phi2), np.cos(readings.phi2)
    return (r1 * cos + r2) / sin - readings.s1, readings.s2 - (r2 * cos + r1) / sin


def balance_lever(readings: QuasistaticReadings, r1: Values, r2: Values) -> Values:
    """Return the denominator D of (3.35), r1 sin φ12 + (r2 + r̃2) sin φ1 + d̃2 cos φ1 (m): ∂(balance error)/∂ψ.

    It may have either sign in a stable pose. Where it is 0 (for a circle everywhere) ψ̇ is not observable.
    """
    tilde = generalized(readings)
    return r1 * np.sin(readings.phi12) + (r2 + tilde.r2) * np.sin(readings.phi1) + tilde.d2 * np.cos(readings.phi1)


def turning_rate(readings: QuasistaticReadings, r1: Values, r2: Values, softening: float = 0.0) -> Values:
    """Return ψ̇ (rad/s) of an object that stays in balance (3.35).

    `softening` (m): length ε that replaces 1/D by D/(D² + ε²), D the `balance_lever`. At zeros of D the printed
    equation is 0/0, and noise and friction in the numerator would be amplified without bound. 0: as printed.
    """
    tilde = generalized(readings)
    drive = (
        tilde.r2_dot * np.cos(readings.phi1)
        - tilde.d2_dot * np.sin(readings.phi1)
        + tilde.d2 * readings.omega2 * np.sin(readings.phi12) / np.sin(readings.phi2)
    )
    D = balance_lever(readings, r1, r2)
    return drive * D / (D**2 + softening**2)


def contact_rates(readings: QuasistaticReadings, psi_dot: Values) -> tuple[Values, Values]:
    """Return θ̇1 v1, θ̇2 v2 (m/s), the contacts' speeds along the outline: (3.27), (3.28) before dividing by θ̇."""
    tilde, sin = generalized(readings), np.sin(readings.phi2)
    theta1_dot, theta2_dot = readings.omega1 - psi_dot, readings.omega12 - psi_dot
    return -(tilde.r2_dot + theta2_dot * tilde.d2) / sin, -(tilde.r1_dot + theta1_dot * tilde.d1) / sin


STATE = ("r1", "r2", "psi", "d1", "d2")


def rates(readings: QuasistaticReadings, state: FloatArray, softening: float = 0.0) -> FloatArray:
    """Return d/dt of `STATE`, (5, …): (3.33), (3.34), (3.35), and ḋ = (r − v) θ̇ for the integrated offsets.

    The radii are driven by the offsets from the readings, (3.13) and (3.14); the integrated offsets d1, d2 feed back
    into nothing and serve for comparison with the readings, see `closure_error`.
    """
    r1, r2 = state[0], state[1]
    d1, d2 = offsets(readings, r1, r2)
    psi_dot = turning_rate(readings, r1, r2, softening)
    speed1, speed2 = contact_rates(readings, psi_dot)
    theta1_dot, theta2_dot = readings.omega1 - psi_dot, readings.omega12 - psi_dot
    return np.stack(
        np.broadcast_arrays(
            -d1 * theta1_dot, -d2 * theta2_dot, psi_dot, r1 * theta1_dot - speed1, r2 * theta2_dot - speed2
        )
    )


def balance_error(readings: QuasistaticReadings, r1: Values, r2: Values) -> Values:
    """Return e_f (m), (3.36): r1 sin φ1 − d1 cos φ1 + d̃2 sin φ1/sin φ2, with d1 from (3.13).

    It is the horizontal distance of the centre of mass from the centre of rotation, constant along any solution of
    (3.33)–(3.35), since (3.35) sets its derivative to 0.
    """
    d1, _ = offsets(readings, r1, r2)
    return (
        r1 * np.sin(readings.phi1)
        - d1 * np.cos(readings.phi1)
        + generalized(readings).d2 * np.sin(readings.phi1) / np.sin(readings.phi2)
    )


def closure_error(readings: QuasistaticReadings, state: FloatArray) -> FloatArray:
    """Return e_c (2, …) (m, world axes), (3.37): R(ψ)(x1 − x2) − s1 t1 − s2 t2, R x_i = −(r_i n_i + d_i t_i).

    r_i and d_i are the integrated ones. Zero for exact readings and exact integration, for any initial radii; it
    shows the drift of the integration.
    """
    r1, r2, _, d1, d2 = state
    phi1, phi12 = readings.phi1, readings.phi12
    sin1, cos1, sin12, cos12 = np.sin(phi1), np.cos(phi1), np.sin(phi12), np.cos(phi12)
    x = r1 * sin1 - d1 * cos1 + r2 * sin12 - d2 * cos12 - readings.s1 * cos1 + readings.s2 * cos12
    y = -r1 * cos1 - d1 * sin1 - r2 * cos12 - d2 * sin12 - readings.s1 * sin1 + readings.s2 * sin12
    return np.stack(np.broadcast_arrays(x, y))


def radii_of(readings: QuasistaticReadings, mean: Values, balance: Values) -> tuple[Values, Values]:
    """Return (r1, r2) (m) with the given mean and `balance_error` (m), the two degrees of freedom of a start.

    e_f = −(r1 cos φ12 + r2 cos φ1)/sin φ2 + K with K = s1 cos φ1 + d̃2 sin φ1/sin φ2, from (3.13) and (3.36).
    """
    cos1, cos12, sin2 = np.cos(readings.phi1), np.cos(readings.phi12), np.sin(readings.phi2)
    K = readings.s1 * cos1 + generalized(readings).d2 * np.sin(readings.phi1) / sin2
    half = (sin2 * (K - balance) - mean * (cos12 + cos1)) / (cos12 - cos1)
    return mean + half, mean - half
