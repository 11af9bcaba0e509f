"""The servos' host on the emulated bus: set up, armed, following, stopped; and all that servos do instead."""

import math
import random

import pytest
from servo_bench import HOME, ServoBench

from palmd.devices import dynamixel as dxl
from palmd.devices.actuator import ArmState
from palmd.devices.servohost import LOST_S, cycle_period


def swing(t):
    return (HOME[0] + 0.3 * math.sin(3.0 * t), HOME[1] + 0.2 * math.sin(4.0 * t))


def following(**how):
    bench = ServoBench(**how).armed()
    assert bench.host.tracking
    t0, start = bench.t, bench.reports[-1].pose.joints_rad

    def path(t):
        grown = min((t - t0) / 0.5, 1.0)
        return tuple(s + grown * (w - h) for s, w, h in zip(start, swing(t), swing(t0), strict=True))

    bench.target = path
    return bench


def test_it_sets_what_the_factory_left_and_nothing_twice():
    bench = ServoBench().go(1.0)
    assert bench.host.state is ArmState.READY
    assert bench.host.counters.registers_set == 8, "return delay, drive mode and both limits of each"
    for servo, axis in zip(bench.rig._servos, bench.host.axes, strict=True):
        assert all(servo.get(register) == value for register, value in axis.settings())
        assert not servo.torque
    bench.host.disconnected()
    bench.go(1.0)
    assert bench.host.state is ArmState.READY
    assert bench.host.counters.registers_set == 8


def test_the_pose_is_that_of_the_palms_but_for_play_and_counts():
    bench = ServoBench().go(1.0)
    assert bench.reports[-1].pose.joints_rad == pytest.approx(HOME, abs=math.radians(0.4))
    assert 15 < len([r for r in bench.reports if r.t_sample > 0.2]) < 18, "twenty times a second"


def test_it_arms_where_it_stands_and_follows():
    bench = following()
    before = bench.rig.palms_at(bench.t).angles
    bench.go(0.02)
    assert bench.rig.palms_at(bench.t).angles == pytest.approx(before, abs=math.radians(0.3))
    bench.go(2.0)
    lag = min(
        (max(abs(a - b) for a, b in zip(bench.target(bench.t - d / 1e3), bench.rig.palms_at(bench.t).angles,
                                        strict=True)), d)
        for d in range(80)
    )  # fmt: skip
    assert lag[0] < math.radians(0.3), "but for the play"
    assert 15 < lag[1] < 45
    assert bench.host.counters.missed == bench.host.counters.refused_goals == 0
    assert bench.reports[-1].state is ArmState.TRACKING
    assert bench.sent == pytest.approx(202, abs=3), "a hundred a second"


def test_a_planned_stop_comes_to_rest_and_holds():
    bench = following().go(1.1)
    assert bench.speed > 0.3
    bench.host.request_stop()
    bench.go(0.3)
    assert bench.host.state is ArmState.READY
    assert bench.speed < 1e-3
    assert all(servo.torque and servo.get(dxl.WATCHDOG) == 0 for servo in bench.rig._servos)
    bench.go(1.0)
    assert bench.host.state is ArmState.READY
    assert bench.armed().host.tracking, "and arms again"


def test_servos_stop_when_the_host_dies_and_the_host_hears_of_it_when_it_is_back():
    bench = following().go(1.1)
    assert bench.speed > 0.3
    bench.deaf, t_died = True, bench.t
    bench.go(1.0, lambda: bench.speed < 1e-2)
    assert bench.t - t_died < 0.150
    bench.go(0.3)
    bench.deaf = False
    bench.go(0.5)
    assert bench.host.state is ArmState.READY, "a silence of more than 250 ms ends the link; it begins anew"
    assert not bench.host.tracking


def test_a_short_silence_trips_the_watchdog_which_is_told_and_reset():
    bench = following().go(0.5)
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


@pytest.mark.parametrize(("name", "code"), [("overload", "overload"), ("overheat", "hot"), ("undervoltage", "voltage")])
def test_a_hardware_error_is_named_within_a_tenth_of_a_second_and_reset_restarts_the_servo(name, code):
    bench = following().go(1.0)
    bench.play(name)
    t = bench.t
    bench.go(0.2, lambda: code in bench.host.faults)
    assert bench.t - t < 0.1
    assert not bench.host.tracking
    assert list(bench.host.health(False)) == [f"servo-{code}"]
    bench.go(0.2)
    bench.host.request_reset()
    assert bench.host.busy
    bench.go(1.0, lambda: not bench.host.busy)
    bench.go(0.1)
    assert (bench.host.state, bench.host.error) == (ArmState.READY, "")
    assert bench.armed().host.tracking


def test_a_servo_that_starts_anew_while_it_follows_is_noticed():
    bench = following().go(1.0)
    bench.play("brownout")
    bench.go(1.0)
    assert not bench.host.tracking
    assert bench.host.state in (ArmState.FAULT, ArmState.READY)


def test_a_goal_that_is_not_taken_is_noticed_by_reading_it_back():
    bench = following().go(1.0)
    servo = bench.rig._servos[1]
    servo._set(dxl.MAX_POSITION, servo.get(dxl.GOAL))
    servo._set(dxl.MIN_POSITION, servo.get(dxl.GOAL))
    bench.go(0.06)
    assert "does not accept its goals" in bench.host.error
    assert not bench.host.tracking


