"""`palmd calibrate vibration`: the palms' speed from an accelerometer, as configuration and observers use it."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest
import yaml

from palmd.calibration.vibration import speed_from_acceleration
from palmd.cli import main
from palmd.config.two_palms import rig_description
from palmd.console.shipped import shipped
from palmd.yamlfile import load_any_config

SPEED_M_S, FREQUENCY_HZ = 0.0147, 247.0
AMPLITUDE_M_S2 = math.tau * FREQUENCY_HZ * SPEED_M_S
FIGURES = ["--acceleration-m-s2", f"{AMPLITUDE_M_S2}", "--acceleration-sd-m-s2", f"{0.03 * AMPLITUDE_M_S2}"]


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "my.yaml"
    shutil.copy(shipped("palmd.yaml"), path)
    return path


def configured_vibration(path, lines):
    """The vibration that observers assume with these lines in the configuration."""
    content = yaml.safe_load(path.read_text())
    content["rig"].setdefault("vibration", {}).update(yaml.safe_load(lines))
    path.write_text(yaml.safe_dump(content))
    return rig_description(load_any_config(path)).vibration


def test_the_speed_is_the_amplitude_of_the_pads_velocity() -> None:
    period = np.linspace(0.0, 1.0 / FREQUENCY_HZ, 2001)
    position = SPEED_M_S / (math.tau * FREQUENCY_HZ) * np.sin(math.tau * FREQUENCY_HZ * period)
    acceleration = np.gradient(np.gradient(position, period), period)[5:-5].max()
    speed, sd = speed_from_acceleration((acceleration, 0.0), (FREQUENCY_HZ, 0.0))
    assert speed == pytest.approx(SPEED_M_S, rel=1e-4)
    assert sd == 0.0


def test_the_sd_is_the_scatter_of_speeds_from_scattered_inputs() -> None:
    random = np.random.default_rng(1)
    figures = (20.0, 0.8), (240.0, 6.0)
    drawn = random.normal([20.0, 240.0], [0.8, 6.0], (20000, 2))
    drawn = [speed_from_acceleration((a, 0.0), (f, 0.0))[0] for a, f in drawn]
    assert speed_from_acceleration(*figures)[1] == pytest.approx(np.std(drawn), rel=0.03)


def test_the_printed_lines_give_observers_the_measured_speed(config, capsys) -> None:
    before = rig_description(load_any_config(config)).vibration
    assert main(["calibrate", "vibration", str(config), *FIGURES, "--frequency-hz", f"{FREQUENCY_HZ}"]) == 0
    message = capsys.readouterr().out
    vibration = configured_vibration(config, message.split("rig.vibration:\n")[1])
    assert vibration.ln_speed == pytest.approx((math.log(SPEED_M_S), 0.03), rel=1e-3)
    assert vibration.frequency == FREQUENCY_HZ
    assert (vibration.relation, vibration.transmission) == (before.relation, before.transmission)
    stored = yaml.safe_load((config.parent / "calibration" / "vibration.yaml").read_text())
    assert stored["configuration"]["rig"]["vibration"]["speed_m_s"] == pytest.approx(SPEED_M_S, rel=1e-3)


def test_an_uncertain_frequency_widens_the_speed_and_is_configured(config, capsys) -> None:
    figures = [*FIGURES, "--frequency-hz", "247", "--frequency-sd-hz", f"{0.04 * 247}"]
    assert main(["calibrate", "vibration", str(config), *figures]) == 0
    vibration = configured_vibration(config, capsys.readouterr().out.split("rig.vibration:\n")[1])
    assert vibration.ln_speed[1] == pytest.approx(0.05, rel=1e-3)
    assert vibration.frequency_sd == pytest.approx(0.04 * 247)


@pytest.mark.parametrize(
    ("shipped_as", "acceleration", "sd", "reason"),
    [
        ("dry", "22", "0.5", "rig.vibration.relation"),  # no shaker
        ("palmd.yaml", "9000", "10", "m/s²"),  # wrong units: no pad reaches this speed
        ("palmd.yaml", "22", "15", "uncertain"),
    ],
)
def test_an_invalid_measurement_gives_one_line_and_writes_nothing(
    tmp_path, capsys, shipped_as, acceleration, sd, reason
) -> None:
    path = tmp_path / "my.yaml"
    if shipped_as == "dry":
        values = yaml.safe_load(shipped("tabletop.yaml").read_text(encoding="utf-8"))
        values["rig"]["vibration"] = {"relation": "none"}
        path.write_text(yaml.safe_dump(values), encoding="utf-8")
    else:
        shutil.copy(shipped(shipped_as), path)
    figures = ["--acceleration-m-s2", acceleration, "--acceleration-sd-m-s2", sd, "--frequency-hz", "240"]
    assert main(["calibrate", "vibration", str(path), *figures]) == 1
    message = capsys.readouterr().err
    assert reason in message
    assert len(message.splitlines()) == 1
    assert not (tmp_path / "calibration").exists()


def test_a_vibration_too_weak_to_prevent_sticking_causes_a_remark(config, capsys) -> None:
    weak = ["--acceleration-m-s2", "4", "--acceleration-sd-m-s2", "0.1", "--frequency-hz", "240"]
    assert main(["calibrate", "vibration", str(config), *weak]) == 0
    assert "weak" in capsys.readouterr().err
