import numpy as np
import pytest
from pydantic import ValidationError

from palmd.config.pads import VersaPadConfig
from palmd.devices.pad import counts_to_mm, linear_mm

PLAIN = VersaPadConfig(port="/dev/pad", zero_mm=0.0, counts_per_mm=10.0)
PLACES = np.arange(2.0, 50.0, 0.5)


def wave(s_mm):
    return 0.1 * np.sin(2.0 * np.pi * s_mm / 12.0)


def mapped(**changes):
    points = [[s, float(wave(s))] for s in np.arange(0.0, 56.0, 1.5).tolist()]
    return VersaPadConfig.model_validate(PLAIN.model_dump() | {"map": points} | changes)


def read(config):
    return np.array([counts_to_mm(config, 10.0 * s) for s in PLACES.tolist()])


def test_a_reading_has_the_correction_of_its_place():
    assert read(mapped()) == pytest.approx(PLACES + wave(PLACES), abs=1e-3)


def test_a_curve_and_a_map_are_added():
    curve = (0.0, 0.4, 0.0)
    curved = read(PLAIN.model_copy(update={"curve_mm": curve}))
    assert read(mapped(curve_mm=curve)) == pytest.approx(curved + wave(PLACES), abs=1e-3)


def test_a_corrected_place_leads_back_to_its_counts():
    assert linear_mm(mapped(), read(mapped())) == pytest.approx(PLACES, abs=1e-6)


@pytest.mark.parametrize(
    "points", [[[1.0, 0.0]], [[2.0, 0.0], [1.0, 0.1]], [[1.0, 0.0], [1.1, 0.5]], [[1.0], [2.0]], [[0, 0], [1e-200, 0]]]
)
def test_maps_that_leave_no_place_for_each_reading_are_refused(points):
    with pytest.raises(ValidationError):
        mapped(map=points)


def test_a_pad_without_a_map_is_written_as_before():
    assert "map" not in PLAIN.model_dump()
    assert mapped().model_dump()["map"]
