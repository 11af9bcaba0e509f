"""Kernels of the extended observer: one filter's prediction and updates, mapped over a whole bank.

State: (r1, r2, ω0, s1, s2, φ1, ω1, φ2, ω2, ρ), the friction coefficient μ, the dither speed u_d, the damping c, the
orientation ψ, and the Fourier coefficients of v(θ) = h + h″, one function that gives the radii of curvature v1, v2 at
both contacts. If v1, v2 were random walks instead, nothing would be known at a return to a normal already touched, and
the filter would diverge whenever the palms excite the object little.
Readings are states, so every update is exactly linear; only the motion between them is not.
"""

from __future__ import annotations

from enum import IntEnum
from functools import cache

from palmd.model.compiled import Library, load
from palmd.model.contact import Contact, offsets
from palmd.model.dynamics import BodyConstants, Motion, Palms, newton_euler
from palmd.model.integrate import exponential_step, variance_share
from palmd.model.kernels import Kernel, first_output, of_columns, single
from palmd.model.outputs import RIG_INPUTS, named_outputs
from palmd.model.shape import COEFFICIENTS, HARMONICS, contact_at, harmonics
from palmd.model.symbolic import SX, ca
from palmd.system.mechanism import normal_directions


class X(IntEnum):
    """Index of each state (SI units). From CURVATURE on: coefficients of v, harmonics 0, 2, 3, …"""

    R1 = 0
    R2 = 1
    OMEGA0 = 2
    S1 = 3
    S2 = 4
    PHI1 = 5
    OMEGA1 = 6
    PHI2 = 7
    OMEGA2 = 8
    PSI = 9
    RHO = 10
    MU = 11
    LN_DITHER = 12
    DAMPING = 13
    CURVATURE = 14


MOVING = X.RHO  # states before this one vary in time; the rest are constants of the object
N = X.CURVATURE + 2 * HARMONICS - 1
PREDICTION_INPUTS = 5 + RIG_INPUTS
UPDATE_INPUTS = 4
MEASURED = (X.S1, X.S2, X.PHI1, X.PHI2, X.OMEGA1, X.OMEGA2)

# Model discrepancy as white noise on the rates; small, so that it matters over seconds only.
Q_LENGTH = 5e-6**2  # m²/s on r1, r2, s1, s2
Q_OMEGA0 = 0.02**2  # (rad/s)²/s
Q_PALM_RATE = 0.02**2  # (rad/s)²/s, deviation of the palms from their plan


def _curvature_at(theta: SX, coefficients: SX) -> SX:
    """v(θ); the first harmonic of h, a shift of the origin, does not enter."""
    v = coefficients[0]
    for k, cos, sin in harmonics(theta):
        if k > 1:
            v = v + coefficients[2 * k - 3] * cos + coefficients[2 * k - 2] * sin
    return v


def _palms(x: SX, alpha1: SX, alpha2: SX) -> Palms:
    return Palms(x[X.PHI1], x[X.PHI2], x[X.OMEGA1], x[X.OMEGA2], alpha1, alpha2)


def _contacts(x: SX) -> tuple[Contact, Contact]:
    d1, d2 = offsets(x[X.PHI2], x[X.R1], x[X.R2], x[X.S1], x[X.S2])
    theta1, theta2 = normal_directions((x[X.PHI1], x[X.PHI2]), x[X.PSI])
    v1 = _curvature_at(theta1, x[X.CURVATURE :])
    v2 = _curvature_at(theta2, x[X.CURVATURE :])
    return Contact(x[X.R1], d1, v1), Contact(x[X.R2], d2, v2)


def _body(x: SX) -> BodyConstants:
    return BodyConstants(x[X.RHO], x[X.MU], ca.exp(x[X.LN_DITHER]), x[X.DAMPING])


def _motion(x: SX, alpha1: SX, alpha2: SX, rig: SX) -> Motion:
    return newton_euler(_palms(x, alpha1, alpha2), x[X.OMEGA0], *_contacts(x), _body(x), rig)


def drift(x: SX, alpha1: SX, alpha2: SX, rig: SX) -> SX:
    """Rates of the moving states: ṙ = −d θ̇, ṡ by differentiating (3.13), (3.14), ω̇0 by Newton–Euler."""
    one, two = _contacts(x)
    palms = _palms(x, alpha1, alpha2)
    theta1_dot = palms.omega1 - x[X.OMEGA0]
    theta2_dot = palms.omega12 - x[X.OMEGA0]
    r1_dot, r2_dot = -one.d * theta1_dot, -two.d * theta2_dot
    d1_dot, d2_dot = (one.r - one.v) * theta1_dot, (two.r - two.v) * theta2_dot
    sin, cos, w2 = ca.sin(palms.phi2), ca.cos(palms.phi2), palms.omega2
    lever1, lever2 = one.r * cos + two.r, two.r * cos + one.r
    s1_dot = (r1_dot * cos - one.r * sin * w2 + r2_dot) / sin - lever1 * cos * w2 / sin**2 - d1_dot
    s2_dot = (r2_dot * cos - two.r * sin * w2 + r1_dot) / sin - lever2 * cos * w2 / sin**2 + d2_dot
    alpha0 = _motion(x, alpha1, alpha2, rig).alpha0
    return ca.vertcat(
        r1_dot, r2_dot, alpha0, s1_dot, s2_dot, palms.omega1, alpha1, w2, alpha2, x[X.OMEGA0]
    )  # in the order of X


