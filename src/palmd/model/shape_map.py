"""Kernels of the shape-map observer: orientation, spin, body constants and the whole outline in one state.

x = (ψ, ω0, ln ρ, μ, ln u_d, c, coefficients of h). Both contacts measure the same function h at two normals, so every
revisit improves its estimate. Only ψ and ω0 vary; s1, s2 are explicit functions of ψ, h, φ1, φ2.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from functools import cache

from palmd.model.compiled import Library, load
from palmd.model.contact import Contact, readings
from palmd.model.dynamics import BodyConstants, Motion, Palms, newton_euler
from palmd.model.integrate import exponential_step, variance_share
from palmd.model.kernels import Kernel, first_output, of_columns, single
from palmd.model.outputs import RIG_INPUTS, named_outputs, touch_on
from palmd.model.shape import HARMONICS, contact_at
from palmd.model.symbolic import SX, ca
from palmd.model.touch import Touch
from palmd.system.mechanism import CONTACTS, PALMS


class Z(IntEnum):
    """Index of each state; SI units, logarithms of SI units."""

    PSI = 0
    OMEGA0 = 1
    LN_RHO = 2
    MU = 3
    LN_DITHER = 4
    DAMPING = 5
    SHAPE = 6


def size(order: int) -> int:
    """Return the number of states for an outline of `order` harmonics."""
    return Z.SHAPE + 2 * order + 1


N = size(HARMONICS)
PALM_INPUTS = 6  # φ1, φ2, ω1, ω2, α1, α2
PREDICTION_INPUTS = 3 + PALM_INPUTS + RIG_INPUTS
UPDATE_INPUTS = 6  # plus both curvatures for curved palms
UPDATES = tuple(f"update_{contact}" for contact in CONTACTS)  # names of the update kernels, one per pad

Q_OMEGA0 = 0.02**2  # (rad/s)²/s, model discrepancy
Q_PSI = 1e-4**2  # rad²/s


def contacts_of(x: SX, joints: tuple[SX, SX], touch: Touch) -> tuple[Contact, Contact]:
    """Return both contacts of a state on palms at these joint angles."""
    return touch.contacts(*joints, x[Z.PSI], lambda theta, _: contact_at(theta, x[Z.SHAPE :]), x[Z.SHAPE])


def body_of(x: SX) -> BodyConstants:
    """Return the body constants of a state that the motion depends on, without the outline."""
    return BodyConstants(ca.exp(x[Z.LN_RHO]), x[Z.MU], ca.exp(x[Z.LN_DITHER]), x[Z.DAMPING])


def palms_after(u: SX, jerk: SX, t: SX) -> Palms:
    """Return the palms' motion `t` seconds after `u` = (φ1, φ2, ω1, ω2, α1, α2), at constant jerk (rad/s³)."""
    phi = u[0:2] + t * u[2:4] + t**2 / 2 * u[4:6] + t**3 / 6 * jerk
    omega = u[2:4] + t * u[4:6] + t**2 / 2 * jerk
    alpha = u[4:6] + t * jerk
    return Palms(phi[0], phi[1], omega[0], omega[1], alpha[0], alpha[1])


def motion_of(x: SX, palms: Palms, rig: SX, touch: Touch) -> Motion:
    """Return α0, forces and discrepancy of a state (`newton_euler`)."""
    one, two = contacts_of(x, palms.angles, touch)
    return newton_euler(palms, x[Z.OMEGA0], one, two, body_of(x), rig)


def step_of(x: SX, dt: SX, palms_at: Callable[[SX], Palms], rig: SX, touch: Touch) -> tuple[SX, SX, Motion, SX]:
    """Return (ψ, ω0) after dt, its Jacobian by x, and at the start the motion and the rate of ω0 (1/s) by friction.

    `palms_at`: the palms' motion at a time into the step.
    """

    def rates(moving: SX, t: SX) -> SX:
        state = ca.vertcat(moving, x[2:])
        return ca.vertcat(moving[Z.OMEGA0], motion_of(state, palms_at(t), rig, touch).alpha0)

    at_start = motion_of(x, palms_at(SX(0)), rig, touch)
    braking = ca.jacobian(at_start.softened_alpha0, x[Z.OMEGA0])
    moved, J = exponential_step(rates, x, dt, [Z.PSI, Z.OMEGA0], Z.OMEGA0, braking, touch)
    return moved, J, at_start, braking


