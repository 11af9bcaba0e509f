"""The daemon's core without I/O, in one process with the emulated rig: commands, faults, and set-points to the arm."""

import dataclasses
import math
import pickle
import random
import re
from functools import cache
from random import Random

import numpy as np
import pytest
from improvements import improvement
from plans import SHORT, SWING
from virtual_rig import AtOnce

from palmd.config.plans import ExploreGoal, ExploreSpec
from palmd.config.two_palms import PlanSpec
from palmd.daemon.commands import Request
from palmd.daemon.core import Core
from palmd.daemon.exploring import OVERTIME_S
from palmd.daemon.planner import Plan
from palmd.events import Estimate, PadLift, PadSample, PalmSample
from palmd.harness.operator import Operator
from palmd.messages import NAMED_STATE, entries_of, events_of, stamp
from palmd.motion.check import motion_limits
from palmd.motion.plan import compile_plan
from palmd.quantities import EVENTS, IMPROVEMENT, RIG, STATE
from palmd.rig.emulated import STEP_S
from palmd.rig.fault_injection import INJECTABLE_FAULTS, order
from palmd.rig.world import World, default_config
from palmd.system.rig_constants import RIG_NAMES
from tools.published import validate
from tools.studies.stub_observers import EmptyObserver

LIFTED = "name: sent\nsegments:\n- move: {phi1_deg: 50, phi2_deg: 85}\n  duration_s: 1.0\n"
ENDS = ("pad1", "pad2", "arm")
TICK_STEPS = 20


class Fake(EmptyObserver):
    """An observer that only records what it is fed."""

    name, object_count, late_dropped = "fake", 1, 0

    def __init__(self):
        self.events = []
        self.ticks = [[]]
        self.times = []
        self.valid = False
        self.value = 0.01
        self.failing = False

    def feed(self, event):
        self.events.append(event)
        self.ticks[-1].append(event.t_sample)

    def estimate(self, t):
        self.ticks.append([])
        self.times.append(t)
        if self.failing:
            raise ZeroDivisionError("a defect")
        values = {
            field.name: self.value
            for field in dataclasses.fields(Estimate)
            if field.name not in ("t", "valid", "observer", "object_count", "sd", "invalid_reasons")
        }
        sd = dict.fromkeys(NAMED_STATE, 1e-3)
        return Estimate(t=t, valid=self.valid, observer="fake", object_count=1, sd=sd, **values)

    def forget_object(self):
        self.forgotten = True
        return True

    @property
    def has_planning_belief(self):
        return self.valid

    @property
    def invalid_because(self):
        return "" if self.valid else "NIS 3.10 (limit 2)"


class Clock:
    """A time budget that is used up after a number of events."""

    def __init__(self, events):
        self.left = events

    def __call__(self):
        self.left -= 1
        return self.left > 0


class Mute:
    """An explorer that never answers."""

    prepared, asked = False, 0

    def prepare(self):
        self.prepared = True

    def ask(self, _question):
        self.asked += 1

    def collect(self, _t):
        return None


class Bench:
    """World and core, advanced tick by tick."""

    def __init__(self, seed=1, spec=SWING, autostart=False, config=None, explorer=None):
        config = (config or default_config()).model_copy(update={"autostart": autostart})
        limits = motion_limits(config)
        plan = None if spec is None else Plan(spec, compile_plan(spec, limits), limits, None)
        self.world = World(config, seed)
        self.observer = Fake()
        self.core = Core(config, self.observer, AtOnce(), plan, explorer=explorer)
        self.steps = 0
        self.messages = []
        self.written = b""
        self.open = set()
        self.plug(*ENDS)

    @property
    def t(self):
        return self.steps * STEP_S

    @property
    def state(self):
        return self.core.state

    @property
    def faults(self):
        return [fault.code for fault in self.core.faults.active]

    def plug(self, *ends):
        for end in ends:
            self.core.opened(end, self.t)
        self.open |= set(ends)

    def unplug(self, end):
        self.open.discard(end)
        self.core.lost(end, self.t)

    def go(self, seconds, until=None):
        for _ in range(round(seconds / STEP_S)):
            self.steps += 1
            for end, data in self.world.advance(self.t).items():
                if data and end in self.open:
                    self.core.receive(end, data, self.t)
            if self.t >= self.core.due():
                data = self.core.transmit(self.t)
                self.written += data
                self.world.receive("arm", data)
            if self.steps % TICK_STEPS == 0:
                self.messages += self.core.step(self.t)
                if until is not None and until():
                    return self
        assert until is None, f"condition not reached: {self.state}, {self.faults}"
        return self

    def ask(self, name, seconds=0.5, **args):
        """A command, and its answer."""
        self.core.handle(Request(name, args, id=name), self.t)
        answers = []

        def answered():
            answers.extend(reply for reply in self.core.replies() if reply.request.id == name)
            return bool(answers)

        if not answered():
            self.go(seconds, answered)
        (answer,) = answers
        return answer

    def do(self, name, **args):
        answer = self.ask(name, **args)
        assert answer.error is None, answer.error
        return answer.result

    def play(self, name, **how):
        self.world.fault_injector.add(order(name, self.world.t, **how))

    def last(self, topic):
        return next(fields for each, fields in reversed(self.messages) if each.name == topic)

    def commanded(self):
        return self.last("palm/motion")["phi1_cmd_rad"]

    def stall(self, seconds):
        """The host does nothing for a while."""
        self.steps += round(seconds / STEP_S)
        for end, data in self.world.advance(self.t).items():
            if data and end in self.open:
                self.core.receive(end, data, self.t)

    def check_the_arm(self):
        """The emulated arm's verdict on the set-points that it received."""
        status = self.world.status()
        assert status["setpoints_outside_limits"] == 0
        assert status["largest_rate_deg_s"] < 121.0
        assert status.get("refused_610", 0) == status.get("refused_611", 0) == 0


