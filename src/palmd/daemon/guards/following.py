"""Does the arm follow its set-points? Following error and motion comparison, on fresh reports only. Pure.

Following error (as LinuxCNC's FERROR and MIN_FERROR): e = actual(t) − commanded(t − L), L the estimated lag. Its limit
is linear in the commanded rate ω: limit(ω) = at_rest + (at_full_rate − at_rest)·|ω|/rate. The slope is a time: the
error of L that is tolerated.

Motion comparison: over 0.3 s the reported motion must be more than half of the commanded motion, and lack no more of
it than noise accounts for. The commanded motion is the least that the tolerated error of L allows, at each end of the
window independently, for a host that is late delays one end alone. A frozen or mirrored encoder fails this at speeds
that the following error allows for a long time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from palmd.events import Joints

WATCH_S = 0.3
MOVED_SHARE = 0.5
IN_A_ROW = 2
"""Reports that must agree: one alone may be a damaged line that its checksum let pass."""

SETTLE_S = 0.15
"""After the controller stood still or answers were late, set-points and arm have parted for a reason."""


FALSE_ALARM_SIGMAS = 6.0
"""Of a difference of two reports: at 100 a second it is exceeded by chance once in a month."""


def noise_of_difference(sigma: float) -> float:
    """What two reports of a joint that stands may differ by, each with this one-sigma (rad or m)."""
    return FALSE_ALARM_SIGMAS * math.sqrt(2.0) * sigma


@dataclass(frozen=True, slots=True)
class FollowingLimits:
    """In the joints' unit (rad or m), and in m at the tool. `rate` is the joints' largest.

    noise: the largest difference between two reports of a joint that stands, play and rounding included. tool: limits
    (m) at rest and at full rate of the point that the arm holds; None where it holds none.
    """

    at_rest: float
    at_full_rate: float
    rate: float
    noise: float
    tool: tuple[float, float] | None = None

    @property
    def slope_s(self) -> float:
        """The error of the lag that is tolerated."""
        return (self.at_full_rate - self.at_rest) / self.rate

    def joint(self, rate: float) -> float:
        """The limit of a joint that is commanded to move at `rate`."""
        return self.at_rest + self.slope_s * min(abs(rate), self.rate)

    def tool_limit(self, rate: float) -> float:
        """The limit of the tool while the fastest joint is commanded to move at `rate`; infinite without a tool."""
        if self.tool is None:
            return math.inf
        at_rest, at_full_rate = self.tool
        return at_rest + (at_full_rate - at_rest) * min(abs(rate) / self.rate, 1.0)


@dataclass(frozen=True, slots=True)
class JointScale:
    """How joints are named and told to people: `unit` and how many of it make one rad or m."""

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

    `reason` says in words why the arm does not follow, empty while it does; it stays until `forget`. `stands` says
    whether the reports of then showed no motion: the arm is blocked, or its encoder is frozen.
    """

    def __init__(self, limits: FollowingLimits, scale: JointScale, free: Collection[int] = ()) -> None:
        """`free` joints need not go where they are commanded."""
        self._limits, self._scale = limits, scale
        self._judged = tuple(joint for joint in range(len(scale.names)) if joint not in free)
        self._none = (math.nan,) * len(scale.names)
        self._past: deque[_Reported] = deque()
        self._t_parted = -math.inf
        self._errors_in_a_row = self._still_in_a_row = 0
        self.errors = self.limits = self._none
        self.reason = ""
        self.stands = False

    def forget(self) -> None:
        """The arm is not commanded: nothing is judged, and what was found is over."""
        if self._past or self.reason or self.errors is not self._none:
            self._past.clear()
            self._errors_in_a_row = self._still_in_a_row = 0
            self.errors = self.limits = self._none
            self.reason, self.stands = "", False

    def part(self, t: float) -> None:
        """At `t` (s) the controller stood still by itself, or its answer came late: nothing is judged for a while."""
        self._t_parted = t
        self._past.clear()
        self._errors_in_a_row = self._still_in_a_row = 0

    def report(
        self, t: float, angles: Joints, extremes: tuple[Joints, Joints], errors: Joints, peak: Sequence[float],
        off_m: float,
    ) -> None:  # fmt: skip
        """Judge a fresh report of `t` (s).

        extremes: least and largest angles that were commanded within `slope_s` of t − L. errors: what the angles are
        more than the set-point of t − L. peak: the largest commanded rate of each joint lately.
        off_m: how far the tool is from its set-point of t − L (m), 0 without a tool.
        """
        if self.reason or t - self._t_parted < SETTLE_S:
            return
        self._past.append(_Reported(t, angles, *extremes))
        while t - self._past[0].t > WATCH_S:
            self._past.popleft()
        limits = tuple([self._limits.joint(rate) for rate in peak])
        self.errors, self.limits = errors, limits
        fastest = max([abs(peak[joint]) for joint in self._judged], default=0.0)
        far = [joint for joint in self._judged if abs(errors[joint]) > limits[joint]]
        tool_limit = self._limits.tool_limit(fastest)
        self._errors_in_a_row = self._errors_in_a_row + 1 if far or off_m > tool_limit else 0
        still = self._unlike()
        self._still_in_a_row = self._still_in_a_row + 1 if still else 0
        if self._errors_in_a_row >= IN_A_ROW:
            self.reason = self._error_words(far, errors, limits, off_m, tool_limit)
        elif self._still_in_a_row >= IN_A_ROW:
            self.reason = still
        self.stands = bool(self.reason) and self._is_still()

    def _unlike(self) -> str:
        """Which joint's reported motion is not the commanded one, in words; empty where there is none."""
        first, last = self._past[0], self._past[-1]
        for joint in self._judged:
            reported = last.angles[joint] - first.angles[joint]
            ways = (1.0, last.least[joint] - first.largest[joint]), (-1.0, first.least[joint] - last.largest[joint])
            for sign, commanded in ways:
                if commanded - sign * reported > max(self._limits.noise, (1.0 - MOVED_SHARE) * commanded):
                    name, unit, k = self._scale.names[joint], self._scale.unit, self._scale.scale
                    return (
                        f"within {last.t - first.t:.2f} s {name} was commanded to move by "
                        f"{sign * commanded * k:.2f}{unit}, the arm reports {reported * k:.2f}{unit}"
                    )
        return ""

    def _is_still(self) -> bool:
        last = self._past[-1]
        since = [each for each in self._past if last.t - each.t <= 0.5 * WATCH_S]
        return all(
            abs(last.angles[joint] - each.angles[joint]) <= max(self._limits.noise, 0.5 * self._limits.at_rest)
            for each in since[len(since) // 2 :]
            for joint in self._judged
        )

    def _error_words(
        self, far: Sequence[int], errors: Joints, limits: Sequence[float], off_m: float, tool_limit: float
    ) -> str:
        unit, k = self._scale.unit, self._scale.scale
        words = [
            f"{self._scale.names[joint]} is {errors[joint] * k:+.2f}{unit} from its delayed set-point, "
            f"the limit at this rate is {limits[joint] * k:.2f}{unit}"
            for joint in far
        ]
        if off_m > tool_limit:
            words.append(
                f"the gripper is {off_m * 1e3:.1f} mm from its delayed set-point, "
                f"the limit at this rate is {tool_limit * 1e3:.1f} mm"
            )
        return "; ".join(words)
