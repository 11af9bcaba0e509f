"""The roadmap: its promises hold in the same dynamics, and it leads where short random sequences do not."""

import math
from functools import cache

import numpy as np
import pytest

from palmd.config.plans import ExploreGoal
from palmd.config.two_palms import LimitsConfig
from palmd.events import PlanningBelief
from palmd.model import shape, shape_map
from palmd.model.outputs import rig_inputs
from palmd.motion import candidates
from palmd.motion.check import motion_limits
from palmd.motion.decisions import UnderWay
from palmd.motion.explorer import Explorer
from palmd.motion.limits import PHI12_MAX, MotionLimits, problems, ranges
from palmd.motion.roadmap import BETWEEN, NEVER_S, ORIENTATIONS, STEP, Roadmap, _refined, _touches
from palmd.motion.rollout_predictor import BINS, MARGIN_M, Moves, RolloutPredictor, goodness
from palmd.motion.segments import Move
from palmd.rig.plant import random_surface
from palmd.rig.shapes import random_body
from palmd.rig.world import World, default_config
from palmd.system.description import RigDescription

LIMITS = motion_limits(default_config())
PREDICTOR = RolloutPredictor(rig_inputs(RigDescription()))
TURN = math.tau / (ORIENTATIONS * BETWEEN)  # from one orientation to the next


@cache
def state(seed=4, kind="rig"):
    random = np.random.default_rng([seed, 7])
    body, surface = random_body(kind, random), random_surface(kind, random)
    found = np.zeros(shape_map.N)
    found[shape_map.Z.LN_RHO], found[shape_map.Z.MU] = math.log(body.rho), surface.mu
    found[shape_map.Z.LN_DITHER], found[shape_map.Z.DAMPING] = math.log(surface.dither), surface.damping
    found[shape_map.Z.SHAPE :] = shape.coefficients_of(body.support.sample(np.arange(360) * (math.tau / 360)))
    return found


@cache
def renewed():
    """A roadmap, and whether it was complete before any pose was processed, after three, and after all."""
    made, complete = Roadmap(PREDICTOR, LIMITS, state()), []
    for poses in (0, 3, len(made.poses) - 3):
        made.renew(state(), poses)
        complete.append(made.complete)
    return made, complete


def roadmap():
    return renewed()[0]


def bins(*which):
    marks = np.zeros(BINS, dtype=np.bool_)
    marks[list(which)] = True
    return marks


def rolled(here, psi, ends):
    """The result of moving from `here` to each of `ends`, as the roadmap's moves do, from rest at psi."""
    start = state().copy()
    start[shape_map.Z.PSI] = psi
    rates = np.full((len(ends), 1), candidates.RATE_SHARE * LIMITS.rate)
    moves = candidates.timed(here, ends[:, None], rates, LIMITS)
    return PREDICTOR.of(start, moves), moves


def test_poses_keep_the_limits_and_extend_to_their_edges():
    poses = roadmap().poses
    for pose in poses:
        assert not problems(LIMITS.bounds, ranges([LIMITS.values(Move(tuple(pose), tuple(pose), 0.1).at(0.0))]))
        radius = state()[shape_map.Z.SHAPE]
        assert radius / math.tan(pose[1] / 2) < LIMITS.pad_length - MARGIN_M
    assert poses.sum(axis=1).max() > PHI12_MAX - math.radians(3.0)
    assert poses[:, 0].min() < math.radians(10.0)


def test_on_a_cradle_the_poses_are_equally_dense_in_the_tangents_and_none_wedges():
    """A circle of radius a on equal palms: cos(φ2/2) = (1 − κa) cos(β/2), with β between the tangents."""
    kappa, radius, mu = 13.3, 0.022, 0.12
    limits = MotionLimits.from_config(
        LimitsConfig(phi1_deg=(0.0, 110.0), phi2_deg=(60.0, 165.0)), pad_length=0.0555, curvatures=(kappa, kappa)
    )
    known = state().copy()
    known[shape_map.Z.SHAPE], known[shape_map.Z.MU] = radius, mu
    poses = Roadmap(PREDICTOR, limits, known).poses
    tangent_angles = 2 * np.arccos(np.cos(poses[:, 1] / 2) / (1 - kappa * radius))
    assert tangent_angles.min() > 2 * math.atan(mu) + math.radians(8.0)
    assert tangent_angles.min() < math.radians(30.0), "only friction limits it"
    apart = -np.diff(tangent_angles)[np.diff(poses[:, 0]) == 0.0]
    assert len(apart) > 15
    assert apart.max() < 1.5 * STEP