@cache
def kept(begun):
    """A bench in the given state, pickled, so that every test starts from its own copy."""
    return pickle.dumps(begun())


def begun_ready():
    return Bench().go(1.0)


def begun_running():
    bench = begun_ready()
    bench.do("arm")
    bench.do("start")
    return bench.go(1.0)


@pytest.fixture
def ready():
    return pickle.loads(kept(begun_ready))


@pytest.fixture
def running():
    return pickle.loads(kept(begun_running))


def logged(bench, kind=""):
    """The log's last message, as a late subscriber gets it."""
    bench.go(0.2)
    return [entry for entry in entries_of(bench.last("palm/log")) if kind in ("", entry.kind)]


# ---- from idle to a running plan


def test_the_daemon_is_idle_until_all_ports_are_open_and_the_arm_has_answered():
    bench = Bench()
    bench.unplug("pad2")
    assert bench.go(0.5).state == "idle"
    assert bench.faults == ["pad2-port"]
    bench.plug("pad2")
    assert bench.go(0.3).state == "ready"


def test_nothing_moves_without_a_command(ready):
    ready.go(2.0)
    assert ready.state == "ready"
    assert {line[:1] for line in ready.written.split(b"\n") if line} == {b"H", b"Q"}


def test_arm_keeps_the_pose_and_start_runs_the_plan(ready):
    assert ready.do("arm") == {"state": "tracking"}
    here = ready.go(0.3).commanded()
    assert ready.go(0.3).commanded() == here
    assert ready.do("start") == {"state": "tracking", "plan": "swing"}
    assert ready.go(2.0).commanded() != here
    motion = ready.last("palm/motion")
    assert (motion["plan"], motion["segment"], motion["arm_state"]) == ("swing", 1, "T")
    assert 0.0 < motion["progress"] < 1.0
    ready.check_the_arm()


def test_after_a_plans_end_the_arm_holds_its_pose_and_start_runs_the_plan_again():
    bench = Bench(spec=SHORT).go(0.5)
    bench.do("arm")
    bench.do("start")
    bench.go(2.0)
    assert bench.state == "tracking"
    assert math.degrees(bench.commanded()) == pytest.approx(55.0)
    assert not bench.core.setpoints.moving
    assert "never reaches" in bench.ask("start").error  # from this pose the plan is impossible
    assert "plan-refused" in bench.go(0.1).faults
    bench.check_the_arm()


def test_autostart_arms_and_starts_once():
    bench = Bench(autostart=True)
    bench.go(3.0)
    assert bench.state == "tracking"
    assert bench.core.setpoints.moving
    bench.do("stop")
    assert bench.go(3.0).state == "ready"


def test_start_after_hold_resumes_from_the_held_pose(running):
    running.do("hold")
    assert running.state == "hold"
    here = running.go(0.5).commanded()
    assert running.go(0.3).commanded() == here
    running.do("start")
    assert running.state == "tracking"
    assert abs(running.go(0.02).commanded() - here) < math.radians(1.0)
    running.go(1.0).check_the_arm()


def test_stop_ends_in_ready(running):
    assert running.do("stop") == {"state": "ready"}
    running.go(0.5)
    assert running.last("palm/motion")["arm_state"] == "R"
    assert math.isnan(running.commanded())
    assert running.core.at_rest
    running.do("arm")


def test_jog(ready):
    ready.do("arm")
    begin = ready.go(0.1).commanded()
    for _ in range(10):
        ready.do("jog", phi1_deg=0.5)
        ready.go(0.05)
    ready.go(0.5)
    here = ready.commanded()
    assert math.degrees(here - begin) > 2.0
    assert ready.go(0.3).commanded() == here
    ready.check_the_arm()


@pytest.mark.parametrize(
    ("whole", "complaint"),
    [
        ({"whole_phi1_deg": 90.0}, "phi1 + phi2 reaches"),
        ({"whole_phi1_deg": -40.0}, "phi1 falls to"),
        ({"whole_phi1_deg": 1.0, "whole_phi2_deg": 70.0}, "phi2 reaches"),
    ],
)
def test_a_jog_that_cannot_be_completed_is_refused_at_its_first_step(ready, whole, complaint):
    ready.do("arm")
    begin = ready.go(0.1).commanded()
    assert complaint in ready.ask("jog", phi1_deg=0.4, **whole).error
    for _ in range(50):
        assert ready.go(0.01).commanded() == begin
    assert not ready.do("status")["moving"]


def test_a_refused_jog_keeps_the_held_plan(running):
    running.do("hold")
    running.go(0.5)
    assert "falls to" in running.ask("jog", phi1_deg=-0.4, whole_phi1_deg=-90.0).error
    assert running.do("status")["doing"] == "sine"
    assert running.do("start") == {"state": "tracking"}
    before = running.commanded()
    assert running.go(0.5).commanded() != before


@pytest.mark.parametrize("command", ["start", "hold", "jog"])
def test_motion_commands_are_refused_in_ready(ready, command):
    assert "it must be tracking or hold" in ready.ask(command).error
    assert ready.state == "ready"


def test_commands_that_would_start_something_twice_are_refused(running):
    assert "it must be ready" in running.ask("arm").error
    assert "moving already" in running.ask("start").error
    assert "hold or stop them first" in running.ask("plan", path="x.yaml").error
    assert running.state == "tracking"


