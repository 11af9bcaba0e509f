"""The arm host against a small scripted controller, in simulated time."""

from __future__ import annotations

import contextlib
import heapq
import itertools
import math
import random
from collections.abc import Callable

import pytest

from palmd.config.arms import AdeptConfig
from palmd.devices.armhost import QUERY_S, ArmHost, ArmReport, _is_near
from palmd.devices.armlink import (
    Ack,
    ArmState,
    Command,
    Hello,
    HelloReply,
    LineReader,
    LinkError,
    Pose,
    Query,
    Refusal,
    Reply,
    Reset,
    SetPoint,
    Start,
    Stop,
    encode_reply,
    parse_command,
)
from palmd.devices.phaselock import STEP_MAX_S, SetPointTimer, wrap_phase

BAUD = 38400
BYTE_S = 10 / BAUD
CYCLE_S = 0.016
HELLO = HelloReply(CYCLE_S, -0.6, 0.6, -0.6, 0.6, 1.0, 10.0)
HOME = Pose(0.1, 0.2, math.radians(17.0))

Filter = Callable[[float, bytes], bytes]


def make_host(baud: int) -> ArmHost:
    return ArmHost(AdeptConfig(port="arm", baud=baud))


def intact(_t: float, line: bytes) -> bytes:
    return line


class Controller:
    """A controller that executes one set-point a cycle and reaches its target at once."""

    def __init__(self, phase_s: float = 0.0, drift: float = 0.0, jitter_s: float = 0.0) -> None:
        self.state = ArmState.READY
        self.pose = HOME
        self.refuse: dict[type[Command], int] = {}
        self.heard: list[tuple[float, Command]] = []
        self.landings: list[float] = []
        self.watchdog = True
        self.t_tick = phase_s
        self._cycle_s = CYCLE_S * (1 + drift)
        self._jitter_s = jitter_s
        self._random = random.Random(1)
        self._reader = LineReader(BAUD)
        self._latest: SetPoint | None = None
        self._t_valid = math.inf
        self._last_ss = 0
        self._answered: tuple[type[Command], int] | None = None

    def receive(self, t: float, data: bytes) -> list[Reply]:
        replies: list[Reply] = []
        for line in self._reader.feed(data, t):
            with contextlib.suppress(LinkError):  # one damaged line in 256 has the right CRC
                replies += self._obey(t, parse_command(line.body))
        return replies

    def _obey(self, t: float, command: Command) -> list[Reply]:
        self.heard.append((t, command))
        if isinstance(command, Hello):
            return [HELLO]
        repeated = self._answered == (type(command), command.ss)
        self._answered = (type(command), command.ss)
        self._last_ss = command.ss
        code = self.refuse.get(type(command))
        match command:
            case _ if code is not None:
                return [Refusal(command.ss, code)]
            case SetPoint():
                self.landings.append(1 - (self.t_tick - t) / self._cycle_s)
                if self.state not in (ArmState.TRACKING, ArmState.HOLD):
                    return [Refusal(command.ss, -620)]
                if self.state is ArmState.HOLD and abs(command.pose.x_m - self.pose.x_m) > 0.005:
                    return [Refusal(command.ss, -611)]
                self._latest = command
                return []
            case Start() if not repeated:
                if self.state is not ArmState.READY:
                    return [Refusal(command.ss, -620)]
                self.state = ArmState.TRACKING
                self._t_valid = t
            case Stop() if self.state is not ArmState.READY:
                self.state = ArmState.DECELERATING
            case Reset() if self.state is ArmState.FAULT:
                self.state = ArmState.READY
        return [Ack(command.ss, self.state, self.pose)]

    def tick(self) -> tuple[list[Reply], float]:
        """One cycle: the replies, and their delay (s)."""
        t = self.t_tick
        self.t_tick += self._cycle_s
        replies: list[Reply] = []
        latest, self._latest = self._latest, None
        if latest is not None and self.state in (ArmState.TRACKING, ArmState.HOLD):
            self.state, self.pose, self._t_valid = ArmState.TRACKING, latest.pose, t
            replies = [Ack(latest.ss, self.state, self.pose)]
        elif self.state is ArmState.DECELERATING and t - self._t_valid > 0.1:
            self.state = ArmState.READY
        elif self.watchdog and self.state in (ArmState.TRACKING, ArmState.HOLD):
            if t - self._t_valid > 0.160:
                self.state = ArmState.FAULT
                replies = [Refusal(self._last_ss, -600)]
            elif t - self._t_valid > 0.048:
                self.state = ArmState.HOLD
        return replies, self._random.uniform(0, self._jitter_s)

    def commands(self, kind: type[Command]) -> list[tuple[float, Command]]:
        return [(t, command) for t, command in self.heard if type(command) is kind]


