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
from palmd.model.outputs import CURVATURE_INPUTS, RIG_INPUTS, touch_on
from palmd.model.shape_map import N, Z, body_of, contacts_of, motion_of, spin_acceleration
from palmd.model.symbolic import SX, ca
from palmd.system.mechanism import OPENING, normal_directions

SUBSTEPS = 4
STEP_S = 0.01
MOVE_INPUTS = 6  # φ1, φ2 at the start and at the end, duration, time since the start
BINS = 72  # of outward normals, bin 0 beginning at θ = 0
TOLD = 10  # ψ, ω0, f1, f2 at their least within a vibration, s1, s2, f1, f2 in the mean, θ1, θ2
LEAST_FORCES, S, MEAN_FORCES, THETA = slice(2, 4), slice(4, 6), slice(6, 8), slice(8, 10)  # in it
MOST_UNEXPLAINED = 0.05
"""rad/s that a step may gain against the torque (derivation: 1 mm/s of slip at a radius of 20 mm, little beside V);
more is the step's own error."""
MOST_TURN = 0.2  # rad, of a curved palm's tangent at the contact within a step: beyond it the contact has jumped


def minimum_jerk(start: SX, end: SX, duration: SX, t: SX) -> tuple[SX, SX, SX]:
    """Place, rate and acceleration at `t` of the quintic 10u³ − 15u⁴ + 6u⁵, at rest before its beginning and after."""
    way, u = end - start, ca.fmin(ca.fmax(t / duration, 0.0), 1.0)
    return (
        start + way * u**3 * (10 + u * (6 * u - 15)),
        way * 30 * u**2 * (1 - u) ** 2 / duration,
        way * 60 * u * (1 - u) * (1 - 2 * u) / duration**2,
    )


def palms_on(move: SX, t: SX) -> Palms:
    """The palms `t` seconds after the time that `move` tells."""
    phi, omega, alpha = minimum_jerk(move[0:2], move[2:4], move[4], move[5] + t)
    return Palms(phi[0], phi[1], omega[0], omega[1], alpha[0], alpha[1])


def _step_function(curved: bool) -> ca.Function:
    """(x, s, move, rig) → (x after one step, `TOLD` then); of a contact that jumps the least force is −inf.

    So it is of a step that nothing explains: from hardly any torque to one that resists what was gained. Friction that
    holds all of a sudden is stiffer than the step can follow.
    """
    x, s, move, rig = SX.sym("x", N), SX.sym("s", 2), SX.sym("move", MOVE_INPUTS), SX.sym("rig", RIG_INPUTS)
    touch = touch_on(rig, curved, ca.vertsplit(s))

    def rates(moving: SX, t: SX) -> SX:
        state = ca.vertcat(moving, x[2:])
        return ca.vertcat(moving[Z.OMEGA0], spin_acceleration(state, palms_on(move, t), rig, touch))

    beginning = motion_of(x, palms_on(move, SX(0)), rig, touch)
    braking = ca.jacobian(beginning.softened_alpha0, x[Z.OMEGA0])
    moving, _ = exponential_step(rates, x, SX(STEP_S), [Z.PSI, Z.OMEGA0], Z.OMEGA0, braking, touch)
    (at_first,) = touch.thawed(beginning.alpha0)
    after, palms = ca.vertcat(moving, x[2:]), palms_on(move, SX(STEP_S))
    touch = touch_on(rig, curved, ca.vertsplit(s))  # the step's own searches are behind it
    one, two = contacts_of(after, palms.angles, touch)
    motion = newton_euler(palms, moving[1], one, two, body_of(x), rig)
    normals = normal_directions(tangent_joints(palms.angles, (one.turn, two.turn)), moving[Z.PSI])
    found, forces = readings(palms.angles[OPENING], one, two), list(motion.least)
    if curved:
        turns = ca.fabs(rig[CURVATURE_INPUTS] * (ca.vertcat(*found) - s))
        forces = [ca.if_else(turns[palm] < MOST_TURN, force, -ca.inf) for palm, force in enumerate(forces)]
    gained = moving[1] - x[Z.OMEGA0]
    unexplained = ca.logic_and(
        gained * motion.alpha0 < 0, ca.fabs(gained) > 2 * STEP_S * ca.fabs(at_first) + MOST_UNEXPLAINED
    )
    forces = [ca.if_else(unexplained, -ca.inf, force) for force in forces]
    told = ca.vertcat(moving, *forces, *found, *motion.forces, *normals)
    return ca.Function("step", [x, s, move, rig], touch.thawed(after, told))


def begin_function(curved: bool = False) -> ca.Function:
    """(x, move, rig) → (s1, s2) there (m), found blind."""
    x, move, rig = SX.sym("x", N), SX.sym("move", MOVE_INPUTS), SX.sym("rig", RIG_INPUTS)
    touch, angles = touch_on(rig, curved), palms_on(move, SX(0)).angles
    s = ca.vertcat(*readings(angles[OPENING], *contacts_of(x, angles, touch)))
    return ca.Function("begin", [x, move, rig], touch.thawed(s), ["x", "move", "rig"], ["s"])


def roll_function(curved: bool = False) -> ca.Function:
    """(x, s, move, rig) → (ψ and ω0 after `SUBSTEPS` steps, `TOLD` at the end of each): forces per unit mass, m/s².

    s: where both contacts are at the start (m), which curved palms go on from.
    """
    x, s, move, rig = SX.sym("x", N), SX.sym("s", 2), SX.sym("move", MOVE_INPUTS), SX.sym("rig", RIG_INPUTS)
    step, state, last, told = _step_function(curved), x, s, []
    for number in range(SUBSTEPS):
        state, now = step(state, last, ca.vertcat(move[:5], move[5] + number * STEP_S), rig)
        told.append(now)
        last = now[S]
    moved = [state[:2], ca.horzcat(*told)]
    return ca.Function("roll", [x, s, move, rig], moved, ["x", "s", "move", "rig"], ["moved", "told"])


@cache
def library(curved: bool = False) -> Library:
    """`begin_batch` and `roll_batch`: on columns, on the same rig; compiled, `roll_sequences` besides."""
    functions = {"begin_batch": begin_function, "roll_batch": roll_function}
    return load(
        "rollout_curved" if curved else "rollout",
        lambda: [of_columns(each(curved), name, ["rig"]) for name, each in functions.items()],
        written=["rollout.c"],
    )
