import math
from pathlib import Path

import pytest

from palmd.config.three_palms import TiltPlanSpec, three_palms_rig
from palmd.motion.check import check_files
from palmd.motion.plan import PlanError
from palmd.motion.three_palms import TiltLimits, compile_tilt_plan
from palmd.yamlfile import load_any_config

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / "config/three_palms.yaml"
PADS = "pads: {palm1: {port: a}, palm2: {port: b}, palm3: {port: c}}\n"
RIG = "rig: {system: three_palms}\n"


@pytest.fixture
def limits():
    return TiltLimits.of(load_any_config(SHIPPED))


def test_shipped_files_are_valid():
    assert check_files([SHIPPED, *(ROOT / "config/plans/three_palms").iterdir()]) == []


def test_the_observers_rig_description_is_in_si_units():
    rig = three_palms_rig(load_any_config(SHIPPED))
    assert rig.pad.side == pytest.approx(0.075)
    assert rig.angle_noise == pytest.approx(math.radians(0.015))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (RIG + PADS.replace("port: c", "port: a") + "arm: {port: d}\n", "port a is already used by palm1"),
        (RIG + PADS.replace("port: b", "port: b, noise_mm: 0.2") + "arm: {port: d}\n", "noise_mm differs from"),
        (RIG + PADS + "arm: {port: a}\n", "port a is already used by a pad"),
        (RIG + PADS + "arm: {port: d, base_x_mm: 3}\n", "base_x_mm: an arm whose axes are the joints"),
        (RIG + PADS + "arm: {port: d}\nlimits: {beta_deg: [60, 30]}\n", "must be"),
        ("rig: {system: three_palms, mechanism: delta}\n" + PADS + "arm: {port: d}\n", "edge-axis"),
    ],
)
def test_impossible_values_are_refused_with_a_reason(tmp_path, text, said):
    path = tmp_path / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    assert said in "\n".join(check_files([path]))


def plan(*segments):
    return TiltPlanSpec.model_validate({"name": "p", "segments": list(segments)})


def test_moves_holds_and_swings_follow_one_another(limits):
    trajectory = compile_tilt_plan(
        plan(
            {"move": {"beta_deg": 50}, "duration_s": 2.0},
            {"hold_s": 1.0},
            {"sine": {"beta_deg": 5, "gamma3_deg": -5}, "frequency_hz": [0.5, 0.4, 0.5], "duration_s": 8.0},
        ),
        limits,
        (0.9, 0.8, 0.7),
    )
    assert trajectory.at(0.0).angles == (0.9, 0.8, 0.7)
    assert trajectory.at(2.5).angles == pytest.approx((math.radians(50), 0.8, 0.7))
    swung = trajectory.at(3.0 + 2.5 + 2.0)  # a quarter period after two whole ones, at full amplitude
    assert swung.angles[0] == pytest.approx(math.radians(50), abs=math.radians(5.01))
    assert swung.angles[1] == 0.8
    assert trajectory.place(3.5).label == "sine"
    assert trajectory.duration == pytest.approx(11.0)


def test_an_exploration_comes_last_and_has_no_band(limits):
    goal = {"explore": {"coverage": 0.8, "time_limit_s": 30}}
    found = compile_tilt_plan(plan({"hold_s": 1}, goal), limits).exploration(2.0)
    assert (found[0].goal.coverage, found[1]) == (0.8, 1.0)
    with pytest.raises(PlanError, match="must be the last segment"):
        compile_tilt_plan(plan(goal, {"hold_s": 1}), limits)
    with pytest.raises(ValueError, match="remove it"):
        plan({"explore": {"band_mm": 0.1}})


def test_a_plan_outside_the_limits_is_refused_with_its_place(limits):
    with pytest.raises(PlanError) as caught:
        compile_tilt_plan(plan({"hold_s": 1}, {"move": {"gamma2_deg": 80}, "duration_s": 3}), limits)
    assert [loc for loc, _ in caught.value.problems] == [("segments", 1)]
    assert "gamma2 reaches 80°, the limit is 75°" in str(caught.value)
    with pytest.raises(PlanError, match="the rate of beta reaches"):
        compile_tilt_plan(plan({"move": {"beta_deg": 33}, "duration_s": 0.2}), limits)
