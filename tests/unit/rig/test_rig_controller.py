"""The emulated controller, line by line, against the contract of the arm link."""

import math

import pytest

from palmd.devices.armlink import ArmState, Pose, crc8, parse_reply
from palmd.rig.controller import ArmLimits, Controller

LIMITS = ArmLimits(-0.2, 0.4, -0.3, 0.3, v_max=0.5, a_max=8.0)
HOME = Pose(0.1, 0.0, 1.0)
CYCLE = 0.016


class Bench:
    """A controller whose arm is always where the path is, and a clock that goes from cycle to cycle."""

    def __init__(self):
        self.heard = []
        self.controller = Controller(LIMITS, HOME, 38400, lambda pose, t: self.heard.append((pose, t)))
        self.t = 0.0
        self.path = [HOME]

    @property
    def state(self):
        return self.controller.state

    def say(self, body):
        raw = body.encode()
        out = self.controller.feed(b"%b*%02X\n" % (raw, crc8(raw)), self.t, self.controller.path)
        return self._lines(out)

    def cycle(self, count=1):
        out = b""
        for _ in range(count):
            self.t += CYCLE
            out += self.controller.cycle(self.t, self.controller.path)
            self.path.append(self.controller.path)
        return self._lines(out)

    def track(self, x_mm=100.0, ss=1):
        assert self.say("G00")[0].startswith("A00T")
        assert self.say(setpoint(ss, x_mm)) == []
        assert self.cycle()[0].startswith(f"A{ss:02X}T")

    @staticmethod
    def _lines(out):
        assert out == b"" or out.endswith(b"\r\n")
        bodies = []
        for line in out.split(b"\r\n")[:-1]:
            body, _, crc = line.rpartition(b"*")
            assert int(crc, 16) == crc8(body)
            bodies.append(body.decode())
        return bodies


HOME_DEG = math.degrees(HOME.t_rad)


def setpoint(ss, x_mm, y_mm=0.0, t_deg=HOME_DEG):
    return f"S{ss:02X}{round(x_mm * 1e3):+07d}{round(y_mm * 1e3):+07d}{round(t_deg * 1e3):+07d}"


@pytest.fixture
def bench():
    return Bench()


def test_hello_tells_cycle_and_limits(bench):
    assert bench.say("H") == ["H1,16,-200000,400000,-300000,300000,500000,8000000"]


def test_query_reports_state_and_place(bench):
    assert bench.say("Q07") == ["A07R+100000+000000+057296"]


def test_setpoint_is_consumed_by_the_next_cycle_only(bench):
    bench.say("G00")
    assert bench.say(setpoint(1, 102.0)) == []
    assert bench.path[-1] == HOME
    assert bench.cycle() == ["A01T+100000+000000+057296"]
    assert bench.path[-1].x_m == pytest.approx(0.102)
    assert bench.cycle() == []
    assert bench.path[-1].x_m == pytest.approx(0.102)


def test_the_latest_setpoint_wins_and_the_superseded_gets_no_answer(bench):
    bench.track()
    bench.say(setpoint(2, 101.0))
    bench.say(setpoint(3, 101.5))
    assert [line[:4] for line in bench.cycle()] == ["A03T"]
    assert bench.path[-1].x_m == pytest.approx(0.1015)
    assert bench.controller.counters.superseded == 1


def test_setpoints_and_start_in_the_wrong_state(bench):
    assert bench.say(setpoint(1, 100.0)) == ["E01-0620"]
    bench.track(ss=2)
    assert bench.say("G09") == ["E09-0620"]
    assert bench.state is ArmState.TRACKING


def test_stop_and_reset_when_ready_are_simply_acknowledged(bench):
    assert bench.say("P01")[0].startswith("A01R")
    assert bench.say("R02")[0].startswith("A02R")


def test_planned_stop_decelerates_then_is_ready(bench):
    bench.track()
    for k in range(2, 20):
        bench.say(setpoint(k, 100.0 + 5.0 * (k - 1)))
        bench.cycle()
    assert bench.say("P30")[0].startswith("A30D")
    assert bench.say(setpoint(0x31, 200.0)) == ["E31-0620"]
    steps = 0
    while bench.state is ArmState.DECELERATING:
        bench.cycle()
        steps += 1
    assert 2 <= steps < 10
    assert bench.state is ArmState.READY
    changes = [
        (c.x_m - 2 * b.x_m + a.x_m) / CYCLE**2
        for a, b, c in zip(bench.path, bench.path[1:], bench.path[2:], strict=False)
    ]
    assert max(map(abs, changes)) <= LIMITS.a_max * (1 + 1e-9)


def test_silence_holds_after_48_ms_and_faults_after_160(bench):
    bench.track()
    bench.cycle(2)
    assert bench.state is ArmState.TRACKING
    bench.cycle()
    assert bench.state is ArmState.HOLD
    bench.cycle(6)
    assert bench.state is ArmState.HOLD
    assert bench.cycle() == ["E01-0600"]
    assert bench.state is ArmState.FAULT
    assert bench.cycle(5) == []
    assert bench.say("G05") == ["E05-0620"]
    assert bench.say("P06") == ["E06-0620"]
    assert bench.say("R07")[0].startswith("A07R")


def test_a_start_without_setpoints_does_not_hold_but_faults(bench):
    bench.say("G00")
    bench.cycle(9)
    assert bench.state is ArmState.TRACKING
    assert bench.cycle() == ["E00-0600"]


