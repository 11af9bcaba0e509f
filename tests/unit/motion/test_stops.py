"""Stops along the path, with the arm's or the configured deceleration."""

import math
from dataclasses import replace

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from palmd.config.two_palms import PlanSpec
from palmd.daemon.poses import make_poses
from palmd.devices.actuator import Reach
from palmd.events import PalmMotion
from palmd.motion.check import motion_limits
from palmd.motion.plan import compile_plan
from palmd.motion.trajectory_executor import TrajectoryExecutor
from palmd.rig.adept_arm import arm_limits
from palmd.rig.world import default_config

CONFIG = default_config()
ARM = arm_limits(CONFIG)
REACH = Reach(ARM.x_min, ARM.x_max, ARM.y_min, ARM.y_max, ARM.v_max, ARM.a_max)
WORKSPACE = make_poses(CONFIG).workspace(REACH)
LIMITS = replace(motion_limits(CONFIG), workspace=WORKSPACE)
SWING = PlanSpec.model_validate(
    yaml.safe_load(
        "name: swing\nrepeat: forever\nsegments:\n- move: {phi1_deg: 45, phi2_deg: 90}\n  duration_s: 0.4\n"
        "- sine: {phi1_deg: 20, phi2_deg: 8}\n  frequency_hz: 0.6\n  duration_s: 20\n"
    )
)
STEP_S = 0.002


def stopped(limits, after_s, *, hard):
    """Time until the path stands still (s), and all its motions until then."""
    trajectory = compile_plan(SWING, limits)
    executor = TrajectoryExecutor(limits)
    executor.stand((math.radians(45.0), math.radians(90.0)))
    executor.start(trajectory)
    t, motions = 0.0, []
    while t < after_s:
        t += STEP_S
        executor.advance(t)
    executor.hold(hard=hard)
    t_begun = t
    while executor.moving:
        t += STEP_S
        motions.append(executor.advance(t))
    return t - t_begun, motions


@pytest.mark.parametrize("after_s", [1.3, 1.7, 2.2, 3.05])
def test_a_stop_is_quicker_than_a_pause_and_within_the_arms_acceleration(after_s):
    hard_s, motions = stopped(LIMITS, after_s, hard=True)
    gentle_s, _ = stopped(LIMITS, after_s, hard=False)
    assert hard_s < 0.75 * gentle_s + STEP_S
    tips = [WORKSPACE.geometry.tip_speed_acceleration(motion)[1] for motion in motions[:-1]]
    assert max(tips, default=0.0) <= ARM.a_max


def test_a_configured_deceleration_is_kept():
    most = math.radians(400.0)
    soft_s, motions = stopped(replace(LIMITS, stop_deceleration=most), 2.2, hard=True)
    assert soft_s > stopped(LIMITS, 2.2, hard=True)[0]
    assert max(abs(each) for motion in motions[:-1] for each in motion.accelerations) <= most * 1.02


def test_without_limits_from_the_arm_stops_keep_the_plans_limit():
    _, motions = stopped(replace(LIMITS, workspace=None), 2.2, hard=True)
    assert max(abs(each) for motion in motions[:-1] for each in motion.accelerations) <= LIMITS.acceleration * 1.02


angle = st.tuples(st.floats(0.2, 2.4), st.floats(0.7, 2.4))
rate = st.floats(-2.0, 2.0)


@given(angle, st.tuples(rate, rate), st.tuples(rate, rate), st.floats(0.0, 1.0))
def test_the_hardest_deceleration_uses_the_arms_full_acceleration(angles, rates, accelerations, speed):
    planned = PalmMotion(angles, rates, accelerations)
    slowing = WORKSPACE.hardest_slowing(planned, speed)
    if not math.isfinite(slowing) or slowing == 0.0 or slowing > 1e4:
        return

    def tip(slowing):
        slowed = tuple(alpha * speed**2 - omega * slowing for omega, alpha in zip(rates, accelerations, strict=True))
        motion = PalmMotion(angles, tuple(omega * speed for omega in rates), slowed)
        return WORKSPACE.geometry.tip_speed_acceleration(motion)[1]

    assert tip(slowing) == pytest.approx(0.9 * ARM.a_max, rel=1e-4)
    assert tip(1.01 * slowing) > tip(slowing) * (1.0 - 1e-9)


@pytest.mark.parametrize("omega", [-1.0, 1.0])
@pytest.mark.parametrize("alpha", [-8.0, -0.5, 0.5, 8.0])
@pytest.mark.parametrize("speed", [0.5, 1.0])
def test_the_plans_own_acceleration_counts_with_its_sign(omega, alpha, speed):
    """Whether the plan speeds up or slows down, in both directions, the palm decelerates by exactly the limit."""
    most = math.radians(900.0)
    limits = replace(LIMITS, workspace=None, stop_deceleration=most)
    planned = PalmMotion((0.8, 1.6), (omega, 0.0), (alpha, 0.0))
    slowing = limits.hardest_slowing(planned, speed)
    assert abs(alpha * speed**2 - omega * slowing) == pytest.approx(most)
    assert (alpha * speed**2 - omega * slowing) * omega < 0.0


def test_palms_at_rest_have_no_deceleration_limit():
    assert WORKSPACE.hardest_slowing(PalmMotion.at_rest((0.8, 1.6)), 1.0) == math.inf


@given(angle)
def test_the_tips_speed_is_bounded_by_its_gain(angles):
    """The bound is reached when the palms are nearly stretched out."""
    (gain,) = {bound.gain for bound in WORKSPACE.bounds()}
    both = PalmMotion(angles, (1.0, 1.0), (0.0, 0.0))
    assert WORKSPACE.geometry.tip_speed_acceleration(both)[0] <= gain
    nearly_shut = PalmMotion((0.8, math.pi - 1e-6), (1.0, 1.0), (0.0, 0.0))
    assert WORKSPACE.geometry.tip_speed_acceleration(nearly_shut)[0] == pytest.approx(gain)
