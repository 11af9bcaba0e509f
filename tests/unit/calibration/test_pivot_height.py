"""`palmd calibrate height`: a cylinder dragged over a pad shows how far the pad is from where the arm assumes it."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

from palmd.calibration.pivot_height import HeightError, pivot_height
from palmd.cli import main
from palmd.config.any_config import config_hash
from palmd.config.pivot import pivot_rig
from palmd.console.shipped import shipped
from palmd.events import PadSample, PalmSample
from palmd.system.description import PadSensor
from palmd.system.pivot import PivotRig
from palmd.yamlfile import load_any_config

RADIUS_M, LENGTH_M = 0.018, 0.0555
CALIBRATED = PivotRig(
    angle_sd=math.radians(0.1), pad=PadSensor(scale_sd=3e-3, sagitta_sd=5e-5, lag_sd=2e-3, standoff_sd=2e-3)
)


def dragged(height_m=0.0, along_m=0.0, off_axis_m=7e-3, slope=0.0, bow_m=0.0, seed=1, turns=0.8, end=0.0):
    """Drag a cylinder to and fro while lowering and raising it for 6 s each on both sides of the dead centre.

    The pad's middle is `height_m` higher than the arm assumes, and its readings are `along_m` larger; a share `end` of
    the readings is replaced by random places. The events are those of a daemon.
    """
    random, events = np.random.default_rng(seed), []
    for k in range(1200):
        t = 0.01 * k
        side = 1.0 if k < 600 else -1.0
        theta = side * (math.pi / 2 + turns * math.cos(math.tau * t / 6.0))
        e, h = off_axis_m * math.sin(theta), RADIUS_M + off_axis_m * math.cos(theta)
        x = LENGTH_M / 2 + 0.012 * math.sin(1.3 * t)
        share = (x + e) / LENGTH_M
        surface = height_m + slope * (x + e - LENGTH_M / 2) - bow_m * (1 - 2 * share) ** 2
        z = h + surface - e * (slope + 4 * bow_m / LENGTH_M * (1 - 2 * share))  # over the foot of the tangent below it
        events.append(PalmSample(t, (x + random.normal(0, 2e-5), z + random.normal(0, 2e-5)), (0.0, 0.0)))
        s = random.uniform(0.0, LENGTH_M) if random.random() < end else x + e + along_m + random.normal(0, 1e-4)
        events.append(PadSample(t, 1, round(s / 1.27e-4) * 1.27e-4, 0.5))
    return events


@pytest.mark.parametrize("seed", range(4))
def test_height_and_place_are_found_within_their_sd(seed: int) -> None:
    random = np.random.default_rng(100 + seed)
    height, along = random.uniform(-8e-4, 8e-4, 2)
    slope, bow = random.normal(0.0, math.radians(0.1)), random.normal(0.0, 5e-5)
    found = pivot_height(dragged(height, along, slope=slope, bow_m=bow, seed=seed, end=0.02), CALIBRATED, RADIUS_M)
    assert abs(found.height_mm - height * 1e3) < 4 * found.height_sd_mm
    assert abs(found.along_mm - along * 1e3) < 4 * found.along_sd_mm + 0.02
    assert abs(found.slope_deg - math.degrees(slope)) < 4 * found.slope_sd_deg
    assert found.height_sd_mm < 0.015
    assert found.off_axis_mm == pytest.approx(7.0, abs=0.05)
    assert found.left < 1.2
    assert found.spoilt < 40


def test_an_error_of_the_radius_is_an_equal_error_of_the_height() -> None:
    one, other = (pivot_height(dragged(), CALIBRATED, radius) for radius in (RADIUS_M, RADIUS_M + 1e-4))
    assert one.height_mm - other.height_mm == pytest.approx(0.1, abs=1e-6)


@pytest.mark.parametrize(
    ("events", "why"),
    [
        (dragged()[:200], "98 readings of the pad"),
        (dragged(off_axis_m=3e-4), "changed by only 0.4. mm"),
        (dragged(turns=0.1), "let the cylinder turn further"),
        ([e if isinstance(e, PadSample) else PalmSample(e.t_sample, (e.angles[0], math.nan)) for e in dragged()],
         "0 readings"),
        ([replace(e, s=e.s + 2e-3 * math.sin(9 * e.t_sample)) if isinstance(e, PadSample) else e for e in dragged()],
         "fit no cylinder"),
    ],
    ids=["few", "on its axis", "hardly turned", "no height", "not round"],
)  # fmt: skip
def test_readings_that_do_not_determine_the_height_are_refused_with_the_reason(events, why) -> None:
    with pytest.raises(HeightError, match=why):
        pivot_height(events, CALIBRATED, RADIUS_M)


@pytest.fixture
def rig(tmp_path):
    """A configuration and an event log of that cylinder; its pad is 0.3 mm higher than the arm assumes."""
    config = tmp_path / "my.yaml"
    config.write_text(
        shipped("pivot.yaml").read_text().replace("plans/", str(shipped("pivot.yaml").parent) + "/plans/")
    )
    header = {"system": "pivot", "gravity_m_s2": 9.81, "gripper": {"vertical": "rigid"}, "force_scale_std": 0.05,
              "pad": {"length_m": LENGTH_M, "noise_m": 1e-4, "resolution_m": 1.27e-4}}  # fmt: skip
    lines = [{"palmd_log": 1, "rig": header}]
    for event in dragged(3e-4, -1e-4):
        if isinstance(event, PadSample):
            lines.append({"t": event.t_sample, "pad": 1, "s_m": event.s, "force_n": 0.5})
        else:
            lines.append({"t": event.t_sample, "arm": dict(zip(("x_m", "z_m"), event.angles, strict=True))})
    log = tmp_path / "run.jsonl"
    log.write_text("\n".join(map(json.dumps, lines)) + "\n")
    return config, log


def test_the_command_prints_and_stores_the_settings(rig, capsys) -> None:
    config, log = rig
    assert main(["calibrate", "height", str(config), str(log), "--radius-mm", "18"]) == 0
    message = capsys.readouterr().out
    stored = yaml.safe_load((config.parent / "calibration" / "height.yaml").read_text())
    called = stored["configuration"]
    before = load_any_config(config)
    assert called["arm"]["base_y_mm"] == pytest.approx(before.arm.base_y_mm - 0.3, abs=0.03)
    assert called["arm"]["base_x_mm"] == pytest.approx(before.arm.base_x_mm - 0.1, abs=0.03)
    assert 0.0 < called["pads"]["palm1"]["standoff_sd_mm"] < 0.02
    assert f"base_y_mm: {called['arm']['base_y_mm']}" in message
    assert stored["settings_sha256"] == config_hash(before.arm.model_copy(update=called["arm"]))
    assert pivot_rig(before).pad.standoff_sd > called["pads"]["palm1"]["standoff_sd_mm"] * 1e-3


def test_input_of_another_system_is_refused_and_nothing_is_written(rig, capsys) -> None:
    config, log = rig
    assert main(["calibrate", "height", str(shipped("cradle.yaml")), str(log), "--radius-mm", "18"]) != 0
    assert "not of a pivoting grasp" in capsys.readouterr().err
    log.write_text(log.read_text().replace('"pivot"', '"swing"'))
    assert main(["calibrate", "height", str(config), str(log), "--radius-mm", "18"]) != 0
    assert "swing" in capsys.readouterr().err
    assert not (config.parent / "calibration").exists()