def test_status_reports_state_plan_and_faults(running):
    status = running.do("status")
    assert status["state"] == "tracking"
    assert (status["plan"], status["doing"], status["arm_state"]) == ("swing", "sine", "T")
    assert status["moving"] is True
    assert status["faults"] == []
    assert status["requested_state"] == ""
    running.do("hold")
    status = running.do("status")
    assert status["wish"] == status["requested_state"] == "hold"


# ---- what is published for the record


def test_status_reports_the_palms_angles_as_soon_as_they_are_known(ready):
    status, actual = ready.do("status"), ready.core.arm.actual
    assert [status[name] for name in ("phi1_rad", "phi2_rad")] == pytest.approx(actual.angles)
    fresh = Bench().do("status")
    assert "phi1_rad" not in fresh
    assert (fresh["segment"], fresh["doing"], fresh["progress"]) == (-1, "", 0.0)


def test_every_tick_publishes_exactly_the_events_that_the_observer_got(running):
    published = [fields for topic, fields in running.messages if topic.name == "palm/events"]
    assert [event for fields in published for event in events_of(fields)] == running.observer.events
    assert [len(fields["source"]) for fields in published] == [len(times) for times in running.observer.ticks[:-1]]
    assert [fields["t_tick_s"] for fields in published] == running.observer.times
    assert {type(event) for event in running.observer.events} == {PadSample, PalmSample}
    for fields in published:
        assert validate(EVENTS, stamp(dict(fields), 0.0, 0.0, 0)) == []


OFF, OFF_SD = np.zeros(len(RIG_NAMES)), np.full(len(RIG_NAMES), 1e-2)
OFF[1], OFF_SD[1] = 3e-4, 3e-5
AGAINST = 6.0 * (OFF != 0.0)


class Improved(Fake):
    """An observer with a smoother that answers in the third estimate."""

    def improve(self, _t):
        result = {
            "t": 0.04,
            "frame": 2,
            "touched": np.ones(72, dtype=bool),
            "rig": OFF,
            "rig_sd": OFF_SD,
            "contradicted": AGAINST,
        }
        return improvement(np.arange(3.0), np.eye(3), **result) if len(self.ticks) == 3 else None


def test_an_improvement_is_published_in_the_tick_that_received_it():
    observer = Improved()
    core = Core(default_config(), observer, AtOnce())
    by_time = {t: dict(core.step(t)) for t in (0.01, 0.02, 0.03)}
    assert [t for t, messages in by_time.items() if IMPROVEMENT in messages] == [0.03]
    fields = by_time[0.03][IMPROVEMENT]
    assert (fields["t_tick_s"], fields["t_s"]) == (0.03, 0.04)
    assert (fields["x"], fields["covariance"]) == ([0.0, 1.0, 2.0], np.eye(3).ravel().tolist())
    assert (fields["frame"], fields["established"], fields["touched"]) == (2, True, [1] * 72)
    assert validate(IMPROVEMENT, stamp(fields, 0.0, 0.0, 0)) == []
    observer.failing = True
    assert IMPROVEMENT not in dict(core.step(0.04))


def test_rig_constants_are_published_after_each_answer_of_the_smoother_and_every_second():
    config = default_config()
    pads = config.pads.model_copy(update={"palm2": config.pads.palm2.model_copy(update={"zero_sd_mm": 0.1})})
    core = Core(config.model_copy(update={"pads": pads}), Improved(), AtOnce())
    by_time = {t: dict(core.step(t)).get(RIG) for t in (0.01, 0.02, 0.03, 0.04, 0.9, 1.03, 1.04)}
    assert [t for t, fields in by_time.items() if fields] == [0.01, 0.03, 1.03]
    first, now, again = (by_time[t] for t in (0.01, 0.03, 1.03))
    assert (first["pad2_zero_m"], first["contradictions"]) == (0.0, [])
    assert list(first["sd"].values()) == first["prior_sd"] == now["prior_sd"]
    assert now["sd"]["pad2_zero_m"] == 3e-5
    assert now["prior_sd"][1] == pytest.approx(1e-4)
    assert now["contradictions"] == ["pad 2's zero seems +0.30 ± 0.03 mm off: palmd calibrate self finds its zero_mm"]
    assert again == now


def test_readings_that_contradict_the_configuration_are_a_fault_that_stops_nothing():
    core = Core(default_config(), Improved(), AtOnce())
    by_time = {t: dict(core.step(t)).get(STATE) for t in (0.01, 0.02, 0.03, 0.04)}
    heard = {
        code: severity
        for fields in by_time.values()
        if fields
        for code, severity in zip(fields["faults"], fields["severities"], strict=True)
    }
    assert "rig-contradicted" not in by_time[0.01]["faults"]
    assert heard["rig-contradicted"] == "note"


RECORDED = {"bytes": 1000.0, "messages": 10.0, "lost": 0.0, "path": "runs/a.mcap"}


def test_a_recorder_is_reported_silent_only_after_it_has_been_heard(ready):
    ready.go(5.0)
    assert "recorder" not in ready.do("status")
    ready.do("recorder", **RECORDED)
    ready.go(2.5)
    assert "recorder-silent" not in ready.faults
    status = ready.do("status")["recorder"]
    assert status.pop("age_s") == pytest.approx(2.5, abs=0.1)
    assert status == RECORDED
    ready.go(1.0)
    assert "recorder-silent" in ready.faults
    ready.do("recorder", **RECORDED)
    assert "recorder-silent" not in ready.go(0.1).faults


def test_a_recorder_that_cannot_write_is_reported_and_stops_nothing(running):
    running.do("recorder", **RECORDED, problem="/runs: the disk is full")
    assert running.go(0.1).faults == ["recorder-failed"]
    assert running.state == "tracking"
    assert running.do("status")["recorder"]["problem"] == "/runs: the disk is full"
    running.do("recorder", **RECORDED)
    assert running.go(0.1).faults == []


