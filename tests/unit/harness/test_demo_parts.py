"""The parts of `palmd demo`: operator, comparison with the truth, punctuality, addresses, configuration."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import zmq

from palmd.bus.subscriber import Message
from palmd.cli import demo
from palmd.config.any_config import BusConfig
from palmd.console.shipped import shipped
from palmd.harness.comparison import Comparison, Punctuality
from palmd.harness.operator import AGAIN_S, CALM_S, Operator
from palmd.harness.stack import as_yaml, free_addresses
from palmd.motion.check import check_files
from palmd.yamlfile import load_any_config, load_config

# -------------------------------------------------------------------------------------------------- the operator


def looks(operator, state, severities=(), segment=-1, since=0.0, until=3.0, requested=""):
    """The commands that it gives in this situation, with their times."""
    given = []
    for i in range(round((until - since) / 0.1)):
        t = since + 0.1 * i
        operator.take("palm/state", {"state": state, "severities": list(severities), "requested_state": requested})
        operator.take("palm/motion", {"segment": segment})
        command = operator.decide(t)
        if command:
            given.append((round(t, 1), command))
    return given


def test_the_operator_arms_and_starts():
    operator = Operator()
    assert looks(operator, "ready", until=0.5) == [(0.0, "arm")]
    assert looks(operator, "tracking", since=0.5, until=1.2) == [(1.0, "start")]
    assert looks(operator, "tracking", segment=0, since=1.2) == []


def test_the_operator_repeats_a_command_after_a_pause():
    assert [t for t, _ in looks(Operator(), "ready")] == pytest.approx([0.0, AGAIN_S, 2 * AGAIN_S])


def test_after_a_hold_the_operator_waits_until_faults_have_ended():
    operator = Operator()
    assert looks(operator, "hold", ["hold", "note"], segment=1, until=2.0) == []
    assert looks(operator, "hold", ["note", "degrade"], segment=1, since=2.0, until=2.9) == [(2.0 + CALM_S, "start")]


def test_the_operator_resets_a_fault_and_gives_a_broken_rig_no_command():
    assert looks(Operator(), "fault", ["stop"], until=1.0) == [(CALM_S, "reset")]
    for state, severities in (("idle", ()), ("ready", ["stop"]), (None, ())):
        assert looks(Operator(), state, severities) == []
    assert Operator().decide(0.0) is None


def seen(operator, *states, requested=""):
    for state, *severities in states:
        operator.take("palm/state", {"state": state, "severities": severities, "requested_state": requested})


@pytest.mark.parametrize(("requested", "state"), [("hold", "hold"), ("stop", "ready")])
def test_a_requested_hold_or_stop_is_respected_until_the_palms_move_again(requested, state):
    operator = Operator()
    seen(operator, ("ready",), ("tracking",))
    assert looks(operator, state, segment=-1 if state == "ready" else 0, requested=requested) == []
    seen(operator, ("tracking",))
    assert looks(operator, "tracking", segment=-1) == []  # armed by another client, which has not started yet
    assert looks(operator, "tracking", segment=0, until=0.2) == []
    assert [command for _, command in looks(operator, "tracking", segment=-1, since=0.2, until=1.0)] == ["start"]


@pytest.mark.parametrize("severity", ["hold", "stop"])
def test_the_operator_continues_after_a_hold_or_stop_caused_by_a_fault(severity):
    operator = Operator()
    seen(operator, ("tracking",), ("hold", "note", severity), ("hold",))
    assert looks(operator, "hold", segment=0, until=1.0) == [(CALM_S, "start")]
    operator = Operator()
    seen(operator, ("tracking",), ("fault", "stop"), ("ready",))
    assert looks(operator, "ready", until=0.5) == [(0.0, "arm")]


@pytest.mark.parametrize("requested", ["hold", "stop"])
@pytest.mark.parametrize("state", ["hold", "fault", "ready"])
def test_a_requested_state_is_respected_even_after_a_fault(state, requested):
    operator = Operator()
    seen(operator, ("tracking",), (state, "hold"))
    assert looks(operator, state, segment=0, requested=requested) == []


class LateBus:
    """A daemon that obeys at once and a bus that delivers its messages `late_s` later, as the demo's processes."""

    def __init__(self, late_s):
        self.t, self._late_s, self.state, self.segment, self.requested = 100.0, late_s, "ready", -1, ""
        self.asked, self._published = [], []
        self.subscriber = self.client = self

    def until(self, t_end):
        while self.t < t_end:
            self.t += 0.01
            self._published.append(
                (self.t, "palm/state", {"state": self.state, "severities": [], "requested_state": self.requested})
            )
            self._published.append((self.t, "palm/motion", {"segment": self.segment}))
            while self._published and self._published[0][0] <= self.t - self._late_s:
                _, topic, fields = self._published.pop(0)
                yield Message(topic, fields, self.t)

    def ask(self, command, _args=None):
        status = {
            "state": self.state,
            "severities": [],
            "segment": self.segment,
            "requested_state": self.requested,
            "control": "",
        }
        if command == "status":
            return {"ok": True, "result": status}
        self.asked.append(command)
        may = {"arm": self.state == "ready", "start": self.state in ("tracking", "hold")}[command]
        if may:
            self.state, self.segment, self.requested = "tracking", 0 if command == "start" else -1, ""
        return {"ok": may, "error": f"the state is {self.state}"}

    def check_alive(self, *_):
        pass


