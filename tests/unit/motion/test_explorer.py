"""The explorer's decisions: reproducible, within the limits, and with the true reason for ending."""

import math
from dataclasses import replace
from functools import cache
from unittest.mock import Mock

import numpy as np
import pytest

from palmd.config.plans import ExploreGoal
from palmd.config.two_palms import LimitsConfig
from palmd.events import PalmMotion, PlanningBelief
from palmd.model import shape, shape_map
from palmd.model.outputs import rig_inputs
from palmd.model.smoothing import ORDER, RIG_CONSTANTS, R
from palmd.motion.check import motion_limits
from palmd.motion.decisions import UnderWay
from palmd.motion.explorer import RIG_S, STUCK_S, Explorer, _inmost
from palmd.motion.limits import MotionLimits, problems, ranges
from palmd.motion.rollout_predictor import BINS, MEAN_FORCES, Moves, RolloutPredictor, may_hop
from palmd.motion.segments import Move
from palmd.rig.plant import Hinge, Plant, random_surface, stable_poses
from palmd.rig.shapes import random_body
from palmd.rig.world import default_config
from palmd.system.arcs import joints_of
from palmd.system.description import PadSensor, RigDescription

LIMITS = motion_limits(default_config())
POSE = (math.radians(45.0), math.radians(90.0))
STANDING = UnderWay(Move(POSE, POSE, 0.1), 0.1)
NOTHING = np.zeros(BINS, dtype=np.bool_)
SHARP = np.full(BINS, 1e-5)


@cache
def lying(seed=2, mu=0.15):
    """The likeliest state of an object at rest in a stable pose, and a few samples of the belief."""
    random = np.random.default_rng([seed, 5])
    body = random_body("rig", random)
    state = np.zeros(shape_map.N)
    state[shape_map.Z.PSI] = stable_poses(body, PalmMotion.at_rest(POSE))[0]
    state[shape_map.Z.LN_RHO], state[shape_map.Z.MU] = math.log(body.rho), mu
    state[shape_map.Z.LN_DITHER] = math.log(0.012)
    theta = np.arange(360) * (math.tau / 360)
    state[shape_map.Z.SHAPE :] = shape.coefficients_of(body.support.sample(theta))
    states = np.tile(state, (4, 1))
    states[1:, shape_map.Z.MU] += (0.02, -0.02, 0.04)
    return states


def planning_belief(t=0.0, touched=NOTHING, h_sd=SHARP, states=None, count=1):
    return PlanningBelief(t, lying() if states is None else states, touched, h_sd, count)


def explorer(seed=0, **goal):
    return Explorer(RigDescription(), LIMITS, ExploreGoal(**{"coverage": 0.95, "time_limit_s": 60.0} | goal), seed)


def test_the_same_seed_gives_the_same_decisions():
    def moves(seed):
        mine, under_way, found = explorer(seed), STANDING, []
        for number in range(2):
            decision = mine.decide(planning_belief(0.5 * number), under_way)
            found.append(decision.move)
            under_way = UnderWay(decision.move, decision.move.duration)
        return found

    assert moves(1) == moves(1)
    assert moves(1) != moves(2)


def test_moves_begin_where_the_current_one_ends_and_keep_all_limits():
    mine, under_way, states = explorer(), STANDING, lying()
    for number in range(4):
        decision = mine.decide(planning_belief(0.5 * number, states=states), under_way)
        if decision.kind != "move":
            assert decision.reason
            continue
        assert decision.move.start == under_way.move.end
        motion = [LIMITS.values(decision.move.at(t)) for t in np.linspace(0.0, decision.move.duration, 200)]
        assert problems(LIMITS.bounds, ranges(motion)) == []
        under_way = UnderWay(decision.move, 0.0)  # the next one is decided while it has just begun