# ---- plans


def test_events_beyond_the_time_budget_wait_for_the_next_tick_in_order(ready):
    core, fed = ready.core, ready.observer.events
    samples = [PalmSample(ready.t + i * 1e-4, (0.8, 1.6)) for i in range(7)]
    core._events = samples[::-1]
    before = len(fed)
    counts = []
    for events in (3, 3, 3):
        core.observe(ready.t, Clock(events))
        topics = {topic.name: fields for topic, fields in core.report(ready.t)}["palm/events"]
        counts.append(len(topics["t_sample_s"]))
    assert fed[before:] == samples
    assert counts == [3, 3, 1]


def test_plan_replaces_the_plan_and_a_bad_plan_changes_nothing(tmp_path):
    ready = Bench(config=default_config().model_copy(update={"plan": tmp_path / "swing.yaml"})).go(1.0)
    good, bad, outside = tmp_path / "good.yaml", tmp_path / "bad.yaml", tmp_path.parent / "outside.yaml"
    for path in (good, outside):
        path.write_text("name: other\nsegments:\n  - {hold_s: 1.0}\n")
    bad.write_text("name: far\nsegments:\n  - {move: {phi1_deg: 170}, duration_s: 2.0}\n")
    assert ready.do("plan", path="good.yaml")["plan"] == "other"
    assert ready.do("plan", path=str(good))["plan"] == "other"
    assert "bad.yaml:3:" in ready.ask("plan", path="bad.yaml").error
    assert "no/such" in ready.ask("plan", path="no/such.yaml").error
    for path in (str(outside), "../outside.yaml"):
        assert "no such file" in ready.ask("plan", path=path).error
    assert ready.go(0.05).last("palm/motion")["plan"] == "other"


def test_a_plans_text_may_be_sent_with_the_command(ready):
    text = "name: sent\nsegments:\n  - {hold_s: 1.0}\n"
    assert ready.do("plan", path="/nobody/here.yaml", text=text)["plan"] == "sent"
    far = text.replace("hold_s: 1.0", "move: {phi1_deg: 170}, duration_s: 2.0")
    assert "/nobody/here.yaml:3:" in ready.ask("plan", path="/nobody/here.yaml", text=far).error
    assert "/nobody/here.yaml:1:" in ready.ask("plan", path="/nobody/here.yaml", text="\x07").error
    assert ready.go(0.05).last("palm/motion")["plan"] == "sent"


def test_start_without_a_plan_is_refused():
    bench = Bench(spec=None).go(0.5)
    bench.do("arm")
    assert "there is no plan" in bench.ask("start").error


EXPLORE = PlanSpec.model_validate({"name": "explore", "segments": [{"explore": {"time_limit_s": 2.0}}]})


def test_a_plan_that_explores_needs_an_explorer():
    bench = Bench(spec=EXPLORE).go(0.5)
    bench.do("arm")
    assert "set observer.primary to shape" in bench.ask("start").error
    assert bench.state == "tracking"


def test_an_exploration_reports_its_end_and_may_be_started_again():
    mute = Mute()
    bench = Bench(spec=EXPLORE, explorer=mute).go(0.5)
    assert mute.prepared
    assert "explored" not in bench.do("status")
    bench.do("arm")
    before = None
    for _ in range(2):
        bench.do("start")
        assert bench.core.supervisor.plan.trajectory is not before  # each start is a new exploration
        before = bench.core.supervisor.plan.trajectory
        bench.go(1.0)
        status = bench.do("status")
        assert (status["doing"], status["over"]) == ("explore", False)
        published = bench.last("palm/state")
        assert (published["running"], published["exploring"], published["coverage_goal"]) == (True, True, 0.95)
        bench.go(1.5 + OVERTIME_S)
        status = bench.do("status")
        assert status["explored"] == {"coverage": None, "reachable": None, "reason": "the time limit of 2 s is over"}
        assert (status["moving"], status["over"]) == (False, True)
        assert status["state"] == "tracking"
        published = bench.last("palm/state")
        assert (published["running"], published["exploring"], published["reason"]) == (
            False,
            False,
            "the time limit of 2 s is over",
        )
        assert published["explored_s"] > 2.0
    bench.do("jog", phi1_deg=0.3)
    assert not bench.go(0.15).last("palm/state")["running"]  # a jog is no plan


def test_a_silent_explorer_is_reported():
    mute = Mute()
    bench = Bench(spec=EXPLORE.model_copy(update={"segments": [ExploreSpec(explore=ExploreGoal())]}), explorer=mute)
    bench.observer.valid = True
    bench.go(0.5).do("arm")
    bench.do("start")
    bench.go(1.5)
    assert bench.faults == []
    bench.go(1.0)
    assert bench.faults == ["explorer-silent"]
    assert mute.asked == 0  # there is no belief for planning
    bench.do("stop")
    assert bench.go(0.1).faults == []


# ---- notes


def test_a_note_is_published_with_its_time():
    bench = Bench().go(0.2)
    bench.do("note", text="put back by hand")
    assert [fields for topic, fields in bench.go(0.1).messages if topic.name == "palm/note"] == [
        {"t_s": pytest.approx(0.2, abs=0.011), "text": "put back by hand"}
    ]


def test_new_object_makes_the_observer_forget_the_object():
    bench = Bench().go(0.2)
    bench.do("new_object")
    assert bench.observer.forgotten


# ---- pads lost


