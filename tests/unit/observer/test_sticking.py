"""Whether contacts stick is determined from forces, slow palm motion and nothing else."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import pytest

from palmd.events import PadSample, PalmMotion
from palmd.observer.sticking import LIFTED_S, StickingWatch
from palmd.system.vibration import DRY, Vibration

SWING, RATE = 0.15, 3.0  # rad, rad/s, of the opening


def rocked(
    watch: StickingWatch,
    friction: Callable[[float], float],
    gains: tuple[float, float] = (1.0, 1.0),
    begin: float = 0.0,
) -> float:
    """Ten seconds of a round object at rest between palms whose friction depends on the opening's rate (rad/s)."""
    chance, t = random.Random(3), begin
    for i in range(1000):
        t = begin + 0.01 * i
        opening, opens = 1.6 + SWING * math.sin(RATE * t), SWING * RATE * math.cos(RATE * t)
        rubs = friction(opens)
        each = 1.0 / (1.0 - math.cos(opening) + rubs * math.sin(opening))  # both alike: Σ f (n − μ σ t) = g
        for pad, gain in zip((1, 2), gains, strict=True):
            watch.feed(PadSample(t, pad, 0.02 + 1e-3 * pad, gain * each * chance.gauss(1.0, 0.05)))
        first = math.pi / 2 - opening / 2
        watch.look(t, PalmMotion((first, opening), (-opens / 2, opens), (0.0, 0.0)))
    return t


@pytest.mark.parametrize("gains", [(1.0, 1.0), (0.6, 1.5)])
def test_rate_independent_friction_means_sticking_contacts(gains: tuple[float, float]) -> None:
    watch = StickingWatch()
    rocked(watch, lambda opens: math.copysign(0.2, opens), gains)
    assert watch.contacts == (0.021, 0.022)


@pytest.mark.parametrize("mu", [0.0, 0.25])
def test_averaged_friction_means_no_sticking(mu: float) -> None:
    watch = StickingWatch()
    rocked(watch, lambda opens: mu * math.tanh(0.02 * opens / 8e-3))
    assert watch.contacts is None


def test_a_lifted_object_or_palms_at_rest_give_no_decision() -> None:
    watch = StickingWatch()
    t = rocked(watch, lambda opens: math.copysign(0.2, opens))
    standing = PalmMotion.at_rest((0.8, 1.6))
    watch.look(t + 0.9 * LIFTED_S, standing)
    assert watch.contacts is not None
    watch.look(t + 1.1 * LIFTED_S, standing)
    assert watch.contacts is None
    for i in range(300):
        for pad in (1, 2):
            watch.feed(PadSample(t + 1.0 + 0.01 * i, pad, 0.02, 1.0 + 0.3 * (i % 2)))
        watch.look(t + 1.0 + 0.01 * i, standing)
    assert watch.contacts is None


def test_readings_without_force_give_no_decision() -> None:
    watch = StickingWatch()
    for i in range(300):
        for pad in (1, 2):
            watch.feed(PadSample(0.01 * i, pad, 0.02, None))
        watch.look(0.01 * i, PalmMotion((0.8, 1.6), (0.0, 0.05), (0.0, 0.0)))
    assert watch.contacts is None


def test_fast_and_strong_vibration_prevents_sticking() -> None:
    strong, weak = (Vibration(frequency=250.0, speed=speed) for speed in (0.02, 0.002))
    for vibration, sticks in ((strong, False), (weak, True)):
        watch = StickingWatch(vibration)
        rocked(watch, lambda opens: math.copysign(0.2, opens))
        assert (watch.contacts is not None) is sticks


@pytest.mark.parametrize(("mu", "frictionless"), [(0.0, True), (0.05, False)])
def test_forces_show_whether_there_is_friction(mu: float, frictionless: bool) -> None:
    watch = StickingWatch(DRY)
    assert not watch.frictionless
    rocked(watch, lambda opens: math.copysign(mu, opens))
    assert watch.frictionless is frictionless
