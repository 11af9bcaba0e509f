"""Rigid-body dynamics of the object between the palms, in a form that is nowhere singular.

CMU-CS-01-107 eliminates the radii of curvature v1, v2 and gets (4.16), (4.17), which divide by the contacts'
sliding rates. Keeping v1, v2 leaves three linear equations in f1, f2, α0 (docs/theory/theory.md), solvable whenever
the palms are not parallel; neither a force nor a torque sensor is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from palmd.model.contact import Contact, centre_of_mass, normal, solve_from_normals, tangent
from palmd.model.friction import FRICTION_NOISE_S, HOP_NOISE_S, SlipResponse, Vibrated, averaged, normal_forces
from palmd.model.symbolic import SX, ca

VIBRATION_INPUTS, HALF_PERIOD_INPUT, VIBRATION_OFF_INPUTS = slice(7, 10), 10, slice(11, 15)
"""Indices among the kernels' rig inputs: κ, λ, a flag of the averaged law; 1/(2f) (s); the errors of κ, of λ and, as
shares, of 1/(2f) and of friction's arm."""


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
    """Radius of gyration ρ (m), friction coefficient μ (the palms' mean), damping c (m²/s).

    dither: u_d = πV/2 (m/s), V the amplitude of the speed of the palms' vibration along themselves.
    """

    rho: SX
    mu: SX
    dither: SX
    damping: SX


@dataclass(frozen=True, slots=True)
class Motion:
    """Result of Newton–Euler: α0 (rad/s²) and the normal forces per unit mass f1, f2 (m/s²), means over a vibration.

    least: the least force on each contact within a vibration (m/s²). discrepancy: spectral density ((rad/s²)²/Hz) of
    the error of α0 that the law of friction leaves, 0 of the old law; hopping: the part of it where contacts hop.
    softened_alpha0: α0 with the directions `Averaged.softened`; its derivative in ω0 is the rate for
    `exponential_step`. α0's own jumps where the ripple begins to stick, and the step would, too.
    """

    alpha0: SX
    f1: SX
    f2: SX
    least: tuple[SX, ...]
    discrepancy: SX
    hopping: SX
    softened_alpha0: SX

    @property
    def forces(self) -> tuple[SX, SX]:
        """f1 and f2."""
        return self.f1, self.f2


def effective_gravity(palms: Palms, rig: SX) -> SX:
    """Gravity as felt in the hinge's frame: (0, −g) − a_O, with O = B − L1 t1(φ1) (m/s²).

    `rig` starts with (g, L1); L1 = 0 stands for a hinge that does not move.
    """
    t1, n1 = tangent(palms.phi1, 1), normal(palms.phi1, 1)
    return ca.vertcat(0, -rig[0]) + rig[1] * (palms.alpha1 * n1 - palms.omega1**2 * t1)


def vibrated_of(dither: SX, rig: SX) -> Vibrated:
    """The palms' vibration by what the kernels are told of the rig; |κ| is 1 at most."""
    kappa, transmission, averaged = ca.vertsplit(rig[VIBRATION_INPUTS])
    kappa_off, transmission_off, _, _ = ca.vertsplit(rig[VIBRATION_OFF_INPUTS])
    kappa = ca.fmin(ca.fmax(kappa + kappa_off, -1), 1)
    return Vibrated(dither, kappa, transmission + transmission_off, averaged)


def half_period_of(rig: SX) -> SX:
    """1/(2f) (s) of the palms' vibration, by the kernels' rig inputs; 0 at least."""
    _, _, period_off, _ = ca.vertsplit(rig[VIBRATION_OFF_INPUTS])
    return rig[HALF_PERIOD_INPUT] * ca.fmax(1 + period_off, 0)


def newton_euler(
    palms: Palms, omega0: SX, one: Contact, two: Contact, body: BodyConstants, rig: SX, steps: int = 1
) -> Motion:
    """Solve the three linear equations of docs/theory/theory.md for α0, f1, f2.

    Two of them say that the object keeps touching (n_i·a prescribed by the contact's motion), the third is
    ρ²α0 = Σ f_i (x_i × F_i) − c ω0 with F_i = n_i − μ_i σ_i t_i. The directions σ_i of friction are those with which
    one solve gives the mean over the palms' vibration (`model.friction`): f1, f2, α0 are such means.
    `rig` is (g, L1, x, y, a, …, κ, λ, averaged, 1/(2f), Δκ, Δλ, 2f Δ(1/(2f)), b): μ1 = (1 + a) μ, μ2 = (1 − a) μ.
    Friction acts as on a body that is larger by b r on palms that lie lower by b r (docs/theory/vibration.md).
    Where a palm is curved its tangent at the contact
    turns at γ = ω ± κ ṡ, and n_i·a has ω(2γ − ω) p·n − κ ṡ² besides (docs/theory/curved.md), p the contact's place.
    Valid while f1, f2 > 0. steps: to the ripple that agrees with the shares of time that it makes. One is enough for
    independent vibrations; in antiphase one is no better than none, and two leave a third of the error.
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
    _, _, _, longer = ca.vertsplit(rig[VIBRATION_OFF_INPUTS])
    arms = [k.r * (1 + longer) for k in contacts]
    slips, needed = [], []
    for k, w, a, t, n in zip(contacts, rates, accelerations, tangents, normals, strict=True):
        slip = ca.dot(t, c_dot) + omega0 * k.r + w * k.above
        bending = k.curvature * (slip + k.v * (w - omega0)) / (1 - k.curvature * k.v)  # ± κ ṡ
        turning = w + bending
        slips.append(slip + longer * k.r * (omega0 - w))
        # n_i·a without its α0 term, less what gravity already gives
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
    kept = solve_from_normals(palms.phi1 + one.turn, palms.phi2 + two.turn - one.turn, one.d, two.d)  # ∂ċ/∂ω0
    by_turning = [ca.dot(t, kept) + arm for t, arm in zip(tangents, arms, strict=True)]
    response = SlipResponse(by_turning, [k.d for k in contacts], arms, rho2, half_period_of(rig))
    mean = averaged(A, B, b, friction, slips, vibrated_of(body.dither, rig), response, steps)

    def moving(directions: Sequence[SX]) -> tuple[SX, tuple[SX, SX], list[SX], list[SX]]:
        along = [mu * each for mu, each in zip(friction, directions, strict=True)]
        forces = normal_forces(A, B, b, along)
        torques = [-(k.d + rubs * arm) for k, arm, rubs in zip(contacts, arms, along, strict=True)]
        spin = (forces[0] * torques[0] + forces[1] * torques[1] - body.damping * omega0) / rho2
        return spin, forces, along, torques

    alpha0, (f1, f2), along, torques = moving(mean.directions)

    def by_friction(i: int, f: SX) -> SX:
        """∂α0/∂ln μ_i: of the force's own torque, and of both normal forces, which change with it."""
        rubbing = along[i] * f
        f1_change, f2_change = normal_forces(A, B, [row[i] * rubbing for row in B], along)
        change: SX = (f1_change * torques[0] + f2_change * torques[1] - rubbing * arms[i]) / rho2
        return change

    hopping = HOP_NOISE_S * mean.pulled**2
    uncertain = (1 - rig[VIBRATION_INPUTS][2]) * FRICTION_NOISE_S * (by_friction(0, f1) ** 2 + by_friction(1, f2) ** 2)
    discrepancy, softened_alpha0 = uncertain + hopping, moving(mean.softened)[0]
    return Motion(alpha0, f1, f2, mean.least_forces((f1, f2)), discrepancy, hopping, softened_alpha0)
