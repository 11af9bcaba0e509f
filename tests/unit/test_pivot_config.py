import math
from pathlib import Path

import pytest

from palmd.config.pivot import PivotConfig, PivotPlanSpec, pivot_rig
from palmd.motion.check import check_files
from palmd.motion.pivot import PivotLimits, compile_pivot_plan
from palmd.motion.plan import PlanError
from palmd.rig.imperfections import Imperfections, PadImperfection, perfect
from palmd.rig.pivot_world import configured_imperfections
from palmd.yamlfile import ConfigError, load_any_config, load_config

ROOT = Path(__file__).parents[2]
SHIPPED, SHIPPED_SLIDE = ROOT / "config/pivot.yaml", ROOT / "config/slide.yaml"
SLIDE = "rig: {{system: pivot, vertical: float, carriage_mass_kg: {}}}\n"
PADS = "pads: {palm1: {port: a}}\narm: {port: b}\n"


@pytest.fixture
def limits():
    return PivotLimits.of(load_any_config(SHIPPED))


def refused(tmp_path, text):
    path = tmp_path / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    return "\n".join(check_files([path]))


def test_shipped_files_are_valid():
    assert check_files([SHIPPED, SHIPPED_SLIDE]) == []
    assert isinstance(load_any_config(SHIPPED), PivotConfig)


def test_the_observers_rig_description_is_in_si_units():
    rig = pivot_rig(load_any_config(SHIPPED))
    assert (rig.vertical, rig.arm_noise) == ("rigid", pytest.approx(2e-5))
    assert rig.pad.standoff_sd == pytest.approx(5e-5)
    slide = pivot_rig(load_any_config(SHIPPED_SLIDE))
    assert (slide.vertical, slide.carriage_mass, slide.carriage_damping) == ("float", 0.04, 0.06)


def test_programs_for_two_palms_refuse_a_pivot_rig():
    with pytest.raises(ConfigError, match="is for a pivoting grasp, but this supports two palms"):
        load_config(SHIPPED)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("rig: {system: pivot, vertical: float}\n" + PADS, "a slide needs the mass of its carriage without the body"),
        (SLIDE.format("0.05, z_measured: false") + PADS, "rig.z_measured: without the pivot's height the body's mean"),
        (SLIDE.format("0.3") + PADS, "force_n is 2 N, but the carriage alone weighs 2.9 N"),
        ("rig: {system: pivot, carriage_mass_kg: 0.1}\n" + PADS, "only a slide has a carriage"),
        ("rig: {system: pivot}\n" + PADS + "limits: {force_n: 9}\n", "the pad may measure no more than 2 N"),
        ("rig: {system: pivot}\n" + PADS + "limits: {x_mm: [9, 3]}\n", r"must be \[low, high\] with low < high"),
        ("rig: {system: pivot}\npads: {palm1: {port: a}}\narm: {port: a}\n", "port a is already used by the pad"),
        ("rig: {system: pivot, hinge: arc}\n" + PADS, "rig.hinge: unknown key"),
        (
            "rig: {system: pivott}\n" + PADS,
            r"^\S+:1:15: rig.system: there is no system 'pivott'; the systems are pivot[^\n]*$",
        ),
    ],
)
def test_impossible_values_are_refused_with_a_reason(tmp_path, text, said):
    import re

    assert re.search(said, refused(tmp_path, text))


def plan(*segments):
    return PivotPlanSpec.model_validate({"name": "p", "segments": list(segments)})


def test_a_move_rises_before_it_travels_and_is_lowered_afterwards(limits):
    spec = plan(
        {"move": {"x_mm": 40, "z_mm": 35}, "duration_s": 3}, {"move": {"x_mm": 10, "z_mm": 20}, "duration_s": 3}
    )
    trajectory = compile_pivot_plan(spec, limits, (0.02, 0.02))
    places = [trajectory.at(t).angles for t in (0.0, 1.2857, 3.0, 5.0, 6.0)]
    assert places[0] == (0.02, 0.02)
    assert places[1] == pytest.approx((0.02, 0.035), abs=1e-5)
    assert places[2] == pytest.approx((0.04, 0.035))
    assert places[3] == pytest.approx((0.01, 0.035))
    assert places[4] == pytest.approx((0.01, 0.02))


def test_a_plan_outside_the_limits_is_refused_with_its_place(limits):
    with pytest.raises(PlanError) as caught:
        compile_pivot_plan(plan({"hold_s": 1}, {"move": {"z_mm": 99}, "duration_s": 3}), limits)
    assert [loc for loc, _ in caught.value.problems] == [("segments", 1)]
    assert "z reaches 99 mm, the limit is 45 mm" in str(caught.value)


def test_a_move_that_is_too_fast_is_refused(limits):
    with pytest.raises(PlanError, match="the speed along x reaches"):
        compile_pivot_plan(plan({"move": {"x_mm": 3}, "duration_s": 0.2}), limits, (0.05, 0.04))


def test_the_last_guard_keeps_ranges_and_steps(limits):
    from palmd.events import PalmMotion

    here = PalmMotion.at_rest((0.02, 0.02))
    far = PalmMotion.at_rest((0.5, -0.5))
    step = limits.clamp_step(here, far, 0.016)
    room = limits.rate * 0.016
    assert max(abs(a - b) for a, b in zip(step.angles, here.angles, strict=True)) == pytest.approx(room)
    assert limits.clamp_step(here, PalmMotion.at_rest((math.nan, 0.0)), 0.016) == here


def test_a_plan_is_checked_against_rigs_of_its_own_system(tmp_path):
    two_palms, plans = ROOT / "config/palmd.yaml", ROOT / "config/plans"
    assert check_files([plans / "pivot/explore.yaml"]) == []
    assert check_files([SHIPPED, two_palms, plans / "pivot/explore.yaml", plans / "rock.yaml"]) == []
    nowhere = tmp_path / "plan.yaml"
    nowhere.write_text("name: a\nsegments:\n  - {move: {x_mm: 900, z_mm: 20}, duration_s: 2}\n", encoding="utf-8")
    assert check_files([SHIPPED, two_palms, nowhere]) == check_files([SHIPPED, nowhere]) != []


def test_a_missing_key_of_a_segment_is_reported_once(tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text("name: a\nsegments:\n  - {hold_s: 1, x: 3}\n  - {hold: 3}\n", encoding="utf-8")
    first, second = check_files([SHIPPED, path])
    assert ":3:17: segments.0.x: unknown key" in first
    assert ":4:5: segments.1: a segment needs exactly one of the keys move, hold_s, explore" in second


def test_the_emulated_rigs_errors_have_the_configured_sd():
    config = load_any_config(SHIPPED)
    off = configured_imperfections(config, 5)
    assert 0.0 < abs(off.pads[0].standoff) <= 3 * 5e-5
    assert 0.0 < abs(off.angles[0]) <= 3 * math.radians(0.1)
    known = perfect(config)
    assert configured_imperfections(known, 5) == Imperfections((PadImperfection(),), (0.0,))
    assert pivot_rig(known).pad.standoff_sd == pivot_rig(known).angle_sd == 0.0