def test_hold_resumes_near_the_arm_only(bench):
    bench.track()
    bench.cycle(4)
    assert bench.state is ArmState.HOLD
    bench.say(setpoint(2, 106.0))
    assert bench.cycle() == ["E02-0611"]
    bench.say(setpoint(3, 100.0, t_deg=HOME_DEG + 4.0))
    assert bench.cycle() == ["E03-0611"]
    assert bench.state is ArmState.HOLD
    bench.say(setpoint(4, 104.0))
    assert bench.cycle()[0].startswith("A04T")


def test_the_first_setpoint_must_be_near(bench):
    bench.say("G00")
    bench.say(setpoint(1, 106.0))
    assert bench.cycle() == ["E01-0611"]


def test_a_long_step_is_clamped_and_a_longer_one_refused(bench):
    bench.track()
    reach_mm = LIMITS.v_max * CYCLE * 1e3
    bench.say(setpoint(2, 100.0 + 2.9 * reach_mm))
    assert bench.cycle()[0].startswith("A02T")
    assert bench.path[-1].x_m - bench.path[-2].x_m <= LIMITS.a_max * CYCLE**2 * (1 + 1e-9)
    assert bench.controller.counters.clamped == 1
    bench.say(setpoint(3, 100.0 + 4.5 * reach_mm))
    assert bench.cycle() == ["E03-0611"]


def test_speed_and_acceleration_are_never_exceeded(bench):
    bench.track()
    for ss in range(2, 60):
        bench.say(setpoint(ss, bench.path[-1].x_m * 1e3 + 20.0, 5.0 * (-1) ** ss))
        bench.cycle()
    for a, b, c in zip(bench.path, bench.path[1:], bench.path[2:], strict=False):
        speed = math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) / CYCLE
        change = math.hypot(c.x_m - 2 * b.x_m + a.x_m, c.y_m - 2 * b.y_m + a.y_m) / CYCLE**2
        assert speed <= LIMITS.v_max * (1 + 1e-9)
        assert change <= LIMITS.a_max * (1 + 1e-9)


def test_outside_the_workspace_is_refused_and_feeds_no_watchdog(bench):
    bench.track()
    answers = []
    for ss in range(2, 6):
        bench.say(setpoint(ss, 401.0))
        answers += bench.cycle()
    assert answers == [f"E{ss:02X}-0610" for ss in range(2, 6)]
    assert bench.state is ArmState.HOLD


def test_a_duplicate_repeats_the_answer_without_motion_or_feeding(bench):
    bench.track()
    first = None
    for _ in range(3):
        again = bench.say(setpoint(1, 100.0))
        first = first or again
        assert again == first
        assert again[0].startswith("A01T")
        bench.cycle()
    assert bench.state is ArmState.HOLD
    assert bench.controller.counters.duplicates == 3
    assert bench.controller.counters.accepted == 1


def test_hello_starts_the_sequence_anew(bench):
    assert bench.say("Q05")
    bench.say("H")
    bench.say("Q05")
    assert bench.controller.counters.duplicates == 0


@pytest.mark.parametrize(
    ("act", "state", "code"),
    [
        ("press_emergency_stop", ArmState.ESTOP, "-0621"),
        ("switch_power_off", ArmState.POWER_OFF, "-0622"),
        ("switch_to_manual", ArmState.MANUAL, "-0623"),
    ],
)
def test_what_only_an_operator_clears(bench, act, state, code):
    bench.track()
    getattr(bench.controller, act)(*([HOME] if act == "switch_to_manual" else []))
    told = bench.cycle()
    assert told == (["E01-0621"] if state is ArmState.ESTOP else [])
    assert bench.say(setpoint(5, 100.0)) == ["E05-0620"]
    for ss, letter in enumerate("GRP", 6):
        assert bench.say(f"{letter}{ss:02X}") == [f"E{ss:02X}{code}"]
    assert bench.state is state
    assert bench.cycle(20) == []
    bench.controller.make_ready()
    assert bench.say("G20")[0].startswith("A20T")


def test_manual_jog_is_slow(bench):
    bench.controller.switch_to_manual(Pose(0.11, 0.0, 1.0))
    bench.cycle(10)
    assert bench.path[-1].x_m == pytest.approx(0.1 + 10 * 0.02 * CYCLE)


def test_a_break_while_tracking_is_a_latched_fault(bench):
    bench.track()
    bench.controller.line_fault(-504)
    assert bench.cycle(3)[-1] == "E01-0504"
    assert bench.state is ArmState.FAULT


def test_bad_crc_is_silent_and_nonsense_counted(bench):
    assert bench.controller.feed(b"Q01*00\n", 0.0, HOME) == b""
    assert bench.controller.reader.counters.crc_errors == 1
    assert bench.say("Z01") == []
    assert bench.say("S01+1") == []
    assert bench.controller.counters.unparsable == 2


def test_every_setpoint_is_told_even_in_the_wrong_state(bench):
    bench.say(setpoint(1, 123.0))
    assert bench.heard[0][0].x_m == pytest.approx(0.123)


def test_answers_parse_as_replies(bench):
    for body in bench.say("H") + bench.say("Q01") + bench.say(setpoint(2, 100.0)):
        parse_reply(body)
