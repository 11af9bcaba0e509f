"""The daemon's parts that are specific to three palms in space: see `daemon.systems`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from typing import ClassVar

from palmd import three_palms_messages as messages
from palmd.config.three_palms import ThreePalmsConfig, three_palms_rig
from palmd.daemon.explorer_process import ExplorerProcess
from palmd.daemon.guards.arm import GuardLimits
from palmd.daemon.guards.following import FollowingLimits, JointScale, noise_of_difference
from palmd.daemon.guards.rig_contradiction import no_contradiction
from palmd.daemon.poses import Poses
from palmd.daemon.smoothing import EventsProcess
from palmd.daemon.systems import LiveSystem
from palmd.devices.actuator import ArmPose, Pose
from palmd.events import Joints, ShapeEstimate
from palmd.messages import Fields, MessageCodec
from palmd.motion.kinematics import PoseError
from palmd.observer.observer import LiveObserver
from palmd.observer.three_palms.live import BodyObserver
from palmd.outlinefile import Outline
from palmd.quantities import Topic
from palmd.system.reasons import Code
from palmd.system.three_palms import JOINTS, NAMING, BodyAnswer, BodyEstimate
from palmd.three_palms_quantities import PALM3_ANSWER, PALM3_SHAPE

DECIDER = "palmd.daemon.body_decider:BodyDecider"
OUTSIDE_RAD = math.radians(1.0)
_PER_RAD = math.degrees(1e-3)  # the line's µm are 1/1000 degree


class TiltPoses(Poses):
    """Poses of a controller that drives the joints: x and y are β and γ2, 1/1000 degree per µm, and t is γ3."""

    def pose(self, angles: Joints, twist: float = 0.0) -> Pose:  # noqa: ARG002
        """These joint angles as the line transmits them."""
        beta, gamma2, gamma3 = angles
        return Pose(beta * _PER_RAD, gamma2 * _PER_RAD, gamma3)

    def angles(self, pose: ArmPose) -> Joints:
        """The joint angles of a pose on the line."""
        if not isinstance(pose, Pose):
            raise PoseError("the controller reports no pose")
        return (pose.x_m / _PER_RAD, pose.y_m / _PER_RAD, pose.t_rad)


class ThreePalmsInSpace(LiveSystem[ThreePalmsConfig, BodyEstimate]):
    """A body between three palms; see `LiveSystem`."""

    codec: ClassVar[MessageCodec] = messages
    naming = NAMING
    limit_tolerance = OUTSIDE_RAD

    def __init__(self, config: ThreePalmsConfig) -> None:
        super().__init__(config)
        self.poses = TiltPoses()
        error = config.limits.following_error
        self.guards = GuardLimits(
            FollowingLimits(
                at_rest=math.radians(error.at_rest_deg),
                at_full_rate=math.radians(error.at_full_rate_deg),
                rate=math.radians(config.limits.rate_deg_s),
                noise=noise_of_difference(math.radians(config.rig.angle_noise_deg)),
            ),
            JointScale(JOINTS, "°", math.degrees(1.0)),
            no_contradiction,
        )
        self._latest: BodyEstimate | None = None

    def observer(self, outlines: Sequence[Outline], stack: ExitStack) -> tuple[BodyObserver, EventsProcess[BodyAnswer]]:
        """The observer and its smoother; stored outlines are not supported."""
        del outlines
        rig = three_palms_rig(self._config)
        smoother = EventsProcess("palmd.daemon.three_palms_smoothing", asdict(rig), messages.ANSWERS.unpacked)
        stack.callback(smoother.close)
        return BodyObserver(rig, smoother), smoother

    def explorer(self, stack: ExitStack) -> ExplorerProcess:
        """The process that decides explorations."""
        explorer = ExplorerProcess(three_palms_rig(self._config), DECIDER)
        stack.callback(explorer.close)
        return explorer

    def invalid_estimate(self, t: float, observer: LiveObserver) -> BodyEstimate:
        nan = (math.nan,) * 4
        return BodyEstimate(
            t, False, observer.name, observer.object_count, math.nan, values={}, quaternion=nan, attitude_sd=nan[1:],
            touched=0.0, hypotheses=0, reason="the observer has failed", invalid_reasons=(Code.OBSERVER_FAILED,),
        )  # fmt: skip

    def is_finite(self, estimate: BodyEstimate) -> bool:
        """Whether all named quantities have finite values and 1σ."""
        named = (each.name for each in self.topics.estimate.quantities if each.role == "named")
        return all(math.isfinite(of.get(name, math.nan)) for name in named for of in (estimate.values, estimate.sd))

    def estimate_fields(self, estimate: BodyEstimate) -> Fields:
        """`palm3/estimate`."""
        self._latest = estimate
        return messages.estimate_fields(estimate)

    def answer_message(self, t: float, answer: BodyAnswer) -> tuple[Topic, Fields]:
        """`palm3/answer`."""
        return PALM3_ANSWER, messages.answer_fields(t, answer)

    def shape_message(self, shape: ShapeEstimate) -> tuple[Topic, Fields]:
        """`palm3/shape`."""
        of = () if self._latest is None else (self._latest.object_count, self._latest.valid)
        return PALM3_SHAPE, messages.shape_fields(shape, *of)
