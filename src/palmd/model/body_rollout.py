"""Simulate bodies between three palms while these move: many motions at once, as generated C.

The dynamics of `model.three_palms`, without sensitivities. The kernel evaluates the palms' minimum-jerk path itself.
One call advances all columns, each with its own state and move, by one step.
"""

from __future__ import annotations

from functools import cache

from palmd.model.compiled import Library, load
from palmd.model.kernels import of_columns
from palmd.model.rollout import minimum_jerk
from palmd.model.spherical import Y00, count
from palmd.model.symbolic import SX, ca
from palmd.model.three_palms import BODY, RIG_INPUTS, PalmVectors, local_function, newton_function

STEP_S = 5e-3
ROUGH_ORDER, ROUGH_STEP_S = 8, 1e-2
"""Degree of the outline and step of coarse, fast predictions."""
MOVE_INPUTS = 8
"""Joints at the start and at the end, duration, time since the start."""
STEP_OUTPUTS = 18
"""Outputs at a step's middle: forces per mass (3, m/s²), contacts a, b (6, m), outward normals in the body (9)."""


def palm_vectors(angle: SX, rate: SX, acceleration: SX) -> tuple[SX, list[SX]]:
    """(kernel inputs of the palms, axes (3, 2) of each pad): symbolic `system.three_palms.palms_at`."""
    edge = SX([1, 0, 0])
    up, n1 = ca.vertcat(0, ca.cos(angle[0]), ca.sin(angle[0])), ca.vertcat(0, -ca.sin(angle[0]), ca.cos(angle[0]))
    tilt, tilting = rate[0] * edge, acceleration[0] * edge
    normals, axes = [n1], [ca.horzcat(edge, up)]
    spins, spin_rates = [tilt], [tilting]
    for i, side in ((1, 1.0), (2, -1.0)):
        cosine, sine = ca.cos(angle[i]), ca.sin(angle[i])
        normals.append(side * cosine * edge + sine * up)
        axes.append(ca.horzcat(-side * sine * edge + cosine * up, n1))
        spins.append(tilt + side * rate[i] * n1)
        spin_rates.append(tilting + side * (acceleration[i] * n1 + rate[i] * ca.cross(tilt, n1)))
    rates = [ca.cross(spin, n) for spin, n in zip(spins, normals, strict=True)]
    normal_accelerations = [
        ca.cross(turning, n) + ca.cross(spin, moving)
        for turning, spin, n, moving in zip(spin_rates, spins, normals, rates, strict=True)
    ]
    return ca.vertcat(*normals, *rates, *normal_accelerations, *spins), axes


def _turned(R: SX, by: SX) -> SX:
    """exp[by]R to fourth order in `by`, then one Newton step towards the nearest rotation."""
    S = ca.skew(by)
    after = R + S @ (R + S @ (R + S @ (R + S @ R / 4) / 3) / 2)
    return after @ (1.5 * SX.eye(3) - 0.5 * after.T @ after)


def step_function(order: int, h: float) -> ca.Function:
    """(R, ω, move; p, rig) → (R and ω after h (s), outputs of size `STEP_OUTPUTS`).

    Half of the turn, then the spin with the forces at midway, then the other half: second order. The forces' dependence
    on the spin is implicit to first order, which is stable for any stiffness of friction.
    """
    n = count(order)
    R, omega, move = SX.sym("R", 3, 3), SX.sym("omega", 3), SX.sym("move", MOVE_INPUTS)
    parameters, rig = SX.sym("p", n + BODY), SX.sym("rig", RIG_INPUTS)
    c, body = parameters[:n], ca.vertcat(Y00 * parameters[0], parameters[n:])
    inputs, axes = palm_vectors(*minimum_jerk(move[0:3], move[3:6], move[6], move[7] + h / 2))
    palms, midway, local = PalmVectors.of(inputs), _turned(R, h / 2 * omega), local_function(order)
    x, kappa, by_spin, normals = [], [], [], []
    for normal, rate in zip(palms.normal, palms.rate, strict=True):
        u, s = -midway.T @ normal, midway.T @ (ca.cross(omega, normal) - rate)
        q, _, by_s, _ = local(u, s, c)
        x.append(q[:3])
        kappa.append(q[3])
        by_spin.append(-by_s[3, :] @ midway.T @ ca.skew(normal))
        normals.append(u)
    alpha, force, by = newton_function("sign_pairs")(
        midway, omega, ca.vertcat(*x), ca.vertcat(*kappa), body, inputs, rig
    )
    damping = by[:, 3:6] + by[:, 15:18] @ ca.vertcat(*by_spin)
    after = omega + h * ca.solve(SX.eye(3) - h / 2 * damping, alpha)
    heights = ca.vertcat(*(ca.dot(u, each) for u, each in zip(normals, x, strict=True)))
    centre = palms.inverse @ heights
    contacts = [axis.T @ (centre + midway @ each) for axis, each in zip(axes, x, strict=True)]
    outputs = ca.vertcat(force, *contacts, *normals)
    return ca.Function(
        "step", [R, omega, move, parameters, rig], [_turned(midway, h / 2 * after), after, outputs],
        ["R", "omega", "move", "p", "rig"], ["R_after", "omega_after", "outputs"],
    )  # fmt: skip


@cache
def library(order: int, h: float) -> Library:
    """`step_columns`, for outlines up to degree `order` and steps of h (s)."""
    name = f"body_rollout{order}_{h * 1e3:g}ms"
    return load(name, lambda: [of_columns(step_function(order, h), "step_columns", ["rig"])])
