"""Rigid-body dynamics of the object between the palms, without singularities.

CMU-CS-01-107 eliminates the radii of curvature v1, v2 and gets (4.16), (4.17), which divide by the contacts'
sliding rates. Keeping v1, v2 leaves three linear equations in f1, f2, α0 (docs/theory/theory.md), solvable whenever
the palms are not parallel; no force or torque sensor is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from palmd.model.contact import Contact, centre_of_mass, normal, solve_from_normals, tangent
from palmd.model.friction import FRICTION_NOISE_S, HOP_NOISE_S, SlipResponse, Vibrated, averaged, normal_forces
from palmd.model.symbolic import SX, ca

VIBRATION_INPUTS, HALF_PERIOD_INPUT, VIBRATION_ERROR_INPUTS = slice(7, 10), 10, slice(11, 15)
"""Indices of the kernels' rig inputs: κ, λ, flag of the averaged law; 1/(2f) (s); the errors of κ and λ, and the
relative errors of 1/(2f) and of friction's lever arm."""


@dataclass(frozen=True, slots=True)
class Palms:
    """Angles (rad), rates (rad/s) and accelerations (rad/s²) of the palms."""

    phi1: SX
    phi2: SX
    omega1: SX
    omega2: SX
    alpha1: SX
    alpha2: SX

    @property
    def angles(self) -> tuple[SX, SX]:
        """φ1 and φ2."""
        return self.phi1, self.phi2

    @property
    def rates(self) -> tuple[SX, SX]:
        """ω1 and ω2."""
        return self.omega1, self.omega2

    @property
    def phi12(self) -> SX:
        """φ1 + φ2, the world angle of palm 2."""
        return self.phi1 + self.phi2

    @property
    def omega12(self) -> SX:
        """ω1 + ω2."""
        return self.omega1 + self.omega2

    @property
    def alpha12(self) -> SX:
        """α1 + α2."""
        return self.alpha1 + self.alpha2


@dataclass(frozen=True, slots=True)
class BodyConstants:
    """Radius of gyration ρ (m), friction coefficient μ (mean of both palms), damping c (m²/s).

    dither: u_d = πV/2 (m/s), V the speed amplitude of the palms' vibration along themselves.
    """

    rho: SX
    mu: SX
    dither: SX
    damping: SX


@dataclass(frozen=True, slots=True)
class Motion:
    """Result of Newton–Euler: α0 (rad/s²) and the normal forces per unit mass f1, f2 (m/s²), means over a vibration.

    least: smallest force on each contact within a vibration (m/s²). discrepancy: spectral density ((rad/s²)²/Hz) of
    α0's error due to the friction law, 0 for the averaged law; hopping: the part of it due to hopping contacts.
    pulling_force: with which contacts would have to pull, and hop instead (m/s²).
    softened_alpha0: α0 with the directions `Averaged.softened`; its derivative by ω0 is the rate for
    `exponential_step`, since that of α0 jumps where contacts begin to stick.
    """

    alpha0: SX
    f1: SX
    f2: SX
    least: tuple[SX, ...]
    discrepancy: SX
    hopping: SX
    pulling_force: SX
    softened_alpha0: SX

    @property
    def forces(self) -> tuple[SX, SX]:
        """f1 and f2."""
        return self.f1, self.f2


def effective_gravity(palms: Palms, rig: SX) -> SX:
    """Return the apparent gravity in the hinge's frame: (0, −g) − a_O, with O = B − L1 t1(φ1) (m/s²).

    `rig` starts with (g, L1); L1 = 0 means a fixed hinge.
    """
    t1, n1 = tangent(palms.phi1, 1), normal(palms.phi1, 1)
    return ca.vertcat(0, -rig[0]) + rig[1] * (palms.alpha1 * n1 - palms.omega1**2 * t1)


def vibrated_of(dither: SX, rig: SX) -> Vibrated:
    """Return the palms' vibration according to the kernels' rig inputs; κ is clipped to ±1."""
    kappa, transmission, averaged = ca.vertsplit(rig[VIBRATION_INPUTS])
    kappa_error, transmission_error, _, _ = ca.vertsplit(rig[VIBRATION_ERROR_INPUTS])
    kappa = ca.fmin(ca.fmax(kappa + kappa_error, -1), 1)
    return Vibrated(dither, kappa, transmission + transmission_error, averaged)


def half_period_of(rig: SX) -> SX:
    """Return 1/(2f) (s) of the palms' vibration according to the kernels' rig inputs; at least 0."""
    _, _, period_error, _ = ca.vertsplit(rig[VIBRATION_ERROR_INPUTS])
    return rig[HALF_PERIOD_INPUT] * ca.fmax(1 + period_error, 0)


