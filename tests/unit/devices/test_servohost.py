"""The servos' host on the emulated bus of each make: set-up, arming, following, stopping, and servo failures."""

import math
import random

import pytest
from servo_bench import HOME, MAKES, BenchTalk, ServoBench

from palmd.devices import dynamixel as dxl
from palmd.devices.actuator import LOST_S, ArmState
from palmd.devices.servohost import cycle_period
from tools.conformance.servo_checks import CHECKS, examine

of_every_make = pytest.mark.parametrize("kind", MAKES)
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


@of_every_make
def test_factory_settings_are_changed_once_even_without_power(kind):
    bench = ServoBench(kind=kind).go(1.0)
    assert bench.host.state is ArmState.READY
    changed = bench.host.counters.registers_set
    assert changed > 0
    for name, begins in (("power_off", True), ("power_off", False)):
        bench.play(name, begins)
        bench.go(1.5)
    assert bench.host.state is ArmState.READY
    assert bench.host.counters.registers_set == changed, "settings are kept without power"
    for servo, axis in zip(bench.rig._servos, bench.host.axes, strict=True):
        assert all(servo.get(register) == value for register, value in axis.settings())
        assert not servo.torque


@of_every_make
def test_arming_keeps_the_pose_and_the_servos_follow_within_friction(kind):
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
    assert bench.sent == pytest.approx(202, abs=3), "a hundred a second"


@of_every_make
def test_palms_deviate_from_the_report_by_half_of_the_play(kind):
    bench = ServoBench(kind=kind).go(1.0)
    assert 15 < len([r for r in bench.reports if r.t_sample > 0.2]) < 18, "twenty times a second"
    bench.armed().go(0.5)
    off = [
        math.degrees(abs(a - b))
        for a, b in zip(bench.rig.palms_at(bench.t).angles, bench.reports[-1].pose.joints_rad, strict=True)
    ]
    assert off[0] == pytest.approx(0.5 * PLAY_DEG[kind], abs=0.1)
    assert off[1] == pytest.approx(PLAY_DEG[kind], abs=0.15), "of both palms"


@of_every_make
def test_a_planned_stop_comes_to_rest_and_holds(kind):
    bench = following(kind).go(1.1)
    bench.host.request_stop()
    bench.go(0.3)
    assert bench.host.state is ArmState.READY
    assert bench.speed < 1e-3
    assert all(servo.torque for servo in bench.rig._servos)
    bench.go(1.0)
    assert bench.armed().host.tracking, "and arms again"


@of_every_make
@pytest.mark.parametrize(("name", "code"), [("overload", "overload"), ("overheat", "hot"), ("undervoltage", "voltage")])
def test_a_hardware_error_is_reported_within_a_tenth_of_a_second_and_cleared_by_reset(kind, name, code):
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


@of_every_make
def test_a_servo_that_loses_power_while_following_is_detected(kind):
    bench = following(kind).go(1.0)
    bench.play("brownout")
    bench.go(1.0)
    assert not bench.host.tracking


@of_every_make
def test_servos_come_to_rest_when_the_host_dies(kind):
    bench = following(kind).go(1.1)
    assert bench.speed > 0.3
    bench.deaf, t_died = True, bench.t
    bench.go(1.0, lambda: bench.speed < 1e-2)
    assert bench.t - t_died < 0.15, "by a watchdog, or at the last goal"
    bench.go(0.3)
    bench.deaf = False
    bench.go(0.5)
    assert bench.host.state is ArmState.READY, "a silence of more than 250 ms ends the link; it starts again"
    assert not bench.host.tracking


@of_every_make
def test_a_damaged_line_costs_only_cycles(kind):
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


@of_every_make
def test_unplugging_is_detected_and_the_link_returns_after_replugging(kind):
    bench = following(kind).go(0.5)
    bench.host.disconnected()
    assert bench.host.lost(bench.t)
    bench.go(1.0)
    assert bench.host.state is ArmState.READY
    assert bench.armed().host.tracking


@of_every_make
def test_random_bytes_raise_nothing_and_the_host_continues(kind):
    bench, dice = following(kind).go(0.2), random.Random(5)
    for _ in range(1000):
        bench.host.feed(dice.randbytes(dice.randrange(30)), bench.t)
        bench.go(1e-3)
        assert bench.host.due() > bench.t - 0.05
    assert bench.go(2.0).host.linked(bench.t)


