"""Test whether the arm follows its set-points: following error and motion comparison, on fresh reports only. Pure.

Following error (as LinuxCNC's FERROR and MIN_FERROR): e = actual(t) − commanded(t − L), L the estimated lag. Its limit
is linear in the commanded rate ω: limit(ω) = at_rest + (at_full_rate − at_rest)·|ω|/rate. The slope is a time: the
tolerated error of L.

Motion comparison: over 0.3 s the reported motion must be more than half of the commanded motion, and fall short of it
by no more than the noise. The commanded motion is the smallest that the tolerated error of L allows, at each end of the
window independently, because a late host delays one end only. A frozen or mirrored encoder fails this test at speeds
that the following error tolerates for a long time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from palmd.events import Joints

WINDOW_S = 0.3
MOVED_SHARE = 0.5
IN_A_ROW = 2
"""Consecutive reports that must fail: a single one may be a corrupted line whose checksum matched by chance."""

SETTLE_S = 0.15
"""No judgement for this time after the controller paused or answers were late: arm and set-points then differ."""


FALSE_ALARM_SIGMAS = 6.0
"""Limit for the difference of two reports, in σ: at 100 reports a second it is exceeded by chance once in a month."""


def noise_of_difference(sigma: float) -> float:
    """Largest noise in the difference of two reports of a joint at rest; `sigma` is that of one report (rad or m)."""
    return FALSE_ALARM_SIGMAS * math.sqrt(2.0) * sigma


@dataclass(frozen=True, slots=True)
class FollowingLimits:
    """Limits in the joints' unit (rad or m), and in m at the tool. `rate` is the joints' largest.

    noise: the largest difference between two reports of a joint at rest, play and rounding included. tool: limits (m)
    of the held tool's position at rest and at full rate; None without a tool.
    """

    at_rest: float
    at_full_rate: float
    rate: float
    noise: float
    tool: tuple[float, float] | None = None

    @property
    def slope_s(self) -> float:
        """The tolerated error of the lag (s)."""
        return (self.at_full_rate - self.at_rest) / self.rate

    def joint(self, rate: float) -> float:
        """The limit of a joint commanded to move at `rate`."""
        return self.at_rest + self.slope_s * min(abs(rate), self.rate)

    def tool_limit(self, rate: float) -> float:
        """The limit of the tool while the fastest joint is commanded to move at `rate`; infinite without a tool."""
        if self.tool is None:
            return math.inf
        at_rest, at_full_rate = self.tool
        return at_rest + (at_full_rate - at_rest) * min(abs(rate) / self.rate, 1.0)


@dataclass(frozen=True, slots=True)
class JointScale:
    """Names of the joints for messages, and their display unit: `scale` units make one rad or m."""

    names: tuple[str, ...]
    unit: str
    scale: float


@dataclass(frozen=True, slots=True)
class _Reported:
    t: float
    angles: Joints
    least: Joints
    largest: Joints


class FollowingGuard:
    """See the module. `errors` and `limits` are those of the last report that was judged, NaN before.

    `reason` states why the arm does not follow, empty while it does; it is kept until `forget`. `shows_no_motion`:
    whether the reports showed no motion then: the arm is blocked, or its encoder is frozen.
    """

    def __init__(self, limits: FollowingLimits, scale: JointScale, free: Collection[int] = ()) -> None:
        """`free` joints need not follow their set-points."""
        self._limits, self._scale = limits, scale
        self._judged = tuple(joint for joint in range(len(scale.names)) if joint not in free)
        self._none = (math.nan,) * len(scale.names)
        self._past: deque[_Reported] = deque()
        self._t_suspended = -math.inf
        self._errors_in_a_row = self._still_in_a_row = 0
        self.errors = self.limits = self._none
        self.reason = ""
        self.shows_no_motion = False

    def forget(self) -> None:
        """The arm is not commanded: reset, and judge nothing."""
        if self._past or self.reason or self.errors is not self._none:
            self._past.clear()
            self._errors_in_a_row = self._still_in_a_row = 0
            self.errors = self.limits = self._none
            self.reason, self.shows_no_motion = "", False

    def suspend(self, t: float) -> None:
        """At `t` (s) the controller paused, or its answer was late: judge nothing for `SETTLE_S`."""
        self._t_suspended = t
        self._past.clear()
        self._errors_in_a_row = self._still_in_a_row = 0

    def report(
        self, t: float, angles: Joints, extremes: tuple[Joints, Joints], errors: Joints, peak: Sequence[float],
        tool_error_m: float,
    ) -> None:  # fmt: skip
        """Judge a fresh report of time `t` (s).

        extremes: least and largest angles commanded within `slope_s` of t − L. errors: the angles minus the set-point
        of t − L. peak: the largest recently commanded rate of each joint. tool_error_m: distance of the tool from its
        set-point of t − L (m), 0 without a tool.
        """
        if self.reason or t - self._t_suspended < SETTLE_S:
            return
        self._past.append(_Reported(t, angles, *extremes))
        while t - self._past[0].t > WINDOW_S:
            self._past.popleft()
        limits = tuple([self._limits.joint(rate) for rate in peak])
        self.errors, self.limits = errors, limits
        fastest = max([abs(peak[joint]) for joint in self._judged], default=0.0)
        exceeded = [joint for joint in self._judged if abs(errors[joint]) > limits[joint]]
        tool_limit = self._limits.tool_limit(fastest)
        self._errors_in_a_row = self._errors_in_a_row + 1 if exceeded or tool_error_m > tool_limit else 0
        mismatch = self._motion_mismatch()
        self._still_in_a_row = self._still_in_a_row + 1 if mismatch else 0
        if self._errors_in_a_row >= IN_A_ROW:
            self.reason = self._describe_errors(exceeded, errors, limits, tool_error_m, tool_limit)
        elif self._still_in_a_row >= IN_A_ROW:
            self.reason = mismatch
        self.shows_no_motion = bool(self.reason) and self._is_still()

    def _motion_mismatch(self) -> str:
        """The first joint whose reported motion does not match the commanded one, in words; empty if there is none."""
        first, last = self._past[0], self._past[-1]
        for joint in self._judged:
            reported = last.angles[joint] - first.angles[joint]
            directions = (
                (1.0, last.least[joint] - first.largest[joint]),
                (-1.0, first.least[joint] - last.largest[joint]),
            )
            for sign, commanded in directions:
                if commanded - sign * reported > max(self._limits.noise, (1.0 - MOVED_SHARE) * commanded):
                    name, unit, k = self._scale.names[joint], self._scale.unit, self._scale.scale
                    return (
                        f"within {last.t - first.t:.2f} s {name} was commanded to move by "
                        f"{sign * commanded * k:.2f}{unit}, the arm reports {reported * k:.2f}{unit}"
                    )
        return ""

    def _is_still(self) -> bool:
        last = self._past[-1]
        since = [each for each in self._past if last.t - each.t <= 0.5 * WINDOW_S]
        return all(
            abs(last.angles[joint] - each.angles[joint]) <= max(self._limits.noise, 0.5 * self._limits.at_rest)
            for each in since[len(since) // 2 :]
            for joint in self._judged
        )

    def _describe_errors(
        self, exceeded: Sequence[int], errors: Joints, limits: Sequence[float], tool_error_m: float, tool_limit: float
    ) -> str:
        unit, k = self._scale.unit, self._scale.scale
        words = [
            f"{self._scale.names[joint]} is {errors[joint] * k:+.2f}{unit} from its delayed set-point, "
            f"the limit at this rate is {limits[joint] * k:.2f}{unit}"
            for joint in exceeded
        ]
        if tool_error_m > tool_limit:
            words.append(
                f"the gripper is {tool_error_m * 1e3:.1f} mm from its delayed set-point, "
                f"the limit at this rate is {tool_limit * 1e3:.1f} mm"
            )
        return "; ".join(words)
