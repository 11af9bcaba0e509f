"""For every injected fault the daemon reacts as its fault table says, and the arm stays safe."""

import signal
from dataclasses import dataclass

import pytest
from harness import LEAST_WORK

from palmd.faults import TABLE
from palmd.rig.fault_injection import INJECTABLE_FAULTS

pytestmark = pytest.mark.rig

PADS, ARM, OBJECT = ("pad1", "pad2"), ("arm",), (None,)
GRAVE = ("hold", "stop")
SILENCES = 8


@dataclass(frozen=True)
class Case:
    """A fault on ports, the expected faults, and other severe ones that may occur."""

    name: str
    ports: tuple
    expected: tuple = ()
    may: tuple = ()
    strength: float | None = None

    @property
    def state(self):
        """The state that the most severe expected fault leads to."""
        severities = {str(TABLE[code].severity) for code in self.expected}
        return "fault" if "stop" in severities else "hold" if "hold" in severities else "tracking"

    def __str__(self):
        return "-".join(filter(None, (self.name, *self.ports, self.strength and f"{self.strength:g}")))


def both(*kinds):
    """These kinds of faults for both pads."""
    return tuple(f"pad{i}-{kind}" for i in (1, 2) for kind in kinds)


CASES = (
    # a pad's line: noise degrades, silence holds
    Case("garble", PADS, both("garbled"), strength=0.2, may=both("silent", "lifted")),
    Case("drop", PADS, both("garbled"), strength=0.15, may=both("silent")),
    Case("misbaud", PADS, both("silent", "garbled")),
    Case("mute", PADS, both("silent")),
    Case("unplug", PADS, both("port")),
    Case("late", PADS, both("silent"), strength=0.2),
    Case("burst", PADS, both("batched")),
    # the object on the pads
    Case("saturate", PADS, ("force-limit",)),
    Case("touch", PADS),
    Case("lift", OBJECT, both("lifted")),
    Case("swap", OBJECT, both("lifted")),
    # the arm's line: a few errors degrade, silence stops
    Case("garble", ARM, ("arm-garbled",), strength=0.006),
    Case("drop", ARM, ("arm-garbled",), strength=0.006),
    Case("garble", ARM, ("arm-link-lost",), strength=0.2, may=("arm-fault",)),
    Case("drop", ARM, ("arm-link-lost",), strength=0.2, may=("arm-fault",)),
    Case("misbaud", ARM, ("arm-late", "arm-link-lost"), may=("arm-fault",)),
    Case("mute", ARM, ("arm-late", "arm-link-lost"), may=("arm-fault",)),
    Case("unplug", ARM, ("arm-port",), may=("arm-fault", "arm-link-lost")),
    Case("late", ARM, ("arm-late",), strength=0.12),
    Case("burst", ARM, ("arm-late",), strength=0.12),
    # the controller
    Case("break", ARM, ("arm-fault",), may=("arm-left-tracking",)),
    Case("estop", ARM, ("arm-estop",)),
    Case("power_off", ARM, ("arm-power-off",)),
    Case("manual", ARM, ("arm-manual",)),
    # an arm that does not move as commanded, or does not report its motion
    Case("block", ARM, ("following-error",)),
    Case("freeze", ARM, ("following-error",)),
    Case("jump", ARM, ("pose-implausible",), may=("following-error",)),
)


def test_every_injection_is_tested():
    assert {case.name for case in CASES} == INJECTABLE_FAULTS.keys()
    assert {(case.name, port) for case in CASES for port in case.ports if port} == {
        (trick.name, port) for trick in INJECTABLE_FAULTS.values() for port in trick.ports
    }


