"""The guards of the arm: every report is judged before it is used. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass

from palmd.daemon.guards.following import FollowingGuard, FollowingLimits, JointScale
from palmd.daemon.guards.plausibility import TOOL_RAD, PlausibilityGuard
from palmd.daemon.guards.rig_contradiction import UNDRIVEN_TOOL_RAD
from palmd.daemon.latency_estimator import LatencyEstimator
from palmd.daemon.poses import Poses
from palmd.devices.actuator import FOLLOWING, ArmReport, ArmState, Pose, Reach
from palmd.events import Joints, PalmMotion
from palmd.motion.kinematics import PoseError, wrapped

PEAK_RATE_S = 0.05
"""A commanded rate widens the limits for this time, in addition to the lag."""

Contradiction = Callable[[Pose, float], str]
"""(pose, tolerance of the tool angle in rad) → how the pose contradicts the configured rig; empty if it does not."""


@dataclass(frozen=True, slots=True)
class GuardLimits:
    """Limits of a system's arm guards."""

    following: FollowingLimits
    scale: JointScale
    contradiction: Contradiction


class ArmGuards:
    """See the module.

    `contradiction` states how the pose that the arm reports at rest contradicts the configured rig, empty if it does
    not.
    """

    def __init__(self, limits: GuardLimits, poses: Poses, free: Collection[int] = ()) -> None:
        """`free` joints need not follow their set-points."""
        self.following = FollowingGuard(limits.following, limits.scale, free)
        self.plausible = PlausibilityGuard(limits.following, limits.scale)
        self.contradiction = ""
        self._driven = False  # whether the arm has been driven since the link came up
        self._limits, self._poses, self._free = limits, poses, free
        self._joints = len(limits.scale.names)

    def suspend(self, t: float) -> None:
        """From `t` (s) on set-points and arm may differ for a known reason, for example a pause of the controller."""
        self.following.suspend(t)
        self.plausible.suspend()

    def accepts(
        self, report: ArmReport, angles: Joints | None, impossible: str, lag: LatencyEstimator, reach: Reach | None
    ) -> bool:
        """Whether a report is plausible; a plausible one updates the lag estimate.

        angles: the joint angles of the report; None if there are none, with the reason in `impossible`. lag: the
        estimator that stores the set-points.
        """
        t, pose, state = report.t_sample, report.pose, report.state
        if state is ArmState.READY:
            tool_rad = TOOL_RAD if self._driven else UNDRIVEN_TOOL_RAD
            self.contradiction = self._limits.contradiction(pose, tool_rad) if isinstance(pose, Pose) else ""
        if state not in FOLLOWING and state is not ArmState.DECELERATING:
            self.following.forget()
            self.plausible.forget()
            return angles is not None
        self._driven = True
        if state is not ArmState.TRACKING or not report.fresh:
            self.suspend(t)
        planned = lag.motion(t) if angles is not None and state is ArmState.TRACKING else None
        if angles is None or planned is None or self.following.reason:
            return self.plausible.report(t, pose, reach, impossible=impossible)
        peak = lag.fastest(t - lag.lag_s - PEAK_RATE_S, self._joints)
        tool_error_m, twist = self._tool_error(pose, angles, planned)
        errors = tuple(
            [
                0.0 if joint in self._free else a - b
                for joint, (a, b) in enumerate(zip(angles, planned.angles, strict=True))
            ]
        )
        if not self.plausible.report(t, pose, reach, errors=errors, peak=peak, twist=twist):
            return False
        extremes = lag.extremes(t, self._limits.following.slope_s)
        self.following.report(t, angles, extremes, errors, peak, tool_error_m)
        if not self.following.reason:  # the deviation of a blocked arm is not lag
            lag.observe(t, angles, self._free, planned)
        return True

    def _tool_error(self, pose: object, angles: Joints, planned: PalmMotion) -> tuple[float, float | None]:
        """Distance of the tool from its set-point (m), its twist against the angle implied by its position (rad)."""
        if self._limits.following.tool is None or not isinstance(pose, Pose):
            return 0.0, None
        try:
            commanded = self._poses.pose(planned.angles)
        except PoseError:
            return 0.0, None
        assert isinstance(commanded, Pose), "an arm with a tool is commanded by poses"
        turned = sum(angles) - sum(planned.angles)
        return math.hypot(pose.x_m - commanded.x_m, pose.y_m - commanded.y_m), wrapped(
            pose.t_rad - commanded.t_rad - turned
        )

    def lost(self) -> None:
        """The link was lost."""
        self.following.forget()
        self.plausible.forget()
        self.contradiction, self._driven = "", False

    def conditions(self, t: float) -> Iterator[str]:
        """The fault codes whose condition holds at `t` (s)."""
        self.plausible.look(t)
        if self.plausible.reason:
            yield "pose-implausible"
        if self.following.reason:
            yield "following-error"
        if self.contradiction:
            yield "pose-contradicts-rig"

    def evidence(self) -> dict[str, str]:
        """Evidence in words with numbers, by fault code."""
        return {
            "pose-implausible": self.plausible.reason,
            "following-error": self.following.reason,
            "pose-contradicts-rig": self.contradiction,
        }
