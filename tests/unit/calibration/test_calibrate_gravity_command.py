"""`palmd calibrate gravity` against a daemon's sockets: what it requests and stores, and what prevents it."""

import math
import threading
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import yaml
from rolls import rolled

from palmd.calibration import rolling_session
from palmd.calibration.gravity import proposed_settings, remarks
from palmd.calibration.linkage import changed
from palmd.calibration.rolling_fit import GravityFit
from palmd.calibration.rolling_session import Slope, slopes_within
from palmd.cli import main
from palmd.config.any_config import config_hash
from palmd.config.two_palms import LimitsConfig, PlanSpec
from palmd.console.errors import CliError
from palmd.daemon.bus import Bus
from palmd.daemon.commands import Reply
from palmd.events import PadSample, PalmSample
from palmd.messages import events_fields
from palmd.motion.check import motion_limits
from palmd.motion.plan import compile_plan
from palmd.quantities import EVENTS, INFO
from palmd.yamlfile import load_config

CONFIG = """\
rig: {{gravity_m_s2: 9.5}}
pads: {{palm1: {{port: /dev/none1}}, palm2: {{port: /dev/none2}}}}
arm: {{port: /dev/none3, base_x_mm: -280.0, base_y_mm: 30.0, base_yaw_deg: 1.0}}
bus: {{publish: "ipc://{folder}/publish", command: "ipc://{folder}/command"}}
"""
FAULTY = 4  # number of the plan at whose pose the fault comes, if any: the third slope
G, YAW_ERROR = 9.2, math.radians(1.5)


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "palmd.yaml"
    path.write_text(CONFIG.format(folder=tmp_path))
    return path


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(rolling_session, "LOOK_S", 0.05)
    monkeypatch.setattr(rolling_session, "SETTLED_S", 0.05)
    monkeypatch.setattr(rolling_session, "PATIENCE_S", 1.5)


class Daemon:
    """Executes each plan at once; there the roller rolls unless `lazy`."""

    def __init__(self, path, refuses=(), lazy=False, touched=False, fault_after=None, hash=None, most=180.0):
        self.state, self.asked, self.poses, self.plans = "ready", [], [], []
        self._most_phi1_deg = most
        self.info = {"config_hash": hash or config_hash(load_config(path))}
        self._refuses, self._lazy, self._touched, self._fault_after = refuses, lazy, touched, fault_after
        self._rng, self._t = np.random.default_rng(7), 0.0
        self._rolling = False
        self.fault_reported = threading.Event()

    def answer(self, request):
        name = request.name
        if name == "status":
            return Reply(request, None, self._status())
        self.asked.append(name)
        if name in self._refuses:
            return Reply(request, f"{name} refused: the state is\n{self.state}")
        match name:
            case "plan":
                spec = PlanSpec.model_validate(yaml.safe_load(request.args["text"]))
                self.plans.append(spec)
                if any(segment.move.phi1_deg > self._most_phi1_deg for segment in spec.segments):
                    return Reply(request, "plan refused: the arm's x reaches 500 mm, the limit is 400 mm")
                self.poses.append((spec.segments[0].move.phi1_deg, spec.segments[0].move.phi2_deg))
                self._rolling = False
            case "arm":
                self.state = "tracking"
            case "start":
                self._rolling = True
            case "stop":
                self.state = "ready"
        return Reply(request, None, {"state": self.state})

    def _status(self):
        if self.state == "fault":
            self.fault_reported.set()
        grave = ["arm-estop"] if self.state == "fault" else []
        return {"state": self.state, "cause": "stop was requested", "over": self._rolling, "moving": False,
                "faults": grave, "severities": ["stop"] * len(grave), "hints": ["release it"] * len(grave)}  # fmt: skip

    def events(self):
        """Events since the last call."""
        self._t += 1.0
        touch = [PadSample(self._t, 1, 0.03, 0.2)] if self._touched else []
        if not (self._rolling and self.poses) or self._lazy:
            return touch
        if self._fault_after is not None and len(self.poses) == FAULTY and self.state == "tracking":
            self._fault_after -= 1
            self.state = "fault" if self._fault_after < 0 else self.state
        phi1, phi2 = self.poses[-1]
        palm = 1 if phi1 < 40.0 else 2
        readings, self._t = rolled(self._rng, palm, phi1, phi2, G, YAW_ERROR, self._t)
        return [PalmSample(self._t, (math.radians(phi1), math.radians(phi2))), *readings]