def test_chosen_moves_touch_new_normals_on_the_plant():
    """A few moves, each decided from the plant's true state, touch much more than the object's first pose."""
    random = np.random.default_rng([2, 5])
    body = random_body("rig", random)
    surface = random_surface("rig", random)
    plant = Plant(body, Hinge("arc"), surface)
    states = lying(mu=surface.mu).copy()
    plant.place(PalmMotion.at_rest(POSE), states[0, 0])
    mine, under_way, touched, t = explorer(), STANDING, NOTHING.copy(), 0.0
    for _ in range(6):
        states[:, :2] = plant.state.psi, plant.state.omega0
        decision = mine.decide(planning_belief(t, touched.copy(), states=states), under_way)
        if decision.kind == "done":
            break
        assert decision.kind == "move"
        move = decision.move
        for step in range(round(move.duration / 1e-3)):
            palms = move.at((step + 1) * 1e-3)
            plant.advance(move.at((step + 0.5) * 1e-3), palms, 1e-3)
            assert plant.touching == (True, True)
            for normal in (palms.angles[0] - math.pi / 2, palms.angles[0] + palms.angles[1] - 1.5 * math.pi):
                touched[math.floor((normal - plant.state.psi) / (math.tau / BINS)) % BINS] = True
        t += move.duration
        under_way = UnderWay(move, move.duration)
    assert touched.mean() > 0.3


def test_without_a_choice_it_only_judges_the_current_move():
    sliding = UnderWay(Move(POSE, (math.radians(8.0), math.radians(36.0)), 0.3), 0.0)
    assert explorer().decide(planning_belief(), STANDING, choose=False).kind == "safe"
    assert explorer().decide(planning_belief(), sliding, choose=False).kind == "unsafe"


def test_it_is_done_when_enough_is_touched_and_reports_the_reachable_share():
    enough = NOTHING.copy()
    enough[:70] = True  # 97 %
    decision = explorer().decide(planning_belief(touched=enough), STANDING)
    assert decision.kind == "done"
    assert decision.coverage == pytest.approx(70 / 72, abs=0.03)
    assert 0.9 <= decision.reachable <= 1.0
    assert "touched" in decision.reason
    assert explorer(coverage=1.0).decide(planning_belief(touched=enough), STANDING).kind != "done"


def test_it_is_not_done_before_a_smoother_confirms_the_touched_normals():
    """A diverged bank also reports full coverage; this is lost once the smoother has found the object."""
    everything = np.ones(BINS, dtype=np.bool_)
    strayed = replace(planning_belief(touched=everything), rig=np.zeros(RIG_CONSTANTS))
    mine = explorer()
    decision = mine.decide(strayed, STANDING)
    assert decision.kind == "move"
    assert decision.move.end != decision.move.start
    found = replace(strayed, rig_spread=np.zeros((2 * ORDER + 1 + RIG_CONSTANTS, RIG_CONSTANTS)))
    assert mine.decide(found, STANDING).kind == "done"
    assert "nothing new" in mine.decide(replace(strayed, t=STUCK_S + 1.0), STANDING).reason


def test_a_requested_standard_deviation_must_be_reached_too():
    everything = np.ones(BINS, dtype=np.bool_)
    blunt = SHARP.copy()
    blunt[20] = 1e-4
    assert explorer(band_mm=0.05).decide(planning_belief(touched=everything, h_sd=blunt), STANDING).kind != "done"
    assert explorer(band_mm=0.05).decide(planning_belief(touched=everything), STANDING).kind == "done"
    assert explorer().decide(planning_belief(touched=everything, h_sd=blunt), STANDING).kind == "done"


def test_it_ends_at_the_time_limit_and_names_the_untouched_normals():
    mine = explorer(time_limit_s=10.0)
    gap = np.ones(BINS, dtype=np.bool_)
    gap[10:20] = False
    assert mine.decide(planning_belief(0.0, gap), STANDING).kind != "done"
    decision = mine.decide(planning_belief(10.5, gap), STANDING)
    assert decision.kind == "done"
    assert "time limit of 10 s" in decision.reason
    assert "50–100°" in decision.reason