def test_a_spoilt_line_costs_cycles_and_no_more():
    dice = random.Random(3)

    def spoil(data):
        if dice.random() > 0.05:
            return data
        spoilt = bytearray(data)
        spoilt[dice.randrange(len(spoilt))] ^= 1 << dice.randrange(8)
        return bytes(spoilt)

    bench = following(spoil=spoil).go(5.0)
    assert bench.host.tracking
    assert 10 < bench.host.counters.missed < 100
    assert bench.host.counters.refused_goals == 0


def test_the_end_of_the_bus_is_the_end_of_the_link():
    bench = following().go(0.5)
    bench.play("power_off")
    t = bench.t
    bench.go(0.4, lambda: bench.host.lost(bench.t))
    assert LOST_S - 0.02 < bench.t - t < LOST_S + 0.02
    bench.play("power_off", begins=False)
    bench.go(2.0)
    assert bench.host.state is ArmState.READY


def test_a_servo_whose_watchdog_does_not_stop_it_is_refused():
    bench = ServoBench()
    bench.rig._servos[1]._set(dxl.MODEL, 1200)
    bench.go(1.0)
    assert "XL330-M288, whose watchdog trips without stopping it" in bench.host.refusal
    assert not bench.host.linked(bench.t) or bench.host.state is ArmState.FAULT
    bench.host.request_tracking()
    assert not bench.go(0.3).host.tracking


def test_goals_beyond_a_servos_range_are_kept_inside_and_counted():
    bench = following()
    bench.target = lambda _t: (math.radians(-30.0), HOME[1])
    bench.go(0.5)
    assert bench.host.counters.bad_targets > 10
    assert bench.host.counters.refused_goals == 0
    assert bench.host.tracking


@pytest.mark.parametrize(("baud", "period_s"), [(115200, 0.040), (1_000_000, 0.010), (4_000_000, 0.010)])
def test_a_cycle_leaves_half_of_the_bus_free(baud, period_s):
    assert cycle_period(baud, 2, dxl.MAKE) == period_s


def test_at_a_slow_bus_it_still_follows():
    bench = following(baud=115200).go(2.0)
    assert bench.host.tracking
    assert bench.host.counters.missed == 0


def test_no_bytes_whatever_make_it_raise():
    dice = random.Random(9)
    bench = following().go(0.2)
    for _ in range(300):
        bench.host.feed(
            bytes(dice.choice((0xFF, 0xFD, 0, 0x55, 1, 2, dice.randrange(256))) for _ in range(40)), bench.t
        )
        bench.go(0.005)


@pytest.mark.parametrize("held_ms", [1, 8, 15, 16, 17, 20, 25, 35])
def test_an_adapter_that_holds_answers_back_arms_and_follows(held_ms):
    bench = ServoBench(held_s=held_ms * 1e-3).go(1.0)
    assert bench.host.state is ArmState.READY
    bench.host.request_tracking()
    while bench.t < 2.0 and not bench.host.tracking:
        bench.go(5e-4)
        assert bench.host.linked(bench.t), "answers are life"
    bench.target = lambda t: (HOME[0] + 0.1 * math.sin(3.0 * (t - 1.0)), HOME[1])
    bench.go(3.0)
    assert bench.host.tracking
    counters = bench.host.counters
    assert (counters.losses, counters.missed, counters.refused_goals) == (0, 0, 0)
    assert len([report for report in bench.reports if report.t_sample > 2.0]) > 2.0 / 0.041
    assert all(servo.torque for servo in bench.rig._servos)


def refuses_torque(servo):
    """Has a servo take everything but its torque."""
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


def test_an_arm_that_takes_long_is_no_loss_of_the_link():
    bench = ServoBench(held_s=0.039).go(2.0)
    refuses_torque(bench.rig._servos[1])
    bench.host.request_tracking()
    while bench.host.busy:
        bench.go(5e-4)
        assert bench.host.linked(bench.t)
    assert "start refused" in bench.host.refusal
    assert not any(servo.torque for servo in bench.rig._servos)


def test_a_failed_arm_leaves_what_held_before_holding():
    bench = following().go(0.5)
    bench.host.request_stop()
    bench.go(0.5)
    refuses_torque(bench.rig._servos[1])
    bench.rig._servos[1]._set(dxl.TORQUE, 0)
    bench.host.request_tracking()
    bench.go(0.5, lambda: not bench.host.busy)
    assert "start refused" in bench.host.refusal
    assert [servo.torque for servo in bench.rig._servos] == [True, False]


@pytest.mark.parametrize("after_s", [0.002, 0.004, 0.006])
def test_an_arm_that_a_silent_servo_ends_leaves_no_torque_on(after_s):
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


def test_a_stop_while_it_arms_turns_the_torque_off_again():
    bench = ServoBench().go(1.0)
    bench.host.request_tracking()
    bench.go(0.5, lambda: any(servo.torque for servo in bench.rig._servos))
    bench.host.request_stop()
    bench.go(0.5)
    assert bench.host.state is ArmState.READY
    assert not any(servo.torque for servo in bench.rig._servos)


@pytest.mark.parametrize("level", [0, 1])
def test_a_status_return_level_that_somebody_left_is_set_right(level):
    bench = ServoBench()
    for servo in bench.rig._servos:
        servo._set(dxl.STATUS_LEVEL, level)
    bench.go(1.0)
    assert bench.host.state is ArmState.READY
    assert all(servo.get(dxl.STATUS_LEVEL) == 2 for servo in bench.rig._servos)
    assert bench.armed().host.tracking


def test_a_lost_bus_names_the_latency_timer_when_answers_were_slow():
    bench = ServoBench(held_s=0.016).go(1.0)
    bench.host.request_tracking()
    bench.play("power_off")
    bench.go(0.5)
    assert "latency timer to 1 ms" in bench.host.refusal
