"""What the page is told that the live outline looks like."""

from __future__ import annotations

import math

import msgpack
import numpy as np
import pytest

from palmd.quantities import ESTIMATE, SHAPE
from palmd.rig.real_things import thing
from palmd.view.naming import named

THETA = np.arange(360) * (math.tau / 360)


def latest(*, valid: bool = True, felt: float = 1.0) -> dict[str, bytes]:
    h = thing("nut", np.random.default_rng(3)).body.support.sample(THETA)
    shape = {"theta_rad": THETA.tolist(), "h_m": h.tolist(), "h_sd_m": [3e-5] * 360,
             "touched": (felt * math.tau > THETA).astype(int).tolist()}  # fmt: skip
    estimate = {"valid": valid, "object": 4}
    return {SHAPE.name: msgpack.packb(shape), ESTIMATE.name: msgpack.packb(estimate)}


def told(payloads: dict[str, bytes]) -> dict[str, object]:
    payload = named(payloads)
    assert payload is not None
    fields: dict[str, object] = msgpack.unpackb(payload)
    return fields


def test_a_nut_felt_all_round_is_a_hexagon_and_of_that_object() -> None:
    fields = told(latest())
    assert fields["object"] == 4
    assert str(fields["said"]).startswith("regular hexagon, 24.0")


def test_half_a_nut_has_no_name() -> None:
    assert told(latest(felt=0.5))["said"] == ""


@pytest.mark.parametrize("without", [ESTIMATE.name, SHAPE.name])
def test_nothing_is_said_of_what_nobody_vouches_for(without: str) -> None:
    assert named(latest(valid=False)) is None
    assert named({topic: payload for topic, payload in latest().items() if topic != without}) is None
