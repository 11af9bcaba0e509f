"""What the host does with servos of every make, in one loop with emulated ones."""

import math
import random

import pytest
from servo_bench import HOME, MAKES, BenchTalk, ServoBench

from palmd.devices.actuator import ArmState
from palmd.devices.servoconformance import CHECKS, examine
from palmd.rig.servokinds.feetech import COMPLIANCE_RAD_N_M

pytestmark = pytest.mark.parametrize("kind", MAKES)
PLAY_DEG = {"dynamixel": 0.25, "feetech": 1.0}
FRICTION_DEG = {"dynamixel": 0.0, "feetech": 0.4}


def following(kind, **how):
    bench = ServoBench(kind=kind, **how).armed()
    assert bench.host.tracking, bench.host.refusal
    t0, start = bench.t, bench.reports[-1].pose.joints_rad

    def path(t):
        grown = min((t - t0) / 0.5, 1.0)
        return (
            start[0] + grown * math.radians(15) * math.sin(3.0 * (t - t0)),
            start[1] + grown * math.radians(8) * math.sin(2.2 * (t - t0)),
        )

    bench.target = path
    return bench


def test_it_sets_what_the_factory_left_and_nothing_twice_even_without_power(kind):
    bench = ServoBench(kind=kind).go(1.0)
    assert bench.host.state is ArmState.READY
    changed = bench.host.counters.registers_set
    assert changed > 0
    for name, begins in (("power_off", True), ("power_off", False)):
        bench.play(name, begins)
        bench.go(1.5)
    assert bench.host.state is ArmState.READY
    assert bench.host.counters.registers_set == changed, "settings are kept without power"
    assert not any(servo.torque for servo in bench.rig._servos)


def test_it_arms_where_it_stands_and_follows_as_far_as_friction_lets_it(kind):
    bench = following(kind).go(2.0)
    reported = [report for report in bench.reports if report.t_sample > bench.t - 1.5]
    off = [
        min(
            max(abs(a - b) for a, b in zip(bench.target(each.t_sample - lag / 1e3), each.pose.joints_rad, strict=True))
            for lag in range(15, 50)
        )
        for each in reported
    ]
    assert max(off) < math.radians(0.25 + FRICTION_DEG[kind])
    assert bench.host.counters.missed == bench.host.counters.refused_goals == 0
    assert bench.reports[-1].state is ArmState.TRACKING


def test_palms_are_off_what_is_reported_by_half_of_the_play(kind):
    bench = ServoBench(kind=kind).armed()
    bench.go(0.5)
    off = [
        math.degrees(abs(a - b))
        for a, b in zip(bench.rig.palms_at(bench.t).angles, bench.reports[-1].pose.joints_rad, strict=True)
    ]
    assert off[0] == pytest.approx(0.5 * PLAY_DEG[kind], abs=0.1)
    assert off[1] == pytest.approx(PLAY_DEG[kind], abs=0.15), "of both palms"


def test_a_planned_stop_comes_to_rest_and_holds(kind):
    bench = following(kind).go(1.1)
    bench.host.request_stop()
    bench.go(0.3)
    assert bench.host.state is ArmState.READY
    assert bench.speed < 1e-3
    assert all(servo.torque for servo in bench.rig._servos)
    bench.go(1.0)
    assert bench.armed().host.tracking, "and arms again"


@pytest.mark.parametrize(("name", "code"), [("overload", "overload"), ("overheat", "hot"), ("undervoltage", "voltage")])
def test_a_hardware_error_is_named_within_a_tenth_of_a_second_and_reset_clears_it(kind, name, code):
    bench = following(kind).go(1.0)
    bench.play(name)
    t = bench.t
    bench.go(0.2, lambda: code in bench.host.faults)
    assert bench.t - t < 0.15
    assert not bench.host.tracking
    assert list(bench.host.health(False)) == [f"servo-{code}"]
    bench.go(0.2)
    bench.host.request_reset()
    bench.go(1.0, lambda: not bench.host.busy)
    bench.go(0.1)
    assert (bench.host.state, bench.host.error) == (ArmState.READY, "")
    assert bench.armed().host.tracking


def test_a_servo_that_loses_its_power_while_it_follows_is_noticed(kind):
    bench = following(kind).go(1.0)
    bench.play("brownout")
    bench.go(1.0)
    assert not bench.host.tracking


def test_servos_come_to_rest_when_the_host_dies(kind):
    bench = following(kind).go(1.1)
    assert bench.speed > 0.3
    bench.deaf, t_died = True, bench.t
    bench.go(1.0, lambda: bench.speed < 1e-2)
    assert bench.t - t_died < 0.15, "by a watchdog, or at the last goal"


def test_a_spoilt_line_costs_cycles_and_no_more(kind):
    dice = random.Random(3)

    def spoil(data):
        if dice.random() > 0.05:
            return data
        spoilt = bytearray(data)
        spoilt[dice.randrange(len(spoilt))] ^= 1 << dice.randrange(8)
        return bytes(spoilt)

    bench = following(kind, spoil=spoil).go(5.0)
    assert bench.host.tracking
    assert 10 < bench.host.counters.missed < 110
    assert bench.host.counters.refused_goals == 0


def test_unplugging_is_noticed_and_plugging_in_begins_anew(kind):
    bench = following(kind).go(0.5)
    bench.host.disconnected()
    assert bench.host.lost(bench.t)
    bench.go(1.0)
    assert bench.host.state is ArmState.READY
    assert bench.armed().host.tracking


def test_random_bytes_raise_nothing_and_the_host_moves_on(kind):
    bench, dice = following(kind).go(0.2), random.Random(5)
    for _ in range(3000):
        bench.host.feed(dice.randbytes(dice.randrange(30)), bench.t)
        bench.go(1e-3)
        assert bench.host.due() > bench.t - 0.05
    assert bench.go(2.0).host.linked(bench.t)


def test_servos_that_palmd_has_set_up_pass_every_check_of_their_make(kind):
    bench = ServoBench(kind=kind).go(1.0)
    talk = BenchTalk(bench)
    results = list(examine(talk, talk.axes))
    assert [result for result in results if result.outcome != "passed"] == []
    made = [check for check in CHECKS if check.applies_to(talk.axes[0].make)]
    assert len(results) == 2 * (len(made) - 1) + 1
    assert len(made) == {"dynamixel": 12, "feetech": 9}[kind]
    assert not any(servo.torque for servo in bench.rig._servos), "and are left without torque"


def test_a_servo_gives_under_load_as_published_and_tells_it(kind):
    if kind != "feetech":
        pytest.skip("of the STS3215")
    bench = ServoBench(kind=kind).armed()
    before = bench.reports[-1].pose.joints_rad[0]
    bench.go(0.5)
    for _ in range(100):
        bench.rig._servos[0].set_load(-1.04)
        bench.go(5e-3)
    given = math.degrees(before - bench.go(0.1).reports[-1].pose.joints_rad[0])
    assert 1.6 < given < 2.8
    assert math.degrees(COMPLIANCE_RAD_N_M) * 1.04 == pytest.approx(2.2)
    assert bench.host.tracking
    assert HOME