@of_every_make
def test_configured_servos_pass_every_check_of_their_make(kind):
    bench = ServoBench(kind=kind).go(1.0)
    talk = BenchTalk(bench)
    results = list(examine(talk))
    assert [result for result in results if result.outcome != "passed"] == []
    made = [check for check in CHECKS if check.applies_to(talk.axes[0].make)]
    assert len(results) == 2 * (len(made) - 1) + 1
    assert len(made) == {"dynamixel": 12, "feetech": 9}[kind]
    assert not any(servo.torque for servo in bench.rig._servos), "the torque is off afterwards"


def test_a_servo_yields_under_load_as_published_and_reports_it():
    bench = ServoBench(kind="feetech").armed()
    before = bench.reports[-1].pose.joints_rad[0]
    bench.go(0.5)
    for _ in range(100):
        bench.rig._servos[0].set_load(-1.04)
        bench.go(5e-3)
    given = math.degrees(before - bench.go(0.1).reports[-1].pose.joints_rad[0])
    assert 1.6 < given < 2.8
    assert bench.host.tracking


def test_a_short_silence_trips_the_watchdog_which_is_reported_and_reset():
    bench = following("dynamixel").go(0.5)
    bench.deaf = True
    bench.go(0.150)
    bench.deaf = False
    bench.go(0.05)
    assert "watchdog" in bench.host.faults
    assert bench.host.state is ArmState.FAULT
    assert not bench.host.tracking
    bench.go(0.5)
    assert bench.host.state is ArmState.FAULT, "until it is reset"
    bench.host.request_reset()
    bench.go(0.5)
    assert (bench.host.state, bench.host.error) == (ArmState.READY, "")
    assert bench.armed().host.tracking


def test_a_goal_that_is_not_accepted_is_detected_by_reading_it_back():
    bench = following("dynamixel").go(1.0)
    servo = bench.rig._servos[1]
    servo._set(dxl.MAX_POSITION, servo.get(dxl.GOAL))
    servo._set(dxl.MIN_POSITION, servo.get(dxl.GOAL))
    bench.go(0.06)
    assert "does not accept its goals" in bench.host.error
    assert not bench.host.tracking


def test_a_broken_bus_ends_the_link():
    bench = following("dynamixel").go(0.5)
    bench.play("power_off")
    t = bench.t
    bench.go(0.4, lambda: bench.host.lost(bench.t))
    assert LOST_S - 0.02 < bench.t - t < LOST_S + 0.02
    bench.play("power_off", begins=False)
    bench.go(2.0)
    assert bench.host.state is ArmState.READY


def test_a_servo_not_stopped_by_its_watchdog_is_refused():
    bench = ServoBench()
    bench.rig._servos[1]._set(dxl.MODEL, 1200)
    bench.go(1.0)
    assert "XL330-M288, whose watchdog trips without stopping it" in bench.host.refusal
    assert not bench.host.linked(bench.t) or bench.host.state is ArmState.FAULT
    bench.host.request_tracking()
    assert not bench.go(0.3).host.tracking


def test_goals_beyond_a_servos_range_are_clamped_and_counted():
    bench = following("dynamixel")
    bench.target = lambda _t: (math.radians(-30.0), HOME[1])
    bench.go(0.5)
    assert bench.host.counters.bad_targets > 10
    assert bench.host.counters.refused_goals == 0
    assert bench.host.tracking


@pytest.mark.parametrize(("baud", "period_s"), [(115200, 0.040), (1_000_000, 0.010), (4_000_000, 0.010)])
def test_a_cycle_leaves_half_of_the_bus_time_free(baud, period_s):
    assert cycle_period(baud, 2, dxl.MAKE) == period_s


def test_servos_follow_on_a_slow_bus():
    bench = following("dynamixel", baud=115200).go(2.0)
    assert bench.host.tracking
    assert bench.host.counters.missed == 0


