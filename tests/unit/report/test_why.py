"""`palmd why`: faults injected into the daemon's real core, without ports, are explained from the recording alone."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from plans import SHORT, SWING
from recorded import config as recorded_config
from wireless_recorder import WirelessRecorder

from palmd.cli import main
from palmd.config.pivot import PivotPlanSpec
from palmd.config.three_palms import TiltPlanSpec
from palmd.console.shipped import shipped
from palmd.daemon.commands import Request
from palmd.record.run import RunError, read_any_run, read_run
from palmd.report.timeline import timeline_of
from palmd.report.why import answer, explain, lines
from palmd.rig.emulated import STEP_S
from palmd.rig.fault_injection import order
from palmd.rig.world import default_config
from palmd.yamlfile import load_any_config, load_config, parse, read_document
from tools.closed_loop import PivotLoop, ThreePalmsLoop, TwoPalmsLoop
from tools.studies.stub_observers import EmptyObserver

TABLETOP = Path(__file__).parents[3] / "config/tabletop.yaml"


class Silent(EmptyObserver):
    name, object_count, late_dropped = "silent", 0, 0


def recorded_in(folder, config):
    return config.model_copy(update={"record": config.record.model_copy(update={"directory": folder})})


class Recorded:
    """A rig whose every tick is recorded, with the counters that the loop adds once a second."""

    def __init__(self, config, *rest, **others):
        super().__init__(config, *rest, **others)
        self.recorder = WirelessRecorder(config)
        self.ticks = 0

    def tick(self):
        instant = super().tick()
        self.recorder.take(instant)
        if self.ticks % 100 == 0:
            counts = self.core.counters()
            self.recorder.publish("palm/loop", counts | {"arm_port_bytes_read": counts["arm_bytes"]}, self.t)
        self.ticks += 1
        return instant

    def go(self, seconds):
        t_end = self.t + seconds
        while self.t < t_end - STEP_S / 2:
            self.tick()

    def play(self, name, port=None, strength=None):
        self.world.fault_injector.add(order(name, self.t, port, strength))

    def give(self, name, who=""):
        self.core.handle(Request(name, who=who), self.t)

    def stall(self, seconds):
        """The daemon gets no processor for a while."""
        self._steps += round(seconds / STEP_S)
        for end, data in self.world.advance(self.t).items():
            if data:
                self.core.receive(end, data, self.t)
        self.core.overran(self.t, seconds)

    def starve(self, seconds, says=True):
        """The emulated rig gets no processor for a while and reports it afterwards; the daemon continues."""
        t_end = self.t + seconds
        while self.t < t_end - STEP_S / 2:
            self._steps += self._steps_per_tick
            for topic, fields in self.core.step(self.t):
                self.recorder.publish(topic.name, fields, self.t)
        for end, data in self.world.advance(self.t).items():
            if data:
                self.core.receive(end, data, self.t)
        if says:
            self.recorder.publish("rig/stall", {"t_s": self.t, "lasted_s": seconds, "count": 1}, self.t)


class Rig(Recorded, TwoPalmsLoop):
    """Two palms without an observer."""

    def __init__(self, folder, spec=SWING, config=None):
        super().__init__(recorded_in(folder, config or default_config()), spec, 3, estimator=Silent())


class RigInSpace(Recorded, ThreePalmsLoop):
    """Three palms in space."""

    def __init__(self, folder):
        config = load_any_config(shipped("three_palms.yaml"))
        super().__init__(recorded_in(folder, config), parse(read_document(config.plan), TiltPlanSpec), 3)


class PivotingRig(Recorded, PivotLoop):
    """A pivoting grasp whose smoother is never asked."""

    def __init__(self, folder):
        config = load_any_config(shipped("pivot.yaml"))
        spec = parse(read_document(config.plan), PivotPlanSpec)
        super().__init__(recorded_in(folder, config), spec, 3, period_s=math.inf)


def run_of(folder, act, seconds=1.0, spec=SWING, config=None):
    """The recording of a swinging rig to which something is done after a second, and the time of that (s)."""
    rig = Rig(folder, spec, config)
    rig.start()
    rig.go(1.0)
    t = rig.t
    act(rig)
    rig.go(seconds)
    return read_run(rig.recorder.finish()), t


PROVOKED = {
    "pad1-mute": lambda rig: rig.play("mute", "pad1"),
    "pad2-foreign": lambda rig: rig.play("misbaud", "pad2"),
    "pad2-port": lambda rig: rig.core.lost("pad2", rig.t),
    "lifted": lambda rig: rig.play("lift"),
    "arm-mute": lambda rig: rig.play("mute", "arm"),
    "arm-foreign": lambda rig: rig.play("misbaud", "arm"),
    "arm-damaged": lambda rig: rig.play("garble", "arm", 0.2),
    "arm-late": lambda rig: rig.play("late", "arm", 0.12),
    "arm-estop": lambda rig: rig.play("estop", "arm"),
    "stalled": lambda rig: rig.stall(0.3),
    "rig-stalled": lambda rig: rig.starve(0.15),
    "failed": lambda rig: rig.core.fail(rig.t, ZeroDivisionError("a defect")),
    "command": lambda rig: rig.give("hold", "ann"),
    "nothing": lambda _rig: None,
}
LATER_S = {"arm-late": 0.2}
WITHOUT_LOG = {"arm-foreign": "arm-mute"}  # a few bytes are lost among the good ones of that second


@pytest.mark.parametrize("name", PROVOKED)
def test_the_cause_is_found_with_its_evidence_with_and_without_a_log(name, tmp_path):
    run, t = run_of(tmp_path, PROVOKED[name])
    timeline = timeline_of(run)
    older = tuple(replace(entry, code="") for entry in timeline.log)  # as in recordings made before entries had codes
    for each in (timeline, replace(timeline, log=()), replace(timeline, log=older)):
        explanation = answer(run, each, t + LATER_S.get(name, 0.5))
        wanted = {name} if each is timeline else {name, WITHOUT_LOG.get(name)}
        assert explanation.cause.name in wanted, "\n".join(lines(explanation))
        assert explanation.cause.evidence or name == "nothing"
        text = "\n".join(lines(explanation))
        assert "nan" not in text
        assert "inf" not in text


OTHERS = {
    "space-mute": (RigInSpace, lambda rig: rig.play("mute", "pad2"), "pad2-mute", "palm3/events"),
    "space-lifted": (RigInSpace, lambda rig: rig.play("lift"), "lifted", "palm3/events"),
    "space-failed": (RigInSpace, lambda rig: rig.core.fail(rig.t, ZeroDivisionError()), "failed", "palm/log"),
    "pivot-stalled": (PivotingRig, lambda rig: rig.stall(0.3), "stalled", "palm/pivot_motion"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_causes_are_found_on_other_systems(name, tmp_path):
    make, act, cause, where = OTHERS[name]
    rig = make(tmp_path)
    rig.start()
    rig.go(0.5)
    t = rig.t
    act(rig)
    rig.go(0.7)
    explanation = explain(read_any_run(rig.recorder.finish()), t + 0.5)
    assert explanation.cause.name == cause, "\n".join(lines(explanation))
    assert where in {each.where for each in explanation.cause.evidence}


SERVOS = {
    "mute": (lambda rig: rig.play("mute", "arm"), "arm-mute"),
    "misbaud": (lambda rig: rig.play("misbaud", "arm"), "arm-mute"),  # no servo answers what it cannot decode
    "garble": (lambda rig: rig.play("garble", "arm", 0.02), "arm-damaged"),
    "overheat": (lambda rig: rig.play("overheat", "arm"), "arm-servo"),
    "held up": (lambda rig: rig.starve(0.13, says=False), "arm-watchdog"),
}


@pytest.mark.parametrize("provoked", SERVOS)
def test_the_cause_is_found_on_a_rig_of_servos(provoked, tmp_path):
    act, name = SERVOS[provoked]
    run, t = run_of(tmp_path, act, config=load_config(TABLETOP))
    explanation = explain(run, t + 0.5 - timeline_of(run).begin)
    assert explanation.cause.name == name, "\n".join(lines(explanation))
    assert explanation.cause.evidence


def test_a_break_is_identified_by_the_controllers_error_code(tmp_path):
    run, t = run_of(tmp_path, lambda rig: rig.play("break", "arm"))
    explanation = explain(run, t + 0.5 - timeline_of(run).begin)
    assert explanation.cause.name == "arm-break"
    assert any("-0504" in clue.what for clue in explanation.cause.evidence)


def test_the_explanation_names_the_age_and_its_limit(tmp_path):
    run, _ = run_of(tmp_path, PROVOKED["pad1-mute"])
    explanation = explain(run)
    (reading,) = (clue.what for clue in explanation.cause.evidence if clue.where == "palm/events")
    assert "the limit is 5 intervals" in reading
    (logged,) = (clue.what for clue in explanation.cause.evidence if clue.where == "palm/log")
    assert "not a byte has come since" in logged
    assert explanation.standing[0][0] == "pad1-silent"
    assert "pad's cable" in explanation.hint


def test_the_client_that_held_the_rig_is_named_if_there_is_a_log(tmp_path):
    run, _ = run_of(tmp_path, PROVOKED["command"])
    assert "hold was requested, by ann" in explain(run).cause.sentence
    timeline = timeline_of(run)
    assert "a client sent the command hold" in answer(run, replace(timeline, log=()), None).cause.sentence


def test_a_transient_fault_is_explained_after_it_has_ended(tmp_path):
    def blink(rig):
        rig.play("mute", "pad1")
        while rig.core.state != "hold":
            rig.tick()
        rig.world.fault_injector.cancel("mute", "pad1")

    run, _ = run_of(tmp_path, blink)
    explanation = explain(run)
    ((code, seconds),) = explanation.standing
    assert (explanation.cause.name, code) == ("pad1-mute", "pad1-silent")
    assert seconds < 0.1


def test_a_fault_between_two_messages_is_found_in_the_log(tmp_path):
    def wink(rig):
        rig._steps += 8 * rig._steps_per_tick - 2
        rig.core.look(rig.t)
        rig._step()

    run, _ = run_of(tmp_path, wink)
    assert not any(state.with_severity("hold", "stop") for state in timeline_of(run).states)
    explanation = explain(run)
    assert (explanation.state, [code for code, _ in explanation.standing]) == ("hold", ["pad1-silent", "pad2-silent"])
    assert explanation.cause.kind not in ("command", "ended")
    assert "cable" in explanation.hint


def test_a_hold_that_has_ended_can_be_explained_by_its_time(tmp_path):
    def hold_and_go_on(rig):
        rig.give("hold", "ann")
        rig.go(0.5)
        rig.give("start", "ann")

    run, t = run_of(tmp_path, hold_and_go_on, seconds=1.2)
    begin = timeline_of(run).begin
    assert explain(run, t + 0.3 - begin).cause.name == "command"
    later = explain(run, t + 1.5 - begin)
    assert later.cause.name == "nothing"
    assert len(later.others) == 1
    assert explain(run, 0.01).cause.name == "before"


def test_the_end_of_a_plan_and_a_requested_end_are_causes(tmp_path):
    run, t = run_of(tmp_path, lambda _rig: None, seconds=1.7, spec=SHORT)
    begin = timeline_of(run).begin
    assert "is complete" in explain(run, t + 1.6 - begin).cause.sentence
    run, _ = run_of(tmp_path / "ended", lambda rig: rig.core.close())
    assert explain(run).cause.name == "ended"
    with pytest.raises(RunError, match=r"no data at 60\.00 s: the run ends after .* in state ready"):
        explain(run, 60.0)


def test_a_daemon_that_died_differs_from_a_truncated_recording(tmp_path):
    rig = Rig(tmp_path)
    rig.start()
    rig.go(2.0)
    rig.recorder._recording.flush(0.0)
    cut = next(tmp_path.glob("*.mcap"))
    assert explain(read_run(cut), 60.0).cause.name == "cut"
    assert explain(read_run(rig.recorder.finish()), 60.0).cause.name == "died"


def test_a_later_time_is_explained_from_the_next_file(tmp_path):
    rig = Rig(tmp_path)
    rig.start()
    rig.go(1.0)
    rig.recorder._recording.finish()
    t = rig.t
    rig.play("mute", "pad1")
    rig.go(1.0)
    rig.recorder.finish()
    first, second = map(read_run, sorted(tmp_path.glob("*.mcap")))
    explanation = explain(first, t + 0.5 - timeline_of(first).begin)
    assert (explanation.recording, explanation.cause.name) == (second.path.name, "pad1-mute")
    explanation = explain(first)
    assert (explanation.recording, explanation.cause.name) == (first.path.name, "goes-on")
    assert second.path.name in explanation.cause.sentence


def test_the_command_prints_text_or_json(tmp_path, capsys):
    run, _ = run_of(tmp_path, PROVOKED["pad1-mute"])
    assert main(["why", str(run.path)]) == 0
    said = capsys.readouterr().out
    assert "the motion was held" in said
    assert "why       pad 1 sent no more data" in said
    assert main(["why", str(run.path), "--json"]) == 0
    explanation = json.loads(capsys.readouterr().out)
    assert explanation["cause"]["name"] == "pad1-mute"
    assert explanation["until"] is None


@pytest.mark.parametrize("t", ["-1", "nan", "soon"])
def test_an_invalid_time_is_a_usage_error(t, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["why", "x.mcap", f"--at={t}"])
    assert ended.value.code == 2
    assert "--at" in capsys.readouterr().err


def test_a_run_without_states_is_an_error(tmp_path):
    recorder = WirelessRecorder(recorded_config(tmp_path))
    recorder.publish("palm/contact", {"s1_m": math.nan}, 0.0)
    with pytest.raises(RunError, match="holds no palm/state"):
        explain(read_run(recorder.finish()))