def test_it_stops_when_nothing_new_was_touched_for_long():
    mine = explorer(time_limit_s=600.0)
    gap = np.ones(BINS, dtype=np.bool_)
    gap[-5:] = gap[:5] = False
    assert mine.decide(planning_belief(0.0, gap), STANDING).kind != "done"
    gap[4] = True
    assert mine.decide(planning_belief(STUCK_S, gap), STANDING).kind != "done"
    decision = mine.decide(planning_belief(2 * STUCK_S + 1.0, gap), STANDING)
    assert decision.kind == "done"
    assert "nothing new" in decision.reason
    assert "335–20°" in decision.reason


def test_it_continues_while_nothing_is_known():
    """Only motion can lead to an estimate, so the palms must not stop for lack of one."""
    mine = explorer(time_limit_s=600.0)
    for t in (0.0, STUCK_S + 1.0, 3 * STUCK_S):
        assert mine.decide(planning_belief(t), STANDING).kind != "done"
    some = NOTHING.copy()
    some[3] = True
    assert mine.decide(planning_belief(4 * STUCK_S, some), STANDING).kind != "done"
    assert mine.decide(planning_belief(5 * STUCK_S + 1.0, some), STANDING).kind == "done"


def test_roadmap_results_are_kept_until_something_is_touched():
    mine = explorer()
    mine.decide(planning_belief(0.0), STANDING)
    mine._roadmap = Mock(complete=False)
    mine.decide(planning_belief(1.0), STANDING)
    mine._roadmap.forget.assert_not_called()
    some = NOTHING.copy()
    some[3] = True
    mine.decide(planning_belief(2.0, some), STANDING)
    mine._roadmap.forget.assert_called_once()


def test_inmost_gives_the_wanted_normals_farthest_from_the_others_and_their_depth():
    wanted = np.zeros(BINS, dtype=np.bool_)
    wanted[[70, 71, 0, 1, 2, 30]] = True
    inner, depth = _inmost(wanted, 8)
    assert (np.flatnonzero(inner).tolist(), depth) == ([0], 3)
    assert _inmost(wanted, 2)[0].sum() == 3
    assert _inmost(~wanted, 8)[1] == 8
    everything = np.ones(BINS, dtype=np.bool_)
    assert _inmost(everything, 8)[0].all()


def test_a_move_that_throws_the_object_is_unsafe():
    hasty = UnderWay(Move(POSE, (POSE[0], math.radians(150.0)), 0.12), 0.02)
    decision = explorer().decide(planning_belief(), hasty)
    assert decision.kind == "unsafe"
    assert "contact" in decision.reason
    gentle = UnderWay(Move(POSE, (POSE[0], math.radians(100.0)), 1.2), 0.02)
    assert explorer().decide(planning_belief(), gentle).kind == "move"


def test_curved_palms_do_not_close_while_friction_is_uncertain():
    """Between tangents 20° apart a circle slides with μ = 0.1 and is wedged with 0.3; a smoother determines which."""
    curvatures, radius = (13.3, 13.3), 0.021
    rig = RigDescription(pads=tuple(PadSensor(curvature=kappa) for kappa in curvatures))
    limits = replace(LIMITS, curvatures=curvatures)
    wide, closed = (joints_of(radius, (math.radians(90.0 - half), math.radians(2 * half)), curvatures)
                    for half in (40.0, 10.0))  # fmt: skip
    states = np.tile(lying(mu=0.1)[:1], (3, 1))
    states[:, shape_map.Z.SHAPE] = radius
    states[:, shape_map.Z.SHAPE + 1 :] = 0.0
    states[:, shape_map.Z.SHAPE + 3] = 2e-4  # nearly a circle, which would rest anywhere
    closing = UnderWay(Move(wide, closed, 1.6), 0.02)
    first = replace(planning_belief(states=states), rig=np.zeros(RIG_CONSTANTS))
    confirmed = replace(first, rig_spread=np.zeros((2 * ORDER + 1 + RIG_CONSTANTS, RIG_CONSTANTS)))

    def judged(known, on=rig, within=limits):
        return Explorer(on, within, ExploreGoal(coverage=0.95, time_limit_s=60.0)).decide(known, closing, choose=False)

    assert judged(first).kind == "unsafe"
    assert judged(confirmed).kind == "safe"
    rough = states.copy()
    rough[:, shape_map.Z.MU] = 0.3
    assert judged(replace(confirmed, states=rough)).kind == "unsafe", "high friction would wedge it"


