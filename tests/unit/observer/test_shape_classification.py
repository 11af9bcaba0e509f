"""Outlines of things that have names are named with their sizes; others, and those felt by halves, are not."""

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


def _named(body: Body, random: np.random.Generator, felt: int = 360, error_m: FloatArray | float = 0.0) -> ShapeClass:
    root = root_of_band(np.full(len(THETA), BAND_M), THETA)
    touched = np.zeros(len(THETA), dtype=np.bool_)
    touched[np.arange(felt) + int(random.integers(360)) - 360] = True
    h = body.support.sample(THETA) + root @ random.standard_normal(root.shape[1]) + error_m
    return shape_class(THETA, h, root, touched)


@pytest.mark.parametrize("kind", sorted(NAMES))
@pytest.mark.parametrize("felt", [360, 270])
def test_a_thing_is_named_with_its_sizes_wherever_its_mass_is(kind: str, felt: int) -> None:
    random = np.random.default_rng([felt, len(kind)])
    true = real_object(kind, random, 1.5e-3)
    told = _named(true.body, random, felt)
    assert told.name == NAMES[kind]
    longest_first = sorted(true.size_m, reverse=True)
    for size, value in zip(told.sizes, longest_first, strict=False):
        assert size.value_m == pytest.approx(value, abs=4.0 * size.sd_m)
        assert size.sd_m < 0.1e-3


@pytest.mark.parametrize("kind", sorted(set(REAL_OBJECTS) - set(NAMES)))
def test_what_is_none_of_the_forms_gets_no_name(kind: str) -> None:
    random = np.random.default_rng(5)
    told = _named(real_object(kind, random).body, random)
    assert not told.name
    assert not told.text
    assert as_json(told)["orientation_determined"] is None


def test_no_smooth_lump_is_taken_for_a_thing() -> None:
    random = np.random.default_rng(6)
    for _ in range(10):
        told = _named(random_body("rig", random), random)
        assert not told.name
        assert told.probabilities[0] == (NONE, pytest.approx(1.0))


@pytest.mark.parametrize("kind", sorted(REAL_OBJECTS))
def test_what_was_felt_by_halves_gets_no_name(kind: str) -> None:
    random = np.random.default_rng(7)
    assert not _named(real_object(kind, random).body, random, 180).name


def test_a_thing_that_is_a_tenth_of_a_millimetre_off_its_form_is_not_it() -> None:
    random = np.random.default_rng(8)
    bump = 1e-4 * np.cos(5.0 * THETA)
    assert not _named(real_object("coin", random).body, random, error_m=bump).name
    assert _named(real_object("coin", random).body, random, error_m=0.1 * bump).name == "circle"


def test_the_orientation_of_a_coin_cannot_be_told_that_of_a_block_up_to_half_a_turn() -> None:
    random = np.random.default_rng(9)
    coin, block = (_named(real_object(kind, random).body, random) for kind in ("coin", "block"))
    assert coin.turn_rad == 0.0
    assert coin.text.endswith("; its orientation is undetermined")
    assert as_json(coin)["orientation_determined"] is False
    assert block.turn_rad == math.pi
    assert "mm long side" in block.text
    assert as_json(block)["orientation_determined"] is True


def test_errors_of_sizes_are_as_told() -> None:
    random = np.random.default_rng(10)
    z = []
    for _ in range(30):
        true = real_object("coin", random, 1e-3)
        size = _named(true.body, random).sizes[0]
        z.append((size.value_m - true.size_m[0]) / size.sd_m)
    # the form itself is perfect here, and what real ones are off is allowed for: the band is wider than the errors
    assert 0.05 < np.mean(np.square(z)) < 1.5