@pytest.fixture(autouse=True)
def _nothing_stays_injected(request):
    """A test that fails in the midst of a fault must not leave it to those that follow on the same bench."""
    yield
    if "bench" in request.fixturenames:
        bench = request.getfixturevalue("bench")
        for injected in bench.rig_status()["injected_faults"]:
            bench.ask_rig("clear", name=injected.partition("@")[0])


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_daemon_reacts_as_the_table_says(bench, case):
    bench.run_plan()
    bench.forget()
    for port in case.ports:
        bench.ask_rig("inject", name=case.name, port=port, strength=case.strength)
    bench.until_faults(*case.expected)
    if case.state != "tracking":
        bench.until_state(case.state)
    bench.ticks(20)  # estimates are still published
    assert bench.heard.faults.items() >= {code: str(TABLE[code].severity) for code in case.expected}.items()
    grave = {code for code, severity in bench.heard.faults.items() if severity in GRAVE}
    assert grave <= {*case.expected, *case.may} or bench.stalled()

    bench.ask_rig("clear", name=case.name)
    passing = [code for code in case.expected if TABLE[code].latch == "no"]
    bench.until_gone(*passing, *both("untouched"))
    if bench.heard.state == "fault":
        assert_rest_until_reset(bench, [code for code in case.expected if code not in passing])
    elif bench.heard.state == "hold":
        assert_rest_until_start(bench)
    bench.moving()
    bench.judge()


def assert_rest_until_reset(bench, latched):
    before = bench.rig_status()
    bench.ticks(20)
    assert bench.heard.state == "fault"
    assert bench.heard.active >= set(latched)
    refused = bench.client.ask("arm")
    assert not refused["ok"]
    assert "it must be ready" in refused["error"]
    after = bench.rig_status()
    assert after["arm_state"] not in ("T", "H")
    assert (after["starts"], after["resets"], after["accepted"]) == tuple(
        before[what] for what in ("starts", "resets", "accepted")
    )
    bench.at_rest()
    bench.run_plan()


def assert_rest_until_start(bench):
    bench.at_rest()
    bench.ticks(20)
    assert (bench.heard.state, bench.rig_status()["arm_state"]) == ("hold", "T")
    bench.client.do("start")


@pytest.mark.parametrize(("port", "code", "promised_s"), [("pad1", "pad1-silent", 0.1), ("arm", "arm-link-lost", 0.25)])
def test_silence_is_detected_in_time(bench, port, code, promised_s):
    bench.run_plan()
    bench.forget()
    before = bench.truth()["mono_ns"] * 1e-9
    bench.ask_rig("inject", name="mute", port=port, for_s=0.5)
    bench.until_faults(code)
    assert bench.heard.since[code] - before < 3 * promised_s
    bench.until_gone(code) if port != "arm" else bench.ready()


def test_motion_resumes_smoothly_after_a_short_silence_of_the_arm(bench):
    """The controller holds after 48 ms; set-points start again at its pose and return to the path."""
    bench.run_plan()
    bench.forget()
    for _ in range(SILENCES):
        bench.ask_rig("inject", name="mute", port="arm", for_s=0.09)
        bench.ticks(40)
        bench.moving()
    assert bench.heard.faults.get("arm-held") == "degrade"
    assert bench.heard.states == ["tracking"] or bench.stalled()
    bench.judge()


def test_motion_may_continue_while_a_pad_is_constantly_late(bench):
    """Only the change of the delay leaves a gap in the pad's data; a constant delay does not hold the motion."""
    bench.run_plan()
    bench.ask_rig("inject", name="late", port="pad1", strength=0.2)
    bench.until_state("hold")
    bench.until_gone("pad1-silent")
    bench.client.do("start")
    bench.moving()
    bench.ask_rig("clear", name="late")


def test_an_emergency_stop_cannot_be_reset_by_a_client(bench):
    bench.run_plan()
    bench.ask_rig("inject", name="estop")
    bench.until_state("fault")
    refused = bench.client.ask("reset")
    assert (refused["ok"], "release it at the arm" in refused["error"]) == (False, True)
    status = bench.client.do("status")
    assert (status["state"], status["arm_state"]) == ("fault", "X")
    assert "-621" in status["arm_error"] or "emergency" in status["arm_error"].lower()
    assert (bench.rig_status()["arm_state"], bench.heard.state) == ("X", "fault")
    bench.ask_rig("clear", name="estop")
    bench.ready()
    bench.judge()


