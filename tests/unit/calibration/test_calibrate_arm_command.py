"""`palmd calibrate arm`: what it stores and prints, and its messages when it cannot measure."""

import contextlib
import math
import os
import threading
import tty

import numpy as np
import pytest
import yaml

from palmd.calibration import arm as command
from palmd.calibration.linkage import changed
from palmd.cli import main
from palmd.config.any_config import config_hash
from palmd.devices import armhost
from palmd.devices.armlink import ArmState, Pose
from palmd.rig.arm import Linkage
from palmd.rig.controller import ArmLimits, Controller
from palmd.yamlfile import load_config

CONFIG = """\
rig: {{hinge: {hinge}, palm1_length_mm: {length1}, palm2_length_mm: {length2}}}
pads: {{palm1: {{port: /dev/none1}}, palm2: {{port: /dev/none2}}}}
arm: {{port: {port}, base_x_mm: {x}, base_y_mm: {y}, base_yaw_deg: 5.0}}
"""
LINKAGE = Linkage((0.12, 0.0), 0.121, 0.118, (-0.31, 0.02), math.radians(5.0))
LIMITS = ArmLimits(-1.0, 1.0, -1.0, 1.0, v_max=1.0, a_max=10.0)


@pytest.fixture
def configured(tmp_path):
    """Write a configuration that is wrong by some millimetres unless the arguments give the right values."""

    def write(port, hinge="arc", length1=120.0, length2=120.0, x=-300.0, y=0.0):
        path = tmp_path / "palmd.yaml"
        path.write_text(CONFIG.format(port=port, hinge=hinge, length1=length1, length2=length2, x=x, y=y))
        return path

    return write


def large_swing(count):
    """The palms' angles (rad) at the given number of reports."""
    phi1, phi2 = (0.5 - 0.5 * math.cos(math.tau * count / period) for period in (61, 43))
    return math.radians(10.0 + 100.0 * phi1), math.radians(40.0 + 70.0 * phi2)


@contextlib.contextmanager
def arm(swing=large_swing, state=ArmState.MANUAL, tool=0.0, deaf=()):
    """A controller at the far end of a terminal, moved by hand a bit further with each report; yields its port."""
    master, slave = os.openpty()
    tty.setraw(slave)
    over = threading.Event()
    controller = Controller(LIMITS, Pose(0.0, 0.0, 0.0), 38400, lambda _pose, _t: None)
    rng = np.random.default_rng(1)

    def answer():
        while not over.is_set():
            with contextlib.suppress(OSError):
                data = os.read(master, 1000)
                count = controller.counters.commands
                pose = LINKAGE.pose(*swing(count))
                x, y = np.array([pose.x_m, pose.y_m]) + rng.normal(0.0, 1.5e-5, 2)
                controller.move_by_hand(Pose(x, y, math.remainder(pose.t_rad - tool, math.tau)))
                controller.state = state
                message = controller.feed(data, 0.0, controller.path)
                if count not in deaf:
                    os.write(master, message)

    thread = threading.Thread(target=answer)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        over.set()
        os.write(slave, b"\n")
        thread.join()
        os.close(slave)
        os.close(master)


@pytest.fixture(autouse=True)
def brisk(monkeypatch):
    monkeypatch.setattr(armhost, "QUERY_S", 0.003)
    monkeypatch.setattr(command, "FIRST_MOTION_S", 0.3)
    monkeypatch.setattr(command, "between", lambda *_: float)


def calibrate(config, *more):
    return main(["calibrate", "arm", str(config), "--seconds", "1.2", *map(str, more)])


def refused(config, capsys, status=3):
    """The one line of its error message."""
    assert calibrate(config) == status
    out, err = capsys.readouterr()
    assert out == ""
    assert not list(config.parent.glob("**/arm.yaml"))
    return err.splitlines()[-1]


