"""`palmd calibrate pads`, `force` and `standoff`: what they find, store and print, and their error messages.

They run on the daemon's core and the emulated rig, whose pads differ from the daemon's configuration.
"""

import threading
import time

import pytest
import yaml
from virtual_rig import running
from waiting import wait

from palmd.calibration import cylinder, cylinder_session
from palmd.calibration import standoff as standoff_command
from palmd.cli import main
from palmd.config.any_config import config_hash
from palmd.rig.fault_injection import order
from palmd.rig.pads import PadOptions
from palmd.rig.shapes import cylinder as turned
from palmd.yamlfile import load_config

REAL = (
    "{port: pad1, zero_mm: 26.5, counts_per_mm: 8.11, newtons_per_count: 0.024}",
    "{port: pad2, zero_mm: 29.2, counts_per_mm: 7.65, newtons_per_count: 0.017, sign: -1}",
)
"""1.5 mm, 3 % and 20 % from the daemon's configuration; the second pad is mirrored."""

LIMITS = "{phi1_deg: [20, 70], phi2_deg: [70, 110]}"
BODIES = turned(0.02, 0.1), turned(0.015, 0.05)


def written(folder, name, pads=("{port: pad1}", "{port: pad2}"), limits=LIMITS, more=""):
    path = folder / name
    path.write_text(
        f"pads: {{palm1: {pads[0]}, palm2: {pads[1]}}}\narm: {{port: arm}}\nlimits: {limits}\n"
        f'bus: {{publish: "ipc://{folder}/publish", command: "ipc://{folder}/command"}}\n{more}'
    )
    return path


@pytest.fixture
def config_path(tmp_path):
    """The daemon's configuration, which is wrong."""
    return written(tmp_path, "my.yaml")


@pytest.fixture
def rig(tmp_path, config_path):
    """Run the rig as it really is; the daemon has the configuration of `config_path`."""

    def run(**more):
        return running(load_config(written(tmp_path, "REAL.yaml", REAL)), load_config(config_path), 5, BODIES, **more)

    return run


@pytest.fixture(autouse=True)
def brief(monkeypatch):
    """Plans like those of a rig, with fewer and shorter rests; `test_pad_force.py` tests the accuracy of full plans."""
    monkeypatch.setattr(cylinder_session, "FIRST_TOUCH_S", 3.0)
    monkeypatch.setattr(cylinder_session, "TOUCHED_S", 0.1)
    monkeypatch.setattr(cylinder, "_TIPS", 2)
    monkeypatch.setattr(cylinder, "_HOLD_S", 0.7)
    monkeypatch.setattr(cylinder, "SLOW_RAD_S", 2.0 * cylinder.SLOW_RAD_S)


@pytest.fixture
def brisk(monkeypatch):
    """Short plans for calibrations that must fail."""
    monkeypatch.setattr(cylinder, "SLOW_RAD_S", cylinder.BRISK_RAD_S)


def pads(config, *more):
    return main(["calibrate", "pads", str(config), "--radius-mm", "20", *map(str, more)])


def force(config, *more):
    return main(["calibrate", "force", str(config), "--radius-mm", "20", "--mass-g", "100", *map(str, more)])


def refused(config, status, capsys, *more, calibrate=pads):
    """The one line of its error message; nothing is stored."""
    assert calibrate(config, *more) == status
    out, err = capsys.readouterr()
    assert out == ""
    assert not list(config.parent.glob("**/*ds.yaml"))
    return err.splitlines()[-1]


def test_pads_are_calibrated_stored_and_printed(rig, config_path, capsys):
    with rig() as world:
        assert pads(config_path) == 0
        wait(lambda: world.status()["arm_state"] != "T", "the arm to brake")  # the command does not wait for it
    result = yaml.safe_load((config_path.parent / "calibration/pads.yaml").read_text())
    assert (result["palmd_pads_scale"], result["radius_mm"]) == (1, 20.0)
    asked = result["configuration"]
    assert asked["palm1"]["zero_mm"] == pytest.approx(26.5, abs=0.05)
    assert asked["palm2"]["zero_mm"] == pytest.approx(29.2, abs=0.05)
    assert asked["palm1"]["counts_per_mm"] == pytest.approx(8.11, rel=0.003)
    assert asked["palm2"]["counts_per_mm"] == pytest.approx(7.65, rel=0.003)
    assert (asked["palm1"]["sign"], asked["palm2"]["sign"]) == (1, -1)
    out, err = capsys.readouterr()
    assert out.startswith("pad1: ")
    for palm, settings in asked.items():
        settings_text = (
            f"sign: {settings['sign']}, zero_mm: {settings['zero_mm']}, counts_per_mm: {settings['counts_per_mm']}"
        )
        assert f"{config_path}: write in pads.{palm}: {settings_text}\n" in out
    assert err.startswith("lay the cylinder between the palms, across both pads\n")
    assert "tracking" in err.splitlines()[-1], "no remarks"
    assert world.status()["arm_state"] in "DR", "the arm is stopped"
    assert world.status()["setpoints_outside_limits"] == 0
    before = [f"{{port: pad{n}, " + ", ".join(f"{k}: {v}" for k, v in asked[f"palm{n}"].items()) + "}" for n in (1, 2)]
    after = written(config_path.parent, "after.yaml", before)
    assert (
        config_hash(load_config(after).pads) == result["settings_sha256"] != config_hash(load_config(config_path).pads)
    )