class Bench:
    """Host and controller joined by two paced lines, run from event to event."""

    def __init__(self, controller: Controller | None = None) -> None:
        self.host = make_host(BAUD)
        self.controller = controller or Controller()
        self.t = 0.0
        self.target: Callable[[float], Pose | None] = lambda _t: None
        self.to_host: Filter = intact
        self.to_controller: Filter = intact
        self.host_asleep_until = 0.0
        self.reports: list[ArmReport] = []
        self.sent: list[tuple[float, bytes]] = []
        self._arrivals: list[tuple[float, int, str, bytes]] = []
        self._number = itertools.count()
        self._busy_until = {"host": 0.0, "controller": 0.0}

    def transmit(self, whither: str, t: float, line: bytes) -> None:
        corrupt = self.to_host if whither == "host" else self.to_controller
        start = max(t, self._busy_until[whither])
        self._busy_until[whither] = start + len(line) * BYTE_S
        arrival = (self._busy_until[whither], next(self._number), whither, corrupt(t, line))
        heapq.heappush(self._arrivals, arrival)

    def run(self, seconds: float) -> None:
        t_end = self.t + seconds
        while True:
            t_host = max(self.t, self.host_asleep_until, self.host.due())
            t_arrival = self._arrivals[0][0] if self._arrivals else math.inf
            t_next = min(t_host, t_arrival, self.controller.t_tick)
            if t_next > t_end:
                self.t = t_end
                return
            self.t = t_next
            if t_next == t_arrival:
                _, _, whither, data = heapq.heappop(self._arrivals)
                if whither == "host":
                    self.reports += self.host.feed(data, self.t)
                else:
                    for reply in self.controller.receive(self.t, data):
                        self.transmit("host", self.t, encode_reply(reply))
            elif t_next == self.controller.t_tick:
                replies, late_s = self.controller.tick()
                for reply in replies:
                    self.transmit("host", self.t + late_s, encode_reply(reply))
            else:
                data = self.host.poll(self.t, self.target(self.t)).data
                assert self.host.due() > self.t
                if data:
                    self.sent.append((self.t, data))
                    self.transmit("controller", self.t, data)

    def track(self) -> None:
        """Brings the link up and starts tracking."""
        self.run(0.2)
        self.host.request_tracking()
        self.run(0.1)
        assert self.host.tracking, self.host.refusal


@pytest.fixture
def bench() -> Bench:
    return Bench()


def mute(_t: float, _line: bytes) -> bytes:
    return b""


# Hello and query


def test_hello_is_sent_first_and_then_a_query_every_100_ms(bench: Bench) -> None:
    bench.run(1.0)
    host, controller = bench.host, bench.controller
    assert host.hello == HELLO
    assert host.linked(bench.t)
    assert (host.state, host.pose) == (ArmState.READY, HOME)
    assert [type(command) for _, command in controller.heard[:2]] == [Hello, Query]
    times = [t for t, _ in controller.commands(Query)]
    assert all(b - a == pytest.approx(QUERY_S, abs=1e-6) for a, b in itertools.pairwise(times))
    assert len(times) in (9, 10)


def test_sequence_starts_at_zero_after_hello_and_wraps(bench: Bench) -> None:
    bench.run(30.0)
    numbers = [command.ss for _, command in bench.controller.heard[1:]]  # type: ignore[union-attr]
    assert numbers == [n % 256 for n in range(len(numbers))]
    assert len(numbers) > 256


def test_hello_is_repeated_until_answered(bench: Bench) -> None:
    bench.to_host = mute
    bench.run(1.1)
    assert len(bench.controller.commands(Hello)) == 5
    assert not bench.host.linked(bench.t)
    bench.to_host = intact
    bench.run(0.5)
    assert bench.host.linked(bench.t)


def test_without_commands_only_hello_and_query_are_sent(bench: Bench) -> None:
    bench.run(2.0)
    bench.host.disconnected()
    bench.run(2.0)
    assert {type(command) for _, command in bench.controller.heard} == {Hello, Query}


