"""The guards of the arm: each report is judged before anything else hears of it. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass

from palmd.daemon.guards.following import FollowingGuard, FollowingLimits, JointScale
from palmd.daemon.guards.plausibility import TOOL_RAD, PlausibilityGuard
from palmd.daemon.guards.rig_contradiction import FOUND_RAD
from palmd.daemon.latency_estimator import LatencyEstimator
from palmd.daemon.poses import Poses
from palmd.devices.actuator import FOLLOWING, ArmReport, ArmState, Pose, Reach
from palmd.events import Joints, PalmMotion
from palmd.motion.kinematics import PoseError, wrapped

LATELY_S = 0.05
"""Beyond the lag: for so long a commanded rate still widens the limits."""

Contradiction = Callable[[Pose, float], str]
"""(pose, tolerance of the tool angle in rad) → what the pose contradicts of the configured rig; empty where nothing."""


@dataclass(frozen=True, slots=True)
class GuardLimits:
    """What a system's guards of the arm go by."""

    following: FollowingLimits
    scale: JointScale
    contradiction: Contradiction


class ArmGuards:
    """See the module.

    `contradiction` says in words what the pose that the arm reports at rest contradicts of the rig as configured.
    """

    def __init__(self, limits: GuardLimits, poses: Poses, free: Collection[int] = ()) -> None:
        """`free` joints need not go where they are commanded."""
        self.following = FollowingGuard(limits.following, limits.scale, free)
        self.plausible = PlausibilityGuard(limits.following, limits.scale)
        self.contradiction = ""
        self._driven = False  # since the link is up
        self._limits, self._poses, self._free = limits, poses, free
        self._joints = len(limits.scale.names)

    def part(self, t: float) -> None:
        """From `t` (s) on set-points and arm part for a reason, as where the controller has paused."""
        self.following.part(t)
        self.plausible.part()

    def accepts(
        self, report: ArmReport, angles: Joints | None, impossible: str, lag: LatencyEstimator, reach: Reach | None
    ) -> bool:
        """Whether a report can be true; from one that can be the lag is learned.

        angles: that belong to it; None where none do, which `impossible` tells. lag: that remembers the set-points.
        """
        t, pose, state = report.t_sample, report.pose, report.state
        if state is ArmState.READY:
            tool_rad = TOOL_RAD if self._driven else FOUND_RAD
            self.contradiction = self._limits.contradiction(pose, tool_rad) if isinstance(pose, Pose) else ""
        if state not in FOLLOWING and state is not ArmState.DECELERATING:
            self.following.forget()
            self.plausible.forget()
            return angles is not None
        self._driven = True
        if state is not ArmState.TRACKING or not report.fresh:
            self.part(t)
        meant = lag.motion(t) if angles is not None and state is ArmState.TRACKING else None
        if angles is None or meant is None or self.following.reason:
            return self.plausible.report(t, pose, reach, impossible=impossible)
        peak = lag.fastest(t - lag.lag_s - LATELY_S, self._joints)
        off_m, twist = self._tool(pose, angles, meant)
        errors = tuple(
            [
                0.0 if joint in self._free else a - b
                for joint, (a, b) in enumerate(zip(angles, meant.angles, strict=True))
            ]
        )
        if not self.plausible.report(t, pose, reach, errors=errors, peak=peak, twist=twist):
            return False
        extremes = lag.extremes(t, self._limits.following.slope_s)
        self.following.report(t, angles, extremes, errors, peak, off_m)
        if not self.following.reason:  # a blocked arm is not late
            lag.observe(t, angles, self._free, meant)
        return True

    def _tool(self, pose: object, angles: Joints, meant: PalmMotion) -> tuple[float, float | None]:
        """How far the tool is from its set-point (m), and its twist against the angle that its place tells (rad)."""
        if self._limits.following.tool is None or not isinstance(pose, Pose):
            return 0.0, None
        try:
            there = self._poses.pose(meant.angles)
        except PoseError:
            return 0.0, None
        assert isinstance(there, Pose), "what holds a tool is told its pose"
        turned = sum(angles) - sum(meant.angles)
        return math.hypot(pose.x_m - there.x_m, pose.y_m - there.y_m), wrapped(pose.t_rad - there.t_rad - turned)

    def lost(self) -> None:
        """The link has ended."""
        self.following.forget()
        self.plausible.forget()
        self.contradiction, self._driven = "", False

    def conditions(self, t: float) -> Iterator[str]:
        """The codes of the fault table that hold at `t` (s)."""
        self.plausible.look(t)
        if self.plausible.reason:
            yield "pose-implausible"
        if self.following.reason:
            yield "following-error"
        if self.contradiction:
            yield "pose-contradicts-rig"

    def evidence(self) -> dict[str, str]:
        """In words with numbers, by code."""
        return {
            "pose-implausible": self.plausible.reason,
            "following-error": self.following.reason,
            "pose-contradicts-rig": self.contradiction,
        }
