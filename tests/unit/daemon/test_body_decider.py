"""Decisions of an exploration of a body between three palms, by questions and answers."""

import dataclasses
import math

import numpy as np
import pytest
from body_stand import WIDE, BodyStand, known_parameters

from palmd.config.three_palms import TiltGoal
from palmd.daemon import body_decider
from palmd.daemon.body_decider import BodyDecider
from palmd.daemon.exploration_requests import ExplorationTask, Question
from palmd.model.convex_bodies import least_radii
from palmd.model.icosphere import icosphere
from palmd.model.rotation import exp
from palmd.model.spherical import count
from palmd.motion import body_explorer
from palmd.motion.body_explorer import LEAST_FORCE
from palmd.motion.decisions import UnderWay
from palmd.motion.segments import Move
from palmd.motion.three_palms import TiltLimits
from palmd.observer.three_palms.body import ORDER
from palmd.rig.three_palms.world import REST_POSE
from palmd.system.three_palms import BodyPlanningBelief, ThreePalmsRig

RIG, SEED = ThreePalmsRig(), 4
LIMITS = TiltLimits.over(WIDE, 75.0)
REST = tuple(REST_POSE.tolist())
STANDING = UnderWay(Move(REST, REST, 0.0), 0.0)


@pytest.fixture(scope="module")
def belief():
    stand = BodyStand(SEED, RIG.gravity)
    (R,), (omega,) = stand.bearings
    p = known_parameters(stand.plant.body, stand.plant.friction)
    none = np.zeros(len(icosphere()[0]), np.bool_)
    sure = 1e-14 * np.eye(6 + len(p))
    return BodyPlanningBelief(10.0, 1, 2.0, True, 0.08, R, omega, p, sure, none, np.zeros((0, 3, 3)), 1, np.eye(3))


def question(belief, under_way=STANDING, *, t=10.0, run=1, choose=True, **goal):
    return Question(t, ExplorationTask(run, TiltGoal(**goal), LIMITS), belief, under_way, choose)


def test_without_an_accepted_body_the_palms_swing():
    answer = BodyDecider(RIG).answer(question(None))
    assert (answer.object_count, answer.decision.kind, answer.decision.move.start) == (None, "move", REST)
    assert "swings" in answer.decision.reason


def test_the_next_move_of_a_known_body_begins_where_the_current_move_ends(belief):
    end = (0.95, 0.78, 0.8)
    answer = BodyDecider(RIG).answer(question(belief, UnderWay(Move(REST, end, 0.5), 0.1)))
    assert answer.object_count == 1
    assert answer.decision.kind == "move"
    assert answer.decision.move.start == end
    assert answer.decision.then.start == answer.decision.move.end
    assert math.isfinite(answer.decision.coverage)
    believed = BodyDecider(RIG).answer(question(dataclasses.replace(belief, accepted=False)))
    assert (believed.decision.kind, believed.decision.then) == ("move", None)  # single moves until it is accepted


def test_a_question_without_choice_is_answered_with_safe_or_unsafe(belief):
    decider, move = BodyDecider(RIG), Move(REST, (0.95, 0.78, 0.8), 0.5)
    assert decider.answer(question(belief, UnderWay(move, 0.1), choose=False)).decision.kind == "safe"
    thrown = UnderWay(Move(REST, (1.3, 0.3, 0.3), 0.08), 0.01)
    assert decider.answer(question(belief, thrown, choose=False)).decision.kind == "unsafe"


def test_it_is_done_when_an_accepted_body_is_covered_or_the_time_is_over(belief):
    decider, most = BodyDecider(RIG), icosphere()[0][:, 2] > -0.6
    seen = dataclasses.replace(belief, touched=most)
    answer = decider.answer(question(seen, coverage=0.8)).decision
    assert (answer.kind, answer.reachable) == ("done", 1.0)
    assert answer.coverage > 0.8
    assert decider.answer(question(dataclasses.replace(seen, accepted=False), coverage=0.8)).decision.kind != "done"
    late = decider.answer(question(belief, t=75.0, time_limit_s=60)).decision
    assert (late.kind, late.reason) == ("done", "the time limit of 60 s is over")


def test_contacts_since_the_last_answer_count_as_coverage(belief):
    decider = BodyDecider(RIG)
    bare = decider.answer(question(belief, choose=False)).decision.coverage
    extended = dataclasses.replace(belief, normals_since=np.tile(np.eye(3), (5, 1, 1)))
    share = decider.answer(question(extended, choose=False)).decision.coverage
    assert bare == 0.0
    assert share == np.mean((icosphere(body_decider.HALVINGS)[0] > math.cos(math.radians(10.0))).any(axis=1))


def test_coverage_of_an_accepted_body_is_kept(belief):
    extended = dataclasses.replace(belief, normals_since=np.tile(np.eye(3), (5, 1, 1)))

    def shares(*beliefs):
        decider = BodyDecider(RIG)
        return [decider.answer(question(each, choose=False)).decision.coverage for each in beliefs]

    share, on, elsewhere = shares(extended, belief, dataclasses.replace(belief, record_start=3.0, frame=2))
    assert on == share > elsewhere == 0.0  # not in another frame
    assert shares(dataclasses.replace(extended, accepted=False), belief) == [share, 0.0]