# Tracking


def test_the_first_set_point_is_the_actual_pose_whatever_the_target(bench: Bench) -> None:
    bench.target = lambda _t: Pose(0.5, 0.5, 0.0)
    bench.track()
    _, first = bench.controller.commands(SetPoint)[0]
    assert isinstance(first, SetPoint)
    assert first.pose.x_m == pytest.approx(HOME.x_m, abs=1e-6)
    assert first.pose.t_rad == pytest.approx(HOME.t_rad, abs=1e-5)


def test_set_points_follow_the_target_every_cycle(bench: Bench) -> None:
    bench.track()
    bench.target = lambda t: Pose(0.1 + 0.01 * (t - 0.3), 0.2, 0.3)
    bench.run(1.0)
    assert bench.host.counters.setpoints == pytest.approx(1.08 / CYCLE_S, abs=4)
    assert bench.controller.pose.x_m == pytest.approx(0.11, abs=5e-4)
    assert bench.host.counters.skipped_periods == 0
    assert bench.host.counters.refusals == 0
    assert 8 < bench.host.counters.ack_latency_max_ms < 33
    assert not bench.controller.commands(Query)[-1][0] > 0.3, "Q while tracking"


def test_without_a_target_the_last_set_point_is_repeated(bench: Bench) -> None:
    bench.track()
    bench.run(0.2)
    assert bench.host.commanded == bench.host.pose
    assert bench.host.counters.setpoints > 10


@pytest.mark.parametrize("target", [Pose(math.nan, 0, 0), Pose(0, math.inf, 0), Pose(5.0, 0, 0), Pose(0, 0, math.inf)])
def test_a_target_that_cannot_be_sent_is_counted_and_the_last_one_repeated(bench: Bench, target: Pose) -> None:
    bench.track()
    commanded = bench.host.commanded
    bench.target = lambda _t: target
    bench.run(0.1)
    assert bench.host.commanded == commanded
    assert bench.host.counters.bad_targets == pytest.approx(6, abs=1)
    assert bench.host.tracking


def test_reports_have_the_time_of_their_first_byte(bench: Bench) -> None:
    bench.track()
    bench.run(0.5)
    ticks = [report.t_sample - BYTE_S for report in bench.reports[-10:]]
    assert [wrap_phase(t, CYCLE_S) for t in ticks] == pytest.approx([0.0] * 10, abs=1e-5)


def test_reports_that_arrive_together_are_dated_one_cycle_apart(bench: Bench) -> None:
    bench.track()
    bench.run(1.0)
    held: list[bytes] = []

    def by_threes(_t: float, line: bytes) -> bytes:
        held.append(line)
        together = b"".join(held) if len(held) == 3 else b""
        if together:
            held.clear()
        return together

    bench.to_host = by_threes
    bench.reports.clear()
    bench.run(0.3)
    times = [report.t_sample - BYTE_S for report in bench.reports]
    assert len(times) > 12
    assert [wrap_phase(t, CYCLE_S) for t in times] == pytest.approx([0.0] * len(times), abs=1e-4)
    assert [b - a for a, b in itertools.pairwise(times)] == pytest.approx([CYCLE_S] * (len(times) - 1), abs=1e-4)


def test_a_late_host_skips_periods_and_never_bursts(bench: Bench) -> None:
    bench.track()
    bench.run(0.5)
    bench.host_asleep_until = bench.t + 0.040
    t_before = bench.t
    bench.run(0.5)
    assert bench.host.counters.skipped_periods in (2, 3)
    times = [t for t, _ in bench.sent if t >= t_before - CYCLE_S]
    assert min(b - a for a, b in itertools.pairwise(times)) > CYCLE_S / 2
    assert bench.host.tracking


def test_a_refused_start_gives_the_reason(bench: Bench) -> None:
    bench.run(0.3)
    bench.controller.refuse[Start] = -622
    bench.host.request_tracking()
    bench.run(0.2)
    assert not bench.host.tracking
    assert not bench.host.busy
    assert "start refused: -0622 arm power is off" in bench.host.refusal
    assert bench.host.last_error == -622
    assert len(bench.controller.commands(Start)) == 1