def test_the_proposed_settings_are_those_of_the_arm(configured, capsys):
    with arm() as port:
        config = configured(port)
        assert calibrate(config) == 0
    result = yaml.safe_load((config.parent / "calibration/arm.yaml").read_text())
    assert result["palmd_arm_calibration"] == 1
    proposed_settings = result["configuration"]
    assert proposed_settings["rig"]["palm1_length_mm"] == pytest.approx(121.0, abs=0.03)
    assert proposed_settings["rig"]["palm2_length_mm"] == pytest.approx(118.0, abs=0.03)
    assert proposed_settings["arm"]["base_x_mm"] == pytest.approx(-310.0, abs=0.03)
    assert proposed_settings["arm"]["base_y_mm"] == pytest.approx(20.0, abs=0.03)
    found = result["found"]
    assert abs(found["tool_deg"]) < 4.0 * found["tool_sd_deg"] < 0.05
    assert found["rms_mm"] == pytest.approx(0.015, rel=0.3)
    out, err = capsys.readouterr()
    assert out.startswith(f"arm: {found['poses']} poses")
    assert f"  arm: {{base_x_mm: {proposed_settings['arm']['base_x_mm']}" in out
    assert "TOOL" not in err
    rig, arm_ = proposed_settings["rig"], proposed_settings["arm"]
    configured(port, "arc", rig["palm1_length_mm"], rig["palm2_length_mm"], arm_["base_x_mm"], arm_["base_y_mm"])
    mended = load_config(config)
    assert config_hash(changed(mended, {}, {})) == result["settings_sha256"]
    pose = LINKAGE.pose(0.7, 1.5)
    assert Linkage.from_config(mended).angles(pose.x_m, pose.y_m) == pytest.approx((0.7, 1.5), abs=3e-4)


def test_a_rotated_tool_is_reported_and_changes_no_other_setting(configured, capsys):
    with arm(tool=math.radians(2.0)) as port:
        config = configured(port)
        assert calibrate(config, "-o", config.parent / "there") == 0
    result = yaml.safe_load((config.parent / "there/arm.yaml").read_text())
    assert result["found"]["tool_deg"] == pytest.approx(2.0, abs=0.02)
    assert result["configuration"]["rig"]["palm2_length_mm"] == pytest.approx(118.0, abs=0.03)
    assert "the tool angle is +2.0" in capsys.readouterr().err


def test_lost_answers_and_power_off_are_tolerated(configured):
    with arm(state=ArmState.POWER_OFF, deaf={3, 4, 20, 21, 60, 70, 80}) as port:
        assert calibrate(configured(port)) == 0


@pytest.mark.parametrize("state", [ArmState.READY, ArmState.TRACKING, ArmState.FAULT])
def test_an_arm_outside_manual_mode_is_refused(configured, capsys, state):
    with arm(state=state) as port:
        message = refused(configured(port), capsys)
    assert f"state {state}: switch it to manual mode (M)" in message


@pytest.mark.parametrize(
    ("swing", "why"),
    [
        (lambda count: (0.6, large_swing(count)[1]), "arm: the arm turned about one point"),
        (lambda _count: (0.6, 1.5), "no motion within"),
    ],
    ids=["one palm alone", "nobody"],
)
def test_too_little_swing_is_refused(configured, capsys, swing, why):
    with arm(swing=swing) as port:
        assert why in refused(configured(port), capsys)


def test_a_silent_controller_is_reported(configured, capsys, monkeypatch):
    monkeypatch.setattr(command, "FIRST_MOTION_S", 20.0)
    with arm(deaf=range(1000)) as port:
        assert "does not answer; is the controller's program running?" in refused(configured(port), capsys)


def test_a_missing_port_and_a_port_held_by_the_daemon_are_reported(configured, capsys, monkeypatch):
    assert refused(configured("/dev/none3"), capsys).startswith("arm: no such port /dev/none3")
    monkeypatch.setattr(command, "holders", lambda _path: [(77, "palmd")])
    assert refused(configured("/dev/none3"), capsys) == (
        "arm: /dev/none3 is held by palmd (process 77): stop the daemon first"
    )


def test_a_fixed_hinge_has_no_arm_to_calibrate(configured, capsys):
    assert "rig.hinge" in refused(configured("/dev/none3", hinge="fixed"), capsys, status=1)


@pytest.mark.parametrize("seconds", ["2", "601", "nan"])
def test_the_duration_is_checked(configured, monkeypatch, seconds):
    monkeypatch.undo()
    with pytest.raises(SystemExit) as ended:
        calibrate(configured("/dev/none3"), "--seconds", seconds)
    assert ended.value.code == 2
