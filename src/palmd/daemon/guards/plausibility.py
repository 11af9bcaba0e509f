"""Plausibility of a report: workspace, palm angles, tool angle, and the step since the report before. Pure.

A step is the change of the following error, so that commanded motion does not count. One report may change it by the
motion within the uncertainty of the report's time, and by the following error allowed at rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from palmd.daemon.guards.following import FollowingLimits, JointScale
from palmd.devices.actuator import ArmPose, Pose, Reach
from palmd.events import Joints

MOST_REPORTS, MOST_S = 3, 0.100
TIME_UNCERTAINTY_S = 0.024
"""Uncertainty of the time between two reports: one cycle of the controller, and an adapter's delivery."""

OUTSIDE_M = 0.005
"""Tolerance of the workspace, as of the controller: it resumes within 5 mm of where it stopped."""

TOOL_RAD = math.radians(10.0)
"""How far the tool may turn since tracking began, relative to the angle that follows from x and y."""


class PlausibilityGuard:
    """Counts consecutive implausible reports. `reason` is set after three of them or 100 ms; see `forget`."""

    def __init__(self, limits: FollowingLimits, scale: JointScale) -> None:
        self._limits, self._scale = limits, scale
        self.reason = ""
        self._bad = 0
        self._t_bad = math.inf
        self._last_words = ""
        self._errors: Joints | None = None
        self._t_errors = math.nan
        self._twist: float | None = None

    def forget(self) -> None:
        """The arm is not commanded: reset."""
        self.reason, self._last_words = "", ""
        self._bad, self._t_bad = 0, math.inf
        self._errors = self._twist = None

    def suspend(self) -> None:
        """Do not judge the next step: the set-points restart."""
        self._errors = None

    def look(self, t: float) -> None:
        """Check whether implausible reports have lasted too long at `t` (s)."""
        if self._bad and t - self._t_bad >= MOST_S:
            self.reason = self.reason or self._last_words

    def report(
        self,
        t: float,
        pose: ArmPose,
        reach: Reach | None,
        *,
        impossible: str = "",
        errors: Joints | None = None,
        peak: Sequence[float] = (),
        twist: float | None = None,
    ) -> bool:
        """Whether a report of time `t` (s) is plausible.

        impossible: why it has no joint angles. errors: the joints' following errors. peak: the largest recently
        commanded rate of each joint. twist: of the tool against the angle that follows from its position (rad).
        """
        words = impossible or _outside(pose, reach) or self._turned(pose, twist) or self._stepped(t, errors, peak)
        if not words:
            self._bad, self._t_bad = 0, math.inf
            if errors is not None:
                self._errors, self._t_errors = errors, t
            self._twist = twist if self._twist is None else self._twist
            return True
        self._bad += 1
        self._t_bad = min(self._t_bad, t)
        self._last_words = f"the arm reports {describe_pose(pose)}: {words}"
        if self._bad >= MOST_REPORTS or t - self._t_bad >= MOST_S:
            self.reason = self.reason or self._last_words
        return False

    def _turned(self, pose: ArmPose, twist: float | None) -> str:
        if twist is None or self._twist is None or not isinstance(pose, Pose):
            return ""
        limit = abs(self._twist) + TOOL_RAD  # as it was found it is taken back gently
        if abs(twist) <= limit:
            return ""
        return (
            f"its tool angle deviates by {math.degrees(twist):+.1f}° from the one that follows from x and y, "
            f"the limit is {math.degrees(limit):.1f}°"
        )

    def _stepped(self, t: float, errors: Joints | None, peak: Sequence[float]) -> str:
        before = self._errors
        if errors is None or before is None:
            return ""
        # an arm that gets no set-points stands still, and no report says so
        interval_s = TIME_UNCERTAINTY_S + t - self._t_errors
        for joint, (now, then) in enumerate(zip(errors, before, strict=True)):
            limit = self._limits.at_rest + interval_s * abs(peak[joint])
            if abs(now - then) > limit:
                name, unit, k = self._scale.names[joint], self._scale.unit, self._scale.scale
                return (
                    f"{name} jumped by {(now - then) * k:+.2f}{unit} within one report beyond the commanded motion, "
                    f"the limit is {limit * k:.2f}{unit}"
                )
        return ""


def _outside(pose: ArmPose, reach: Reach | None) -> str:
    if reach is None or not isinstance(pose, Pose):
        return ""
    found = [
        f"{axis} is outside the controller's workspace, {low * 1e3:.1f} to {high * 1e3:.1f} mm"
        for axis, position, low, high in (
            ("x", pose.x_m, reach.x_min_m, reach.x_max_m),
            ("y", pose.y_m, reach.y_min_m, reach.y_max_m),
        )
        if not low - OUTSIDE_M <= position <= high + OUTSIDE_M
    ]
    return "; ".join(found)


def describe_pose(pose: ArmPose) -> str:
    """A reported pose in words."""
    if isinstance(pose, Pose):
        return f"x {pose.x_m * 1e3:.1f} mm, y {pose.y_m * 1e3:.1f} mm, tool angle {math.degrees(pose.t_rad):.1f}°"
    return ", ".join(f"joint {n} at {math.degrees(each):.1f}°" for n, each in enumerate(pose.joints_rad, 1))
