"""The quasistatic system (CMU-CS-01-107, chapter 3): shape and motion of an object that is always in balance.

Pure NumPy, broadcasting: what is felt may be one instant (floats) or many, the radii one guess or many. SI units.
The readings s1, s2 and the palms' motion, with their rates, drive it; the unknown are r1, r2 and ψ, in the end only
the two radii at the beginning. Friction is not in it.
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


def generalized(felt: QuasistaticReadings) -> Generalized:
    """(3.6): r̃1 = s2 sin φ2, d̃1 = s2 cos φ2 − s1, r̃2 = −s1 sin φ2, d̃2 = s1 cos φ2 − s2 (m), and their rates (m/s)."""
    sin, cos = np.sin(felt.phi2), np.cos(felt.phi2)
    return Generalized(
        r1=felt.s2 * sin,
        d1=felt.s2 * cos - felt.s1,
        r2=-felt.s1 * sin,
        d2=felt.s1 * cos - felt.s2,
        r1_dot=felt.s2_dot * sin + felt.s2 * cos * felt.omega2,
        r2_dot=-felt.s1_dot * sin - felt.s1 * cos * felt.omega2,
        d2_dot=felt.s1_dot * cos - felt.s1 * sin * felt.omega2 - felt.s2_dot,
    )


def offsets(felt: QuasistaticReadings, r1: Values, r2: Values) -> tuple[Values, Values]:
    """(d1, d2) (m) from the radii and the readings: (3.13), (3.14) with d2's sign as the geometry has it."""
    sin, cos = np.sin(felt.phi2), np.cos(felt.phi2)
    return (r1 * cos + r2) / sin - felt.s1, felt.s2 - (r2 * cos + r1) / sin


def balance_lever(felt: QuasistaticReadings, r1: Values, r2: Values) -> Values:
    """The denominator D of (3.35), r1 sin φ12 + (r2 + r̃2) sin φ1 + d̃2 cos φ1 (m): what a turn adds to the balance.

    It may have either sign in a stable pose. Where it is 0 (for a circle everywhere) readings tell nothing of turning.
    """
    tilde = generalized(felt)
    return r1 * np.sin(felt.phi12) + (r2 + tilde.r2) * np.sin(felt.phi1) + tilde.d2 * np.cos(felt.phi1)


def turning_rate(felt: QuasistaticReadings, r1: Values, r2: Values, softening: float = 0.0) -> Values:
    """ψ̇ (rad/s) of an object that stays in balance (3.35).

    `softening` (m) is a length ε that turns 1/D into D/(D² + ε²), D the `balance_lever`: at its zeros the printed
    equation is 0/0, and what noise and friction leave of the numerator has no bound. 0 is the equation as printed.
    """
    tilde = generalized(felt)
    drive = (
        tilde.r2_dot * np.cos(felt.phi1)
        - tilde.d2_dot * np.sin(felt.phi1)
        + tilde.d2 * felt.omega2 * np.sin(felt.phi12) / np.sin(felt.phi2)
    )
    D = balance_lever(felt, r1, r2)
    return drive * D / (D**2 + softening**2)


def contact_rates(felt: QuasistaticReadings, psi_dot: Values) -> tuple[Values, Values]:
    """θ̇1 v1 and θ̇2 v2 (m/s): how fast the contacts run along the outline, (3.27) and (3.28) without their division."""
    tilde, sin = generalized(felt), np.sin(felt.phi2)
    theta1_dot, theta2_dot = felt.omega1 - psi_dot, felt.omega12 - psi_dot
    return -(tilde.r2_dot + theta2_dot * tilde.d2) / sin, -(tilde.r1_dot + theta1_dot * tilde.d1) / sin


STATE = ("r1", "r2", "psi", "d1", "d2")


def rates(felt: QuasistaticReadings, state: FloatArray, softening: float = 0.0) -> FloatArray:
    """d/dt of `STATE`, (5, …): (3.33), (3.34), (3.35), and of the offsets carried along by curvature, ḋ = (r − v) θ̇.

    The radii are driven by the offsets that the readings give, (3.13) and (3.14); those carried along have no say and
    are there to be compared with the readings, see `closure_error`.
    """
    r1, r2 = state[0], state[1]
    d1, d2 = offsets(felt, r1, r2)
    psi_dot = turning_rate(felt, r1, r2, softening)
    run1, run2 = contact_rates(felt, psi_dot)
    theta1_dot, theta2_dot = felt.omega1 - psi_dot, felt.omega12 - psi_dot
    return np.stack(
        np.broadcast_arrays(-d1 * theta1_dot, -d2 * theta2_dot, psi_dot, r1 * theta1_dot - run1, r2 * theta2_dot - run2)
    )


def balance_error(felt: QuasistaticReadings, r1: Values, r2: Values) -> Values:
    """e_f (m), (3.36): r1 sin φ1 − d1 cos φ1 + d̃2 sin φ1/sin φ2, how far the centre of mass is beside that of rotation.

    With d1 from (3.13). Any solution of (3.33)–(3.35) keeps its first value: (3.35) is its derivative, set to 0.
    """
    d1, _ = offsets(felt, r1, r2)
    return (
        r1 * np.sin(felt.phi1) - d1 * np.cos(felt.phi1) + generalized(felt).d2 * np.sin(felt.phi1) / np.sin(felt.phi2)
    )


def closure_error(felt: QuasistaticReadings, state: FloatArray) -> FloatArray:
    """e_c (2, …) (m, world axes), (3.37): R(ψ)(x1 − x2) − s1 t1 − s2 t2, with R x_i = −(r_i n_i + d_i t_i) as carried.

    Zero for exact readings exactly integrated, whatever the radii at the beginning; it shows how integration drifts.
    """
    r1, r2, _, d1, d2 = state
    phi1, phi12 = felt.phi1, felt.phi12
    sin1, cos1, sin12, cos12 = np.sin(phi1), np.cos(phi1), np.sin(phi12), np.cos(phi12)
    x = r1 * sin1 - d1 * cos1 + r2 * sin12 - d2 * cos12 - felt.s1 * cos1 + felt.s2 * cos12
    y = -r1 * cos1 - d1 * sin1 - r2 * cos12 - d2 * sin12 - felt.s1 * sin1 + felt.s2 * sin12
    return np.stack(np.broadcast_arrays(x, y))


def radii_of(felt: QuasistaticReadings, mean: Values, balance: Values) -> tuple[Values, Values]:
    """(r1, r2) (m) of the given mean and `balance_error` (m): the two freedoms of a beginning.

    e_f = −(r1 cos φ12 + r2 cos φ1)/sin φ2 + K with K = s1 cos φ1 + d̃2 sin φ1/sin φ2, from (3.13) and (3.36).
    """
    cos1, cos12, sin2 = np.cos(felt.phi1), np.cos(felt.phi12), np.sin(felt.phi2)
    K = felt.s1 * cos1 + generalized(felt).d2 * np.sin(felt.phi1) / sin2
    half = (sin2 * (K - balance) - mean * (cos12 + cos1)) / (cos12 - cos1)
    return mean + half, mean - half
