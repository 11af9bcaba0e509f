"""Predict an object's motion during palm moves, many rollouts at once, as generated C.

The same dynamics as `model.shape_map`, without a covariance. The kernel evaluates the palms' minimum-jerk path, so
that one call takes columns, each with its own object and its own move, through `SUBSTEPS` steps. `rollout.c` chains
the moves; it must use the sizes defined here.
"""

from __future__ import annotations

from functools import cache

from palmd.model.compiled import Library, load
from palmd.model.contact import readings, tangent_joints
from palmd.model.dynamics import Palms, newton_euler
from palmd.model.kernels import of_columns
from palmd.model.outputs import CURVATURE_INPUTS, RIG_INPUTS, touch_on
from palmd.model.shape_map import N, Z, body_of, contacts_of, step_of
from palmd.model.symbolic import SX, ca
from palmd.system.mechanism import OPENING, normal_directions

SUBSTEPS = 4
STEP_S = 0.01
MOVE_INPUTS = 6  # φ1, φ2 at the start and at the end, duration, time since the start
BINS = 72  # of outward normals; bin 0 begins at θ = 0
OUTPUTS = 10  # ψ, ω0, smallest f1, f2 within a vibration, s1, s2, mean f1, f2, θ1, θ2
LEAST_FORCES, S, MEAN_FORCES, THETA = slice(2, 4), slice(4, 6), slice(6, 8), slice(8, 10)  # in the outputs
MOST_UNEXPLAINED = 0.05
"""rad/s that ω0 may gain against the torque in a step (derivation: 1 mm/s of slip at a radius of 20 mm, small against
V); more is an integration error."""
MOST_TURN = 0.2  # rad; a curved palm's tangent at the contact that turns more within a step means a jump of the contact


def minimum_jerk(start: SX, end: SX, duration: SX, t: SX) -> tuple[SX, SX, SX]:
    """Return position, rate and acceleration at `t` of the quintic 10u³ − 15u⁴ + 6u⁵; at rest before and after it."""
    way, u = end - start, ca.fmin(ca.fmax(t / duration, 0.0), 1.0)
    return (
        start + way * u**3 * (10 + u * (6 * u - 15)),
        way * 30 * u**2 * (1 - u) ** 2 / duration,
        way * 60 * u * (1 - u) * (1 - 2 * u) / duration**2,
    )


def palms_on(move: SX, t: SX) -> Palms:
    """Return the palms' motion `t` seconds after the time in `move` (`MOVE_INPUTS`)."""
    phi, omega, alpha = minimum_jerk(move[0:2], move[2:4], move[4], move[5] + t)
    return Palms(phi[0], phi[1], omega[0], omega[1], alpha[0], alpha[1])


def _step_function(curved: bool) -> ca.Function:
    """(x, s, move, rig) → (x after one step, `OUTPUTS` then); the smallest force is −inf where a contact jumps.

    It is also −inf for a step with an integration error, where ω0 rises without torque to a value that the torque then
    opposes: friction that starts to hold suddenly is stiffer than the step can follow.
    """
    x, s, move, rig = SX.sym("x", N), SX.sym("s", 2), SX.sym("move", MOVE_INPUTS), SX.sym("rig", RIG_INPUTS)
    touch = touch_on(rig, curved, ca.vertsplit(s))

    moving, _, at_start, _ = step_of(x, SX(STEP_S), lambda t: palms_on(move, t), rig, touch)
    (alpha0_at_start,) = touch.thawed(at_start.alpha0)
    after, palms = ca.vertcat(moving, x[2:]), palms_on(move, SX(STEP_S))
    touch = touch_on(rig, curved, ca.vertsplit(s))  # a new search for the contacts after the step
    one, two = contacts_of(after, palms.angles, touch)
    motion = newton_euler(palms, moving[1], one, two, body_of(x), rig)
    normals = normal_directions(tangent_joints(palms.angles, (one.turn, two.turn)), moving[Z.PSI])
    s_after, forces = readings(palms.angles[OPENING], one, two), list(motion.least)
    if curved:
        turns = ca.fabs(rig[CURVATURE_INPUTS] * (ca.vertcat(*s_after) - s))
        forces = [ca.if_else(turns[palm] < MOST_TURN, force, -ca.inf) for palm, force in enumerate(forces)]
    gained = moving[1] - x[Z.OMEGA0]
    unexplained = ca.logic_and(
        gained * motion.alpha0 < 0, ca.fabs(gained) > 2 * STEP_S * ca.fabs(alpha0_at_start) + MOST_UNEXPLAINED
    )
    forces = [ca.if_else(unexplained, -ca.inf, force) for force in forces]
    outputs = ca.vertcat(moving, *forces, *s_after, *motion.forces, *normals)
    return ca.Function("step", [x, s, move, rig], touch.thawed(after, outputs))


def begin_function(curved: bool = False) -> ca.Function:
    """(x, move, rig) → (s1, s2) (m), by a contact search without a starting point."""
    x, move, rig = SX.sym("x", N), SX.sym("move", MOVE_INPUTS), SX.sym("rig", RIG_INPUTS)
    touch, angles = touch_on(rig, curved), palms_on(move, SX(0)).angles
    s = ca.vertcat(*readings(angles[OPENING], *contacts_of(x, angles, touch)))
    return ca.Function("begin", [x, move, rig], touch.thawed(s), ["x", "move", "rig"], ["s"])


def roll_function(curved: bool = False) -> ca.Function:
    """(x, s, move, rig) → (ψ and ω0 after `SUBSTEPS` steps, `OUTPUTS` at the end of each); forces per unit mass, m/s².

    s: both contacts at the start (m), the starting point of the contact search on curved palms.
    """
    x, s, move, rig = SX.sym("x", N), SX.sym("s", 2), SX.sym("move", MOVE_INPUTS), SX.sym("rig", RIG_INPUTS)
    step, state, last, outputs = _step_function(curved), x, s, []
    for number in range(SUBSTEPS):
        state, now = step(state, last, ca.vertcat(move[:5], move[5] + number * STEP_S), rig)
        outputs.append(now)
        last = now[S]
    results = [state[:2], ca.horzcat(*outputs)]
    return ca.Function("roll", [x, s, move, rig], results, ["x", "s", "move", "rig"], ["moved", "outputs"])


@cache
def library(curved: bool = False) -> Library:
    """Load the column kernels `begin_batch` and `roll_batch`, for one rig; if compiled, with `roll_sequences`."""
    functions = {"begin_batch": begin_function, "roll_batch": roll_function}
    return load(
        "rollout_curved" if curved else "rollout",
        lambda: [of_columns(each(curved), name, ["rig"]) for name, each in functions.items()],
        written=["rollout.c"],
    )
