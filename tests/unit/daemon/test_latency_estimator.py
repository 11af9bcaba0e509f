"""The latency estimator on motions with known lag."""

import math

import numpy as np
import pytest

from palmd.daemon.latency_estimator import LONGEST_S, START_S, LatencyEstimator
from palmd.events import PalmMotion

CYCLE = 0.016


def swing(t: float, rate_hz: float = 0.4) -> PalmMotion:
    w = math.tau * rate_hz
    a1, a2 = 0.3, 0.15
    return PalmMotion(
        (0.8 + a1 * math.sin(w * t), 1.6 + a2 * math.cos(w * t)),
        (a1 * w * math.cos(w * t), -a2 * w * math.sin(w * t)),
        (-a1 * w * w * math.sin(w * t), -a2 * w * w * math.cos(w * t)),
    )


def run(lag: float, seconds: float, noise: float = 2e-4, motion=swing, free=(), drift=0.0) -> LatencyEstimator:
    tracker, random = LatencyEstimator(), np.random.default_rng(1)
    for i in range(round(seconds / CYCLE)):
        t = i * CYCLE
        tracker.sent(t, motion(t))
        now = motion(t - lag)
        phi1, phi2 = now.angles + random.normal(0.0, noise, 2)
        tracker.observe(t + 0.001, (phi1, phi2 + drift * t), free)
    return tracker


@pytest.mark.parametrize("within_s", [0.01, 0.04])
def test_extremes_are_those_of_the_commanded_motion_around_the_time(within_s):
    tracker = LatencyEstimator()
    for i in range(20):
        tracker.sent(i * CYCLE, swing(i * CYCLE, rate_hz=4.0))
    at = 0.2
    around = np.array([tracker.motion(at + x).angles for x in np.linspace(-within_s, within_s, 400)])
    least, largest = tracker.extremes(at, within_s)
    assert np.allclose(least, around.min(axis=0), atol=1e-3)
    assert np.allclose(largest, around.max(axis=0), atol=1e-3)
    tracker.sent(1.0, PalmMotion.at_rest((0.1, 0.2)))
    assert tracker.extremes(2.0, within_s) == ((0.1, 0.2), (0.1, 0.2))


@pytest.mark.parametrize("lag", [0.005, 0.03, 0.055, 0.09])
def test_the_lag_is_found_while_moving(lag):
    # observed 1 ms after the set-point, which does not count as lag
    assert run(lag, 6.0).lag_s == pytest.approx(lag + 0.001, abs=1.5e-3)


def test_a_joint_free_to_move_by_itself_is_ignored():
    assert run(0.03, 6.0, free=(1,), drift=0.05).lag_s == pytest.approx(0.031, abs=1.5e-3)
    assert run(0.03, 6.0, drift=0.05).lag_s != pytest.approx(0.031, abs=5e-3)


def test_an_arm_at_rest_leaves_the_lag_unchanged():
    def still(_t: float) -> PalmMotion:
        return PalmMotion.at_rest((0.8, 1.6))

    assert run(0.08, 6.0, motion=still).lag_s == START_S


@pytest.mark.parametrize("lag", [-0.05, 0.3])
def test_the_lag_stays_within_bounds(lag):
    assert 0.0 <= run(lag, 6.0).lag_s <= LONGEST_S


def test_the_motion_is_that_commanded_one_lag_ago():
    tracker = LatencyEstimator()
    for i in range(20):
        tracker.sent(i * CYCLE, swing(i * CYCLE))
    meant = tracker.motion(0.25)
    assert meant is not None
    expected = swing(0.25 - START_S)
    assert meant.angles[0] == pytest.approx(expected.angles[0], abs=1e-4)
    assert meant.rates[1] == pytest.approx(expected.rates[1], abs=1e-3)


def test_after_the_last_set_point_the_motion_holds_and_before_the_first_there_is_none():
    tracker = LatencyEstimator()
    tracker.sent(1.0, swing(1.0))
    assert tracker.motion(5.0) == swing(1.0)
    assert tracker.motion(1.0 + START_S - 1e-6) is None


def test_forgetting_the_motion_keeps_the_lag():
    tracker = run(0.07, 6.0)
    lag = tracker.lag_s
    tracker.forget()
    assert tracker.motion(6.0) is None
    assert tracker.lag_s == lag
