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
    """Joint 1 commanded at a constant rate; `reported(t, commanded)` in rad. When it was named (s), None if never."""
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
def test_an_arm_that_follows_with_an_error_of_its_lag_is_not_named(rate):
    guard = FollowingGuard(LIMITS, SCALE)
    late = LIMITS.slope_s * math.radians(rate)
    assert drive(guard, rate, lambda t, c: c - late + math.radians(0.04) * math.sin(7.0 * t)) is None


@pytest.mark.parametrize("rate", [2.0, 5.0, 10.0, 20.0, 45.0, 90.0, 120.0])
def test_a_blocked_arm_is_named_within_300_ms_of_passing_the_limit_and_500_of_the_block(rate):
    block = 0.5
    guard = FollowingGuard(LIMITS, SCALE)
    named = drive(guard, rate, lambda _t, c: min(c, math.radians(rate) * block))
    assert named - block <= 0.5
    passed = LIMITS.joint(math.radians(rate)) / math.radians(rate)
    assert named - block <= passed + 0.3
    assert guard.shows_no_motion
    assert "phi1" in guard.reason


@pytest.mark.parametrize("rate", [2.0, -2.0, 30.0])
def test_an_encoder_that_is_mirrored_is_named_though_the_error_is_small(rate):
    guard = FollowingGuard(LIMITS, SCALE)
    assert drive(guard, rate, lambda _, c: -c) < 0.5


@pytest.mark.parametrize("late_s", [0.01, 0.02, 0.04])
@pytest.mark.parametrize("seed", range(5))
def test_small_steps_by_hand_are_followed_though_the_host_is_late_now_and_then(late_s, seed):
    def place(t):  # 0.4 s at 3 °/s there, 0.4 s at rest, and back
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


def test_one_report_alone_is_not_believed():
    guard = FollowingGuard(LIMITS, SCALE)
    spoilt = []

    def reported(_t, commanded):
        spoilt.append(commanded)
        return commanded + (math.radians(20.0) if len(spoilt) == 30 else 0.0)

    assert drive(guard, 20.0, reported) is None


def test_a_joint_that_need_not_follow_is_not_judged():
    guard = FollowingGuard(LIMITS, SCALE, free=(0,))
    assert drive(guard, 30.0, lambda _t, _c: 0.0) is None


def test_after_the_controller_has_paused_nothing_is_judged_for_a_while():
    guard = FollowingGuard(LIMITS, SCALE)
    guard.suspend(0.0)
    named = drive(guard, 45.0, lambda _t, _c: 0.0)
    assert SETTLE_S <= named <= SETTLE_S + 2.5 * CYCLE


def test_the_tool_has_a_limit_of_its_own():
    guard = FollowingGuard(FollowingLimits(1.0, 2.0, RATE, 0.1, (0.004, 0.024)), SCALE)
    still = (0.0, 1.0), (0.0, 1.0)
    for n in range(1, 3):
        guard.report(n * CYCLE, (0.0, 1.0), still, (0.0, 0.0), [0.0, 0.0], 0.005)
    assert "gripper" in guard.reason
    assert "5.0 mm" in guard.reason
    guard.forget()
    assert not guard.reason
