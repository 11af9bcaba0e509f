"""The rig's verdict on set-points."""

import math

import pytest

from palmd.devices.armlink import Pose
from palmd.rig.arm import Linkage
from palmd.rig.setpoint_checker import SetPointChecker
from palmd.rig.world import default_config

CONFIG = default_config()
LINKAGE = Linkage.from_config(CONFIG)


def judge(*angles_deg, dt=0.016):
    found = SetPointChecker(LINKAGE, CONFIG.limits)
    for k, (phi1, phi2) in enumerate(angles_deg):
        found.check(LINKAGE.pose(math.radians(phi1), math.radians(phi2)), k * dt)
    return found.as_dict()


def test_the_rate_uses_the_interval_but_at_least_one_cycle():
    assert judge((45, 90), (46, 90))["largest_rate_deg_s"] == pytest.approx(1 / 0.016)
    assert judge((45, 90), (46, 90), dt=0.032)["largest_rate_deg_s"] == pytest.approx(1 / 0.032)
    assert judge((45, 90), (46, 90), dt=0.004)["largest_rate_deg_s"] == pytest.approx(1 / 0.016)
    assert judge((45, 90), (60, 90), dt=0.2)["largest_rate_deg_s"] == 0.0


def test_an_arm_in_hold_may_resume_from_its_pose():
    before, stands, far = (LINKAGE.pose(math.radians(phi1), 1.5) for phi1 in (50, 45, 40))
    for standing, step_deg in ((None, 5), (stands, 0), (far, 5)):
        found = SetPointChecker(LINKAGE, CONFIG.limits)
        found.check(before, 0.0)
        found.check(stands, 0.016, standing)
        assert found.as_dict()["largest_rate_deg_s"] == pytest.approx(step_deg / 0.016)


def test_set_points_bunched_by_a_late_rig_are_not_reported_as_fast():
    """Two set-points sent 0.03 s apart are dated 7 ms apart; later ones on time are judged as usual."""
    found = SetPointChecker(LINKAGE, CONFIG.limits)
    for t, late_s, phi1 in ((0.0, 0.0, 45), (0.016, 0.04, 46), (0.023, 0.04, 48), (0.078, 0.0, 48)):
        found.note_delay(t, late_s)
        found.check(LINKAGE.pose(math.radians(phi1), 1.5), t)
    assert found.as_dict()["largest_rate_deg_s"] == pytest.approx(2 / 0.047)
    for k, phi1 in enumerate((48, 50)):
        found.note_delay(0.2 + k * 0.016, 0.0)
        found.check(LINKAGE.pose(math.radians(phi1), 1.5), 0.2 + k * 0.016)
    assert found.as_dict()["largest_rate_deg_s"] == pytest.approx(2 / 0.016)


def test_a_truly_fast_set_point_is_found_however_late_the_rig_reads():
    """Ten degrees in a cycle, at most 100°/s: too fast even over the longest possible interval."""
    for late_s in (0.0, 0.005, 0.05, 0.08):
        found = SetPointChecker(LINKAGE, CONFIG.limits)
        for t, phi1 in ((0.0, 45), (0.016, 55)):
            found.note_delay(t, late_s)
            found.check(LINKAGE.pose(math.radians(phi1), 1.5), t)
        rate_deg_s = found.as_dict()["largest_rate_deg_s"]
        assert rate_deg_s > 100.0
        assert rate_deg_s == pytest.approx(10 / (0.016 + late_s))


@pytest.mark.parametrize("angles", [(5, 90), (45, 34), (10, 156), (80, 93)])
def test_set_points_outside_the_limits_are_reported(angles):
    assert judge((45, 90), angles)["setpoints_outside_limits"] == 1


@pytest.mark.parametrize("angles", [(6, 90), (45, 35), (10, 155), (80, 91.9)])
def test_set_points_on_the_limits_are_accepted(angles):
    assert judge((45, 90), angles)["setpoints_outside_limits"] == 0


def test_an_unreachable_set_point_counts_as_outside():
    found = SetPointChecker(LINKAGE, CONFIG.limits)
    found.check(Pose(0.9, 0.9, 0.0), 0.0)
    assert found.outside_limits == 1


def test_tool_angle_is_checked():
    found = SetPointChecker(LINKAGE, CONFIG.limits)
    pose = LINKAGE.pose(0.8, 1.6)
    found.check(Pose(pose.x_m, pose.y_m, pose.t_rad - 0.1 + math.tau), 0.0)
    assert found.as_dict()["largest_tool_error_deg"] == pytest.approx(math.degrees(0.1))