@pytest.mark.parametrize(
    ("trick", "how", "fault"), [("mute", {"port": "pad1"}, "pad1-silent"), ("lift", {}, "pad2-lifted")]
)
def test_a_lost_pad_holds_the_motion_within_100_ms(running, trick, how, fault):
    t = running.t
    running.play(trick, **how)
    running.go(0.2, lambda: running.state == "hold")
    assert running.t - t < 0.1
    running.go(0.4)
    assert fault in running.faults
    assert re.search(rf"pad {fault[3]}.* \(its last packet is .* old.*\)", running.last("palm/state")["cause"])
    here = running.commanded()
    assert running.go(0.2).commanded() == here
    running.check_the_arm()
    running.do("stop")
    assert fault not in running.go(0.05).faults  # palms at rest need no object


def test_a_missing_object_blocks_any_plan_until_it_is_back_or_the_palms_are_stopped(running):
    running.play("lift")
    running.go(0.3, lambda: running.state == "hold")
    running.go(0.5).do("plan", path="sent.yaml", text=LIFTED)
    assert "put the object back" in running.go(0.2).ask("start").error
    running.do("jog", phi1_deg=0.1)
    assert "put the object back" in running.go(1.0).ask("start").error
    running.do("stop")
    running.go(0.5).do("arm")
    running.do("start")
    assert running.state == "tracking"


def test_an_unplugged_pad_holds_at_once_and_motion_resumes_only_on_command(running):
    running.unplug("pad1")
    running.go(0.02)
    assert running.state == "hold"
    assert running.faults == ["pad1-port"]
    assert "pad 1 is not open" in running.ask("start").error
    running.plug("pad1")
    running.go(0.3)
    assert (running.state, running.faults) == ("hold", [])
    published = running.last("palm/state")
    assert published["cause"].startswith("the serial port of pad 1 is not open")  # though it is open again
    assert 0.15 < published["since_s"] < 0.45
    running.do("start")
    assert running.state == "tracking"


def test_the_observer_gets_a_lift_event_for_an_unplugged_pad(running):
    running.unplug("pad2")
    running.go(0.02)
    lifts = [event for event in running.observer.events if isinstance(event, PadLift)]
    assert lifts[-1].pad == 2


def test_palms_may_be_armed_and_moved_without_an_object(ready):
    ready.play("lift")
    ready.go(1.5)
    assert ready.faults == ["pad1-untouched", "pad2-untouched"]
    ready.do("arm")
    ready.do("start")
    ready.go(1.0)
    assert (ready.state, ready.core.setpoints.moving) == ("tracking", True)


def test_an_object_removed_from_resting_palms_holds_nothing(ready):
    ready.do("arm")
    ready.go(0.2)
    ready.play("lift")
    ready.go(0.5)
    assert (ready.state, ready.faults) == ("tracking", [])


def test_a_pad_unplugged_in_ready_leads_to_idle(ready):
    ready.unplug("pad1")
    assert ready.go(0.05).state == "idle"


# ---- the arm lost or stopped


@pytest.mark.parametrize(
    ("trick", "fault"), [("estop", "arm-estop"), ("power_off", "arm-power-off"), ("manual", "arm-manual")]
)
def test_an_operators_action_at_the_arm_stops_it_until_reset(running, trick, fault):
    running.play(trick, port="arm", for_s=0.5)
    running.go(0.3)
    assert (running.state, running.faults) == ("fault", [fault])
    assert "reset refused" in running.ask("reset").error
    assert "it must be ready" in running.ask("arm").error
    running.go(0.5)
    assert (running.state, running.faults) == ("fault", [fault])
    assert running.do("reset") == {"state": "ready", "cleared": [fault]}
    assert (running.state, running.faults) == ("ready", [])
    assert running.do("reset") == {"state": "ready", "cleared": []}
    running.do("arm")
    running.go(0.3).check_the_arm()


def test_reset_sends_nothing_to_a_controller_in_e_stop(running):
    running.play("estop", port="arm")
    running.go(0.3)
    running.written = b""
    running.ask("reset")
    running.go(0.3)
    assert b"R" not in running.written


def test_arm_needs_power(ready):
    ready.play("power_off", port="arm")
    ready.go(0.3)
    assert ready.state == "ready"
    assert "enable power" in ready.ask("arm").error


def test_a_controller_that_does_not_answer_arm_is_given_up_after_a_second(ready, monkeypatch):
    ready.go(0.003)  # between two ticks
    host, begun = type(ready.core.arm.host), ready.t
    monkeypatch.setattr(host, "request_tracking", lambda _: monkeypatch.setattr(host, "busy", True))
    assert ready.ask("arm", seconds=1.5).error == "arm refused: the controller does not answer"
    assert ready.t - begun == pytest.approx(1.0, abs=0.02)


def test_a_short_silence_of_the_arm_pauses_the_motion(running):
    running.play("mute", port="arm", for_s=0.11)
    running.messages.clear()
    running.go(0.3)
    states = [fields for topic, fields in running.messages if topic.name == "palm/state"]
    assert {(fields["state"], *fields["faults"]) for fields in states} == {("tracking",), ("tracking", "arm-late")}
    running.go(0.5)
    assert (running.state, running.faults) == ("tracking", [])
    assert running.core.setpoints.moving
    running.check_the_arm()


def test_a_lost_arm_link_is_a_fault_and_reset_brings_it_back(running):
    t = running.t
    running.play("mute", port="arm", for_s=1.0)
    running.go(0.4, lambda: running.state == "fault")
    assert 0.2 < running.t - t < 0.3
    assert "arm-link-lost" in running.faults
    assert "has not answered" in running.ask("reset").error
    running.go(1.5)
    assert running.state == "fault"
    assert "arm-fault" in running.faults  # the controller's own watchdog has expired
    running.do("reset")
    assert (running.state, running.faults) == ("ready", [])
    running.check_the_arm()