def test_a_move_that_is_safe_for_the_likeliest_state_only_is_not_made():
    """One sample so large that it leaves the pads is enough to reject the move chosen otherwise."""
    states = lying().copy()
    states[3, shape_map.Z.SHAPE] *= 3.5
    doubtful, sure = (
        explorer().decide(planning_belief(states=states), STANDING),
        explorer().decide(planning_belief(), STANDING),
    )
    assert sure.kind == "move"
    assert doubtful.move != sure.move


@pytest.mark.parametrize(
    ("phi1_deg", "phi2_deg"),
    [((44.0, 47.0), (89.0, 92.0)), ((45.0, 45.5), (60.0, 120.0)), ((85.0, 150.0), (85.0, 155.0))],
    ids=["one pose", "one angle", "one sum"],
)
def test_very_narrow_limits_are_kept(phi1_deg, phi2_deg):
    """Until the roadmap, even of a single pose, is complete and in use."""
    limits = MotionLimits.from_config(LimitsConfig(phi1_deg=phi1_deg, phi2_deg=phi2_deg), pad_length=LIMITS.pad_length)
    mine = Explorer(RigDescription(), limits, ExploreGoal(coverage=0.95, time_limit_s=60.0))
    here = (math.radians(phi1_deg[0] + 0.25), math.radians(phi2_deg[0] + 1.0))
    for number in range(4):
        decision = mine.decide(planning_belief(0.5 * number), UnderWay(Move(here, here, 0.1), 0.1))
        assert decision.kind in ("move", "wait")
        if decision.move is not None:
            motion = [limits.values(decision.move.at(t)) for t in np.linspace(0.0, decision.move.duration, 50)]
            assert problems(limits.bounds, ranges(motion)) == []


def open_rig(constant, off):
    """Everything is touched; one constant of the rig is known to `off` only, and so is the radius."""
    spread = np.zeros((2 * ORDER + 1 + RIG_CONSTANTS, RIG_CONSTANTS))
    spread[0, 0], spread[2 * ORDER + 1 + constant, 0] = 5e-5, off
    everything = np.ones(BINS, dtype=np.bool_)
    return replace(planning_belief(touched=everything), rig=np.zeros(RIG_CONSTANTS), rig_spread=spread)


def test_with_all_touched_it_continues_while_touch_can_determine_the_rig():
    ajar = open_rig(R.TURN, math.radians(0.1))
    mine = explorer()
    decision = mine.decide(ajar, STANDING)
    assert decision.kind == "move"
    assert decision.move.end != decision.move.start
    later = replace(ajar, t=ajar.t + RIG_S)
    assert mine.decide(later, STANDING).kind == "done"  # no longer than that
    assert explorer().decide(replace(ajar, touched=NOTHING), STANDING).kind == "move"
    known = replace(ajar, rig_spread=0.01 * ajar.rig_spread)
    assert explorer().decide(replace(known, h_sd=np.full(BINS, 1e-4)), STANDING).kind == "done"


def test_it_does_not_continue_for_unobservable_rig_constants():
    decision = explorer().decide(open_rig(R.STANDOFF, 5e-5), STANDING)
    assert decision.kind == "done"
    assert "100%" in decision.reason


def test_it_is_done_when_no_motion_determines_the_rig_better():
    """A constant that moves the readings by a thousandth of their noise costs most, and yet cannot be determined."""
    ajar = open_rig(R.TURN, math.radians(0.1))
    ajar = replace(ajar, rig_spread=0.002 * ajar.rig_spread, h_sd=np.full(BINS, 1e-9))
    assert explorer().decide(ajar, STANDING).kind == "done"