@contextmanager
def serving(path, daemon):
    """Serve the daemon at its sockets."""
    folder = path.parent
    bus, over = Bus(f"ipc://{folder}/publish", f"ipc://{folder}/command"), threading.Event()

    def serve():
        while not over.wait(0.02):
            bus.publish(INFO, dict(daemon.info), 0.0, 0.0)
            bus.publish(EVENTS, events_fields(0.0, daemon.events()), 0.0, 0.0)
            for request in bus.receive():
                bus.reply(daemon.answer(request))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        bus.close()


def calibrate(path, *more):
    return main(["calibrate", "gravity", str(path), "--clear", "0.2", *map(str, more)])


def refused(path, capsys, status, *more):
    """The one line of its error message; nothing is stored."""
    assert calibrate(path, *more) == status
    out, err = capsys.readouterr()
    assert out == ""
    assert not list(path.parent.glob("**/gravity.yaml"))
    return err.splitlines()[-1]


def base_in_arm(sections):
    """Position of the palms' base in arm coordinates (mm), by complex numbers."""
    offset = complex(*sections.rig.base_mm) - complex(sections.arm.base_x_mm, sections.arm.base_y_mm)
    turned = offset * np.exp(-1j * math.radians(sections.arm.base_yaw_deg))
    return turned.real, turned.imag


def test_four_slopes_determine_gravity_and_yaw(path, capsys):
    daemon = Daemon(path)
    with serving(path, daemon):
        assert calibrate(path, "--rolls", 12) == 0
    assert daemon.asked == ["plan", "arm", *["plan", "start"] * 4, "stop"]
    assert daemon.poses == [(8.0, 110.0), (8.0, 110.0), (26.0, 110.0), (41.0, 110.0), (59.0, 110.0)]
    result = yaml.safe_load((path.parent / "calibration/gravity.yaml").read_text())
    found = result["found"]
    assert result["palmd_gravity_calibration"] == 1
    assert result["roller"] == "ball"
    assert abs(found["gravity_m_s2"] - G) < 4.0 * found["gravity_sd_m_s2"] < 0.2
    assert found["yaw_error_deg"] == pytest.approx(1.5, abs=0.1)
    assert [(row["pad"], row["slope_deg"]) for row in found["slopes"]] == [(1, 8.0), (1, 26.0), (2, 11.0), (2, 29.0)]
    assert all(abs(row["left_m_s2"]) < 4.0 * row["left_sd_m_s2"] for row in found["slopes"])
    out, err = capsys.readouterr()
    assert out.startswith("gravity: ")
    assert "palm 2   29.0°" in out
    assert "place the roller at the upper end of palm 2" in err
    before = load_config(path)
    after = changed(before, result["configuration"]["rig"], result["configuration"]["arm"])
    assert config_hash(after) == result["settings_sha256"]
    assert base_in_arm(after) == pytest.approx(base_in_arm(before), abs=2e-3)
    assert after.arm.base_yaw_deg - before.arm.base_yaw_deg == pytest.approx(found["yaw_error_deg"], abs=1e-3)


def test_all_slopes_are_checked_before_the_first_motion(path, capsys):
    daemon = Daemon(path, most=50.0)
    with serving(path, daemon):
        assert "the arm's x reaches" in refused(path, capsys, 1)
    assert daemon.asked == ["plan"]
    config = load_config(path)
    slow = config.limits.model_copy(update={"rate_deg_s": 1.0, "acceleration_deg_s2": 1.0})
    slow_limits = motion_limits(config.model_copy(update={"limits": slow}))
    ends = compile_plan(daemon.plans[0], slow_limits).rounds[0].segments
    assert [round(math.degrees(each.at(each.duration).angles[0])) for each in ends] == [8, 26, 41, 59]


def test_a_daemon_with_another_configuration_is_refused(path, capsys):
    daemon = Daemon(path, hash="0" * 64)
    with serving(path, daemon):
        assert "another configuration" in refused(path, capsys, 1)
    assert daemon.asked == []


