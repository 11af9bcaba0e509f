"""Following error and motion comparison, report by report."""

import math

import numpy as np
import pytest

from palmd.daemon.guards.following import SETTLE_S, FollowingGuard, FollowingLimits, JointScale

CYCLE = 0.016
RATE = math.radians(120.0)
LIMITS = FollowingLimits(math.radians(1.0), math.radians(6.0), RATE, math.radians(0.1))
SCALE = JointScale(("phi1", "phi2"), "°", math.degrees(1.0))


def drive(guard, rate_deg_s, reported, seconds=2.0, t=0.0):
    """Joint 1 commanded at a constant rate; `reported(t, commanded)` in rad. Time of detection (s), None if never."""
    rate = math.radians(rate_deg_s)
    t_begin = t
    while t < t_begin + seconds:
        t += CYCLE
        commanded = rate * (t - t_begin)
        within = abs(rate) * LIMITS.slope_s
        extremes = (commanded - within, 1.0), (commanded + within, 1.0)
        at = reported(t - t_begin, commanded)
        guard.report(t, (at, 1.0), extremes, (at - commanded, 0.0), [abs(rate), 0.0], 0.0)
        if guard.reason:
            return t - t_begin
    return None


@pytest.mark.parametrize("rate", [0.0, 1.0, 10.0, 45.0, 120.0])
def test_a_lag_within_the_following_error_limit_is_not_reported(rate):
    guard = FollowingGuard(LIMITS, SCALE)
    late = LIMITS.slope_s * math.radians(rate)
    assert drive(guard, rate, lambda t, c: c - late + math.radians(0.04) * math.sin(7.0 * t)) is None


@pytest.mark.parametrize("rate", [2.0, 5.0, 10.0, 20.0, 45.0, 90.0, 120.0])
def test_a_blocked_arm_is_reported_within_300_ms_of_the_limit_and_500_ms_of_the_block(rate):
    block = 0.5
    guard = FollowingGuard(LIMITS, SCALE)
    named = drive(guard, rate, lambda _t, c: min(c, math.radians(rate) * block))
    assert named - block <= 0.5
    passed = LIMITS.joint(math.radians(rate)) / math.radians(rate)
    assert named - block <= passed + 0.3
    assert guard.shows_no_motion
    assert "phi1" in guard.reason


@pytest.mark.parametrize("rate", [2.0, -2.0, 30.0])
def test_a_mirrored_encoder_is_reported_even_with_a_small_error(rate):
    guard = FollowingGuard(LIMITS, SCALE)
    assert drive(guard, rate, lambda _, c: -c) < 0.5


@pytest.mark.parametrize("late_s", [0.01, 0.02, 0.04])
@pytest.mark.parametrize("seed", range(5))
def test_small_manual_steps_with_occasional_host_delays_are_not_reported(late_s, seed):
    def place(t):  # 0.4 s forth at 3 °/s, 0.4 s at rest, and back
        phase = math.fmod(max(t, 0.0), 1.6)
        return math.radians(3.0) * (min(phase, 0.4) - min(max(phase - 0.8, 0.0), 0.4))

    guard, rng = FollowingGuard(LIMITS, SCALE), np.random.default_rng(seed)
    for n in range(1000):
        t = CYCLE * n
        peak = max(abs(place(t - back + 1e-3) - place(t - back)) / 1e-3 for back in (0.0, 0.02, 0.04))
        at = place(t - rng.choice((-late_s, 0.0, late_s))) + math.radians(0.02) * rng.normal()
        around = [place(t + shift) for shift in np.linspace(-LIMITS.slope_s, LIMITS.slope_s, 9)]
        extremes = (min(around), 1.0), (max(around), 1.0)
        guard.report(t, (at, 1.0), extremes, (at - place(t), 0.0), [peak, 0.0], 0.0)
        assert not guard.reason


def test_a_single_report_is_not_enough():
    guard = FollowingGuard(LIMITS, SCALE)
    spoilt = []

    def reported(_t, commanded):
        spoilt.append(commanded)
        return commanded + (math.radians(20.0) if len(spoilt) == 30 else 0.0)

    assert drive(guard, 20.0, reported) is None


def test_a_joint_that_need_not_follow_is_not_tested():
    guard = FollowingGuard(LIMITS, SCALE, free=(0,))
    assert drive(guard, 30.0, lambda _t, _c: 0.0) is None


def test_after_a_pause_of_the_controller_the_test_is_suspended():
    guard = FollowingGuard(LIMITS, SCALE)
    guard.suspend(0.0)
    named = drive(guard, 45.0, lambda _t, _c: 0.0)
    assert SETTLE_S <= named <= SETTLE_S + 2.5 * CYCLE


def test_the_tool_angle_has_its_own_limit():
    guard = FollowingGuard(FollowingLimits(1.0, 2.0, RATE, 0.1, (0.004, 0.024)), SCALE)
    still = (0.0, 1.0), (0.0, 1.0)
    for n in range(1, 3):
        guard.report(n * CYCLE, (0.0, 1.0), still, (0.0, 0.0), [0.0, 0.0], 0.005)
    assert "gripper" in guard.reason
    assert "5.0 mm" in guard.reason
    guard.forget()
    assert not guard.reason