def test_start_without_a_link_is_refused_at_once() -> None:
    host = make_host(BAUD)
    host.request_tracking()
    assert host.refusal == "start refused: no link to the arm's controller"
    assert not host.busy


def test_a_line_too_slow_for_the_cycle_is_refused() -> None:
    host = make_host(9600)
    host.poll(0.0, None)
    host.feed(encode_reply(HELLO), 0.05)
    host.request_tracking()
    assert "29.2 ms at 9600 baud, longer than the controller's cycle of 16 ms" in host.refusal


@pytest.mark.parametrize("direction", ["to_host", "to_controller"])
def test_a_lost_start_is_repeated_with_the_same_number(bench: Bench, direction: str) -> None:
    bench.run(0.25)
    setattr(bench, direction, mute)
    bench.host.request_tracking()
    bench.run(0.05)
    setattr(bench, direction, intact)
    bench.run(0.1)
    assert bench.host.tracking
    assert bench.host.counters.retries == 1
    starts = [data for _, data in bench.sent if data.startswith(b"G")]
    assert len(starts) == 2
    assert starts[0] == starts[1]


# Stop and reset


def test_stop_is_repeated_and_followed_until_the_arm_is_ready(bench: Bench) -> None:
    bench.track()
    bench.to_controller = mute  # for half of the time until the repetition
    bench.host.request_stop()
    bench.run(0.04)
    bench.to_controller = intact
    bench.run(0.06)
    assert not bench.host.tracking
    assert bench.host.state is ArmState.DECELERATING
    bench.run(0.4)
    assert bench.host.state is ArmState.READY
    t_stop = bench.controller.commands(Stop)[0][0]
    assert not [t for t, _ in bench.controller.commands(SetPoint) if t > t_stop]


def test_no_set_point_follows_a_stop(bench: Bench) -> None:
    bench.track()
    bench.host.request_stop()
    bench.host.request_tracking()
    assert bench.host.refusal == "start refused: a stop is under way"
    bench.run(0.05)
    assert bench.host.state is ArmState.DECELERATING


def test_reset_clears_a_fault_and_does_not_start(bench: Bench) -> None:
    bench.controller.state = ArmState.FAULT
    bench.run(0.3)
    bench.host.last_error = -600
    bench.host.request_reset()
    bench.run(0.2)
    assert bench.host.state is ArmState.READY
    assert bench.host.last_error is None
    assert not bench.controller.commands(Start)


def test_reset_while_tracking_is_refused_by_the_host(bench: Bench) -> None:
    bench.track()
    bench.host.request_reset()
    assert bench.host.refusal == "reset refused: the arm is tracking"
    bench.run(0.1)
    assert bench.host.tracking


def test_an_answered_stop_is_followed_by_a_query_100_ms_later(bench: Bench) -> None:
    bench.track()
    bench.host.request_stop()
    bench.run(0.3)
    ((t_stop, _),) = bench.controller.commands(Stop)
    assert 0.100 < min(t for t, _ in bench.controller.commands(Query) if t > t_stop) - t_stop < 0.130


# Failures


def test_motion_freezes_after_80_ms_of_silence_and_the_link_is_lost_after_250(bench: Bench) -> None:
    bench.track()
    bench.controller.watchdog = False
    bench.to_host = mute
    bench.run(0.080 - 0.032)
    assert not bench.host.frozen(bench.t)
    bench.run(0.033)
    assert bench.host.frozen(bench.t)
    assert bench.host.linked(bench.t)
    bench.run(0.250 - 0.080)
    assert bench.host.lost(bench.t)
    assert not bench.host.tracking
    assert bench.host.counters.losses == 1
    t_lost = bench.t
    bench.run(0.5)
    assert not [t for t, _ in bench.controller.commands(SetPoint) if t > t_lost + CYCLE_S]
    bench.to_host = intact
    bench.run(0.5)
    assert bench.host.linked(bench.t)
    assert len(bench.controller.commands(Start)) == 1, "a lost link must not start again by itself"


def test_a_link_that_the_controller_has_ended_is_noticed_and_queried(bench: Bench) -> None:
    bench.track()
    bench.to_controller = lambda _t, line: b"" if line.startswith(b"S") else line
    bench.run(0.22)
    assert bench.host.last_error == -600
    assert bench.host.state is ArmState.FAULT
    assert not bench.host.tracking