@pytest.mark.parametrize(
    ("command", "asked"),
    [("plan", ["plan"]), ("arm", ["plan", "arm"]), ("start", ["plan", "arm", "plan", "start", "hold", "stop"])],
)
def test_a_refusal_is_reported_in_one_line_with_the_daemons_text(path, capsys, command, asked):
    daemon = Daemon(path, refuses=(command,))
    with serving(path, daemon):
        assert (
            refused(path, capsys, 1)
            == f"{command} refused: the state is {'tracking' if command == 'start' else 'ready'}"
        )
    assert daemon.asked == asked


def test_slopes_without_rolls_are_reported(path, capsys):
    daemon = Daemon(path, lazy=True)
    with serving(path, daemon):
        message = refused(path, capsys, 3)
    assert "palm 1, 8°: 0 good rolls of 13 needed" in message
    assert message.endswith("nothing touches its pad")
    assert daemon.asked[-2:] == ["hold", "stop"]


def test_nothing_moves_while_something_touches_the_pads(path, capsys):
    daemon = Daemon(path, touched=True)
    with serving(path, daemon):
        assert "something touches the pads" in refused(path, capsys, 3)
    assert "start" not in daemon.asked


def test_a_persistent_fault_ends_the_calibration(path, capsys):
    daemon = Daemon(path, fault_after=4)
    with serving(path, daemon):
        assert refused(path, capsys, 3) == "gravity: arm-estop: release it"


def test_after_a_cleared_fault_it_continues_and_keeps_its_rolls(path, capsys):
    daemon = Daemon(path, fault_after=2)

    def mend():
        daemon.fault_reported.wait()
        daemon.fault_reported.clear()
        daemon.fault_reported.wait()  # the command has read and printed it by now
        daemon.state, daemon._rolling, daemon._fault_after = "tracking", False, None

    person = threading.Thread(target=mend)
    with serving(path, daemon):
        person.start()
        assert calibrate(path, "--rolls", 6) == 0
        person.join()
    assert len(daemon.poses) == 6  # one of them twice
    err = capsys.readouterr().err
    assert "arm-estop: release it; after clearing it: palmd ctl reset, palmd ctl arm" in err


def test_slopes_are_within_the_limits():
    for phi1, phi2 in (((6, 150), (35, 155)), ((20, 70), (75, 105)), ((0, 60), (100, 160)), ((30, 180), (40, 80))):
        limits = LimitsConfig(phi1_deg=phi1, phi2_deg=phi2)
        found = list(slopes_within(limits, 40))
        assert [each.rolls for each in found] == [13, 40, 40, 13]
        for each in found:
            for (low, high), angle in zip((phi1, phi2), each.angles_deg, strict=True):
                assert low < angle < high
            assert sum(each.angles_deg) < 172.0
    with pytest.raises(CliError, match="limits: they allow no two slopes"):
        list(slopes_within(LimitsConfig(phi1_deg=(45, 50), phi2_deg=(75, 105)), 40))
    assert str(Slope(2, (41.0, 110.0), 3)) == "palm 2, 29°"


def test_a_yaw_without_error_changes_no_setting(path):
    config = load_config(path)
    values = proposed_settings(GravityFit(9.5, 0.0, 0.0, 0.01, 1e-4, 1e-4, 1.0, (), 0), config)
    assert values == {
        "rig": {"gravity_m_s2": 9.5}, "arm": {"base_x_mm": -280.0, "base_y_mm": 30.0, "base_yaw_deg": 1.0}
    }  # fmt: skip


def test_implausible_fits_cause_remarks():
    fit = GravityFit(9.8, 0.0, 0.003, 0.01, 1e-4, 1e-4, 1.0, (), 0)
    assert remarks(fit, "ball") == []
    assert "counts_per_mm, and that it is a ball" in remarks(replace(fit, g=9.9), "ball")[0]
    assert "a negative resistance" in remarks(replace(fit, resistance=-0.001), "ball")[0]
    assert "round and clean" in remarks(replace(fit, scatter=2.5), "ball")[0]


@pytest.mark.parametrize(
    ("option", "value"), [("--rolls", "3"), ("--rolls", "many"), ("--clear", "0"), ("--roller", "cube")]
)
def test_arguments_are_checked(path, option, value):
    with pytest.raises(SystemExit) as ended:
        calibrate(path, option, value)
    assert ended.value.code == 2