def test_it_is_complete_after_each_pose_has_been_processed():
    assert renewed()[1] == [False, False, True]


def test_without_wanted_normals_the_time_is_infinite():
    assert (roadmap().time_to(bins()).seconds == NEVER_S).all()


def test_between_its_poses_it_gives_no_time():
    to_go = roadmap().time_to(bins(*range(BINS)))
    on = to_go.poses[np.abs(to_go.poses - np.radians((45.0, 90.0))).max(axis=1).argmin()]
    off = on + 0.01
    assert to_go.at(on, np.array(0.3)) < 5.0
    assert to_go.at(off, np.array(0.3)) == NEVER_S
    assert to_go.at(on, np.array(math.nan)) >= 0.0
    assert to_go.nearest(off) == pytest.approx(on)


def test_no_move_is_quicker_than_the_roadmaps_time():
    """Bellman's equation from above, with each move simulated here: no route by a next pose is quicker."""
    wanted = bins(*range(30, 36))
    to_go = roadmap().time_to(wanted)
    random = np.random.default_rng(3)
    compared = 0
    for number in random.integers(0, len(to_go.poses), 12):
        here, place = to_go.poses[number], BETWEEN * random.integers(0, ORIENTATIONS)
        apart = np.abs(to_go.poses - here).max(axis=1)
        ends = to_go.poses[(apart > 0) & (apart < math.radians(45.0))]
        predicted, moves = rolled(here, place * TURN, ends)
        seconds, safe = moves.durations[:, 0], goodness(predicted, moves, LIMITS)[:, 0] > 1.0
        after = np.where((predicted.touched[:, 0] & wanted).any(axis=1), 0.0, to_go.at(ends, predicted.psi[:, 0]))
        if safe.any():
            compared += 1
            assert to_go.seconds[number, place] <= (seconds + after)[safe].min() + 0.02
    assert compared > 4


def test_its_greedy_policy_reaches_the_wanted_normals():
    """From wherever the time is finite, the greedy policy arrives in the model, though not always in that time."""
    wanted = bins(*range(10, 14))
    to_go = roadmap().time_to(wanted)
    arrived = tried = 0
    for number, place in zip(*np.nonzero((to_go.seconds > 1.0) & (to_go.seconds < 6.0)), strict=True):
        if (number * ORIENTATIONS * BETWEEN + place) % 71:
            continue
        tried += 1
        here, psi, t = to_go.poses[number], place * TURN, 0.0
        while t < 3.0 * to_go.seconds[number, place]:
            ends = to_go.poses[np.abs(to_go.poses - here).max(axis=1) > 0.0]
            predicted, moves = rolled(here, psi, ends)
            seconds = moves.durations[:, 0]
            there = (predicted.touched[:, 0] & wanted).any(axis=1)
            cost = seconds + np.where(there, 0.0, to_go.at(ends, predicted.psi[:, 0]))
            cost[goodness(predicted, moves, LIMITS)[:, 0] <= 1.0] = np.inf
            best = cost.argmin()
            here, psi, t = ends[best], predicted.psi[best, 0], t + seconds[best]
            if there[best]:
                arrived += 1
                break
    assert tried >= 5
    assert arrived >= 0.6 * tried


