"""Swapped pads are detected from the pressures, whatever the pads' gains; correct pads are never reported."""

from __future__ import annotations

import math
import random

import pytest

from palmd.daemon.swap import SwapWatch
from palmd.events import PadSample, PalmMotion


def _watch(gains: tuple[float, float], swapped: bool, swing: float, seconds: float = 10.0) -> SwapWatch:
    watch, chance = SwapWatch(), random.Random(4)
    for i in range(int(seconds * 100)):
        t = i * 0.01
        phi1 = 0.8 + swing * math.sin(2.5 * t)
        phi2 = 1.6 + 0.3 * swing * math.sin(3.6 * t)
        forces = (math.sin(phi1 + phi2) / math.sin(phi2), math.sin(phi1) / math.sin(phi2))
        pressures = [g * f * chance.gauss(1.0, 0.1) for g, f in zip(gains, forces, strict=True)]
        if swapped:
            pressures.reverse()
        watch.feed(PadSample(t, 1, 0.02, pressures[0]))
        watch.feed(PadSample(t, 2, 0.02, pressures[1]))
        watch.look(t, PalmMotion.at_rest((phi1, phi2)))
    return watch


@pytest.mark.parametrize("gains", [(1.0, 1.0), (0.6, 1.5), (3.0, 0.4)])
def test_swapped_pads_are_detected_and_correct_ones_are_not_reported(gains: tuple[float, float]) -> None:
    assert _watch(gains, swapped=True, swing=0.4).swapped
    assert not _watch(gains, swapped=False, swing=0.4).swapped


def test_palms_that_hardly_move_give_no_verdict() -> None:
    assert not _watch((1.0, 1.0), swapped=True, swing=0.01).swapped


def test_no_verdict_is_given_in_the_first_moments() -> None:
    assert not _watch((1.0, 1.0), swapped=True, swing=0.4, seconds=2.0).swapped


def test_readings_without_force_or_palm_angles_are_ignored() -> None:
    watch = SwapWatch()
    for i in range(1000):
        watch.feed(PadSample(i * 0.01, 1, 0.02, None))
        watch.feed(PadSample(i * 0.01, 2, 0.02, 0.0))
        watch.look(i * 0.01, None if i % 2 else PalmMotion.at_rest((0.8, 1.6)))
    assert not watch.swapped
