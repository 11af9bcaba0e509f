"""Whether a pose is possible on the configured rig."""

import math
from dataclasses import replace

import pytest

from palmd.daemon.guards.rig_contradiction import UNDRIVEN_TOOL_RAD, arc_contradiction, pivot_contradiction
from palmd.devices.actuator import Pose
from palmd.motion.kinematics import RigGeometry

RIG = RigGeometry(0.12, 0.0, 0.12, 0.12, -0.3, 0.0, 0.0)


@pytest.mark.parametrize("phi1", [20.0, 45.0, 80.0])
@pytest.mark.parametrize("phi2", [50.0, 90.0])
def test_every_pose_of_the_rig_is_consistent(phi1, phi2):
    pose = Pose(*RIG.arm_pose((math.radians(phi1), math.radians(phi2))))
    assert not arc_contradiction(RIG, pose, UNDRIVEN_TOOL_RAD)


@pytest.mark.parametrize("turn", [90.0, 180.0, -90.0])
@pytest.mark.parametrize("phi1", [30.0, 45.0, 70.0])
def test_a_rotated_base_is_reported_with_the_yaw_that_fits(turn, phi1):
    pose = Pose(*RIG.arm_pose((math.radians(phi1), math.radians(90.0))))
    wrong = replace(RIG, arm_yaw=math.radians(turn))
    said = arc_contradiction(wrong, pose, UNDRIVEN_TOOL_RAD)
    assert "mm" in said
    assert "arm.base_yaw_deg: 0" in said or "arm.base_yaw_deg: -0" in said


def test_a_displaced_base_is_reported_with_its_distance():
    pose = Pose(*RIG.arm_pose((math.radians(45.0), math.radians(90.0))))
    said = arc_contradiction(replace(RIG, arm_x=-0.6), pose, UNDRIVEN_TOOL_RAD)
    assert "240.0 mm" in said


@pytest.mark.parametrize("off_mm", [10.0, -10.0, 5.0, -5.0])
@pytest.mark.parametrize("phi1", [30.0, 45.0, 80.0])
def test_a_wrong_palm_length_contradicts_the_tool_angle(off_mm, phi1):
    pose = Pose(*RIG.arm_pose((math.radians(phi1), math.radians(80.0))))
    wrong = replace(RIG, palm1_length=RIG.palm1_length + off_mm * 1e-3)
    assert "palm lengths as configured" in arc_contradiction(wrong, pose, UNDRIVEN_TOOL_RAD)


def test_a_pivot_below_its_pad_is_reported():
    def place(pose):
        return pose.x_m, pose.y_m

    assert not pivot_contradiction(place, 0.0, Pose(0.02, 0.03, 0.0), UNDRIVEN_TOOL_RAD)
    assert "30.0 mm below" in pivot_contradiction(place, 180.0, Pose(0.02, -0.03, 0.0), UNDRIVEN_TOOL_RAD)
