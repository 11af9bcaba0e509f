"""Conversion between joint angles and actuator poses, one class for each kind of mechanism. Pure.

An arm that holds the far end of palm 2 takes poses of its tool; servos that turn the palms directly take angles.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from palmd.config.two_palms import Config
from palmd.devices.actuator import ArmPose, JointPose, Pose, Reach
from palmd.events import Joints
from palmd.motion.kinematics import PoseError, RigGeometry, wrapped
from palmd.motion.limits import Workspace


class Poses(ABC):
    """Joint angles (rad) to the actuator's poses and back; a tool may be twisted against palm 2 (rad)."""

    @abstractmethod
    def pose(self, angles: Joints, twist: float = 0.0) -> ArmPose:
        """The actuator's pose for these joint angles; raises PoseError if there is none."""

    @abstractmethod
    def angles(self, pose: ArmPose) -> Joints:
        """The joint angles for a pose; raises PoseError if there are none."""

    def twist(self, pose: ArmPose, angles: Joints) -> float:
        """Twist of the tool against palm 2 in a pose with these joint angles; 0 without a tool."""
        del pose, angles
        return 0.0

    def workspace(self, reach: Reach) -> Workspace | None:
        """The actuator's limits that apply to a motion, None where only the joint limits apply."""
        del reach
        return None


class ArcPoses(Poses):
    """Poses of an arm that holds palm 2's far end; palm 1 is hinged to the base."""

    def __init__(self, geometry: RigGeometry) -> None:
        self.geometry = geometry

    def pose(self, angles: Joints, twist: float = 0.0) -> Pose:
        """The tool's pose in arm coordinates."""
        x, y, tool = self.geometry.arm_pose(angles)
        return Pose(x, y, wrapped(tool + twist))

    def angles(self, pose: ArmPose) -> Joints:
        """From the tool's position alone."""
        if not isinstance(pose, Pose):
            raise PoseError("the arm reports no position of its tool")
        return self.geometry.palm_angles(pose.x_m, pose.y_m)

    def twist(self, pose: ArmPose, angles: Joints) -> float:
        """The tool angle minus the one that follows from the joint angles."""
        straight = self.geometry.arm_pose(angles)[2]
        return wrapped(pose.t_rad - straight) if isinstance(pose, Pose) else 0.0

    def workspace(self, reach: Reach) -> Workspace:
        """A box for the tool's position, and limits of its speed and acceleration."""
        box = reach.x_min_m, reach.x_max_m, reach.y_min_m, reach.y_max_m
        return Workspace(self.geometry, *box, reach.v_max_m_s, reach.a_max_m_s2)


class JointPoses(Poses):
    """Poses of servos that turn the palms about a fixed hinge: the joint angles."""

    def pose(self, angles: Joints, twist: float = 0.0) -> JointPose:  # noqa: ARG002
        """The joint angles themselves."""
        return JointPose(angles)

    def angles(self, pose: ArmPose) -> Joints:
        """The joint angles themselves."""
        if not isinstance(pose, JointPose):
            raise PoseError("the actuator reports no joint angles")
        return pose.joints_rad


def make_poses(config: Config) -> Poses:
    """The conversion for the configured mechanism."""
    return ArcPoses(RigGeometry.from_config(config)) if config.arm.hinge == "arc" else JointPoses()
