"""Sensitivity of the readings of a short interval to the shape map's state at its start, as generated C.

Along a trajectory of `model.shape_map` only ψ and ω0 vary, so two rows T = ∂(ψ, ω0)/∂x0 carry the whole sensitivity
to the initial state x0; the other rows of the transition Φ are those of the identity. A reading s_i with gradient
g_i = ∂s_i/∂x adds w_i (g_i Φ)ᵀ(g_i Φ) to the information G about x0, the observability Gramian.
"""

from __future__ import annotations

from functools import cache

from palmd.model.compiled import Library, load
from palmd.model.contact import readings
from palmd.model.kernels import single
from palmd.model.outputs import touch_on
from palmd.model.shape_map import PALM_INPUTS, PREDICTION_INPUTS, N, contacts_of, palms_after, step_of
from palmd.model.symbolic import SX, ca
from palmd.model.touch import Touch

GATHER_INPUTS = PREDICTION_INPUTS + 2
AIM_INPUTS = 4
MOVING = 2  # ψ and ω0
AIMED_AT = 4  # r1, r2, s1, s2


def gather_function(curved: bool = False) -> ca.Function:
    """(x, T, G, [dt, φ1 … α2, jerk1, jerk2, rig, w1, w2]) → (T, G): add readings at x, weights w (1/m²); step by dt."""
    x, T, G = SX.sym("x", N), SX.sym("T", MOVING, N), SX.sym("G", N, N)
    u = SX.sym("u", GATHER_INPUTS)
    palms, jerk, rig = u[1 : 1 + PALM_INPUTS], u[1 + PALM_INPUTS : 3 + PALM_INPUTS], u[3 + PALM_INPUTS : -2]
    touch = touch_on(rig, curved)
    transition = ca.vertcat(T, SX.eye(N)[MOVING:, :])

    G_next = G
    for reading, weight in zip(
        readings(palms[1], *contacts_of(x, (palms[0], palms[1]), touch)), (u[-2], u[-1]), strict=True
    ):
        row = ca.jacobian(reading, x) @ transition
        G_next = G_next + weight * (row.T @ row)

    _, J, _, _ = step_of(x, u[0], lambda t: palms_after(palms, jerk, t), rig, touch)
    outputs = [J @ transition, *touch.thawed(G_next)]
    return ca.Function("gather", [x, T, G, u], outputs, ["x", "T", "G", "u"], ["T_next", "G_next"])


def aim_function(curved: bool = False) -> ca.Function:
    """(x, [φ1, φ2, κ1, κ2]) → ∂(r1, r2, s1, s2)/∂x."""
    x, u = SX.sym("x", N), SX.sym("u", AIM_INPUTS)
    touch = Touch(ca.vertsplit(u[2:])) if curved else Touch()
    one, two = contacts_of(x, (u[0], u[1]), touch)
    z = ca.vertcat(one.r, two.r, *readings(u[1], one, two))
    return ca.Function("aim", [x, u], touch.thawed(ca.jacobian(z, x)), ["x", "u"], ["J"])


@cache
def library(curved: bool = False) -> Library:
    """Load the kernels `gather` and `aim`, for one trajectory."""
    name = "sensitivity_curved" if curved else "sensitivity"
    return load(name, lambda: map(single, (gather_function(curved), aim_function(curved))))