def predict_function() -> ca.Function:
    """(x, P, [dt, α1, α2, jerk1, jerk2, rig]) → (x, P) after dt, by the Jacobian of the integration step."""
    x, P, u = SX.sym("x", N), SX.sym("P", N, N), SX.sym("u", PREDICTION_INPUTS)
    alpha, jerk, rig = u[1:3], u[3:5], u[5:]

    def rates(moving: SX, t: SX) -> SX:
        now = alpha + jerk * t
        return drift(ca.vertcat(moving, x[MOVING:]), now[0], now[1], rig)

    at_start = _motion(x, alpha[0], alpha[1], rig)
    braking = ca.jacobian(at_start.softened_alpha0, x[X.OMEGA0])
    moved, J = exponential_step(rates, x, u[0], list(X)[:MOVING], X.OMEGA0, braking)
    Q = SX.zeros(MOVING)
    Q[X.R1] = Q[X.R2] = Q[X.S1] = Q[X.S2] = Q_LENGTH
    Q[X.OMEGA0] = Q_OMEGA0 + at_start.discrepancy * variance_share(braking, u[0])
    Q[X.OMEGA1] = Q[X.OMEGA2] = Q_PALM_RATE
    # only the moving rows of the transition differ from the identity
    top = J @ P
    corner = ca.triu2symm(ca.triu(top @ J.T)) + ca.diag(Q * u[0])
    side = top[:, MOVING:]
    P_next = ca.blockcat([[corner, side], [side.T, P[MOVING:, MOVING:]]])
    x_next = ca.vertcat(moved, x[MOVING:])
    return ca.Function("predict", [x, P, u], [x_next, P_next], ["x", "P", "u"], ["x_next", "P_next"])


def update_function(name: str, state: int) -> ca.Function:
    """(x, P, [value, variance, gate, repeated]) → (x, P, [log-likelihood, NIS]) for one scalar reading of one state.

    Joseph form, so P stays symmetric positive definite. If a reading's NIS exceeds `gate`, its variance is inflated
    until the NIS equals the gate: an outlier moves the state little, and a diverged filter can still recover. The
    likelihood uses the variance that is not inflated and is bounded at 4 gates. `repeated` as in `model.shape_map`.
    """
    x, P, z = SX.sym("x", N), SX.sym("P", N, N), SX.sym("z", UPDATE_INPUTS)
    value, variance, gate, repeated = ca.vertsplit(z)
    innovation = value - x[state]
    spread = P[state, state]
    nis = innovation**2 / (spread + variance)
    S = ca.fmax(spread + repeated * variance, innovation**2 / gate)
    k = P[:, state] / S
    # (I − k hᵀ) P (I − k hᵀ)ᵀ + k R kᵀ, written out for h a unit vector
    cross = k @ P[state, :]
    P_next = P - cross - cross.T + (k @ k.T) * S
    score = -0.5 * (ca.log(spread + variance) + ca.fmin(nis, 4 * gate)) / repeated
    outputs = [x + k * innovation, ca.triu2symm(ca.triu(P_next)), ca.vertcat(score, nis)]
    return ca.Function(name, [x, P, z], outputs, ["x", "P", "z"], ["x_next", "P_next", "score"])


def named_function() -> ca.Function:
    """(x, [α1, α2, rig]) → values of `NAMED` and their Jacobian by x."""
    x, u = SX.sym("x", N), SX.sym("u", 2 + RIG_INPUTS)
    one, two = _contacts(x)
    y = named_outputs(_palms(x, u[0], u[1]), x[X.OMEGA0], x[X.PSI], one, two, _body(x), u[2:])
    return ca.Function("named", [x, u], [y, ca.jacobian(y, x)], ["x", "u"], ["y", "J"])


def outline_function() -> ca.Function:
    """x → Fourier coefficients of h and their Jacobian by x.

    All harmonics but the first follow from those of v, h_k = v_k / (1 − k²). The first is fitted to the rest of r and d
    at both contacts by least squares, four equations for two unknowns.
    """
    x = SX.sym("x", N)
    h = SX.zeros(COEFFICIENTS)
    h[0] = x[X.CURVATURE]
    for k in range(2, HARMONICS + 1):
        h[2 * k - 1] = x[X.CURVATURE + 2 * k - 3] / (1 - k**2)
        h[2 * k] = x[X.CURVATURE + 2 * k - 2] / (1 - k**2)
    theta = normal_directions((x[X.PHI1], x[X.PHI2]), x[X.PSI])
    rest, rows = [], []
    for angle, contact in zip(theta, _contacts(x), strict=True):
        known = contact_at(angle, h)
        rest += [contact.r - known.r, contact.d - known.d]
        rows += [ca.horzcat(ca.cos(angle), ca.sin(angle)), ca.horzcat(ca.sin(angle), -ca.cos(angle))]
    # the four rows are orthonormal pairs, so that AᵀA = 2 I
    first = ca.vertcat(*rows).T @ ca.vertcat(*rest) / 2
    h[1], h[2] = first[0], first[1]
    return ca.Function("outline", [x], [h, ca.jacobian(h, x)], ["x"], ["h", "J"])


@cache
def library() -> Library:
    """Load the kernels for blocks of filters (predict, update_*, values) and for one (predict, named, outline)."""

    def kernels() -> list[Kernel]:
        updates = (update_function(f"update_{s.name.lower()}", s) for s in MEASURED)
        named = named_function()
        functions = [predict_function(), *updates, first_output(named, "values")]
        banks = [of_columns(f, f"{f.name()}_block", [f.name_in(f.n_in() - 1)]) for f in functions]
        return [*banks, *map(single, (functions[0], named, outline_function()))]

    return load("extended", kernels)
