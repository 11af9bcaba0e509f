from __future__ import annotations

import math

import numpy as np
import pytest

from palmd.events import PadSample, PalmMotion, PalmSample
from palmd.observer.static_mass import mass_at_rest
from palmd.rig.plant import Hinge, Plant, random_surface, stable_poses
from palmd.rig.shapes import random_body
from palmd.system.description import RigDescription

RIG = RigDescription(hinge="fixed")


def lying(seconds: float, seed: int, turning: float = 0.0, forces: bool = True):
    """An object at rest in the emulated plant, and the pads' readings of it."""
    rng = np.random.default_rng(seed)
    body = random_body("friction", rng)
    palms = PalmMotion.at_rest((0.7, 1.6))
    plant = Plant(body, Hinge("fixed"), random_surface("friction", rng))
    plant.place(palms, psi=stable_poses(body, palms)[0])
    for _ in range(400):
        plant.advance(palms, palms, 5e-4)
    events = []
    for k in range(round(seconds / 0.01)):
        t = k * 0.01
        events.append(PalmSample(t, (0.7 + turning * t + rng.normal(0, 2e-4), 1.6 + rng.normal(0, 2e-4))))
        for pad, contact in zip((1, 2), plant.contacts(), strict=True):
            force = contact.force * (1 + rng.normal(0, 0.05)) if forces else None
            events.append(PadSample(t, pad, contact.s + rng.normal(0, 1e-4), force))
    return events, body.mass


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_object_at_rest_is_weighed(seed):
    events, true = lying(3.0, seed)
    weighed = mass_at_rest(events, RIG)
    assert weighed.value == pytest.approx(true, rel=0.01)
    assert abs(weighed.value - true) < 4 * weighed.sd
    assert weighed.sd < 0.005 * true


def test_a_moving_object_is_not_weighed():
    events, _ = lying(2.0, 1, turning=0.1)
    assert math.isnan(mass_at_rest(events, RIG).value)


def test_without_forces_or_events_there_is_no_mass():
    events, _ = lying(2.0, 1, forces=False)
    assert math.isnan(mass_at_rest(events, RIG).value)
    assert math.isnan(mass_at_rest([], RIG).value)
    assert math.isnan(mass_at_rest([e for e in events if isinstance(e, PalmSample)], RIG).value)


def test_only_the_spans_at_rest_count():
    still, true = lying(1.0, 2)
    moving = [
        PadSample(e.t_sample + 1.0, e.pad, e.s + 0.01 * e.t_sample, 9.0) if isinstance(e, PadSample)
        else PalmSample(e.t_sample + 1.0, e.angles)
        for e in still
    ]  # fmt: skip
    assert mass_at_rest(still + moving, RIG).value == pytest.approx(true, rel=0.01)