def test_an_arm_port_unplugged_is_a_fault(running):
    running.unplug("arm")
    running.go(0.02)
    assert (running.state, running.faults) == ("fault", ["arm-port"])
    running.plug("arm")
    running.go(0.5)
    running.do("reset")
    assert running.state == "ready"


def test_a_controller_that_has_stopped_following_is_a_fault(running):
    running.play("break", port="arm", for_s=0.1)
    running.go(0.4)
    assert running.state == "fault"
    running.do("reset")


# ---- defects


def test_an_observer_that_raises_stops_the_arm_in_good_order(running, caplog):
    running.observer.failing = True
    running.go(0.05)
    assert (running.state, running.faults) == ("fault", ["tick-error"])
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    running.go(0.5)
    assert running.last("palm/motion")["arm_state"] == "R"
    assert running.last("palm/estimate")["valid"] is False
    assert "unexpected error" in running.ask("reset").error
    running.observer.failing = False
    running.do("reset")
    assert running.state == "ready"


def test_a_stop_fault_before_the_first_arm_stays_a_fault_until_reset(ready):
    ready.observer.failing = True
    ready.go(0.05)
    ready.observer.failing = False
    ready.go(0.2)
    assert (ready.state, ready.faults) == ("fault", ["tick-error"])
    assert "must be ready" in ready.ask("arm").error
    ready.do("reset")
    assert (ready.state, ready.faults) == ("ready", [])


def test_a_valid_estimate_that_is_not_finite_is_not_published_as_valid(running):
    running.observer.valid, running.observer.value = True, math.nan
    running.go(0.05)
    assert (running.state, running.faults) == ("fault", ["estimate-not-finite"])
    assert running.last("palm/estimate")["valid"] is False


def test_a_failed_tick_stops_the_arm_at_once(running):
    running.core.fail(running.t, RuntimeError("broken"))
    assert running.state == "fault"
    running.written = running.core.transmit(running.t)
    assert running.written.startswith(b"P")
    running.world.receive("arm", running.written)
    running.go(0.5)
    assert running.last("palm/motion")["arm_state"] == "R"


def test_repeated_overruns_stop_and_a_single_one_does_not(running):
    running.core.overran(running.t, 0.02)
    running.go(0.05)
    assert (running.state, running.faults) == ("tracking", ["loop-overrun"])
    for _ in range(10):
        running.core.overran(running.t, 0.02)
    running.go(0.05)
    assert running.state == "fault"
    assert running.faults[0] == "loop-overruns"


# ---- the end


def test_closing_stops_and_waits_for_rest(running):
    assert not running.core.at_rest
    running.core.close()
    running.go(0.5, lambda: running.core.at_rest)
    assert running.last("palm/motion")["arm_state"] == "R"
    assert "palmd is stopping" in running.ask("arm").error


def test_closing_waits_for_an_arm_command_in_progress(ready):
    ready.core.handle(Request("arm", id=1), ready.t)
    ready.core.close()
    assert not ready.core.at_rest
    ready.go(0.5, lambda: ready.core.at_rest)
    ready.go(0.1)
    assert ready.last("palm/motion")["arm_state"] == "R"


def test_an_arm_that_does_not_answer_is_not_considered_at_rest(running):
    running.play("mute", port="arm")
    running.core.close()
    running.go(1.0)
    assert not running.core.at_rest


def test_an_arm_that_was_never_commanded_is_at_rest(ready):
    ready.core.close()
    assert ready.core.at_rest


# ---- what is published and measured


def test_every_message_matches_its_table_and_its_rate(running):
    stamp = {"v": 1, "timestamp": 0.0, "mono_ns": 0, "seq": 0}
    counts = {}
    for topic, fields in running.messages:
        assert validate(topic, fields | stamp) == []
        counts[topic.name] = counts.get(topic.name, 0) + 1
    ticks = running.steps // TICK_STEPS
    assert counts["palm/estimate"] == counts["palm/contact"] == counts["palm/motion"] == ticks
    assert ticks / 10 <= counts["palm/state"] <= ticks / 10 + 6


def test_each_tick_feeds_events_in_order_of_their_timestamps(running):
    assert sum(len(times) > 1 for times in running.observer.ticks) > 50
    assert all(times == sorted(times) for times in running.observer.ticks)


def test_readings_agree_with_the_truth(running):
    truth = running.world.truth()
    contact, motion = running.last("palm/contact"), running.last("palm/motion")
    assert contact["s1_m"] == pytest.approx(truth["s1_m"], abs=2e-3)
    assert contact["touch1"] is True
    assert contact["age1_ms"] < 50.0
    assert contact["arm_age_ms"] < 50.0
    assert motion["phi1_rad"] == pytest.approx(truth["phi1_rad"], abs=0.02)
    forces = [e.force for e in running.observer.events if isinstance(e, PadSample) and e.force]
    assert min(forces) > 0.0


def test_palm_angles_come_with_the_plans_rates_shifted_by_the_lag(running):
    running.go(2.0)
    assert 0.030 < running.core.arm.lag.lag_s < 0.060
    palms = [event for event in running.observer.events if isinstance(event, PalmSample)][-60:]
    for a, b, c in zip(palms, palms[1:], palms[2:], strict=False):
        slope = (c.angles[0] - a.angles[0]) / (c.t_sample - a.t_sample)
        assert b.rates[0] == pytest.approx(slope, abs=0.05)


