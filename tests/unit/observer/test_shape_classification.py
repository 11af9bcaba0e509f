"""Classification of outlines as named shapes with sizes; other and half-touched outlines get no name."""

from __future__ import annotations

import math

import numpy as np
import pytest

from palmd.events import FloatArray
from palmd.observer.outline import directions
from palmd.observer.shape_classification import NONE, ShapeClass, as_json, root_of_band, shape_class
from palmd.rig.shapes import Body, random_body
from tools.studies.real_objects import REAL_OBJECTS, real_object

THETA = directions()
BAND_M = 8e-6
NAMES = {
    "die": "square", "nut": "regular hexagon", "coin": "circle", "ellipse": "ellipse", "triangle": "regular triangle",
    "block": "rectangle",
}  # fmt: skip


def _named(
    body: Body, random: np.random.Generator, touched_deg: int = 360, error_m: FloatArray | float = 0.0
) -> ShapeClass:
    root = root_of_band(np.full(len(THETA), BAND_M), THETA)
    touched = np.zeros(len(THETA), dtype=np.bool_)
    touched[np.arange(touched_deg) + int(random.integers(360)) - 360] = True
    h = body.support.sample(THETA) + root @ random.standard_normal(root.shape[1]) + error_m
    return shape_class(THETA, h, root, touched)


@pytest.mark.parametrize("kind", sorted(NAMES))
@pytest.mark.parametrize("touched_deg", [360, 270])
def test_a_shape_is_named_with_its_sizes_for_any_centre_of_mass(kind: str, touched_deg: int) -> None:
    random = np.random.default_rng([touched_deg, len(kind)])
    true = real_object(kind, random, 1.5e-3)
    found = _named(true.body, random, touched_deg)
    assert found.name == NAMES[kind]
    longest_first = sorted(true.size_m, reverse=True)
    for size, value in zip(found.sizes, longest_first, strict=False):
        assert size.value_m == pytest.approx(value, abs=4.0 * size.sd_m)
        assert size.sd_m < 0.1e-3


@pytest.mark.parametrize("kind", sorted(set(REAL_OBJECTS) - set(NAMES)))
def test_other_shapes_get_no_name(kind: str) -> None:
    random = np.random.default_rng(5)
    found = _named(real_object(kind, random).body, random)
    assert not found.name
    assert not found.text
    assert as_json(found)["orientation_determined"] is None


def test_smooth_lumps_get_no_name() -> None:
    random = np.random.default_rng(6)
    for _ in range(10):
        found = _named(random_body("rig", random), random)
        assert not found.name
        assert found.probabilities[0] == (NONE, pytest.approx(1.0))


@pytest.mark.parametrize("kind", sorted(REAL_OBJECTS))
def test_a_half_touched_outline_gets_no_name(kind: str) -> None:
    random = np.random.default_rng(7)
    assert not _named(real_object(kind, random).body, random, 180).name


def test_a_deviation_of_a_tenth_of_a_millimetre_prevents_a_name() -> None:
    random = np.random.default_rng(8)
    bump = 1e-4 * np.cos(5.0 * THETA)
    assert not _named(real_object("coin", random).body, random, error_m=bump).name
    assert _named(real_object("coin", random).body, random, error_m=0.1 * bump).name == "circle"


def test_a_coin_has_no_orientation_and_a_block_one_up_to_half_a_turn() -> None:
    random = np.random.default_rng(9)
    coin, block = (_named(real_object(kind, random).body, random) for kind in ("coin", "block"))
    assert coin.turn_rad == 0.0
    assert coin.text.endswith("; its orientation is undetermined")
    assert as_json(coin)["orientation_determined"] is False
    assert block.turn_rad == math.pi
    assert "mm long side" in block.text
    assert as_json(block)["orientation_determined"] is True


def test_errors_of_sizes_match_their_sds() -> None:
    random = np.random.default_rng(10)
    z = []
    for _ in range(30):
        true = real_object("coin", random, 1e-3)
        size = _named(true.body, random).sizes[0]
        z.append((size.value_m - true.size_m[0]) / size.sd_m)
    # the shape is perfect here, but the sd allows for deviations of real ones: it is larger than the errors
    assert 0.05 < np.mean(np.square(z)) < 1.5
