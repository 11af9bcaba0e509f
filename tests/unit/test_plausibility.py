"""Implausible values in a configuration are questioned with a suggestion; plausible ones are not."""

from __future__ import annotations

from pathlib import Path

import pytest

from palmd.config.fields import Plausible, Strict
from palmd.motion.check import check_files
from palmd.plausibility import describe_implausible, implausible
from palmd.yamlfile import load_any_config, load_config, read_document

ROOT = Path(__file__).parents[2]


def config_file(folder: Path, *, rig="", pad="", arm="", rest="") -> Path:
    path = folder / "palmd.yaml"
    path.write_text(
        f"rig: {{{rig}}}\n"
        f"pads: {{palm1: {{port: /dev/a{pad and ', ' + pad}}}, palm2: {{port: /dev/b}}}}\n"
        f"arm: {{port: /dev/c{arm and ', ' + arm}}}\n{rest}\n"
    )
    return path


SLIPS = {
    "rig.palm1_length_mm": ({"rig": "palm1_length_mm: 0.12"}, "0.12 mm", "120 mm"),  # in m
    "rig.palm2_length_mm": ({"rig": "palm2_length_mm: 4.724"}, "4.724 mm", "120 mm"),  # in inches
    "rig.base_mm": ({"rig": "base_mm: [0.12, 0.0]"}, "[0.12, 0] mm", "[120, 0] mm"),
    "rig.angle_sd_deg": ({"rig": "angle_sd_deg: 0.0000175"}, "1.75e-05°", "0.001003°"),
    "pads.palm1.zero_mm": ({"pad": "zero_mm: 0.028"}, "0.028 mm", "28 mm"),
    "pads.palm1.newtons_per_count": ({"pad": "newtons_per_count: 20"}, "20 N/count", "0.02 N/count"),  # mN
    "pads.palm1.counts_per_mm": ({"pad": "counts_per_mm: 0.127"}, "0.127 counts/mm", "7.874 counts/mm"),  # mm per count
    "pads.palm1.length_mm": ({"pad": "length_mm: 0.0555"}, "0.0555 mm", "55.5 mm"),
    "pads.palm1.noise_mm": ({"pad": "noise_mm: 0.0001"}, "0.0001 mm", "0.1 mm"),
    "pads.palm1.lag_sd_ms": ({"pad": "lag_sd_ms: 0.002"}, "0.002 ms", "2 ms"),
    "pads.palm1.scale_sd": ({"pad": "scale_sd: 0.2"}, "0.2", "0.002"),  # per cent
    "limits.phi1_deg": ({"rest": "limits: {phi1_deg: [0.1, 2.6]}"}, "[0.1, 2.6]°", "[5.73, 149]°"),  # radians
    "limits.rate_deg_s": ({"rest": "limits: {rate_deg_s: 2.09}"}, "2.09 °/s", "119.7 °/s"),
    "limits.acceleration_deg_s2": ({"rest": "limits: {acceleration_deg_s2: 15.7}"}, "15.7 °/s²", "899.5 °/s²"),
    "loop.rate_hz": ({"rest": "loop: {rate_hz: 10}"}, "10 Hz", "100 Hz"),  # in ms
}


@pytest.mark.parametrize("key", SLIPS)
def test_a_wrong_unit_is_reported_with_a_suggestion(key: str, tmp_path: Path) -> None:
    parts, got, meant = SLIPS[key]
    path = config_file(tmp_path, **parts)
    load_config(path)  # the daemon accepts it
    (error,) = (each for each in check_files([path]) if f" {key}: " in each)
    assert f"{key}: {got} is implausible: " in error
    assert error.endswith(f"; did you mean {meant}?")
    line = int(error.removeprefix(f"{path}:").split(":")[0])
    assert key.rpartition(".")[2] in path.read_text().splitlines()[line - 1]


def test_a_pads_zero_lies_on_the_pad(tmp_path: Path) -> None:
    (error,) = check_files([config_file(tmp_path, pad="zero_mm: 280")])
    assert "pads.palm1.zero_mm: count 0 would be 280 mm from the hinge, but the pad ends at 55.5 mm" in error


def test_counts_per_inch_are_found_too(tmp_path: Path) -> None:
    (error,) = check_files([config_file(tmp_path, pad="counts_per_mm: 200")])
    assert error.endswith("did you mean 7.874 counts/mm?")


def test_an_arm_that_stands_in_the_palms_is_reported(tmp_path: Path) -> None:
    path = config_file(tmp_path, arm="base_x_mm: -0.3")
    (error,) = check_files([path])
    assert error == (
        f"{path}:3:32: arm.base_x_mm: the arm's base would be 120 mm from the hinge of palm 1 (rig.base_mm), and no"
        " arm works nearer to its base than 150 mm; did you mean -300 mm?"
    )


def test_a_pad_is_no_longer_than_its_palm(tmp_path: Path) -> None:
    (error,) = check_files([config_file(tmp_path, pad="length_mm: 130")])
    assert error.endswith("the pad would reach 130 mm along a palm of 120 mm (rig.palm1_length_mm)")


@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"rig": "gravity_m_s2: 0.5, base_mm: [0, 0], palm1_length_mm: 60, palm2_length_mm: 300"},
        {"rig": "base_mm: [120.0, 0.3]", "arm": "base_x_mm: -299.7, base_y_mm: 0.14, base_yaw_deg: 0.02"},
        {"pad": "zero_mm: 0, counts_per_mm: 4, newtons_per_count: 0.005, noise_mm: 0.02, zero_sd_mm: 0, scale_sd: 0"},
        {"pad": "zero_mm: -12, sign: -1"},
        {"rest": "limits: {phi1_deg: [20, 70], rate_deg_s: 10}\nloop: {rate_hz: 50}"},
    ],
)
def test_plausible_values_are_not_questioned(parts: dict[str, str], tmp_path: Path) -> None:
    assert check_files([config_file(tmp_path, **parts)]) == []


def test_every_default_is_plausible() -> None:
    found = [
        (f"{model.__name__}.{name}", usual.holds(field.default))
        for model in Strict.__subclasses__()
        for name, field in model.model_fields.items()
        for usual in field.metadata
        if isinstance(usual, Plausible)
    ]
    assert len(found) > 15
    assert [name for name, holds in found if not holds] == []
    for path in (ROOT / "config").glob("*.yaml"):
        assert implausible(read_document(path), load_any_config(path)) == []


def test_implausible_values_without_a_suggestion_are_questioned_only() -> None:
    assert describe_implausible("palm1_length_mm", 1500.0, Plausible(20, 21), 20.5).endswith("20 to 21 mm is usual")