def newton_euler(
    palms: Palms, omega0: SX, one: Contact, two: Contact, body: BodyConstants, rig: SX, steps: int = 1
) -> Motion:
    """Solve the three linear equations of docs/theory/theory.md for α0, f1, f2.

    Two of them keep both contacts closed (n_i·a is prescribed by the contact's motion), the third is
    ρ²α0 = Σ f_i (x_i × F_i) − c ω0 with F_i = n_i − μ_i σ_i t_i. With the friction directions σ_i of `model.friction`
    one solve gives the means of f1, f2, α0 over the palms' vibration.
    `rig` is (g, L1, x, y, a, …, κ, λ, averaged, 1/(2f), Δκ, Δλ, 2f Δ(1/(2f)), b): μ1 = (1 + a) μ, μ2 = (1 − a) μ.
    Friction acts as on a body that is larger by b r on palms that are lower by b r (docs/theory/vibration.md).
    The tangent of a curved palm at the contact turns at γ = ω ± κ ṡ, which adds ω(2γ − ω) p·n − κ ṡ² to n_i·a, p the
    contact's position (docs/theory/curved.md).
    Valid while f1, f2 > 0. steps: iterations for a ripple that is consistent with the time shares that it causes. One
    is enough for independent vibrations; in antiphase one is no better than none, and two leave a third of the error.
    """
    c = centre_of_mass(palms.phi1, palms.phi2, one, two)
    friction = (body.mu * (1 + rig[4]), body.mu * (1 - rig[4]))
    rates = (palms.omega1, palms.omega12)
    accelerations = (palms.alpha1, palms.alpha12)
    contacts = (one, two)
    tangents = (tangent(palms.phi1 + one.turn, 1), tangent(palms.phi12 + two.turn, 2))
    normals = (normal(palms.phi1 + one.turn, 1), normal(palms.phi12 + two.turn, 2))

    # n_i·ċ = ṙ_i − ω_i e_i·c with e_i = dn_i/dφ_i = −t_i and ṙ_i = −d_i θ̇_i
    along = [-k.d * (w - omega0) + w * ca.dot(t, c) for k, w, t in zip(contacts, rates, tangents, strict=True)]
    c_dot = solve_from_normals(palms.phi1 + one.turn, palms.phi2 + two.turn - one.turn, *along)

    g_eff = effective_gravity(palms, rig)
    _, _, _, arm_error = ca.vertsplit(rig[VIBRATION_ERROR_INPUTS])
    arms = [k.r * (1 + arm_error) for k in contacts]
    slips, needed = [], []
    for k, w, a, t, n in zip(contacts, rates, accelerations, tangents, normals, strict=True):
        slip = ca.dot(t, c_dot) + omega0 * k.r + w * k.above
        bending = k.curvature * (slip + k.v * (w - omega0)) / (1 - k.curvature * k.v)  # ± κ ṡ
        turning = w + bending
        slips.append(slip + arm_error * k.r * (omega0 - w))
        # n_i·a without its α0 term, minus the contribution of gravity
        needed.append(
            (k.v - k.r) * (turning - omega0) ** 2
            - k.d * a
            + 2 * turning * ca.dot(t, c_dot)
            + a * ca.dot(t, c)
            + turning**2 * k.r
            - ca.dot(n, g_eff)
            + w * (2 * turning - w) * k.above
            - bending * (slip + k.v * (turning - omega0))
        )

    # (A − B diag(μσ)) f = b, after α0 is eliminated by the torque equation
    rho2 = body.rho**2
    A = [[ca.dot(normals[i], normals[j]) + contacts[i].d * contacts[j].d / rho2 for j in range(2)] for i in range(2)]
    B = [[ca.dot(normals[i], tangents[j]) - contacts[i].d * arms[j] / rho2 for j in range(2)] for i in range(2)]
    b = [needed[i] - contacts[i].d * body.damping * omega0 / rho2 for i in range(2)]
    c_dot_by_omega0 = solve_from_normals(palms.phi1 + one.turn, palms.phi2 + two.turn - one.turn, one.d, two.d)
    slip_by_omega0 = [ca.dot(t, c_dot_by_omega0) + arm for t, arm in zip(tangents, arms, strict=True)]
    response = SlipResponse(slip_by_omega0, [k.d for k in contacts], arms, rho2, half_period_of(rig))
    mean = averaged(A, B, b, friction, slips, vibrated_of(body.dither, rig), response, steps)

    def solve(directions: Sequence[SX]) -> tuple[SX, tuple[SX, SX], list[SX], list[SX]]:
        along = [mu * each for mu, each in zip(friction, directions, strict=True)]
        forces = normal_forces(A, B, b, along)
        torques = [-(k.d + mu_sigma * arm) for k, arm, mu_sigma in zip(contacts, arms, along, strict=True)]
        spin = (forces[0] * torques[0] + forces[1] * torques[1] - body.damping * omega0) / rho2
        return spin, forces, along, torques

    alpha0, (f1, f2), along, torques = solve(mean.directions)

    def by_friction(i: int, f: SX) -> SX:
        """∂α0/∂ln μ_i: through the friction force's own torque and through both normal forces."""
        rubbing = along[i] * f
        f1_change, f2_change = normal_forces(A, B, [row[i] * rubbing for row in B], along)
        change: SX = (f1_change * torques[0] + f2_change * torques[1] - rubbing * arms[i]) / rho2
        return change

    hopping = HOP_NOISE_S * mean.pulled**2
    uncertain = (1 - rig[VIBRATION_INPUTS][2]) * FRICTION_NOISE_S * (by_friction(0, f1) ** 2 + by_friction(1, f2) ** 2)
    least, softened_alpha0 = mean.least_forces((f1, f2)), solve(mean.softened)[0]
    return Motion(alpha0, f1, f2, least, uncertain + hopping, hopping, mean.pulling_force, softened_alpha0)