@pytest.mark.parametrize("late_s", [0.0, 3.5])
def test_a_demo_with_a_delayed_bus_repeats_no_completed_command(monkeypatch, late_s):
    bus = LateBus(late_s)
    monkeypatch.setattr(demo.time, "monotonic", lambda: bus.t)
    compared = SimpleNamespace(t_started=None, take=lambda _: None, progress=lambda _: "")
    compared.started = lambda t: setattr(compared, "t_started", t)
    demo._operate(bus, compared, SimpleNamespace(made=False), 6.0)
    assert bus.asked == ["arm", "start"]


def test_a_demo_with_a_delayed_bus_respects_a_hold_requested_meanwhile(monkeypatch):
    bus = LateBus(3.5)
    monkeypatch.setattr(demo.time, "monotonic", lambda: bus.t)
    bus.state, bus.segment = "hold", 0  # by a fault that has ended
    compared = SimpleNamespace(t_started=100.0, take=lambda _: None, progress=lambda _: "")
    for _ in bus.until(103.0):
        pass
    bus.requested = "hold"
    demo._operate(bus, compared, SimpleNamespace(made=False), 12.0)
    assert bus.asked == []


# --------------------------------------------------------------------------------------------- the comparison

THETA = np.arange(360) * (math.tau / 360)
TRUE_H = 0.02 + 1e-3 * np.cos(2 * THETA) + 5e-4 * np.sin(3 * THETA)


def feed(comparison, topic, t=0.0, **fields):
    comparison.take(Message(topic, {"mono_ns": round(t * 1e9), **fields}, t))


def run_for(comparison, seconds, settles=0.0, begin=100.0, error=0.0):
    """A run from `begin`: truth every 10 ms, estimates in between, valid after `settles`, r1 wrong by `error`."""
    feed(comparison, "rig/object", begin, h_m=TRUE_H.tolist(), rho_m=0.014, mass_kg=0.1, mu=0.12)
    comparison.started(begin)
    for k in range(round(seconds * 100)):
        t = begin + 0.01 * k
        r = 0.02 + 1e-3 * (t - begin)
        feed(comparison, "rig/truth", t, r1_m=r, r2_m=0.02, omega0_rad_s=0.5)
        t += 0.004
        feed(
            comparison, "palm/estimate", t, valid=t - begin > settles, observer="shape", r1_m=r + 4e-6 + error,
            r2_m=0.02, omega0_rad_s=0.6, rho_m=0.0154, mass_kg=0.099, mu=0.11,
        )  # fmt: skip
    touched = [int(theta < 1.0) for theta in THETA]
    h = np.roll(TRUE_H, 40)
    h[200] += 3e-4  # at an untouched normal
    shape = {"theta_rad": THETA.tolist(), "h_m": h.tolist(), "touched": touched, "h_sd_m": [*[4e-5] * 359, 8e-5]}
    feed(comparison, "palm/shape", **shape)


def test_a_stall_of_the_emulated_rig_is_shown_once_and_in_the_summary():
    comparison = Comparison(7, "perfect")
    run_for(comparison, 2.0)
    feed(comparison, "rig/stall", 101.0, t_s=101.0, lasted_s=0.112, count=1)
    assert comparison.progress(101.5).endswith("(the emulated rig got no processor time for 112 ms)")
    assert "processor" not in comparison.progress(102.0)
    feed(comparison, "rig/stall", 102.0, t_s=102.0, lasted_s=0.05, count=2)
    assert comparison.summary().endswith("rig perfect, which got no processor time 2 times, 0.16 s in total")


def test_the_summary_compares_with_the_truth():
    comparison = Comparison(7, "perfect")
    run_for(comparison, 4.0, settles=2.1, error=1e-4)
    feed(comparison, "palm/loop", work_p99_ms=1.25)
    assert comparison.settled
    summary = comparison.summary()
    assert summary.startswith(
        "palmd demo: seed 7, shape observer settled after 2.1 s, object 0 valid at the end, lost never, "
    )
    assert "outline 0 µm RMS (0.00%) on 16% t" in summary
    assert "touched normals (sd 40 µm), whole" in summary
    assert "whole outline within 0.300 mm (largest sd 0.080 mm)" in summary
    assert "r 0.071 mm, omega0 0.100 rad/s" in summary  # 0.1 mm in one of two
    assert "rho +10.0%, mu 0.11 (true 0.12), mass -1.0%" in summary
    assert summary.endswith("ticks 400, late > 2 ms 0.00%, work p99 1.2 ms, rig perfect")
    assert "\n" not in summary