def test_no_set_point_is_sent_while_the_state_is_uncertain(bench: Bench) -> None:
    bench.track()
    bench.controller.state = ArmState.FAULT
    bench.to_controller = lambda _t, line: b"" if line.startswith(b"Q") else line
    bench.transmit("host", bench.t, encode_reply(Refusal(7, -600)))
    bench.run(0.01)
    sent = bench.host.counters.setpoints
    bench.run(0.08)
    assert bench.host.counters.setpoints == sent
    assert bench.host.tracking
    bench.to_controller = intact
    bench.run(0.1)
    assert bench.host.state is ArmState.FAULT
    assert not bench.host.tracking


def test_a_refused_set_point_is_queried_and_tracking_continues(bench: Bench) -> None:
    bench.track()
    asked = len(bench.controller.commands(Query))
    bench.controller.refuse[SetPoint] = -611
    bench.run(0.02)
    bench.controller.refuse.clear()
    bench.run(0.1)
    assert bench.host.last_error == -611
    assert bench.host.tracking
    assert len(bench.controller.commands(Query)) in (asked + 1, asked + 2)


def test_after_a_hold_set_points_resume_at_the_actual_pose(bench: Bench) -> None:
    bench.track()
    bench.host_asleep_until = bench.t + 0.080
    bench.target = lambda _t: Pose(0.2, 0.2, 0.3)
    bench.run(0.080)
    assert bench.controller.state is ArmState.HOLD
    bench.run(0.060)
    assert bench.host.last_error == -611
    assert bench.host.counters.rebased > 0
    assert bench.host.state is ArmState.TRACKING
    assert bench.host.tracking


def test_a_refusal_as_first_answer_is_the_last_error() -> None:
    """Nothing is uncertain before the first answer: a wrong state then is no consequence of a latched fault."""
    host = make_host(BAUD)
    host.poll(0.0, None)
    host.feed(encode_reply(HELLO), 0.05)
    host.poll(0.06, None)
    host.feed(encode_reply(Refusal(0, -620)), 0.08)
    assert host.last_error == -620


def test_poses_are_near_if_position_and_wrapped_angle_are_near() -> None:
    half = Pose(0.1, 0.2, math.pi)
    for turn_deg, near in ((0.0, True), (2.9, True), (-2.9, True), (3.1, False), (-3.1, False)):
        assert _is_near(Pose(0.1, 0.2, -math.pi + math.radians(turn_deg)), half) is near
    assert _is_near(Pose(0.1049, 0.2, math.pi), half)
    assert not _is_near(Pose(0.1051, 0.2, math.pi), half)


def test_an_emergency_stop_ends_tracking(bench: Bench) -> None:
    bench.track()
    while not isinstance(bench.controller.heard[-1][1], SetPoint) or not bench.sent[-1][0] > bench.t - 0.001:
        bench.run(0.001)
    bench.controller.state = ArmState.ESTOP
    bench.transmit("host", bench.t, encode_reply(Refusal(7, -621)))
    bench.run(0.1)
    assert bench.host.state is ArmState.ESTOP
    assert bench.host.last_error == -621, "not -620, the answer to set-points already sent"
    assert bench.host.counters.refusals > 1
    assert not bench.host.tracking


def test_a_restarted_controller_gets_hello_again_and_no_start(bench: Bench) -> None:
    bench.track()
    bench.run(2.0)
    bench.controller.state = ArmState.READY
    bench.transmit("host", bench.t, encode_reply(HELLO))
    bench.run(0.3)
    assert bench.host.counters.restarts == 1
    assert bench.host.linked(bench.t)
    assert not bench.host.tracking
    assert len(bench.controller.commands(Hello)) == 2
    assert len(bench.controller.commands(Start)) == 1


def test_a_controller_found_ready_ends_tracking(bench: Bench) -> None:
    bench.track()
    bench.controller.state = ArmState.READY
    bench.run(0.2)
    assert not bench.host.tracking
    assert bench.host.state is ArmState.READY


def test_a_lost_port_resets_the_link_and_is_reported(bench: Bench) -> None:
    bench.track()
    bench.host.request_stop()
    bench.host.disconnected()
    assert bench.host.refusal == "stop failed: the port was lost"
    assert bench.host.lost(bench.t)
    assert (bench.host.state, bench.host.pose, bench.host.tracking) == (None, None, False)
    assert not bench.host.busy
    t_lost = bench.t
    bench.run(0.3)
    assert bench.host.linked(bench.t)
    heard = [command for t, command in bench.controller.heard if t > t_lost]
    assert heard[heard.index(Hello()) :][:4] == [Hello(), Query(0), Query(1), Query(2)]