def test_forces_are_calibrated_stored_and_printed(rig, config_path, tmp_path, capsys):
    with rig(pad_options=PadOptions(force_drift=0.0)):  # many rounds average the drift
        assert force(config_path, "--rounds", 2, "-o", tmp_path / "kept") == 0
    result = yaml.safe_load((tmp_path / "kept/force.yaml").read_text())
    assert (result["palmd_pads_force"], result["radius_mm"], result["mass_g"]) == (1, 20.0, 100.0)
    found = result["configuration"]
    assert found["palm1"]["newtons_per_count"] == pytest.approx(0.024, rel=0.015)
    assert found["palm2"]["newtons_per_count"] == pytest.approx(0.017, rel=0.015)
    assert (result["found"]["rests"], result["found"]["rounds"]) == (32, 2)
    out, _ = capsys.readouterr()
    assert out.startswith("32 rests in 2 rounds, friction at rest ")
    assert f"{config_path}: write in pads.palm2: newtons_per_count: {found['palm2']['newtons_per_count']}\n" in out


def standoff(config, *more):
    return main(
        ["calibrate", "standoff", str(config), "--radius-mm", "20", "--second-radius-mm", "15", *map(str, more)]
    )


def test_standoffs_are_found_with_two_cylinders(rig, config_path, tmp_path, capsys, monkeypatch):
    off = "rig: {imperfections: {palm1: {standoff_mm: 0.3}, palm2: {standoff_mm: -0.1}}}"

    def exchanged(*arguments):
        world.fault_injector.add(order("swap", world.t))
        waited(*arguments)

    waited = standoff_command.wait_until_removed
    monkeypatch.setattr(standoff_command, "wait_until_removed", exchanged)
    real = load_config(written(tmp_path, "off.yaml", REAL, more=off))
    with running(real, load_config(config_path), 5, BODIES) as world:
        assert standoff(config_path) == 0
    result = yaml.safe_load((config_path.parent / "calibration/standoff.yaml").read_text())
    assert (result["radius_mm"], result["second_radius_mm"]) == (20.0, 15.0)
    for pad, true_mm in zip(result["found"].values(), (0.3, -0.1), strict=True):
        assert pad["standoff_mm"] == pytest.approx(true_mm, abs=3.0 * pad["standoff_sd_mm"])
        assert pad["standoff_sd_mm"] < 0.08
    out, err = capsys.readouterr()
    assert out.startswith("pad1: ")
    asked = [line for line in err.splitlines() if "the cylinder of" in line]
    assert asked == [
        "lay the cylinder of 20 mm radius between the palms, across both pads",
        "take the cylinder of 20 mm radius out",
        "lay the cylinder of 15 mm radius between the palms, across both pads",
    ]
    found_mm = result["found"]["palm1"]["standoff_mm"]
    assert f"pad 1's surface lies {found_mm:.2f} mm above the hinge line" in err
    assert world.status()["setpoints_outside_limits"] == 0


def test_a_first_cylinder_that_stays_in_ends_the_calibration(rig, config_path, capsys, monkeypatch):
    monkeypatch.setattr(cylinder_session, "TAKE_OUT_S", 0.5)
    monkeypatch.setattr(standoff_command, "recorded_events", lambda *_, **__: [])
    with rig():
        message = refused(config_path, 3, capsys, calibrate=standoff)
    assert message == "the cylinder of 20 mm radius was not taken out within 0 s: nothing is stored"


@pytest.mark.usefixtures("brisk")
def test_swapped_pads_are_refused(rig, config_path, capsys):
    with rig(crossed=True):
        message = refused(config_path, 3, capsys)
    assert "the pads are swapped; exchange pads.palm1.port and pads.palm2.port" in message


@pytest.mark.usefixtures("brisk")
def test_a_daemon_with_another_configuration_is_detected(rig, config_path, capsys):
    with rig():
        config_path.write_text(
            config_path.read_text().replace("palm1: {port: pad1}", "palm1: {port: pad1, zero_mm: 26.5}")
        )
        message = refused(config_path, 3, capsys)
    assert message == "pad 1's readings were made with another configuration: restart the daemon with this one"


