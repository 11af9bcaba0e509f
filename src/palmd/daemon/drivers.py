"""The arm's driver for palms: joint angles, rates and lag from its reports. Pure."""

from __future__ import annotations

import math
from collections.abc import Collection

from palmd.config.arms import ArmConfig
from palmd.daemon.guards.arm import ArmGuards, GuardLimits
from palmd.daemon.latency_estimator import LatencyEstimator
from palmd.daemon.poses import Poses
from palmd.devices.actuator import FOLLOWING, ArmReport, ArmState, make_actuator
from palmd.events import Joints, PalmMotion, PalmSample
from palmd.motion.kinematics import PoseError

EndName = str
"""`arm`, or `pad` and the palm's number."""

RESTING = frozenset({ArmState.READY, ArmState.POWER_OFF, ArmState.UNCALIBRATED, ArmState.FAULT, ArmState.ESTOP})
"""States in which the controller leaves the arm at rest, once it has stopped."""

COMING_TO_REST_S = 0.3
AT_REST_S, AT_REST_RAD = 0.05, 1e-3
"""The arm is at rest before `COMING_TO_REST_S` has passed if two reports at least this far apart agree to this angle.
"""


class ArmDriver:
    """The arm's port, actuator and guards. `actual` are the palm angles of the last report with the plan's rates.

    `actual` is None before the first report, and while the reported poses have no palm angles. guards: limits for
    judging the reports. free: joints that need not follow their set-points.
    """

    def __init__(self, config: ArmConfig, poses: Poses, guards: GuardLimits, free: Collection[int] = ()) -> None:
        self.host = make_actuator(config)
        self.lag = LatencyEstimator()
        self.guards = ArmGuards(guards, poses, free)
        self.is_open = False
        self.linked_since_open = False
        self.actual: PalmMotion | None = None
        self.bad_poses = 0
        self._poses = poses
        self._t_moving = -math.inf
        self._last_at_rest: tuple[float, Joints] | None = None

    def opened(self) -> None:
        """The port was opened."""
        self.is_open = True

    def lost(self) -> None:
        """The port was lost."""
        self.is_open = False
        self.linked_since_open = False
        self.lag.forget()
        self.guards.lost()
        self.host.disconnected()

    def feed(self, data: bytes, t: float) -> list[PalmSample]:
        """Process bytes read at `t` (s)."""
        samples = []
        for report in self.host.feed(data, t):
            self.linked_since_open = True
            sample = self._sample(report)
            if sample is not None:
                samples.append(sample)
        return samples

    def _sample(self, report: ArmReport) -> PalmSample | None:
        """The palm angles of a plausible report; rates and accelerations are the plan's, None where unknown."""
        t, impossible = report.t_sample, ""
        angles: Joints | None = None
        try:
            angles = self._poses.angles(report.pose)
        except PoseError as error:
            impossible = str(error)
        accepted = self.guards.accepts(report, angles, impossible, self.lag, self.host.reach)
        if angles is None or not accepted:
            self.bad_poses += 1
            if self.guards.plausible.reason or report.state in RESTING:
                self.actual = None if angles is None else PalmMotion.at_rest(angles)
            return None
        planned = self._planned_motion(t, angles, report.state)
        if planned is None:
            self.actual = PalmMotion.at_rest(angles)
            return PalmSample(t, angles)
        self.actual = planned._replace(angles=angles)
        return PalmSample(t, angles, planned.rates, planned.accelerations)

    def _planned_motion(self, t: float, angles: Joints, state: ArmState) -> PalmMotion | None:
        """The planned motion of the arm at `t` (s), None where unknown; only its rates are used."""
        if state not in FOLLOWING:
            self.lag.forget()
        at_rest = PalmMotion.at_rest((0.0,) * len(angles))
        if state in RESTING:
            return at_rest if t - self._t_moving > COMING_TO_REST_S or self._has_stopped(t, angles) else None
        self._t_moving, self._last_at_rest = t, None
        if state is ArmState.TRACKING:
            return self.lag.motion(t) or (at_rest if self.host.tracking else None)
        return None

    def _has_stopped(self, t: float, angles: Joints) -> bool:
        """Whether an arm that comes to rest reported the same angles at least `AT_REST_S` ago."""
        before, self._last_at_rest = self._last_at_rest, (t, angles)
        if before is None or t - before[0] < AT_REST_S:
            return False
        return max(abs(one - other) for one, other in zip(angles, before[1], strict=True)) < AT_REST_RAD
