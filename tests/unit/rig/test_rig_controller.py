"""The emulated controller's behaviour beyond the arm link's contract, which `test_armconformance` tests."""

import math

import pytest

from palmd.devices.armlink import ArmState, Pose, crc8
from palmd.rig.controller import ArmLimits, Controller

LIMITS = ArmLimits(-0.2, 0.4, -0.3, 0.3, v_max=0.5, a_max=8.0)
HOME = Pose(0.1, 0.0, 1.0)
CYCLE = 0.016


class Bench:
    """A controller whose arm is always on its path, and a clock that advances by cycles."""

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


def test_planned_stop_decelerates_and_ends_in_ready(bench):
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


def test_commands_are_counted_by_result(bench):
    assert bench.say(setpoint(1, 100.0)) == ["E01-0620"]
    bench.track(ss=2)
    far = 100.0 + 2.9 * LIMITS.v_max * CYCLE * 1e3
    bench.say(setpoint(3, far))
    bench.say(setpoint(4, far))
    bench.cycle()
    bench.say(setpoint(4, far))
    assert bench.controller.feed(b"Q01*00\n", 0.0, HOME) == b""
    assert bench.say("Z01") == bench.say("S01+1") == []
    counters = bench.controller.counters.as_dict()
    expected = {"setpoints": 4, "accepted": 2, "superseded": 1, "clamped": 1, "duplicates": 1, "refused_620": 1}
    expected["unparsable"] = 2
    assert {name: counters[name] for name in expected} == expected
    assert bench.controller.reader.counters.crc_errors == 1


@pytest.mark.parametrize(
    ("act", "state", "code"),
    [
        ("press_emergency_stop", ArmState.ESTOP, "-0621"),
        ("switch_power_off", ArmState.POWER_OFF, "-0622"),
        ("switch_to_manual", ArmState.MANUAL, "-0623"),
    ],
)
def test_conditions_that_only_an_operator_clears(bench, act, state, code):
    bench.track()
    getattr(bench.controller, act)(*([HOME] if act == "switch_to_manual" else []))
    replies = bench.cycle()
    assert replies == (["E01-0621"] if state is ArmState.ESTOP else [])
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


def test_every_setpoint_is_logged_even_in_the_wrong_state(bench):
    bench.say(setpoint(1, 123.0))
    assert bench.heard[0][0].x_m == pytest.approx(0.123)
