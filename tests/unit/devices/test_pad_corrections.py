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


def test_a_reading_is_corrected_by_the_map_at_its_position():
    assert read(mapped()) == pytest.approx(PLACES + wave(PLACES), abs=1e-3)


def test_curve_and_map_are_added():
    curve = (0.0, 0.4, 0.0)
    curved = read(PLAIN.model_copy(update={"curve_mm": curve}))
    assert read(mapped(curve_mm=curve)) == pytest.approx(curved + wave(PLACES), abs=1e-3)


def test_the_correction_can_be_inverted():
    assert linear_mm(mapped(), read(mapped())) == pytest.approx(PLACES, abs=1e-6)


@pytest.mark.parametrize(
    "points", [[[1.0, 0.0]], [[2.0, 0.0], [1.0, 0.1]], [[1.0, 0.0], [1.1, 0.5]], [[1.0], [2.0]], [[0, 0], [1e-200, 0]]]
)
def test_maps_that_are_not_invertible_are_refused(points):
    with pytest.raises(ValidationError):
        mapped(map=points)


def test_a_pad_without_a_map_is_written_unchanged():
    assert "map" not in PLAIN.model_dump()
    assert mapped().model_dump()["map"]