def test_moves_are_interpolated_between_two_orientations():
    """Against the same motion simulated from there, 5° from the tabulated orientations."""
    made, off, total = roadmap(), [], 0
    numbers = range(0, len(made.poses), 5)
    for number in numbers:
        moves = np.flatnonzero(made._from == number)
        for place in range(BETWEEN // 2, made._psi.shape[1], 7 * BETWEEN):
            predicted, _ = rolled(made.poses[number], place * TURN, made.poses[made._to[moves]])
            there = np.isfinite(made._seconds[moves, place])
            off += np.abs(made._psi[moves, place] - predicted.psi[:, 0])[there].tolist()
            total += len(there)
    assert len(off) > 0.5 * total
    assert np.median(off) < math.radians(0.5)
    assert np.quantile(off, 0.9) < math.radians(2.0)


def test_interpolation_is_periodic():
    angles = np.array([[0.3, 1.9, 3.4, 5.0]])
    rises = np.diff(_refined(angles, math.tau, largest_gap=2.0)[0], append=0.3 + math.tau)
    assert rises.reshape(4, BETWEEN) == pytest.approx(
        np.repeat([[1.6], [1.5], [1.6], [1.5832]], BETWEEN, 1) / BETWEEN, abs=1e-4
    )


def test_a_palm_touches_all_bins_from_the_lowest_to_the_highest_normal():
    degrees = np.radians([[-12.0, 3.0], [-2.0, -1.0], [361.0, 364.0], [17.0, 40.0]])
    lowest, highest = degrees.T
    assert _touches(lowest, highest, bins(0)).tolist() == [True, False, True, False]
    assert _touches(lowest, highest, bins(71)).tolist() == [True, True, False, False]
    assert _touches(lowest, highest, bins(4, 5)).tolist() == [False, False, False, True]
    assert not _touches(lowest, highest, bins()).any()


def test_next_to_a_barrier_there_is_no_interpolation():
    angles = np.array([[0.0, 0.2, 2.0, math.nan]])
    between = _refined(angles, math.tau, largest_gap=1.0).reshape(4, BETWEEN)
    assert between[:, 0] == pytest.approx(angles[0], nan_ok=True)
    assert between[0] == pytest.approx(0.2 * np.arange(BETWEEN) / BETWEEN)
    assert np.isnan(between[1:, 1:]).all()


def test_learnt_times_hold_until_they_are_forgotten():
    made, wanted = roadmap(), bins(*range(BINS))
    before = made.time_to(wanted).seconds
    made.learn(made.poses[5], 0.0, 20.0)
    learnt = made.time_to(wanted).seconds
    assert learnt[5, 0] >= 20.0
    assert (learnt >= before).all()
    made.forget()
    assert (made.time_to(wanted).seconds == before).all()


def test_an_object_that_rests_almost_anywhere_is_turned_fully():
    """For this object, moves chosen without the roadmap leave a quarter untouched at the time limit."""
    assert exploring(102) < 40.0


def exploring(seed):
    """Time until all is touched, when the object moves as the model predicts (s)."""
    truth = World(default_config(), seed, kind="rig", t=0.0).object_truth()
    now = np.zeros(shape_map.N)
    now[shape_map.Z.SHAPE :] = shape.coefficients_of(np.array(truth["h_m"]))
    now[shape_map.Z.LN_RHO], now[shape_map.Z.MU] = math.log(truth["rho_m"]), truth["mu"]
    now[shape_map.Z.LN_DITHER], now[shape_map.Z.DAMPING] = math.log(truth["dither_m_s"]), truth["damping_m2_s"]
    explorer = Explorer(RigDescription(), LIMITS, ExploreGoal(coverage=0.95, time_limit_s=60.0), seed)
    pose = (math.radians(45.0), math.radians(90.0))
    move, touched, t = Move(pose, pose, 0.1), np.zeros(BINS, dtype=np.bool_), 0.0
    while True:
        states = np.tile(now, (4, 1))
        states[1:, shape_map.Z.MU] += (0.01, -0.01, 0.02)
        belief = PlanningBelief(t, states, touched, np.full(BINS, 1e-5), 1)
        decision = explorer.decide(belief, UnderWay(move, move.duration))
        if decision.kind == "done":
            return t
        if decision.kind != "move":
            t += 0.3
            continue
        move = decision.move
        moves = Moves(np.array(move.start), np.array([[move.end]]), np.array([[move.duration]]))
        predicted = PREDICTOR.of(now, moves)
        now[shape_map.Z.PSI], now[shape_map.Z.OMEGA0] = predicted.psi[0, 0], predicted.omega0[0, 0]
        touched = touched | predicted.touched[0, 0]
        t += move.duration
