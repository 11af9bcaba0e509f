"""Checks the set-points that the rig receives against the limits, at the far end of the wire. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.config.two_palms import Config, LimitsConfig
from palmd.devices.actuator import Pose
from palmd.rig.arm import Linkage, wrap_angle
from palmd.rig.controller import CYCLE_S

_TOLERANCE = math.radians(0.05)  # micrometres on the wire correspond to about a thousandth of a degree
_MAX_PHI12 = math.radians(172.0)
_CONCAVE_SHARE = (
    0.3  # of palm 2's pad: φ12 may exceed its limit by the angle through which a concave palm turns up to there
)
_SEPARATE_S = 0.1  # set-points further apart belong to different motions


@dataclass(slots=True)
class SetPointChecker:
    """Converts every received set-point, accepted or not, to palm angles; counts limit violations and maximum rates.

    A rate is that between consecutive set-points, over the time between them but at least one cycle. While the arm does
    not follow, a set-point may also start from the arm's pose: the smaller step counts. A rig that could not read for a
    while receives several set-points at once and dates them all to the present: the time between them may then have
    been longer by that delay, and only the rate over the longer time is a proven violation.
    """

    linkage: Linkage
    limits: LimitsConfig
    max_phi12: float = _MAX_PHI12
    outside_limits: int = 0
    largest_step_m: float = 0.0
    largest_rate_rad_s: float = 0.0
    largest_tool_error_rad: float = 0.0
    _last: tuple[float, Pose] | None = None
    _delay_s: float = 0.0
    _t_delay: float = -math.inf  # when the delay was noted

    def note_delay(self, t: float, delay_s: float) -> None:
        """What arrives at t (s) may have been sent up to delay_s (s) later; call for every arrival, even with 0."""
        if delay_s >= self._delay_s or t - self._t_delay >= _SEPARATE_S:
            self._delay_s, self._t_delay = delay_s, t

    def check(self, pose: Pose, t: float, standing: Pose | None = None) -> None:
        """Check a set-point received at t (s); `standing`: pose of an arm that follows no set-points, else None."""
        angles = self.linkage.angles(pose.x_m, pose.y_m)
        if angles is None:
            self.outside_limits += 1
            self._last = None
            return
        inside = all(map(_within, angles, self.limits.angles_deg))
        self.outside_limits += not (inside and sum(angles) < self.max_phi12 + _TOLERANCE)
        tool_error = abs(wrap_angle(pose.t_rad - (sum(angles) - self.linkage.yaw)))
        self.largest_tool_error_rad = max(self.largest_tool_error_rad, tool_error)
        if self._last is not None and t - self._last[0] < _SEPARATE_S:
            t_last, last_pose = self._last
            delay_s = self._delay_s if t - self._t_delay < _SEPARATE_S else 0.0
            rate, step = self._step(last_pose, pose, max(CYCLE_S, t - t_last + delay_s))
            if standing is not None:
                rate, step = min((rate, step), self._step(standing, pose, CYCLE_S))
            self.largest_rate_rad_s = max(self.largest_rate_rad_s, rate)
            self.largest_step_m = max(self.largest_step_m, step)
        self._last = (t, pose)

    def _step(self, start: Pose, end: Pose, duration_s: float) -> tuple[float, float]:
        """Rate (rad/s) of the faster palm and distance (m) between two poses; infinite where no palm angles exist."""
        start_angles = self.linkage.angles(start.x_m, start.y_m) or (math.inf, math.inf)
        end_angles = self.linkage.angles(end.x_m, end.y_m) or (math.inf, math.inf)
        rate = max(abs(b - a) for a, b in zip(start_angles, end_angles, strict=True)) / duration_s
        return rate, math.hypot(end.x_m - start.x_m, end.y_m - start.y_m)

    def as_dict(self) -> dict[str, float]:
        """Results, with units in the names."""
        return {
            "setpoints_outside_limits": self.outside_limits,
            "largest_step_mm": self.largest_step_m * 1e3,
            "largest_rate_deg_s": math.degrees(self.largest_rate_rad_s),
            "largest_tool_error_deg": math.degrees(self.largest_tool_error_rad),
        }


def max_phi12(config: Config) -> float:
    """Upper limit of φ12 (rad)."""
    length = min(pad.length_mm for pad in config.pads.each()) * 1e-3
    return _MAX_PHI12 + _CONCAVE_SHARE * length * max(config.rig.curvatures_per_m[-1], 0.0)


def _within(angle: float, range_deg: tuple[float, float]) -> bool:
    return math.radians(range_deg[0]) - _TOLERANCE <= angle <= math.radians(range_deg[1]) + _TOLERANCE