def test_an_arm_at_rest_has_zero_rates(ready):
    palms = [event for event in ready.observer.events if isinstance(event, PalmSample)]
    assert (palms[-1].rates[0], palms[-1].accelerations[1]) == (0.0, 0.0)


def test_counters_are_reported_by_port(running):
    counters = running.core.counters()
    assert counters["pad1_packets"] > 50
    assert counters["pad1_bytes_discarded"] == 0
    assert counters["arm_crc_errors"] == 0
    assert counters["arm_setpoints"] > 50


def test_garbled_pads_are_reported_and_cause_no_other_fault(running):
    running.play("garble", port="pad1", strength=0.3)
    running.go(1.2)
    assert running.state in ("tracking", "hold")
    assert "pad1-garbled" in running.faults
    running.check_the_arm()


# ---- random sequences


@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(n, marks=pytest.mark.nightly) for n in range(3, 6))])
def test_no_sequence_of_events_sends_the_arm_a_bad_set_point(seed):
    random = Random(seed)
    bench = Bench(seed).go(0.5)
    for _ in range(25):
        match random.choice(("command", "inject", "inject", "plug", "stall", "fail")):
            case "command":
                name = random.choice(("arm", "start", "start", "hold", "stop", "reset", "jog"))
                step = random.uniform(-0.5, 0.5)
                bench.core.handle(Request(name, {"phi1_deg": step} if name == "jog" else {}), bench.t)
            case "inject":
                name = random.choice(list(INJECTABLE_FAULTS))
                bench.play(name, for_s=random.uniform(0.05, 0.3))
            case "plug":
                end = random.choice(ENDS)
                bench.unplug(end) if end in bench.open else bench.plug(end)
            case "stall":
                bench.stall(random.uniform(0.02, 0.4))
            case "fail":
                bench.core.fail(bench.t, RuntimeError("broken"))
        bench.go(random.uniform(0.05, 0.3))
        if random.random() < 0.7:  # a persistent operator
            bench.plug(*(set(ENDS) - bench.open))
            for name in ("reset", "arm", "start"):
                bench.core.handle(Request(name), bench.t)
                bench.go(0.1)
    bench.check_the_arm()
    assert bench.world.status()["setpoints"] > 50


# ---- the log


def test_the_log_records_who_sent_which_command_and_its_result(running):
    running.core.handle(Request("hold", who="ann"), running.t)
    running.go(0.5)
    running.core.handle(Request("jog", {"phi1_deg": -0.4, "whole_phi1_deg": -90.0}, who="bob"), running.t)
    entries = logged(running)
    assert entries[0].line.startswith("palmd: palmd ")
    assert [entry.line for entry in entries if entry.kind == "state"] == [
        "idle -> ready: all ports open and the arm has answered hello",
        "ready -> tracking: arm, by an unnamed client",
        "tracking -> hold: hold was requested, by ann",
    ]
    assert [(entry.name, entry.who) for entry in entries if entry.kind == "command"] == [
        ("arm", "an unnamed client"),
        ("start", "an unnamed client"),
        ("hold", "ann"),
        ("jog", "bob"),
    ]
    assert "jog refused" in entries[-1].text
    assert [entry.number for entry in entries] == list(range(len(entries)))


def test_a_jog_is_logged_once(ready):
    ready.do("arm")
    for _ in range(30):
        ready.do("jog", phi1_deg=0.1)
        ready.go(0.05)
    assert [entry.name for entry in logged(ready, "command")] == ["arm", "jog"]


def test_a_fault_of_one_tick_is_logged_with_its_cause(running):
    running.play("mute", port="pad1")
    running.go(0.5, lambda: running.state == "hold")
    running.world.fault_injector.cancel("mute", "pad1")
    running.go(0.3)
    assert running.faults == []
    came, went = logged(running, "fault")
    assert (came.name, came.severity) == ("pad1-silent", "hold")
    assert "the limit is" in came.text
    assert "not a byte has come since" in came.text
    assert went.lasted_s < 0.1
    assert [entry.text for entry in logged(running, "state")][
        -1
    ] == "tracking -> hold: pad 1 fell silent while the palms moved"


def test_the_status_contains_the_last_log_entries(running):
    status = running.do("status")
    entries = entries_of(status["log"])
    assert entries[-1].name == "start"
    assert 0.9 < status["t_s"] - entries[-1].t_s < 1.1


def test_the_log_has_a_bounded_length(running):
    for i in range(500):
        running.core.handle(Request("plan", {"path": f"{i}.yaml"}, who="x" * 100), running.t)
    running.core.replies()
    assert len(logged(running)) <= 100


def test_a_failed_tick_is_logged_with_its_error(running):
    running.core.fail(running.t, ZeroDivisionError("a defect"))
    (entry,) = logged(running, "fault")
    assert "ZeroDivisionError('a defect')" in entry.text
    assert logged(running, "state")[-1].text.startswith("tracking -> fault: an unexpected error in the control loop")


def test_a_pad_unplugged_between_two_ticks_brakes_the_next_set_point(running):
    running.unplug("pad1")
    assert running.state == "tracking"
    running.core.look(running.t)
    assert (running.state, running.core.setpoints.held) == ("hold", True)
    assert "pad1-port" in running.faults
    running.core.decide(running.t - 1e-3)  # the tick had begun before
    assert "pad1-port" in running.faults


def test_a_pad_that_falls_silent_between_two_ticks_brakes_the_next_set_point(running):
    late = running.t + 0.08
    running.core.look(late)
    assert (running.state, running.core.setpoints.held) == ("hold", True)
    running.core.observe(late)
    assert {type(event) for event in running.observer.events[-2:]} == {PadLift}


