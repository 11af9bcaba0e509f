"""What an object will do while the palms move: many motions at once, as generated C.

The same dynamics as `model.shape_map`, without a covariance. The palms' minimum-jerk path is evaluated inside, so
that one call carries columns, each with its own object and its own move, through `SUBSTEPS` steps. `rollout.c` goes on
from move to move; its sizes are those here.
"""

from __future__ import annotations

from functools import cache

from palmd.model.compiled import Library, load
from palmd.model.contact import readings, tangent_joints
from palmd.model.dynamics import Palms, newton_euler
from palmd.model.integrate import exponential_step
from palmd.model.kernels import of_columns
from palmd.model.outputs import RIG_INPUTS, touch_on
from palmd.model.shape_map import N, Z, body_of, contacts_of, spin_acceleration
from palmd.model.symbolic import SX, ca
from palmd.system.mechanism import OPENING, normal_directions

SUBSTEPS = 4
STEP_S = 0.01
MOVE_INPUTS = 6  # φ1, φ2 at the start and at the end, duration, time since the start
BINS = 72  # of outward normals, bin 0 beginning at θ = 0
TOLD = 8  # ψ, ω0, f1, f2, s1, s2, θ1, θ2


def palms_on(move: SX, t: SX) -> Palms:
    """The palms `t` seconds after the time that `move` tells: the quintic 10u³ − 15u⁴ + 6u⁵, at rest after its end."""
    start, way, duration = move[0:2], move[2:4] - move[0:2], move[4]
    u = ca.fmin(ca.fmax((move[5] + t) / duration, 0.0), 1.0)
    phi = start + way * u**3 * (10 + u * (6 * u - 15))
    omega = way * 30 * u**2 * (1 - u) ** 2 / duration
    alpha = way * 60 * u * (1 - u) * (1 - 2 * u) / duration**2
    return Palms(phi[0], phi[1], omega[0], omega[1], alpha[0], alpha[1])


def _step_function(curved: bool) -> ca.Function:
    """(x, move, rig) → (x after one step, `TOLD` then)."""
    x, move, rig = SX.sym("x", N), SX.sym("move", MOVE_INPUTS), SX.sym("rig", RIG_INPUTS)
    touch = touch_on(rig, curved)

    def rates(moving: SX, t: SX) -> SX:
        state = ca.vertcat(moving, x[2:])
        return ca.vertcat(moving[Z.OMEGA0], spin_acceleration(state, palms_on(move, t), rig, touch))

    damping = ca.jacobian(spin_acceleration(x, palms_on(move, SX(0)), rig, touch), x[Z.OMEGA0])
    moving, _ = exponential_step(rates, x, SX(STEP_S), [Z.PSI, Z.OMEGA0], Z.OMEGA0, damping, touch)
    after, palms = ca.vertcat(moving, x[2:]), palms_on(move, SX(STEP_S))
    touch = touch_on(rig, curved)  # the step's own searches are behind it
    one, two = contacts_of(after, palms.angles, touch)
    motion = newton_euler(palms, moving[1], one, two, body_of(x), rig)
    normals = normal_directions(tangent_joints(palms.angles, (one.turn, two.turn)), moving[Z.PSI])
    told = ca.vertcat(moving, motion.f1, motion.f2, *readings(palms.angles[OPENING], one, two), *normals)
    return ca.Function("step", [x, move, rig], touch.thawed(after, told))


def roll_function(curved: bool = False) -> ca.Function:
    """(x, move, rig) → (ψ and ω0 after `SUBSTEPS` steps, `TOLD` at the end of each): forces per unit mass, m/s²."""
    x, move, rig = SX.sym("x", N), SX.sym("move", MOVE_INPUTS), SX.sym("rig", RIG_INPUTS)
    step, state, told = _step_function(curved), x, []
    for number in range(SUBSTEPS):
        state, now = step(state, ca.vertcat(move[:5], move[5] + number * STEP_S), rig)
        told.append(now)
    return ca.Function("roll", [x, move, rig], [state[:2], ca.horzcat(*told)], ["x", "move", "rig"], ["moved", "told"])


@cache
def library(curved: bool = False) -> Library:
    """`roll_batch`: `roll` on columns, on the same rig; compiled, `roll_sequences` besides."""
    name = "rollout_curved" if curved else "rollout"
    return load(name, lambda: [of_columns(roll_function(curved), "roll_batch", ["rig"])], written=["rollout.c"])