def test_coverage_is_carried_into_the_frame_of_the_next_record(belief):
    one, turn = np.array([0.0, 0.0, 1.0]), exp(np.array([0.0, 1.1, 0.0]))
    extended = dataclasses.replace(belief, normals_since=np.tile(one, (1, 3, 1)))
    again = dataclasses.replace(belief, record_start=3.0, turn=turn)  # the contact lies at turn.T @ one in this frame
    there = dataclasses.replace(again, normals_since=np.tile(turn.T @ one, (1, 3, 1)))
    elsewhere = dataclasses.replace(again, normals_since=np.tile(one, (1, 3, 1)))

    def share(*beliefs):
        decider = BodyDecider(RIG)
        return [decider.answer(question(each, choose=False)).decision.coverage for each in beliefs][-1]

    once = share(extended)
    assert share(extended, again) == pytest.approx(once, rel=0.25)
    assert share(extended, there) < 1.4 * once
    assert share(extended, elsewhere) > 1.7 * once
    assert share(extended, again, belief) == pytest.approx(once, rel=0.4)  # and back in the first frame


def test_a_body_at_rest_without_a_safe_move_is_swung_unless_it_is_accepted(belief, monkeypatch):
    monkeypatch.setattr(body_decider.BodyExplorer, "decide", lambda *_, **__: None)
    believed, late = dataclasses.replace(belief, accepted=False), 10.1 + body_decider.REST_LIMIT_S
    decider = BodyDecider(RIG)
    assert decider.answer(question(believed)).decision.kind == "wait"
    swing = decider.answer(question(believed, t=late)).decision
    assert (swing.kind, swing.blind, swing.move.start) == ("move", True, REST)
    # A predicted loss of the body neither stops the swing nor delays the next one.
    leaving = dataclasses.replace(believed, omega=np.array([60.0, 40.0, 0.0]))
    after = decider.answer(question(leaving, UnderWay(swing.move, 0.1), t=late + 0.1)).decision
    assert (after.kind, after.move.start) == ("move", swing.move.end)
    assert (
        decider.answer(question(leaving, UnderWay(swing.move, 0.1), t=late)).decision.kind == "unsafe"
    )  # the previous move
    accepted = BodyDecider(RIG)
    assert [accepted.answer(question(belief, t=t)).decision.kind for t in (10.0, late)] == ["wait", "wait"]
    decider.answer(question(believed, t=late, run=2))  # a new exploration restarts the waiting time
    assert decider.answer(question(believed, t=late + 0.1, run=2)).decision.kind == "wait"


def test_a_light_body_is_pressed_hard_enough_for_the_pads_to_detect_it(belief, monkeypatch):
    asked = []
    monkeypatch.setattr(body_decider.BodyExplorer, "decide", lambda *args, **_: asked.append(args[3]))
    decider = BodyDecider(RIG)
    for mass in (0.02, 10.0, math.nan):
        decision = decider.answer(question(dataclasses.replace(belief, mass=mass))).decision
        assert (decision.kind, decision.reason) == ("wait", "no safe motion found yet")
    assert asked == [body_decider.DETECTABLE_N / 0.02, LEAST_FORCE, LEAST_FORCE]
    decider.answer(question(dataclasses.replace(belief, accepted=False)))
    assert asked[-1] == 2.0 * max(LEAST_FORCE, body_decider.DETECTABLE_N / 0.08)


def test_moves_are_short_before_a_body_is_accepted_and_slow_after_it_is_lost(belief, monkeypatch):
    asked = []
    monkeypatch.setattr(
        body_decider.BodyExplorer, "decide", lambda *args, most_rad_s, **_: asked.append((most_rad_s, args[4]))
    )
    decider = BodyDecider(RIG)
    for accepted in (False, True, False):
        decider.answer(question(dataclasses.replace(belief, accepted=accepted)))
    decider.answer(question(dataclasses.replace(belief, accepted=False, record_start=3.0)))  # in another frame
    short, stride, slower = body_decider.SHORT_RAD_S, body_decider.STRIDE_RAD_S, body_decider.SLOWER_RAD_S
    assert [most for most, _ in asked] == [short, stride, slower, short]
    assert all(np.abs(drawn.p - belief.p).max() < 1e-6 for _, drawn in asked)


def test_every_move_lasts_long_enough_to_decide_the_next(belief, monkeypatch):
    made, grown = [], body_explorer.BodyExplorer._extended_randomly
    monkeypatch.setattr(
        body_explorer.BodyExplorer, "_extended_randomly", lambda *args: made.extend(grown(*args)) or made[-48:]
    )
    assert BodyDecider(RIG).answer(question(belief)).decision.move.duration >= body_decider.SHORTEST_S
    assert min(move.duration for each in made for move in each.moves) == body_decider.SHORTEST_S


def test_another_frame_of_the_body_gets_a_new_explorer(belief, monkeypatch):
    made = []
    explorer = body_decider.BodyExplorer
    monkeypatch.setattr(body_decider, "BodyExplorer", lambda *a: made.append(a) or explorer(*a))
    decider = BodyDecider(RIG)
    for each in (
        belief,
        belief,
        dataclasses.replace(belief, record_start=3.0),
        dataclasses.replace(belief, object_count=2),
    ):
        decider.answer(question(each, choose=False))
    assert len(made) == 3


def test_untouched_parts_are_predicted_as_convex(belief):
    decider, hollow, n = BodyDecider(RIG), belief.p.copy(), count(ORDER)
    hollow[count(8) : n] += 3e-5 * np.random.default_rng(0).normal(size=n - count(8))
    wide = belief.covariance.copy()
    wide[6 : 6 + n, 6 : 6 + n] += 1e-7 * np.eye(n)
    assert least_radii(hollow[:n])[0].min() < 0.0
    decider.answer(question(dataclasses.replace(belief, p=hollow, covariance=wide), choose=False))
    assert least_radii(decider._predictor.parameters[:n])[0].min() > 0.0