def predict_function(order: int = HARMONICS, curved: bool = False) -> ca.Function:
    """(x, P, [dt, φ1, φ2, ω1, ω2, α1, α2, jerk1, jerk2, rig]) → (x, P) after dt."""
    n = size(order)
    x, P, u = SX.sym("x", n), SX.sym("P", n, n), SX.sym("u", PREDICTION_INPUTS)
    dt, palms, jerk, rig = u[0], u[1:7], u[7:9], u[9:]
    touch = touch_on(rig, curved)
    moved, J, at_start, braking = step_of(x, dt, lambda t: palms_after(palms, jerk, t), rig, touch)
    x_next = ca.vertcat(moved, x[2:])
    (discrepancy,) = touch.thawed(at_start.discrepancy * variance_share(braking, dt))
    # only two rows of the transition differ from the identity
    top = J @ P
    corner = top @ J.T + ca.diag(ca.vertcat(Q_PSI, Q_OMEGA0 + discrepancy)) * dt
    corner[1, 0] = corner[0, 1]
    P_next = ca.blockcat([[corner, top[:, 2:]], [top[:, 2:].T, P[2:, 2:]]])
    return ca.Function("predict", [x, P, u], [x_next, P_next], ["x", "P", "u"], ["x_next", "P_next"])


def update_function(name: str, pad: int, order: int = HARMONICS, curved: bool = False) -> ca.Function:
    """(x, P, [value, variance, gate, repeated, φ1, φ2]) → (x, P, [log-likelihood, NIS]) for one reading of `pad`.

    Joseph form; the variance of a reading beyond the gate is inflated until its NIS equals the gate. `repeated`: number
    of readings that share one error; it multiplies the variance and divides the log-likelihood, but not the NIS. For
    `curved` palms κ1, κ2 follow φ2.
    """
    n = size(order)
    x, P, z = SX.sym("x", n), SX.sym("P", n, n), SX.sym("z", UPDATE_INPUTS + len(PALMS) * curved)
    value, variance, gate, repeated = z[0], z[1], z[2], z[3]
    touch = Touch(ca.vertsplit(z[6:8])) if curved else Touch()
    predicted = readings(z[5], *contacts_of(x, (z[4], z[5]), touch))[pad - 1]
    predicted, h = touch.thawed(predicted, ca.jacobian(predicted, x))
    innovation = value - predicted
    Ph = P @ h.T
    spread = h @ Ph
    nis = innovation**2 / (spread + variance)
    S = ca.fmax(spread + repeated * variance, innovation**2 / gate)
    k = Ph / S
    cross = k @ Ph.T
    P_next = P - cross - cross.T + (k @ k.T) * S
    score = -0.5 * (ca.log(spread + variance) + ca.fmin(nis, 4 * gate)) / repeated
    outputs = [x + k * innovation, ca.triu2symm(ca.triu(P_next)), ca.vertcat(score, nis)]
    return ca.Function(name, [x, P, z], outputs, ["x", "P", "z"], ["x_next", "P_next", "score"])


def named_function(order: int = HARMONICS, curved: bool = False) -> ca.Function:
    """(x, [φ1 … α2, rig]) → values of `NAMED` and their Jacobian by (x, φ1, φ2)."""
    x, u = SX.sym("x", size(order)), SX.sym("u", PALM_INPUTS + RIG_INPUTS)
    palms, rig = palms_after(u[:PALM_INPUTS], SX.zeros(2), SX(0)), u[PALM_INPUTS:]
    touch = touch_on(rig, curved)
    one, two = contacts_of(x, palms.angles, touch)
    y = named_outputs(palms, x[Z.OMEGA0], x[Z.PSI], one, two, body_of(x), rig)
    J = ca.horzcat(ca.jacobian(y, x), ca.jacobian(y, u)[:, : len(PALMS)])
    return ca.Function("named", [x, u], touch.thawed(y, J), ["x", "u"], ["y", "J"])


@cache
def library(order: int = HARMONICS, curved: bool = False) -> Library:
    """Load kernels for blocks of shape maps (`_block`) and for one: predict, update_s1, update_s2, values; named.

    For `curved` palms the contacts are found by iteration. If compiled, the library includes `fusion.c`.
    """

    def kernels() -> list[Kernel]:
        pads = [update_function(name, pad, order, curved) for pad, name in zip(PALMS, UPDATES, strict=True)]
        named = named_function(order, curved)
        functions = [predict_function(order, curved), *pads, first_output(named, "values")]
        banks = [of_columns(f, f"{f.name()}_block", [f.name_in(f.n_in() - 1)]) for f in functions]
        return [*banks, *map(single, (*functions, named))]

    name = ("shape_map" if order == HARMONICS else f"shape_map{order}") + ("_curved" if curved else "")
    return load(name, kernels, written=["fusion.c"])
