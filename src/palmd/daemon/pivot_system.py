"""The daemon's parts that are specific to a pivoting grasp: see `daemon.systems`."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from typing import ClassVar

from palmd import pivot_messages as messages
from palmd.config.pivot import PivotConfig, pivot_rig
from palmd.daemon.dragging import DragExploration
from palmd.daemon.exploration_requests import DecisionSource
from palmd.daemon.exploring import ExplorationControl
from palmd.daemon.guards.arm import GuardLimits
from palmd.daemon.guards.following import FollowingLimits, JointScale, noise_of_difference
from palmd.daemon.guards.rig_contradiction import pivot_contradiction
from palmd.daemon.poses import Poses
from palmd.daemon.setpoints import SetPoints
from palmd.daemon.smoothing import EventsProcess
from palmd.daemon.systems import LiveSystem
from palmd.devices.actuator import ArmPose, Pose
from palmd.events import Joints
from palmd.messages import Fields, MessageCodec
from palmd.motion.kinematics import PoseError
from palmd.observer.observer import LiveObserver
from palmd.observer.pivot.live import PivotObserver
from palmd.observer.pivot.observer import pivot_observer
from palmd.outlinefile import Outline
from palmd.pivot_quantities import PIVOT_ANSWER
from palmd.quantities import Topic
from palmd.system.pivot import AXES, NAMING, PAD, PivotAnswer, PivotEstimate
from palmd.system.reasons import Code

OUTSIDE_M = 2e-3


class PivotPoses(Poses):
    """Poses of an arm whose tool is the pivot; its base is at (x, y) from the pad's zero, turned by `yaw` (m, rad)."""

    def __init__(self, x: float, y: float, yaw: float) -> None:
        self._base, self._yaw = (x, y), yaw

    @classmethod
    def of(cls, config: PivotConfig) -> PivotPoses:
        """Poses of the configured arm."""
        arm = config.arm
        return cls(arm.base_x_mm * 1e-3, arm.base_y_mm * 1e-3, math.radians(arm.base_yaw_deg))

    def pose(self, angles: Joints, twist: float = 0.0) -> Pose:
        """Pose of the tool in arm coordinates, for a position of the pivot."""
        dx, dy = angles[0] - self._base[0], angles[1] - self._base[1]
        cos, sin = math.cos(self._yaw), math.sin(self._yaw)
        return Pose(cos * dx + sin * dy, cos * dy - sin * dx, twist)

    def angles(self, pose: ArmPose) -> Joints:
        """Position of the pivot for a pose of the tool."""
        if not isinstance(pose, Pose):
            raise PoseError("the arm reports no pose of its tool")
        cos, sin = math.cos(self._yaw), math.sin(self._yaw)
        return (
            self._base[0] + cos * pose.x_m - sin * pose.y_m,
            self._base[1] + sin * pose.x_m + cos * pose.y_m,
        )

    def twist(self, pose: ArmPose, angles: Joints) -> float:
        """The tool's present angle, which is kept: the tool turns freely about the pivot."""
        del angles
        return pose.t_rad if isinstance(pose, Pose) else 0.0


class PivotGrasp(LiveSystem[PivotConfig, PivotEstimate]):
    """A body that turns freely in a gripper over one pad; see `LiveSystem`."""

    codec: ClassVar[MessageCodec] = messages
    naming = NAMING
    limit_tolerance = OUTSIDE_M

    def __init__(self, config: PivotConfig) -> None:
        super().__init__(config)
        self.poses = PivotPoses.of(config)
        self.guards = _guard_limits(config, self.poses)
        if config.rig.vertical == "float":
            self.free = (AXES.index("z"),)  # commanded is the slide's stop

    def observer(
        self, outlines: Sequence[Outline], stack: ExitStack
    ) -> tuple[PivotObserver, EventsProcess[PivotAnswer]]:
        """The observer and its smoother; stored outlines are not supported."""
        del outlines
        rig = pivot_rig(self._config)
        smoother = EventsProcess("palmd.daemon.pivot_smoothing", asdict(rig), messages.ANSWERS.unpacked)
        stack.callback(smoother.close)
        return pivot_observer(rig, smoother), smoother

    def exploration_control(self, setpoints: SetPoints, source: DecisionSource | None) -> DragExploration:
        """Explorations are decided in the loop."""
        del source
        return DragExploration(setpoints)

    def invalid_estimate(self, t: float, observer: LiveObserver) -> PivotEstimate:
        nan = math.nan
        return PivotEstimate(
            t, False, observer.name, observer.object_count, nan, nan, nan, nan, nan, nan, nan, nan, nan, nan,
            side=0, touched=0.0, reason="the observer has failed", invalid_reasons=(Code.OBSERVER_FAILED,),
        )  # fmt: skip

    def suppressed_faults(self, exploring: ExplorationControl) -> Collection[str]:
        """No contact is no fault: the gripper lifts the body on purpose, and explorations report a loss themselves."""
        del exploring
        return _NO_CONTACT

    def answer_message(self, t: float, answer: PivotAnswer) -> tuple[Topic, Fields]:
        """`palm/pivot_answer`."""
        return PIVOT_ANSWER, messages.answer_fields(t, answer)


_NO_CONTACT = frozenset({f"pad{PAD}-lifted", f"pad{PAD}-silent"})


def _guard_limits(config: PivotConfig, poses: PivotPoses) -> GuardLimits:
    """Guard limits of the configured gripper, whose joints are its axes (m)."""
    error = config.limits.following_error
    return GuardLimits(
        FollowingLimits(
            at_rest=error.at_rest_mm * 1e-3,
            at_full_rate=error.at_full_rate_mm * 1e-3,
            rate=config.limits.speed_mm_s * 1e-3,
            noise=noise_of_difference(config.rig.arm_noise_mm * 1e-3),
        ),
        JointScale(AXES, " mm", 1e3),
        partial(pivot_contradiction, poses.angles, config.arm.base_yaw_deg),
    )
