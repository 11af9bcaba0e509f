"""How the readings of a short while depend on the shape map's state at its beginning, as generated C.

Along a trajectory of `model.shape_map` only ψ and ω0 move, so two rows T = ∂(ψ, ω0)/∂x0 carry the whole sensitivity
to the state x0 at the beginning; the other rows of the transition Φ are the identity's. A reading s_i with gradient
g_i = ∂s_i/∂x adds w_i (g_i Φ)ᵀ(g_i Φ) to the information G about x0, the observability Gramian.
"""

from __future__ import annotations

from functools import cache

from palmd.model.compiled import Library, load
from palmd.model.contact import Contact, readings
from palmd.model.dynamics import BodyConstants, Palms, newton_euler
from palmd.model.integrate import exponential_step
from palmd.model.kernels import single
from palmd.model.shape import contact_at
from palmd.model.shape_map import PALM_INPUTS, PREDICTION_INPUTS, N, Z, palms_after
from palmd.model.symbolic import SX, ca
from palmd.system.mechanism import normal_directions

GATHER_INPUTS = PREDICTION_INPUTS + 2
MOVING = 2  # ψ and ω0
AIMED_AT = 4  # r1, r2, s1, s2


def _contacts(x: SX, phi1: SX, phi2: SX) -> tuple[Contact, Contact]:
    theta1, theta2 = normal_directions((phi1, phi2), x[Z.PSI])
    return contact_at(theta1, x[Z.SHAPE :]), contact_at(theta2, x[Z.SHAPE :])


def gather_function() -> ca.Function:
    """(x, T, G, [dt, φ1 … α2, jerk1, jerk2, rig, w1, w2]) → (T, G): readings at x with weights w (1/m²), then dt on."""
    x, T, G = SX.sym("x", N), SX.sym("T", MOVING, N), SX.sym("G", N, N)
    u = SX.sym("u", GATHER_INPUTS)
    palms, jerk, rig = u[1 : 1 + PALM_INPUTS], u[1 + PALM_INPUTS : 3 + PALM_INPUTS], u[3 + PALM_INPUTS :]
    transition = ca.vertcat(T, SX.eye(N)[MOVING:, :])

    G_next = G
    for reading, weight in zip(readings(palms[1], *_contacts(x, palms[0], palms[1])), (u[-2], u[-1]), strict=True):
        row = ca.jacobian(reading, x) @ transition
        G_next = G_next + weight * (row.T @ row)

    def alpha0(state: SX, now: Palms) -> SX:
        body = BodyConstants(ca.exp(state[Z.LN_RHO]), state[Z.MU], ca.exp(state[Z.LN_DITHER]), state[Z.DAMPING])
        return newton_euler(now, state[Z.OMEGA0], *_contacts(state, now.phi1, now.phi2), body, rig).alpha0

    def rates(moving: SX, t: SX) -> SX:
        state = ca.vertcat(moving, x[MOVING:])
        return ca.vertcat(moving[Z.OMEGA0], alpha0(state, palms_after(palms, jerk, t)))

    damping = ca.jacobian(alpha0(x, palms_after(palms, jerk, SX(0))), x[Z.OMEGA0])
    _, J = exponential_step(rates, x, u[0], [Z.PSI, Z.OMEGA0], Z.OMEGA0, damping)
    return ca.Function("gather", [x, T, G, u], [J @ transition, G_next], ["x", "T", "G", "u"], ["T_next", "G_next"])


def aim_function() -> ca.Function:
    """(x, [φ1, φ2]) → ∂(r1, r2, s1, s2)/∂x."""
    x, u = SX.sym("x", N), SX.sym("u", 2)
    one, two = _contacts(x, u[0], u[1])
    z = ca.vertcat(one.r, two.r, *readings(u[1], one, two))
    return ca.Function("aim", [x, u], [ca.jacobian(z, x)], ["x", "u"], ["J"])


@cache
def library() -> Library:
    """The kernels `gather` and `aim`, for one trajectory."""
    return load("sensitivity", lambda: map(single, (gather_function(), aim_function())))
