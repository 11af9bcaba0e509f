"""The angular rate of a vibrated body: without the ripple, and without a lag."""

import math

import pytest

from palmd.rig.mean_turning import MeanTurning

STEP_S = 1e-3


@pytest.mark.parametrize(("one_hz", "other_hz", "worst"), [(240.0, 240.0, 3e-3), (233.5, 246.5, 1e-2)])
def test_a_ripple_is_removed_and_a_slow_motion_followed_without_lag(one_hz, other_hz, worst):
    turning, ripple = MeanTurning(0.5 / one_hz + 0.5 / other_hz), 0.1  # rad/s
    turning.reset(0.0, 0.0, 0.0)
    errors = []
    for step in range(1, 1000):
        t = step * STEP_S
        shaken = sum(ripple / (math.tau * hz) * math.cos(math.tau * hz * t) for hz in (one_hz, other_hz))
        turning.take(t, 0.2 * math.sin(5.0 * t) + shaken)
        if step > 10:
            errors.append(turning.rate - math.cos(5.0 * t))
    assert max(map(abs, errors)) < worst


def test_the_initial_rate_holds_for_two_periods():
    turning = MeanTurning(4e-3)
    turning.reset(1.0, 0.3, 0.7)
    for step in range(1, 8):
        turning.take(1.0 + step * STEP_S, 0.3)
        assert turning.rate == 0.7
    for step in range(8, 12):
        turning.take(1.0 + step * STEP_S, 0.3)
    assert turning.rate == pytest.approx(0.0, abs=1e-12)