def test_exchanging_the_object_begins_a_new_one(bench):
    bench.run_plan()
    before = bench.heard.latest["palm/estimate"]["object"]
    bench.ask_rig("inject", name="swap")
    bench.until_state("hold")
    bench.until(lambda heard: heard.latest["palm/estimate"]["object"] > before, "a new object")


def test_a_daemon_stopped_for_a_second_does_not_compensate_for_it(bench):
    bench.run_plan()
    bench.forget()
    overruns = bench.heard.latest["palm/loop"]["overruns"]
    bench.daemon.send(signal.SIGSTOP)
    before = bench.until_rig(lambda status: status["arm_state"] == "F", "the controller's fault")
    bench.daemon.send(signal.SIGCONT)
    bench.until_state("fault")
    bench.until(lambda heard: heard.latest["palm/loop"]["overruns"] > overruns, "overruns counted")
    after = bench.judge()
    assert after["arm_state"] == "F"
    assert after["setpoints"] - before["setpoints"] <= 2
    bench.run_plan()
    bench.judge()


def test_after_a_killed_daemon_the_arm_holds_and_the_next_daemon_moves_nothing(light_bench):
    bench = light_bench
    bench.run_plan()
    assert bench.daemon.end(signal.SIGKILL) == -signal.SIGKILL
    before = bench.until_rig(lambda status: status["arm_state"] == "F", "the controller's fault")
    stood = bench.at_rest()
    bench.start_daemon(plan=None, **LEAST_WORK)
    bench.until_state("ready", "fault")
    bench.until_faults("arm-fault")
    bench.ticks(100)
    assert bench.heard.states[-1] in ("ready", "fault")
    assert set(bench.heard.states) <= {"idle", "ready", "fault"}
    assert not bench.client.ask("arm")["ok"]
    now, after = bench.truth(), bench.judge()
    assert after["arm_state"] == "F"
    assert {what: after[what] - before[what] for what in ("starts", "resets", "setpoints")} == {
        "starts": 0, "resets": 0, "setpoints": 0,
    }  # fmt: skip
    assert max(abs(now[phi] - stood[phi]) for phi in ("phi1_rad", "phi2_rad")) < 1e-3
    bench.client.do("reset")
    bench.client.do("arm")
    assert bench.until_rig(lambda status: status["arm_state"] == "T", "tracking")["resets"] == before["resets"] + 1


def test_a_terminated_daemon_stops_the_arm(light_bench):
    bench = light_bench
    bench.run_plan()
    t = bench.truth()["mono_ns"]
    assert bench.daemon.end(signal.SIGTERM) == 0
    truth = bench.truth()
    assert (truth["mono_ns"] - t) * 1e-9 < 2 * 2.0
    assert truth["arm_state"] == "R"
    bench.at_rest()
    bench.judge()

    bench.start_daemon(**LEAST_WORK)
    bench.run_plan()
    bench.ask_rig("inject", name="mute", port="arm")
    t = bench.truth()["mono_ns"]
    assert bench.daemon.end(signal.SIGTERM) == 3  # the arm's standstill is not confirmed
    assert (bench.truth()["mono_ns"] - t) * 1e-9 < 2 * 2.0
    bench.until_rig(lambda status: status["arm_state"] == "F", "the controller's fault")
    bench.judge()


def test_a_rig_that_restarts_is_connected_again(light_bench):
    bench = light_bench
    bench.run_plan()
    bench.forget()
    bench.rig.stop()
    bench.until_faults("pad1-port", "pad2-port", "arm-port")
    bench.until_state("fault")
    bench.ticks(100)
    for name, path in bench.ports.items():
        assert f"{name}: " in bench.daemon.all_said
        assert str(path) in bench.daemon.all_said
    assert bench.client.do("status")["arm_linked"] is False
    bench.start_rig()
    bench.until_gone("pad1-port", "pad2-port")
    bench.until(lambda _: bench.motion["arm_state"] == "R", "the arm's answer")
    status = bench.judge()
    assert (bench.heard.state, status["starts"], status["resets"]) == ("fault", 0, 0)
    bench.run_plan()
    bench.judge()
