"""`python -m tools.conformance`: its arguments and its output."""

import pytest

from tools.conformance.__main__ import main
from tools.conformance.arm import as_text
from tools.conformance.arm_checks import CheckResult


def test_a_failed_check_reports_what_was_sent_expected_and_received():
    text = as_text(CheckResult(7, "numbers", "failed", "Q07*98", "A07", "nothing"))
    assert [line.split(maxsplit=1) for line in text.splitlines()[1:]] == [
        ["sent", "Q07*98"], ["expected", "A07"], ["seen", "nothing"]
    ]  # fmt: skip
    assert text.startswith(" 7 FAIL")


def test_a_configuration_of_another_actuator_is_refused(tmp_path, capsys):
    path = tmp_path / "palmd.yaml"
    path.write_text("pads: {palm1: {port: a}, palm2: {port: b}}\narm: {port: c}\n")
    assert main(["servos", "/dev/nothing", "--config", str(path)]) == 1
    assert "arm.kind is adept" in capsys.readouterr().err


@pytest.mark.parametrize("what", ["arm", "servos"])
def test_a_missing_port_is_reported(what, capsys, monkeypatch):
    monkeypatch.setattr("palmd.daemon.realtime.prepare", lambda *_: [])
    assert main([what, "/dev/nothing"]) == 3
    assert "no such port /dev/nothing" in capsys.readouterr().err
