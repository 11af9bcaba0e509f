"""The page's message about the shape class of the live outline."""

from __future__ import annotations

import math

import msgpack
import numpy as np
import pytest

from palmd.quantities import ESTIMATE, SHAPE
from palmd.view.naming import NamingError, shape_class_message
from tools.studies.real_objects import real_object

THETA = np.arange(360) * (math.tau / 360)


def latest(*, valid: bool = True, coverage: float = 1.0) -> dict[str, bytes]:
    h = real_object("nut", np.random.default_rng(3)).body.support.sample(THETA)
    shape = {"theta_rad": THETA.tolist(), "h_m": h.tolist(), "h_sd_m": [3e-5] * 360,
             "touched": (coverage * math.tau > THETA).astype(int).tolist()}  # fmt: skip
    estimate = {"valid": valid, "object": 4}
    return {SHAPE.name: msgpack.packb(shape), ESTIMATE.name: msgpack.packb(estimate)}


def shape_class_of(payloads: dict[str, bytes]) -> dict[str, object]:
    payload = shape_class_message(payloads)
    assert payload is not None
    fields: dict[str, object] = msgpack.unpackb(payload)
    return fields


def test_a_fully_covered_nut_is_a_hexagon_with_its_object_number() -> None:
    fields = shape_class_of(latest())
    assert fields["object"] == 4
    assert str(fields["text"]).startswith("regular hexagon, 24.0")


def test_half_a_nut_has_no_shape_class() -> None:
    assert shape_class_of(latest(coverage=0.5))["text"] == ""


@pytest.mark.parametrize("without", [ESTIMATE.name, SHAPE.name])
def test_an_invalid_or_missing_estimate_has_no_shape_class(without: str) -> None:
    assert shape_class_message(latest(valid=False)) is None
    assert shape_class_message({topic: payload for topic, payload in latest().items() if topic != without}) is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"theta_rad": None, "touched": None}, "palm/shape has no list theta_rad, touched"),
        ({"h_sd_m": [3e-5] * 7}, "lists of numbers of equal length"),
        ({"h_m": ["a"] * 360}, "lists of numbers of equal length"),
        ({"h_m": [math.nan] * 360}, "lists of finite numbers of equal length"),
    ],
)
def test_an_invalid_outline_message_is_a_one_line_error(change: dict[str, object], words: str) -> None:
    payloads = latest()
    shape = msgpack.unpackb(payloads[SHAPE.name]) | change
    payloads[SHAPE.name] = msgpack.packb({name: value for name, value in shape.items() if value is not None})
    with pytest.raises(NamingError, match=words):
        shape_class_message(payloads)
