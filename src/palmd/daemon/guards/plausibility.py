"""Can a report be true? Workspace, palm angles, tool angle, and the step from the report before. Pure.

A step is judged as the change of the following error: motion that was commanded is none. What one report may add is
what the joints move within the uncertainty of a report's time, and the following error that is allowed at rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from palmd.daemon.guards.following import FollowingLimits, JointScale
from palmd.devices.actuator import ArmPose, Pose, Reach
from palmd.events import Joints

MOST_REPORTS, MOST_S = 3, 0.100
TIME_S = 0.024
"""How uncertain the time between two reports is: a cycle of the controller, and an adapter's delivery."""

OUTSIDE_M = 0.005
"""A controller's own tolerance: it resumes within 5 mm of where it stands."""

TOOL_RAD = math.radians(10.0)
"""How far the tool may turn from where it was when tracking began, against the angle that follows from x, y."""


class PlausibilityGuard:
    """Counts implausible reports in a row. `reason` is not empty once there are three, or for 100 ms; see `forget`."""

    def __init__(self, limits: FollowingLimits, scale: JointScale) -> None:
        self._limits, self._scale = limits, scale
        self.total = 0
        self.reason = ""
        self._bad = 0
        self._t_bad = math.inf
        self._last_words = ""
        self._errors: Joints | None = None
        self._t_errors = math.nan
        self._twist: float | None = None

    def forget(self) -> None:
        """The arm is not commanded: what was found is over."""
        self.reason, self._last_words = "", ""
        self._bad, self._t_bad = 0, math.inf
        self._errors = self._twist = None

    def part(self) -> None:
        """The next step is no step: the set-points begin anew."""
        self._errors = None

    def look(self, t: float) -> None:
        """Whether implausible reports have lasted too long by `t` (s)."""
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
        """Whether a report of `t` (s) is plausible.

        impossible: why there are no joint angles for it. errors: the joints' following errors. peak: the largest
        commanded rate of each joint lately. twist: of the tool against the angle that follows from its place (rad).
        """
        words = impossible or _outside(pose, reach) or self._turned(pose, twist) or self._stepped(t, errors, peak)
        if not words:
            self._bad, self._t_bad = 0, math.inf
            if errors is not None:
                self._errors, self._t_errors = errors, t
            self._twist = twist if self._twist is None else self._twist
            return True
        self.total += 1
        self._bad += 1
        self._t_bad = min(self._t_bad, t)
        self._last_words = f"the arm reports {told_pose(pose)}: {words}"
        if self._bad >= MOST_REPORTS or t - self._t_bad >= MOST_S:
            self.reason = self.reason or self._last_words
        return False

    def _turned(self, pose: ArmPose, twist: float | None) -> str:
        if twist is None or self._twist is None or not isinstance(pose, Pose):
            return ""
        most = abs(self._twist) + TOOL_RAD  # as it was found it is taken back gently
        if abs(twist) <= most:
            return ""
        return (
            f"its tool angle is {math.degrees(twist):+.1f}° off the one that follows from x and y, "
            f"the limit is {math.degrees(most):.1f}°"
        )

    def _stepped(self, t: float, errors: Joints | None, peak: Sequence[float]) -> str:
        before = self._errors
        if errors is None or before is None:
            return ""
        stood_s = TIME_S + t - self._t_errors  # an arm that gets no set-points stands still, and no report says so
        for joint, (now, then) in enumerate(zip(errors, before, strict=True)):
            most = self._limits.at_rest + stood_s * abs(peak[joint])
            if abs(now - then) > most:
                name, unit, k = self._scale.names[joint], self._scale.unit, self._scale.scale
                return (
                    f"{name} has jumped by {(now - then) * k:+.2f}{unit} within one report beyond what was commanded, "
                    f"{most * k:.2f}{unit} are possible"
                )
        return ""


def _outside(pose: ArmPose, reach: Reach | None) -> str:
    if reach is None or not isinstance(pose, Pose):
        return ""
    found = [
        f"{axis} is outside the controller's workspace, {low * 1e3:.1f} to {high * 1e3:.1f} mm"
        for axis, at, low, high in (
            ("x", pose.x_m, reach.x_min_m, reach.x_max_m),
            ("y", pose.y_m, reach.y_min_m, reach.y_max_m),
        )
        if not low - OUTSIDE_M <= at <= high + OUTSIDE_M
    ]
    return "; ".join(found)


def told_pose(pose: ArmPose) -> str:
    """A reported pose in words."""
    if isinstance(pose, Pose):
        return f"x {pose.x_m * 1e3:.1f} mm, y {pose.y_m * 1e3:.1f} mm, tool angle {math.degrees(pose.t_rad):.1f}°"
    return ", ".join(f"joint {n} at {math.degrees(each):.1f}°" for n, each in enumerate(pose.joints_rad, 1))
