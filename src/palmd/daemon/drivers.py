"""The arm's driver among palms: what its reports say of their angles, rates and lag. Pure."""

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
"""`arm`, or `pad` and the number of its palm."""

RESTING = frozenset({ArmState.READY, ArmState.POWER_OFF, ArmState.UNCALIBRATED, ArmState.FAULT, ArmState.ESTOP})
"""States in which the controller lets the arm stand, once it has come to rest."""

COMING_TO_REST_S = 0.3
STANDS_S, STANDS_RAD = 0.05, 1e-3
"""Sooner, where two reports at least so far apart tell the same angles within so much."""


class ArmDriver:
    """The arm's line. `actual` are the palm angles of the last report, rates are the plan's.

    `actual` is None before, and where no palm angles belong to what the arm reports for long. guards: what its reports
    are judged by. free: joints that need not go where they are commanded.
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
        self._rested: tuple[float, Joints] | None = None

    def opened(self) -> None:
        """The port has been opened."""
        self.is_open = True

    def lost(self) -> None:
        """The port has gone."""
        self.is_open = False
        self.linked_since_open = False
        self.lag.forget()
        self.guards.lost()
        self.host.disconnected()

    def feed(self, data: bytes, t: float) -> list[PalmSample]:
        """Take bytes read at `t` (s)."""
        samples = []
        for report in self.host.feed(data, t):
            self.linked_since_open = True
            sample = self._sample(report)
            if sample is not None:
                samples.append(sample)
        return samples

    def _sample(self, report: ArmReport) -> PalmSample | None:
        """The palms at a report that can be true; rates and accelerations are the plan's, None where unknown."""
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
        meant = self._meant(t, angles, report.state)
        if meant is None:
            self.actual = PalmMotion.at_rest(angles)
            return PalmSample(t, angles)
        self.actual = meant._replace(angles=angles)
        return PalmSample(t, angles, meant.rates, meant.accelerations)

    def _meant(self, t: float, angles: Joints, state: ArmState) -> PalmMotion | None:
        """What the arm is meant to do at `t` (s), with these angles; only its rates count."""
        if state not in FOLLOWING:
            self.lag.forget()
        still = PalmMotion.at_rest((0.0,) * len(angles))
        if state in RESTING:
            return still if t - self._t_moving > COMING_TO_REST_S or self._stands(t, angles) else None
        self._t_moving, self._rested = t, None
        if state is ArmState.TRACKING:
            return self.lag.motion(t) or (still if self.host.tracking else None)
        return None

    def _stands(self, t: float, angles: Joints) -> bool:
        """Whether an arm that comes to rest has told these angles before, and not just now."""
        before, self._rested = self._rested, (t, angles)
        if before is None or t - before[0] < STANDS_S:
            return False
        return max(abs(one - other) for one, other in zip(angles, before[1], strict=True)) < STANDS_RAD
