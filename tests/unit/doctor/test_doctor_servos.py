"""Findings of `palmd doctor` about servos."""

from contextlib import nullcontext

from servo_bench import BenchTalk, ServoBench, tabletop

from palmd.devices import dynamixel as dxl
from palmd.doctor import servos

ARM = tabletop().arm


def found(monkeypatch, bench):
    monkeypatch.setattr(servos, "open_talk", lambda _arm: nullcontext(BenchTalk(bench)))
    return list(servos.findings(ARM))


def test_each_problem_is_named_with_its_fix(monkeypatch):
    bench = ServoBench().go(1.0)
    bench.rig._servos[1]._set(dxl.TEMPERATURE, 68)
    findings = found(monkeypatch, bench)
    missing = [finding for finding in findings if finding.verdict != "ok"]
    assert len(findings) == 13
    assert [(each.what, each.fix) for each in missing] == [("servo 2", "let it cool down; use lighter palms")]
    assert "68 °C" in missing[0].text


def test_a_missing_servo_is_asked_once(monkeypatch):
    bench = ServoBench().go(1.0)
    bench.rig._servos[0].restart(bench.t, silent_s=1e9)
    findings = found(monkeypatch, bench)
    assert [each.what for each in findings].count("servo 1") == 1
    assert "id 1 does not answer" in findings[0].text


def test_a_port_that_cannot_be_opened_is_reported():
    assert [(found.what, found.verdict) for found in servos.findings(ARM)] == [("servos", "missing")]
