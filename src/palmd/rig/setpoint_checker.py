"""What the rig makes of the set-points it hears: limits checked at the far end of the wire. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.config.two_palms import Config, LimitsConfig
from palmd.devices.actuator import Pose
from palmd.rig.arm import Linkage, turn
from palmd.rig.controller import CYCLE_S

_TOLERANCE = math.radians(0.05)  # micrometres on the wire are worth a thousandth of a degree or so
_MOST_PHI12 = math.radians(172.0)
_CRADLE_SHARE = 0.3  # of palm 2's pad: by as much as a cradle turns up to there, φ12 may be more
_SEPARATE_S = 0.1  # set-points further apart belong to different motions


@dataclass(slots=True)
class SetPointChecker:
    """Every set-point heard, valid or not, as palm angles: outside limits or not, and how fast they moved.

    The rate is that between two set-points in a row, over the time between them but one cycle at least. Where the arm
    does not follow, a set-point may as well begin from where it is: whichever step is the smaller counts. A rig that
    was kept from listening finds set-points lying in a heap, and dates them all to when it listened last: then the time
    between may have been longer by as much, and nothing faster is known than the rate over that.
    """

    linkage: Linkage
    limits: LimitsConfig
    most_phi12: float = _MOST_PHI12
    outside_limits: int = 0
    largest_step_m: float = 0.0
    largest_rate_rad_s: float = 0.0
    largest_tool_error_rad: float = 0.0
    _last: tuple[float, Pose] | None = None
    _late_s: float = 0.0
    _t_late: float = -math.inf  # when late_s was told

    def listened_late(self, t: float, late_s: float) -> None:
        """What comes at t (s) may have been sent up to late_s (s) later; told for whatever comes, 0 included."""
        if late_s >= self._late_s or t - self._t_late >= _SEPARATE_S:
            self._late_s, self._t_late = late_s, t

    def hear(self, pose: Pose, t: float, standing: Pose | None = None) -> None:
        """Takes a set-point heard at t (s); `standing` is where an arm is that no set-point moves, else None."""
        angles = self.linkage.angles(pose.x_m, pose.y_m)
        if angles is None:
            self.outside_limits += 1
            self._last = None
            return
        inside = all(map(_within, angles, self.limits.angles_deg))
        self.outside_limits += not (inside and sum(angles) < self.most_phi12 + _TOLERANCE)
        tool_error = abs(turn(pose.t_rad - (sum(angles) - self.linkage.yaw)))
        self.largest_tool_error_rad = max(self.largest_tool_error_rad, tool_error)
        if self._last is not None and t - self._last[0] < _SEPARATE_S:
            t_last, before = self._last
            late_s = self._late_s if t - self._t_late < _SEPARATE_S else 0.0
            rate, step = self._step(before, pose, max(CYCLE_S, t - t_last + late_s))
            if standing is not None:
                rate, step = min((rate, step), self._step(standing, pose, CYCLE_S))
            self.largest_rate_rad_s = max(self.largest_rate_rad_s, rate)
            self.largest_step_m = max(self.largest_step_m, step)
        self._last = (t, pose)

    def _step(self, start: Pose, end: Pose, span_s: float) -> tuple[float, float]:
        """Rate (rad/s) of the faster palm and way (m) from one pose to another; infinite from where no palm can be."""
        phi_start = self.linkage.angles(start.x_m, start.y_m) or (math.inf, math.inf)
        phi_end = self.linkage.angles(end.x_m, end.y_m) or (math.inf, math.inf)
        rate = max(abs(b - a) for a, b in zip(phi_start, phi_end, strict=True)) / span_s
        return rate, math.hypot(end.x_m - start.x_m, end.y_m - start.y_m)

    def as_dict(self) -> dict[str, float]:
        """The findings, units in the names."""
        return {
            "setpoints_outside_limits": self.outside_limits,
            "largest_step_mm": self.largest_step_m * 1e3,
            "largest_rate_deg_s": math.degrees(self.largest_rate_rad_s),
            "largest_tool_error_deg": math.degrees(self.largest_tool_error_rad),
        }


def most_phi12(config: Config) -> float:
    """What φ12 (rad) must stay below."""
    length = min(pad.length_mm for pad in config.pads.each()) * 1e-3
    return _MOST_PHI12 + _CRADLE_SHARE * length * max(config.rig.curvatures_per_m[-1], 0.0)


def _within(angle: float, range_deg: tuple[float, float]) -> bool:
    return math.radians(range_deg[0]) - _TOLERANCE <= angle <= math.radians(range_deg[1]) + _TOLERANCE