def test_the_expected_information_of_its_moves_counts_until_a_smoother_answers():
    """The same belief again and again is a reason neither to repeat a move nor to be done."""
    ajar, mine = open_rig(R.TURN, math.radians(0.1)), explorer()
    counted = []
    for _ in range(3):
        assert mine.decide(ajar, STANDING).kind == "move"
        counted.append(np.trace(mine._expected))
    assert 0.0 < counted[0] < counted[1] < counted[2]
    answered = replace(ajar, rig_spread=0.002 * ajar.rig_spread, h_sd=np.full(BINS, 1e-9))
    assert mine.decide(answered, STANDING).kind == "done"  # it has answered, and no motion gives more information


FORCE_LIMIT_N = 5.0


def pressing(belief, decision):
    """The largest predicted force on a pad (N) during the move, for the object of this belief."""
    move = decision.move
    moves = Moves(np.array(move.start), np.array([[move.end]]), np.array([[move.duration]]))
    predicted = RolloutPredictor(rig_inputs(RigDescription())).of(belief.states[0], moves)
    return belief.mass * float(np.nanmax(predicted.path[..., MEAN_FORCES]))


def test_moves_keep_the_pads_force_limits():
    """Closing palms press on an object with more than its weight, which can exceed the limit for a heavy one."""
    heavy = replace(planning_belief(), mass=0.3, mass_sd=0.003)
    limited = replace(LIMITS, pad_forces=(FORCE_LIMIT_N,) * 2)
    closing = UnderWay(Move(POSE, (math.radians(60.0), math.radians(50.0)), 4.0), 0.02)

    def judged(known, limits=limited):
        mine = Explorer(RigDescription(), limits, ExploreGoal(coverage=0.95, time_limit_s=60.0))
        return mine.decide(known, closing, choose=False)

    assert judged(heavy).kind == "unsafe"
    assert "force limit" in judged(heavy).reason
    assert judged(replace(heavy, mass=0.1)).kind == "safe"
    assert judged(replace(heavy, mass=math.nan)).kind == "safe", "an unknown mass sets no limit"
    assert judged(heavy, replace(LIMITS, pad_forces=())).kind == "safe", "these pads have no force limit"

    mine, under_way = Explorer(RigDescription(), limited, ExploreGoal(coverage=0.95, time_limit_s=60.0)), STANDING
    for number in range(6):
        # the mass is unknown for a moment after a saturated reading
        known = heavy if number % 2 == 0 else replace(heavy, mass=math.nan)
        decision = mine.decide(replace(known, t=0.5 * number), under_way)
        if decision.kind == "move":
            assert pressing(heavy, decision) < FORCE_LIMIT_N


def hopping(mu):
    """The number of decisions whose move may make a contact hop, for the likeliest state."""
    mine, under_way, states, found = explorer(), STANDING, lying(mu=mu), 0
    predictor = RolloutPredictor(rig_inputs(RigDescription()))
    for number in range(8):
        decision = mine.decide(planning_belief(0.5 * number, states=states), under_way)
        if decision.kind == "move":
            move = decision.move
            moves = Moves(np.array(move.start), np.array([[move.end]]), np.array([[move.duration]]))
            predicted = predictor.of(states[0], moves)
            states = states.copy()
            states[:, [shape_map.Z.PSI, shape_map.Z.OMEGA0]] = predicted.psi[0, 0], predicted.omega0[0, 0]
            found += bool(may_hop(predicted, moves)[0, 0])
            under_way = UnderWay(move, move.duration)
    return found


def test_moves_with_possible_hops_are_avoided(monkeypatch):
    careful = hopping(0.2)
    monkeypatch.setattr("palmd.motion.explorer.HOP_S", 0.0)
    monkeypatch.setattr("palmd.motion.roadmap.HOP_S", 0.0)
    assert careful <= 1
    assert hopping(0.2) > careful + 1
