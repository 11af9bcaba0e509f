"""Motion segments: from rest to rest, to the right place, with consistent derivatives."""

from __future__ import annotations

import itertools
import math

import pytest

from palmd.events import PalmMotion
from palmd.motion.segments import ConstantRate, Hold, MotionSegment, Move, Sine, blend

SEGMENTS: list[MotionSegment] = [
    Hold((0.7, 1.5), 2.0),
    Move((0.7, 1.5), (1.0, 1.2), 1.3),
    ConstantRate((0.7, 1.5), (0.5, -0.2), 0.1, 1.1),
    ConstantRate((0.7, 1.5), (-0.5, 0.2), 0.4, 0.8),
    Sine((0.7, 1.5), (0.3, -0.1), (2.5, 4.0), 1.0, 5.0),
    Sine((0.7, 1.5), (0.3, 0.1), (30.0, 30.0), 0.5, 1.0),
]


def rest(motion: PalmMotion) -> tuple[float, float, float, float]:
    return *motion.rates, *motion.accelerations


@pytest.mark.parametrize("segment", SEGMENTS, ids=lambda s: type(s).__name__)
def test_segments_begin_and_end_at_rest(segment: MotionSegment) -> None:
    assert rest(segment.at(0.0)) == pytest.approx((0, 0, 0, 0), abs=1e-9)
    assert rest(segment.at(segment.duration)) == pytest.approx((0, 0, 0, 0), abs=1e-9)


@pytest.mark.parametrize("segment", SEGMENTS, ids=lambda s: type(s).__name__)
def test_rates_and_accelerations_are_the_derivatives(segment: MotionSegment) -> None:
    h = 1e-5
    for i in range(1, 200):
        t = segment.duration * i / 200
        a, b, c = segment.at(t - h), segment.at(t), segment.at(t + h)
        assert (c.angles[0] - a.angles[0]) / (2 * h) == pytest.approx(b.rates[0], abs=1e-6)
        assert (c.angles[1] - a.angles[1]) / (2 * h) == pytest.approx(b.rates[1], abs=1e-6)
        assert (c.rates[0] - a.rates[0]) / (2 * h) == pytest.approx(b.accelerations[0], abs=1e-3)
        assert (c.rates[1] - a.rates[1]) / (2 * h) == pytest.approx(b.accelerations[1], abs=1e-3)


@pytest.mark.parametrize("segment", SEGMENTS, ids=lambda s: type(s).__name__)
def test_samples_include_the_extremes(segment: MotionSegment) -> None:
    fine = [segment.at(segment.duration * i / 20000) for i in range(20001)]
    seen = [segment.at(t) for t in segment.sample_times()]
    for name, joint in itertools.product(("angles", "rates", "accelerations"), (0, 1)):
        true = [getattr(motion, name)[joint] for motion in fine]
        some = [getattr(motion, name)[joint] for motion in seen]
        tolerance = 0.003 * (max(true) - min(true)) + 1e-12
        assert max(some) >= max(true) - tolerance
        assert min(some) <= min(true) + tolerance


def test_blend_is_the_minimum_jerk_quintic() -> None:
    assert blend(0.5) == pytest.approx((0.5, 1.875, 0.0))
    assert max(blend(i / 10000)[2] for i in range(10001)) == pytest.approx(10 / math.sqrt(3), rel=1e-6)
    assert blend(-1.0) == (0.0, 0.0, 0.0)
    assert blend(2.0) == (1.0, 0.0, 0.0)


def test_a_rate_segment_is_constant_between_its_ramps_and_covers_its_distance() -> None:
    segment = ConstantRate((0.7, 1.5), (0.5, -0.2), 0.1, 1.1)
    for t in (0.1, 0.5, 1.0):
        motion = segment.at(t)
        assert (*motion.rates, motion.accelerations[0]) == pytest.approx((0.5, -0.2, 0.0))
    end = segment.at(1.1)
    assert end.angles == pytest.approx((0.7 + 0.5, 1.5 - 0.2))


def test_a_sine_reaches_its_amplitude_and_decays_to_its_centre() -> None:
    segment = Sine((0.7, 1.5), (0.3, -0.1), (2.5, 2.5), 1.0, 6.0)
    peak = segment.at(2.5 * math.pi / 2.5)  # the second crest, sin = 1, at full amplitude
    assert peak.angles == pytest.approx((1.0, 1.4))
    assert segment.at(6.0).angles == pytest.approx((0.7, 1.5))


def test_an_endless_sine_does_not_decay() -> None:
    segment = Sine((0.0, 0.0), (0.1, 0.1), (1.0, 1.0), 0.5, math.inf)
    assert segment.at(math.pi * 1000.5).angles[0] == pytest.approx(0.1)
    assert len(list(segment.sample_times())) < 1000
