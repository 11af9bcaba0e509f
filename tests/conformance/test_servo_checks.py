"""The servos' conformance test: configured emulated servos pass, and each deviation fails its own check."""

import pytest
from servo_bench import BenchTalk, ServoBench

from palmd.devices import dynamixel as dxl
from tools.conformance.servo_checks import examine


@pytest.fixture
def bench():
    return ServoBench().go(1.0)


def failures(talk):
    return {result.number: result for result in examine(talk) if result.outcome == "failed"}


def test_servos_with_factory_settings_fail():
    talk = BenchTalk(ServoBench())
    found = failures(talk)
    assert set(found) == {5, 9, 12}, "the limits and the profile by time are among them"
    assert "register 9 is 250, 0 is needed" in found[5].seen
    assert "palmd run sets it" in found[5].fix


@pytest.mark.parametrize(
    ("register", "value", "check", "says"),
    [
        (dxl.MODEL, 1200, 2, "trips without stopping"),
        (dxl.MODEL, 311, 2, "model 311"),
        (dxl.HARDWARE_ERROR, 0x20, 4, "hardware error 0x20"),
        (dxl.VOLTAGE, 74, 4, "7.4 V"),
        (dxl.TEMPERATURE, 68, 4, "68 °C"),
        (dxl.HOMING_OFFSET, -512, 5, "register 20 is -512"),
    ],
)
def test_a_wrong_register_is_found(bench, register, value, check, says):
    bench.rig._servos[1]._set(register, value)
    found = failures(BenchTalk(bench))
    assert found[check].servo == 2
    assert says in found[check].seen
    assert found[check].fix


def test_an_adapter_that_delays_answers_is_found(bench):
    found = failures(BenchTalk(bench, late_s=0.016))
    assert "latency timer" in found[1].fix
    assert 7 in found


def test_a_missing_servo_is_asked_once(bench):
    bench.rig._servos[0].restart(bench.t, silent_s=1e9)
    talk = BenchTalk(bench)
    results = list(examine(talk))
    first = [result for result in results if result.servo == 1]
    assert [result.number for result in first] == [1]
    assert "id 1 does not answer at 1000000 bit/s" in first[0].seen


def test_a_servo_that_moves_on_during_silence_is_found(bench):
    """As the 330 size does: the watchdog's register reports that it has tripped, and the servo goes to its goal."""
    servo = bench.rig._servos[0]
    stop, servo._stop = servo._stop, lambda t: stop(t) if t >= servo._t_arrival else None
    found = failures(BenchTalk(bench))
    assert set(found) == {12}
    assert "do not use it" in found[12].fix


@pytest.mark.parametrize("level", [0, 1])
def test_a_wrong_status_return_level_is_reported_as_such_and_not_as_a_cable_fault(bench, level):
    bench.rig._servos[0]._set(dxl.STATUS_LEVEL, level)
    found = [result for result in failures(BenchTalk(bench)).values() if result.servo == 1]
    assert found
    assert any("status return level" in result.seen or "register 68" in result.seen for result in found)
    assert not any("cable" in result.fix for result in found)