@pytest.mark.parametrize("held_ms", [1, 8, 16, 17, 25, 35])
def test_an_adapter_that_delays_answers_arms_and_follows(held_ms):
    bench = ServoBench(held_s=held_ms * 1e-3).go(1.0)
    assert bench.host.state is ArmState.READY
    bench.host.request_tracking()
    while bench.t < 2.0 and not bench.host.tracking:
        bench.go(5e-4)
        assert bench.host.linked(bench.t), "answers keep the link alive"
    bench.target = lambda t: (HOME[0] + 0.1 * math.sin(3.0 * (t - 1.0)), HOME[1])
    bench.go(3.0)
    assert bench.host.tracking
    counters = bench.host.counters
    assert (counters.losses, counters.missed, counters.refused_goals) == (0, 0, 0)
    assert len([report for report in bench.reports if report.t_sample > 2.0]) > 2.0 / 0.041
    assert all(servo.torque for servo in bench.rig._servos)


def refuses_torque(servo):
    """Makes a servo refuse only its torque."""
    write = servo.write

    def without_torque(address, data, t):
        return 1 if address == dxl.TORQUE.address and data[0] else write(address, data, t)

    servo.write = without_torque


def test_a_failed_arm_turns_off_the_torque_that_it_turned_on():
    bench = ServoBench().go(1.0)
    refuses_torque(bench.rig._servos[1])
    bench.host.request_tracking()
    assert bench.host.busy
    bench.go(0.5, lambda: not bench.host.busy)
    assert "start refused: servo 2 has 0 in register 64" in bench.host.refusal
    assert bench.host.state is ArmState.READY
    assert not any(servo.torque for servo in bench.rig._servos)


def test_slow_arming_is_no_loss_of_the_link():
    bench = ServoBench(held_s=0.039).go(2.0)
    refuses_torque(bench.rig._servos[1])
    bench.host.request_tracking()
    while bench.host.busy:
        bench.go(5e-4)
        assert bench.host.linked(bench.t)
    assert "start refused" in bench.host.refusal
    assert not any(servo.torque for servo in bench.rig._servos)


def test_a_failed_arm_keeps_the_torque_of_servos_that_held_before():
    bench = following("dynamixel").go(0.5)
    bench.host.request_stop()
    bench.go(0.5)
    refuses_torque(bench.rig._servos[1])
    bench.rig._servos[1]._set(dxl.TORQUE, 0)
    bench.host.request_tracking()
    bench.go(0.5, lambda: not bench.host.busy)
    assert "start refused" in bench.host.refusal
    assert [servo.torque for servo in bench.rig._servos] == [True, False]


@pytest.mark.parametrize("after_s", [0.002, 0.004, 0.006])
def test_an_arm_ended_by_a_silent_servo_leaves_no_torque_on(after_s):
    bench = ServoBench().go(1.0)
    bench.host.request_tracking()
    bench.go(after_s)
    bench.rig._servos[1].restart(bench.t, silent_s=0.5)
    bench.go(0.4, lambda: not bench.host.busy and not bench.host.tracking)
    bench.go(2.0)
    assert bench.host.state in (ArmState.READY, ArmState.FAULT)
    assert not bench.rig._servos[1].torque
    assert not bench.host.tracking
    if "failed" in (bench.host.refusal or ""):
        assert not bench.rig._servos[0].torque


def test_a_stop_during_arming_turns_the_torque_off_again():
    bench = ServoBench().go(1.0)
    bench.host.request_tracking()
    bench.go(0.5, lambda: any(servo.torque for servo in bench.rig._servos))
    bench.host.request_stop()
    bench.go(0.5)
    assert bench.host.state is ArmState.READY
    assert not any(servo.torque for servo in bench.rig._servos)


@pytest.mark.parametrize("level", [0, 1])
def test_a_wrong_status_return_level_is_corrected(level):
    bench = ServoBench()
    for servo in bench.rig._servos:
        servo._set(dxl.STATUS_LEVEL, level)
    bench.go(1.0)
    assert bench.host.state is ArmState.READY
    assert all(servo.get(dxl.STATUS_LEVEL) == 2 for servo in bench.rig._servos)
    assert bench.armed().host.tracking


def test_a_lost_bus_with_slow_answers_names_the_latency_timer():
    bench = ServoBench(held_s=0.016).go(1.0)
    bench.host.request_tracking()
    bench.play("power_off")
    bench.go(0.5)
    assert "latency timer to 1 ms" in bench.host.refusal
