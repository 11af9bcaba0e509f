"""The closed loop without wires: deterministic by seed, driven by the same commands, with correct estimates."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from campaign import nightly

from palmd.config.two_palms import PlanSpec, rig_description
from palmd.daemon.exploration_requests import Decider
from palmd.harness.scorer import COMPARED, Scorer
from palmd.motion.decisions import Decision
from palmd.motion.segments import Move
from palmd.observer import Simulated
from palmd.quantities import ESTIMATE, SHAPE
from palmd.rig.fault_injection import order
from palmd.rig.world import default_config
from tools.closed_loop import ClosedLoopError, InlineExplorer, TwoPalmsLoop
from tools.studies.real_objects import real_object

ROCK = PlanSpec.model_validate(
    {
        "name": "rock",
        "repeat": "forever",
        "segments": [{"sine": {"phi1_deg": 25, "phi2_deg": 10}, "frequency_hz": [0.41, 0.57], "duration_s": 20}],
    }
)
EXPLORE = PlanSpec.model_validate({"name": "explore", "segments": [{"explore": {"time_limit_s": 30}}]})
RATE_LIMIT = math.radians(120.0)


def wireless(seed, **how):
    return TwoPalmsLoop(default_config(), ROCK, seed, **how)


def light(seed=5):
    """A run without the full observer."""
    return wireless(seed, observer_name="quasistatic")


def bits(instants):
    """All messages and the truth of a run, bit by bit."""
    return repr([(instant.messages, instant.truth) for instant in instants])


def test_the_same_seed_repeats_a_run_bit_by_bit():
    first, second = wireless(3), wireless(3)
    first.start()
    second.start()
    assert bits(first.run(2.5)) == bits(second.run(2.5))


def test_another_seed_draws_another_body():
    bodies = [wireless(seed).world.object_truth() for seed in (3, 4)]
    assert bodies[0]["h_m"] != bodies[1]["h_m"]
    assert bodies[0]["mass_kg"] != bodies[1]["mass_kg"]


def take(scorer, instant):
    """Scores one tick of a run; returns whether its estimate counts."""
    estimate = instant.messages[ESTIMATE.name]
    counts = scorer.take(instant.t, estimate)
    if counts:
        scorer.compare(instant.t, [estimate[name] for name in COMPARED], [instant.truth[name] for name in COMPARED])
    if SHAPE.name in instant.messages:
        scorer.take_shape(instant.messages[SHAPE.name])
    return counts


@pytest.mark.parametrize(("seed", "observer_name"), [(3, "shape"), *nightly((1, "shape"), (6, "extended"))])
def test_the_estimate_becomes_valid_and_is_correct(seed, observer_name):
    run = wireless(seed, observer_name=observer_name)
    run.start()
    scorer = Scorer(run.t)
    counted = [take(scorer, instant) for instant in run.run(12.0)]
    run.stop()
    status, body = run.world.status(), run.world.object_truth()
    assert scorer.settling_s < 6.0
    assert np.mean(counted[counted.index(True) :]) > 0.8
    assert scorer.rms()[0] < 1e-4
    outline = scorer.outline(body["h_m"])
    assert outline.e_h < 1e-4
    assert outline.touched > 0.05
    assert abs(scorer.constants(body)[2]) < 0.1
    assert scorer.estimate["object"] == 1
    assert status["contact_losses"] == status["falls"] == status["setpoints_outside_limits"] == 0
    assert 0.0 < math.radians(status["largest_rate_deg_s"]) < RATE_LIMIT


def test_ticks_follow_the_loops_period_and_truth_belongs_to_the_same_instant():
    run = light()
    run.start()
    instants = list(run.run(0.5))
    times = [instant.t for instant in instants]
    assert len(times) == 50
    assert [b - a for a, b in itertools.pairwise(times)] == pytest.approx([0.01] * 49)
    assert instants[-1].truth == run.world.truth()
    assert {"palm/estimate", "palm/contact", "palm/motion"} <= instants[-1].messages.keys()


def test_commands_are_checked_as_those_of_a_client():
    run = light()
    with pytest.raises(ClosedLoopError, match="it must be tracking or hold"):
        run.ask("start")
    run.start()
    assert run.ask("status")["plan"] == "rock"
    with pytest.raises(ValueError, match="unknown argument"):
        run.ask("jog", phi3_deg=0.1)
    run.stop()
    assert run.core.at_rest
    assert run.world.truth()["arm_state"] == "R"


def test_a_rig_that_does_not_become_ready_raises_with_its_state():
    run = light()
    run.world.fault_injector.add(order("mute", 0.0, port="arm"))
    with pytest.raises(ClosedLoopError, match="not ready within 5 s, but idle: "):
        run.start()


def test_motion_continues_after_a_hold():
    run = light()
    run.start()
    run.world.fault_injector.add(order("mute", run.t, port="pad1", for_s=0.5))
    states = [str(run.core.state) for _ in run.run(3.0)]
    assert "hold" in states
    assert states[-1] == "tracking"
    assert run.core.setpoints.moving


class AlternatingDecider(Decider):
    """Decides for two poses in turn, and ends the exploration after so many questions."""

    questions_left = 15

    def answer(self, question):
        answer = super().answer(question)
        if question.belief is None:
            return answer
        self.questions_left -= 1
        here = question.under_way.move.end
        way = math.radians(14 if here[0] < math.radians(45) else -14)
        move = Move(here, (here[0] + way, here[1]), 0.7)
        decision = Decision("move", move, "goes on", 0.3, 0.9)
        return dataclasses.replace(
            answer, decision=decision if self.questions_left > 0 else Decision("done", None, "enough")
        )


def exploring(seed=3):
    decider = AlternatingDecider(rig_description(default_config()))
    run = TwoPalmsLoop(default_config(), EXPLORE, seed, explorer=InlineExplorer(decider))
    run.start()
    return run


@pytest.mark.nightly
def test_an_exploration_starts_without_an_estimate_and_follows_the_decisions_to_the_end():
    run = exploring()
    instants = list(run.run(20.0))
    valid = next(instant.t for instant in instants if instant.messages["palm/estimate"]["valid"])
    assert valid < 8.0
    motions = [instant.messages["palm/motion"] for instant in instants if instant.t > 1.0]
    phi1 = [math.degrees(motion["phi1_cmd_rad"]) for motion in motions]
    assert max(phi1) - min(phi1) == pytest.approx(14, abs=0.1)
    assert {motion["progress"] for motion in motions} >= {0.3}
    status = run.ask("status")
    assert status["explored"] == {"coverage": 0.3, "reachable": 0.9, "reason": "enough"}
    assert (status["doing"], status["moving"], status["state"]) == ("explore", False, "tracking")
    assert run.world.status()["setpoints_outside_limits"] == run.core.setpoints.interventions == 0
    run.stop()


def test_the_same_seed_repeats_an_exploration_bit_by_bit():
    first, again = (bits(exploring().run(4.0)) for _ in range(2))
    assert first == again


@pytest.mark.nightly
def test_an_exploration_continues_after_a_hold_from_its_pose():
    run = exploring()
    for instant in run.run(8.0):
        if instant.messages["palm/estimate"]["valid"]:
            break
    list(run.run(1.0))
    run.world.fault_injector.add(order("mute", run.t, port="pad2", for_s=0.6))
    instants = list(run.run(4.0))
    held = [i for i in instants if i.messages.get("palm/state", {}).get("state") == "hold"]
    assert held
    stood = held[-1].messages["palm/motion"]["phi1_cmd_rad"]
    later = [i.messages["palm/motion"]["phi1_cmd_rad"] for i in instants if i.t > held[-1].t]
    steps = [abs(b - a) for a, b in itertools.pairwise([stood, *later])]
    assert max(steps) < RATE_LIMIT * 0.01
    assert max(later) - min(later) > math.radians(10)
    assert str(run.core.state) == "tracking"


def test_the_score_compares_an_estimate_with_the_truth():
    run = wireless(5)
    run.start()
    (instant,) = run.run(0.01)
    scorer = Scorer(t_started=0.0)
    truth = instant.truth
    names = ("r1_m", "r2_m", "omega0_rad_s")
    body = run.world.object_truth()
    take(scorer, dataclasses.replace(instant, t=1.0))
    for t, valid, off in ((2.0, True, 0.0), (3.0, True, 4e-4), (4.0, False, 1.0), (5.0, True, 0.0)):
        estimate = {name: truth[name] + off * (name == "r2_m") for name in names}
        estimate |= {"valid": valid, "object": 2, "rho_m": 1.1 * body["rho_m"], "mu": body["mu"] - 0.02}
        estimate |= {"mass_kg": 0.9 * body["mass_kg"]}
        take(scorer, dataclasses.replace(instant, t=t, messages={"palm/estimate": estimate}))
    assert scorer.settling_s == 2.0
    assert scorer.rms() == (pytest.approx(4e-4 / math.sqrt(6)), pytest.approx(0.0))
    assert scorer.constants(body) == pytest.approx((0.1, -0.02, -0.1))
    assert scorer.estimate["object"] == 2
    assert scorer.outline(body["h_m"]) is None


def test_the_score_of_a_run_without_a_valid_estimate_has_no_numbers():
    scorer = Scorer(0.0)
    scorer.take(1.0, {"valid": False})
    assert all(map(math.isnan, (scorer.settling_s, *scorer.rms())))


@pytest.mark.nightly
def test_a_body_with_detected_corners_is_tipped():
    config = default_config()
    body = real_object("nut", np.random.default_rng(1)).body
    run = TwoPalmsLoop(config, EXPLORE, 1, smoothing=Simulated(rig_description(config)), body=body)
    run.start()
    list(run.run(4.0))
    assert "corners" in run.core.exploring.reason
