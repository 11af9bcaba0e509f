"""Doctor, check, init and the daemon's start compare what a touch device reports with the configuration."""

import kernel_touch as kt
import pytest
from kernel_touch import FakeKernel

from palmd.cli import main
from palmd.config.two_palms import Config
from palmd.daemon.pad_units import with_reported_units
from palmd.devices import evdevport
from palmd.devices.pad import inspect_pad, pad_note
from palmd.doctor.ports import device_findings

AXES = {kt.X: (0, 0, 3000, 20), kt.Y: (0, 0, 2000, 20), kt.PRESSURE: (0, 0, 500, 5)}


@pytest.fixture
def device(tmp_path, monkeypatch):
    """Two paths that lead to the emulated device."""

    def made(**values):
        paths = [tmp_path / "event1", tmp_path / "event2"]
        for each in paths:
            each.touch()
        FakeKernel(**{"axes": AXES, "keys": {kt.TOUCH}} | values).install(monkeypatch, evdevport)
        return [str(each) for each in paths]

    return made


def config(paths, **values):
    pads = {f"palm{i}": {"kind": "evdev", "port": path} | values for i, path in enumerate(paths, 1)}
    return Config.model_validate({"rig": {"hinge": "fixed"}, "pads": pads, "arm": {"kind": "dynamixel", "port": "c"}})


def findings(pad, tmp_path):
    return {each.what: each for each in device_findings("pad 1", pad, tmp_path / "palmd.yaml")}


def test_doctor_reports_the_device_its_units_and_the_quantities_it_lacks(device, tmp_path):
    found = findings(config(device()).pads.palm1, tmp_path)
    assert found["pad 1 device"].text == "a test pad, single touch, a pressure pad"
    assert "20 counts/mm" in found["pad 1 units"].text
    assert "plastic" in found["pad 1 senses"].text
    assert {each.verdict for each in found.values()} == {"ok"}


@pytest.mark.parametrize(
    ("values", "pad", "what", "verdict"),
    [
        ({"axes": {}, "keys": {30}}, {}, "pad 1 device", "missing"),
        ({}, {"counts_per_mm": 10.0}, "pad 1 units", "mismatch"),
        ({}, {"newtons_per_count": 0.5}, "pad 1 units", "mismatch"),
        ({"axes": {kt.X: (0, 0, 3000, 0)}}, {}, "pad 1 units", "missing"),
    ],
    ids=["a keyboard", "another scale", "another force", "no scale"],
)
def test_doctor_reports_problems(device, tmp_path, values, pad, what, verdict):
    assert findings(config(device(**values), **pad).pads.palm1, tmp_path)[what].verdict == verdict


CONFIGURATION = """\
rig: {{hinge: fixed}}
pads:
  palm1: {{kind: evdev, port: {0}}}
  palm2: {{kind: evdev, port: {1}, counts_per_mm: 10.0}}
arm: {{kind: dynamixel, port: /dev/c}}
"""


def test_check_reports_where_the_configuration_contradicts_the_device(device, tmp_path, capsys):
    path = tmp_path / "palmd.yaml"
    path.write_text(CONFIGURATION.format(*device()))
    assert main(["check", str(path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{path}:4:" in line
    assert "pads.palm2.counts_per_mm: 10 counts/mm, but a test pad reports 20" in line


def test_check_ignores_absent_devices(tmp_path):
    path = tmp_path / "palmd.yaml"
    path.write_text(CONFIGURATION.format(tmp_path / "none1", tmp_path / "none2"))
    assert main(["check", str(path)]) == 0


def test_the_daemon_uses_reported_units_unless_configured(device):
    found = with_reported_units(config(device()))
    assert found.pads.palm2.counts_per_mm == 20.0
    assert found.pads.palm2.newtons_per_count == pytest.approx(9.80665e-3 / 5)
    own = config(device(), counts_per_mm=19.7, newtons_per_count=0.002)
    assert with_reported_units(own) is own


def test_a_kind_without_a_kernel_device_has_no_findings():
    strip = Config.model_validate(
        {
            "rig": {"hinge": "fixed"},
            "pads": {f"palm{i}": {"kind": "strip", "port": f"p{i}"} for i in (1, 2)},
            "arm": {"kind": "dynamixel", "port": "c"},
        }
    )
    assert inspect_pad(strip.pads.palm1).remarks == ()
    assert pad_note("strip") == ""
    assert with_reported_units(strip) is strip