def test_late_and_repeated_answers_are_counted_and_ignored(bench: Bench) -> None:
    bench.run(0.3)
    stray = encode_reply(Ack(0, ArmState.TRACKING, Pose(0.0, 0.0, 0.0)))
    assert bench.host.feed(stray, bench.t) == []
    assert bench.host.counters.unmatched == 1
    assert bench.host.state is ArmState.READY


def test_invalid_lines_are_counted(bench: Bench) -> None:
    bench.run(0.3)
    assert bench.host.feed(b"\x00\xff*00\nZZ*00\nH*FF\n", bench.t) == []
    counts = bench.host.counters.as_dict()
    assert (counts["unframed"], counts["crc_errors"], counts["malformed"]) == (1, 1, 1)


def test_a_noisy_line_is_survived() -> None:
    noise = random.Random(5)

    def corrupt(_t: float, line: bytes) -> bytes:
        return bytes(byte for byte in line if noise.random() > 0.004)

    bench = Bench()
    bench.track()
    bench.to_host = bench.to_controller = corrupt
    bench.run(5.0)
    assert bench.host.tracking
    assert bench.controller._reader.counters.crc_errors + bench.controller._reader.counters.unframed > 10
    assert bench.host.counters.line.bytes_discarded > 100


# Phase lock


@pytest.mark.parametrize("phase_ms", [0, 4, 8, 14])
@pytest.mark.parametrize("drift", [-200e-6, 0.0, 200e-6])
def test_set_points_arrive_in_mid_cycle(phase_ms: int, drift: float) -> None:
    bench = Bench(Controller(phase_ms * 1e-3, drift, jitter_s=1e-3))
    bench.track()
    bench.run(0.6)
    settled = len(bench.controller.landings)
    bench.run(2.0)
    landings = bench.controller.landings[settled:]
    assert len(landings) > 100
    assert min(landings) > 0.5 - 1.0 / 16
    assert max(landings) < 0.5 + 1.0 / 16 + 0.5 / 16  # answers leave up to 1 ms late, 0.5 ms on average
    times = [t for t, _ in bench.controller.commands(SetPoint)]
    assert max(abs(b - a - CYCLE_S) for a, b in itertools.pairwise(times)) < 1e-3


@pytest.mark.parametrize("offset_ms", range(-8, 9))
def test_the_phase_lock_converges_from_any_initial_phase(offset_ms: int) -> None:
    timer = SetPointTimer(BAUD, CYCLE_S, offset_ms * 1e-3)
    noise = random.Random(offset_ms)
    for cycle in range(200):
        late_s = 0.005 if cycle % 20 == 7 else noise.uniform(0, 0.5e-3)
        timer.answered(cycle * CYCLE_S + late_s)
        before = timer.t_next
        timer.sent()
        assert abs(timer.t_next - before - CYCLE_S) <= STEP_MAX_S + 1e-12
    landing = timer.t_next + 29 * BYTE_S
    assert abs(wrap_phase(landing - CYCLE_S / 2, CYCLE_S)) < 1e-3


def test_late_answers_hardly_move_the_timer() -> None:
    timer = SetPointTimer(BAUD, CYCLE_S, 0.0)
    slot = timer.t_next
    timer.answered(CYCLE_S + 0.007)
    for _ in range(10):
        timer.sent()
    assert timer.t_next - slot - 10 * CYCLE_S == pytest.approx(STEP_MAX_S)
    for _ in range(5):  # five at once, as after a stall
        timer.answered(CYCLE_S + 0.007)
    slot = timer.t_next
    timer.sent()
    assert timer.t_next - slot - CYCLE_S == pytest.approx(STEP_MAX_S)


def test_the_timer_skips_to_the_nearest_slot() -> None:
    timer = SetPointTimer(BAUD, CYCLE_S, 0.0)
    slot = timer.t_next
    assert timer.skip(slot + 0.007) == 0
    assert timer.skip(slot + 0.041) == 3
    assert timer.t_next == pytest.approx(slot + 3 * CYCLE_S)
    assert timer.skip(slot) == 0
