"""The servos' suite: motion needs consent, and the exit status reports the result."""

from contextlib import nullcontext

import pytest
from servo_bench import MAKES, BenchTalk, ServoBench, tabletop

from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.devices import dynamixel as dxl
from tools.conformance import servos
from tools.conformance.servo_checks import CHECKS


@pytest.fixture
def bench(monkeypatch):
    """Configured servos behind the port; nobody answers questions."""
    bench = ServoBench().go(1.0)
    monkeypatch.setattr(servos, "open_talk", lambda _arm: nullcontext(BenchTalk(bench)))
    monkeypatch.setattr(servos, "confirmed", lambda _question: False)
    return bench


ARM = tabletop().arm


@pytest.mark.parametrize("kind", MAKES)
def test_with_consent_every_check_is_made_and_passes(kind, monkeypatch, capsys):
    bench = ServoBench(kind=kind).go(1.0)
    monkeypatch.setattr(servos, "open_talk", lambda _arm: nullcontext(BenchTalk(bench)))
    assert servos.examine_servos(tabletop(kind=kind).arm, sure=True) == 0
    count = 2 * (sum(check.applies_to(bench.host.axes[0].make) for check in CHECKS) - 1) + 1
    assert f"c: {count} of {count} checks passed, 0 failed\n" in capsys.readouterr().out


def test_without_consent_no_torque_is_applied_and_the_check_does_not_pass(bench, capsys):
    torque = []
    step = bench.rig.step
    bench.rig.step = lambda t: torque.extend(servo.torque for servo in bench.rig._servos) or step(t)
    assert servos.examine_servos(ARM, sure=False) == BAD_INPUT
    assert torque
    assert not any(torque)
    out, err = capsys.readouterr()
    assert "FAIL" not in out
    assert "checks that turn the torque on were skipped: give --yes, or answer yes" in err


def test_servos_that_fail_at_rest_are_not_moved(bench, monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(servos, "confirmed", asked.append)
    bench.rig._servos[0]._set(dxl.TEMPERATURE, 68)
    assert servos.examine_servos(ARM, sure=True) == RIG_FAILED
    out = capsys.readouterr().out
    assert "FAIL  servo 1: " in out
    assert "68 °C" in out
    assert not asked
    assert not any(check.clause in out for check in CHECKS if check.moves)


def test_a_port_that_cannot_be_opened_is_reported():
    with pytest.raises(CliError) as caught:
        servos.examine_servos(ARM, sure=True)
    assert caught.value.status == RIG_FAILED