def test_without_a_valid_estimate_no_errors_are_given():
    comparison = Comparison(7, "perfect")
    run_for(comparison, 2.0, settles=99.0)
    assert not comparison.settled
    summary = comparison.summary()
    assert "shape observer never settled" in summary
    assert "outline" not in summary
    assert "rho" not in summary
    assert "no valid estimate yet" in comparison.progress(102.0)


def test_an_estimate_before_the_motion_does_not_count_as_settled():
    comparison = Comparison(7, "perfect")
    feed(comparison, "palm/estimate", 99.0, valid=True, observer="shape", r1_m=0.0, r2_m=0.0, omega0_rad_s=0.0)
    comparison.started(100.0)
    feed(comparison, "palm/estimate", 99.9, valid=True, observer="shape", r1_m=0.0, r2_m=0.0, omega0_rad_s=0.0)
    assert not comparison.settled


def test_progress_names_state_and_severe_faults():
    comparison = Comparison(7, "perfect")
    run_for(comparison, 1.0)
    feed(comparison, "palm/state", state="tracking", exploring=True, reason="it sticks", coverage=0.25)
    line = comparison.progress(102.2)
    assert all(words in line for words in ("exploring 25%", "it sticks"))
    feed(comparison, "palm/state", state="hold", faults=["a", "b"], severities=["hold", "note"], hints=["", ""])
    line = comparison.progress(103.2)
    assert line.startswith("    3 s  hold")
    assert "rho 15.40 mm  mu 0.11  mass 99 g  outline ± 40 µm (1σ) on 16%  [true error: 0 µm RMS]" in line
    assert line.endswith("  a")


# -------------------------------------------------------------------------------------------------- punctuality


def late_share(times):
    punctuality = Punctuality()
    for t in times:
        punctuality.tick(t)
    return punctuality.late_share(len(times))


def test_late_and_missing_ticks_are_counted():
    random = np.random.default_rng(1)
    times = 5.0 + 0.01 * np.arange(1000) + random.uniform(0.0, 2e-4, 1000)
    assert late_share(times) == 0.0
    late = times.copy()
    late[[3, 500, 501]] += [0.003, 0.006, 0.0088]
    assert late_share(late) == pytest.approx(3 / 1000)
    late[700] += 0.0015
    assert late_share(late) == pytest.approx(3 / 1000)
    assert late_share(np.delete(times, [300, 301, 302, 303])) == pytest.approx(4 / 1000)
    assert math.isnan(late_share(times[:50]))


# -------------------------------------------------------------------------------------- addresses, configuration


def test_addresses_in_use_are_replaced_by_free_ones():
    with zmq.Context() as context, context.socket(zmq.PUB) as busy:
        taken = busy.bind_to_random_port("tcp://127.0.0.1")
        wanted = BusConfig(publish=f"tcp://127.0.0.1:{taken}", command="tcp://127.0.0.1:9871")
        found = free_addresses(wanted)
        assert found.publish != wanted.publish
        assert found.command != found.publish
        for address in (found.publish, found.command):
            with context.socket(zmq.PUB) as socket:
                socket.bind(address)


def test_the_daemons_configuration_is_the_rigs_with_its_ports(tmp_path):
    config = load_config(shipped("demo.yaml"))
    bus = BusConfig(publish="tcp://127.0.0.1:9882", command="tcp://127.0.0.1:9883")
    path = tmp_path / "palmd.yaml"
    path.write_text(as_yaml(config, bus, {"pad1": "/dev/a", "pad2": "/dev/b", "arm": "/dev/c"}))
    mine = load_config(path)
    assert (mine.pads.palm1.port, mine.pads.palm2.port, mine.arm.port) == ("/dev/a", "/dev/b", "/dev/c")
    assert mine.bus == bus
    assert mine.plan == config.plan
    assert mine.plan.is_file()
    assert (mine.limits, mine.observer) == (config.limits, config.observer)
    assert mine.rig == config.rig.model_copy(update={"imperfections": "none"})  # hidden from the daemon
    path.write_text(as_yaml(config, bus, {"pad1": "/dev/a", "pad2": "/dev/b", "arm": "/dev/c"}, emulated=True))
    assert load_config(path).rig == config.rig
    assert config.rig.imperfections == "calibrated"


def test_the_emulated_pivoting_gripper_has_the_configured_imperfections(tmp_path):
    config, path = load_any_config(shipped("pivot.yaml")), tmp_path / "rig.yaml"
    path.write_text(as_yaml(config, config.bus, emulated=True))
    assert load_any_config(path).rig == config.rig
    assert config.rig.imperfections == "calibrated"


def test_shipped_files_are_valid():
    files = [shipped(name) for name in ("palmd.yaml", "demo.yaml")]
    plans = sorted(shipped("plans").glob("*.yaml"))
    assert len(plans) >= 3
    assert check_files([*files, *plans]) == []
