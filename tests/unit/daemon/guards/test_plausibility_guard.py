"""Which arm reports are plausible."""

import math

import pytest

from palmd.daemon.guards.following import FollowingLimits, JointScale
from palmd.daemon.guards.plausibility import MOST_REPORTS, PlausibilityGuard
from palmd.devices.actuator import Pose, Reach

LIMITS = FollowingLimits(math.radians(1.0), math.radians(6.0), math.radians(120.0), 1e-3)
SCALE = JointScale(("phi1", "phi2"), "°", math.degrees(1.0))
REACH = Reach(0.1, 0.4, -0.2, 0.2, 0.9, 10.0)
HERE = Pose(0.25, 0.0, 2.0)
PEAK = [math.radians(45.0), 0.0]
CYCLE = 0.016


def test_three_reports_outside_the_workspace_are_reported_with_the_pose():
    guard = PlausibilityGuard(LIMITS, SCALE)
    for n in range(MOST_REPORTS):
        assert not guard.reason
        assert not guard.report(n * CYCLE, Pose(0.5, 0.0, 2.0), REACH)
    assert "500.0 mm" in guard.reason
    assert "100.0 to 400.0 mm" in guard.reason


def test_a_single_report_counts_after_100_ms():
    guard = PlausibilityGuard(LIMITS, SCALE)
    guard.report(0.0, HERE, REACH, impossible="no palm angles")
    guard.look(0.09)
    assert not guard.reason
    guard.look(0.11)
    assert "no palm angles" in guard.reason


def test_a_lasting_jump_is_reported_after_three_reports():
    guard = PlausibilityGuard(LIMITS, SCALE)
    jump = (math.radians(7.0), 0.0)
    assert guard.report(0.0, HERE, REACH, errors=(0.0, 0.0), peak=PEAK)
    for n in range(1, 1 + MOST_REPORTS):
        assert not guard.report(n * CYCLE, HERE, REACH, errors=jump, peak=PEAK)
    assert "phi1 jumped by +7.00°" in guard.reason


def test_a_transient_jump_is_not_reported():
    guard = PlausibilityGuard(LIMITS, SCALE)
    plausible = [
        guard.report(n * CYCLE, HERE, REACH, errors=(0.1 if n % 5 == 4 else 0.0, 0.0), peak=PEAK) for n in range(30)
    ]
    assert not guard.reason
    assert not all(plausible)


@pytest.mark.parametrize(("twist_deg", "fits"), [(3.0, True), (11.0, False), (-90.0, False)])
def test_a_tool_angle_inconsistent_with_x_and_y_is_implausible(twist_deg, fits):
    guard = PlausibilityGuard(LIMITS, SCALE)
    guard.report(0.0, HERE, REACH, errors=(0.0, 0.0), peak=PEAK, twist=0.0)
    twist = math.radians(twist_deg)
    assert guard.report(CYCLE, HERE, REACH, errors=(0.0, 0.0), peak=PEAK, twist=twist) is fits


def test_motion_during_a_silence_of_the_arm_is_no_jump():
    """Without set-points a controller holds its position: motion commanded meanwhile is missing in the next report."""
    guard = PlausibilityGuard(LIMITS, SCALE)
    assert guard.report(0.0, HERE, REACH, errors=(0.0, 0.0), peak=PEAK)
    missed = 0.09 * PEAK[0]
    assert guard.report(0.09, HERE, REACH, errors=(-missed, 0.0), peak=PEAK)
    assert not guard.report(0.106, HERE, REACH, errors=(-2.0 * missed, 0.0), peak=PEAK)