def test_without_contact_nothing_is_moved(rig, config_path, capsys, monkeypatch):
    monkeypatch.setattr(cylinder_session, "FIRST_TOUCH_S", 1.0)
    with rig() as world:
        world.fault_injector.add(order("lift", world.t, strength=1.0, for_s=1e6))
        assert refused(config_path, 3, capsys) == "nothing has touched the pads within 1 s: nothing has been moved"
        assert world.status()["arm_state"] == "R"


def test_a_cylinder_on_one_palm_only_is_reported(rig, config_path, capsys, monkeypatch):
    monkeypatch.setattr(cylinder_session, "TOUCHED_S", 1.0)  # less time than the pad takes to become silent
    with rig() as world:
        world.fault_injector.add(order("mute", world.t, port="pad2", for_s=1e6))
        message = refused(config_path, 3, capsys)
    assert message == "the cylinder touches palm 1 but not palm 2 within 3 s: nothing has been moved"


def test_a_fault_that_prevents_arming_is_reported(rig, config_path, capsys):
    with rig() as world:
        world.fault_injector.add(order("estop", world.t))
        time.sleep(0.3)
        message = refused(config_path, 3, capsys)
    assert message.startswith("the arm cannot be armed, the state is fault; arm-estop: when it is safe, release it")


def test_losing_the_cylinder_ends_the_calibration(rig, config_path, capsys, monkeypatch):
    monkeypatch.setattr("palmd.harness.operator.HELD_S", 0.5)

    def lift():
        time.sleep(1.5)
        world.fault_injector.add(order("lift", world.t, strength=1.0, for_s=1e6))

    with rig() as world:
        thread = threading.Thread(target=lift)
        thread.start()
        message = refused(config_path, 3, capsys)
        thread.join()
    assert message.startswith("held for 0.5 s, so ended; pad")


def test_a_missing_daemon_is_reported(config_path, capsys):
    assert "is a palmd running there" in refused(config_path, 3, capsys)
    assert not (config_path.parent / "calibration").exists(), "a refused calibration stores nothing"


def test_cylinders_of_unsuitable_radius_are_refused(config_path, capsys, tmp_path):
    message = refused(config_path, 1, capsys, "--radius-mm", "60")
    assert message == (
        "a cylinder of 60 mm radius can be moved by 7.7 mm along the pads; at least 10 mm are needed:"
        " the radius is too large for these pads and limits.phi2_deg"
    )
    assert "0.0 mm along the pads" in refused(config_path, 1, capsys, "--radius-mm", "90")
    assert "use a larger cylinder, or widen limits" in refused(config_path, 1, capsys, "--radius-mm", "8")
    narrow = written(tmp_path, "narrow.yaml", limits="{phi1_deg: [40, 50], phi2_deg: [70, 110]}")
    assert "widen limits.phi1_deg" in refused(narrow, 1, capsys, calibrate=force)


def test_invalid_configurations_and_folders_are_reported(tmp_path, config_path, capsys):
    assert "no such file" in refused(tmp_path / "none.yaml", 1, capsys)
    (tmp_path / "file").write_text("")
    for folder in ("file", "file/of/it"):
        assert f"{tmp_path / 'file'} is no folder" in refused(config_path, 1, capsys, "-o", tmp_path / folder)
    (tmp_path / "dangling").symlink_to("nowhere")
    assert "dangling is no folder" in refused(config_path, 1, capsys, "-o", tmp_path / "dangling")
    assert "File name too long" in refused(config_path, 1, capsys, "-o", tmp_path / ("a" * 300))


def test_a_daemon_that_stops_between_the_cylinders_is_reported(config_path, capsys, monkeypatch):
    monkeypatch.setattr(cylinder_session, "TAKE_OUT_S", 0.5)
    monkeypatch.setattr(standoff_command, "recorded_events", lambda *_, **__: [])
    assert "is a palmd running there" in refused(config_path, 3, capsys, calibrate=standoff)


def test_two_cylinders_of_similar_radius_are_refused(config_path, capsys):
    message = refused(config_path, 1, capsys, "--second-radius-mm", "19", calibrate=standoff)
    assert message.startswith("cylinders of 20 and 19 mm radius are too similar")


@pytest.mark.parametrize(
    "arguments",
    [
        ["pads", "my.yaml"],
        *(["pads", "my.yaml", "--radius-mm", value] for value in ("nan", "-20", "0", "inf")),
        ["force", "my.yaml", "--radius-mm", "20"],
        ["force", "my.yaml", "--radius-mm", "20", "--mass-g", "100", "--rounds", "1"],
    ],
)
def test_invalid_arguments_are_usage_errors(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["calibrate", *arguments])
    assert caught.value.code == 2