def test_a_silence_between_two_ticks_holds_with_its_cause_though_no_fault_remains(running):
    held = interrupted(running)
    assert (held["state"], held["faults"], held["requested_state"]) == ("hold", [], "")
    assert re.search(r"pad 1.* \(its last packet is .* old.*\)", held["cause"])
    operator = Operator()
    operator.take("palm/state", held)
    while (command := operator.decide(running.t)) is None:
        operator.take("palm/state", running.go(0.1).last("palm/state"))
    running.do(command)
    assert running.state == "tracking"


def interrupted(bench):
    """The state after a host that received no bytes for a moment has checked just before they came."""
    bench.steps += 8 * TICK_STEPS - 2
    bench.core.look(bench.t)
    return bench.go(2 * STEP_S).last("palm/state")


def test_a_requested_hold_or_stop_is_published_until_the_next_start_or_arm(running):
    def requested():
        return running.go(0.02).last("palm/state")["requested_state"]

    running.unplug("pad1")
    assert (running.go(0.02).state, requested()) == ("hold", "")
    running.do("hold")  # in the state hold already
    assert requested() == "hold"
    running.plug("pad1")
    running.go(0.3).do("start")
    assert requested() == ""
    running.do("stop")
    assert requested() == "stop"
    running.go(0.5).do("arm")
    assert requested() == ""


def test_the_check_between_two_ticks_runs_no_other_decision(running, monkeypatch):
    decided = []
    monkeypatch.setattr(running.core, "decide", decided.append)
    running.core.look(running.t)
    running.do("stop")
    running.unplug("pad1")
    running.core.look(running.t)
    assert not decided


def test_events_that_arrive_while_the_observer_works_wait_for_the_next_tick(running):
    core, begun = running.core, len(running.observer.events)
    core._events = [PadSample(running.t - 0.004 + n * 1e-3, 1, 0.02, 0.5) for n in range(3)]

    def between():
        core._events.append(PadSample(running.t, 2, 0.02, 0.5))
        return False

    core.observe(running.t, between)
    core.observe(running.t + 0.01)
    assert len(running.observer.events) == begun + 4


# ------------------------------------------------------------------------------------------------------ control


def sent(bench, name, client, lease_s=None, **args):
    """A client's command, and its answer."""
    request = Request(name, args, id=name, client=client, lease_s=lease_s, route=(client.encode(),))
    bench.core.handle(request, bench.t)
    answers = []

    def answered():
        answers.extend(bench.core.replies())
        return bool(answers)

    if not answered():
        bench.go(0.5, answered)
    return answers[0]


def swung(client, lease_s=None):
    """A bench whose palms a client has set in endless motion."""
    bench = Bench(spec=SWING.model_copy(update={"repeat": "forever"}))
    bench.go(5.0, lambda: bench.state == "ready")
    for name in ("arm", "start"):
        assert sent(bench, name, client, lease_s).error is None
    return bench.go(2.0, lambda: bench.core.setpoints.moving)


def test_after_an_operators_hold_no_other_client_moves_the_rig():
    bench = swung("a")
    rng = random.Random(5)
    for _ in range(4):
        bench.go(rng.uniform(0.1, 0.6))
        assert sent(bench, "hold", "a").error is None
        bench.go(rng.uniform(0.0, 0.8))
        for name, args in (
            ("start", {}),
            ("jog", {"phi1_deg": 0.1}),
            ("reset", {}),
            ("plan", {"path": "p", "text": "t"}),
        ):
            assert "a has control" in sent(bench, name, "b", **args).error
        assert bench.state == "hold"
        assert not bench.core.setpoints.moving
        bench.go(0.02)
        assert bench.last("palm/state")["control"] == "a"
        assert sent(bench, "start", "a").error is None
    assert sent(bench, "hold", "b").error is None
    assert "b has control" in sent(bench, "start", "a").error
    assert sent(bench, "start", "a", take=True).error is None
    taken = [entry for entry in bench.core.journal.entries if entry.kind == "control"]
    assert [(entry.name, "took control from b" in entry.text) for entry in taken] == [("taken", True)]


def test_an_expired_lease_holds_the_motion():
    bench, rng, worst = swung("a", 1.0), random.Random(6), 0.0
    for _ in range(4):
        for _ in range(rng.randrange(4)):
            bench.go(rng.uniform(0.1, 0.7))
            assert sent(bench, "alive", "a").error is None
        assert bench.core.setpoints.moving
        assert not bench.last("palm/state")["unattended"]
        t = bench.t
        bench.go(1.5, lambda: bench.state == "hold")
        worst = max(worst, bench.t - t)
        bench.go(0.05)
        assert bench.faults == ["operator-lost"]
        assert bench.last("palm/state")["control"] == ""
        assert sent(bench, "start", "a", 1.0).error is None
        bench.go(0.2)
    assert worst <= 1.02
    bench.check_the_arm()


def test_motion_without_a_declared_lease_continues_and_is_published_as_unattended():
    bench = swung("a")
    bench.go(6.0)
    state = bench.last("palm/state")
    assert (state["control"], state["unattended"], state["state"]) == ("", True, "tracking")
    assert sent(bench, "alive", "b", 5.0, take=True).error is None  # attended from now on
    bench.go(0.1)
    state = bench.last("palm/state")
    assert (state["control"], state["unattended"]) == ("b", False)
    bench.go(6.0, lambda: bench.state == "hold")


def test_a_refused_command_gives_no_control():
    bench = Bench(spec=SWING)
    bench.go(5.0, lambda: bench.state == "ready")
    assert sent(bench, "start", "a").error is not None
    assert sent(bench, "plan", "a", path="p", text="no plan").error is not None
    assert sent(bench, "arm", "b").error is None
