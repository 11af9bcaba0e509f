"""The arm's driver among palms: what its reports say of their angles, rates and lag. Pure."""

from __future__ import annotations

import math
from typing import Literal

from palmd.config import Config
from palmd.daemon.latency_estimator import LatencyEstimator
from palmd.devices.actuator import ArmReport, ArmState, make_actuator
from palmd.events import PalmMotion, PalmSample
from palmd.motion.kinematics import PoseError, RigGeometry

EndName = Literal["pad1", "pad2", "arm"]

RESTING = frozenset({ArmState.READY, ArmState.POWER_OFF, ArmState.UNCALIBRATED, ArmState.FAULT, ArmState.ESTOP})
"""States in which the controller lets the arm stand, once it has come to rest."""

COMING_TO_REST_S = 0.3


class ArmDriver:
    """The arm's line. `actual` are the palm angles of the last report, None before; rates are the plan's."""

    def __init__(self, config: Config, geometry: RigGeometry) -> None:
        self.host = make_actuator(config.arm)
        self.lag = LatencyEstimator()
        self.is_open = False
        self.linked_since_open = False
        self.actual: PalmMotion | None = None
        self.bad_poses = 0
        self._geometry = geometry
        self._t_moving = -math.inf

    def opened(self) -> None:
        """The port has been opened."""
        self.is_open = True

    def lost(self) -> None:
        """The port has gone."""
        self.is_open = False
        self.linked_since_open = False
        self.host.disconnected()

    def feed(self, data: bytes, t: float) -> list[PalmSample]:
        """Take bytes read at `t` (s)."""
        samples = []
        for report in self.host.feed(data, t):
            self.linked_since_open = True
            sample = self._sample(report)
            if sample is not None:
                samples.append(sample)
        if not self.host.tracking:
            self.lag.forget()
        return samples

    def _sample(self, report: ArmReport) -> PalmSample | None:
        """The palms at a report; rates and accelerations are the plan's, zero at rest, None where unknown."""
        try:
            phi1, phi2 = self._geometry.palm_angles(report.pose.x_m, report.pose.y_m)
        except PoseError:
            self.bad_poses += 1
            return None
        t = report.t_sample
        self.lag.observe(t, phi1, phi2)
        meant = self._meant(t, report.state)
        if meant is None:
            self.actual = PalmMotion(phi1, phi2)
            return PalmSample(t, phi1, phi2)
        self.actual = PalmMotion(phi1, phi2, meant.omega1, meant.omega2, meant.alpha1, meant.alpha2)
        return PalmSample(t, phi1, phi2, meant.omega1, meant.omega2, meant.alpha1, meant.alpha2)

    def _meant(self, t: float, state: ArmState) -> PalmMotion | None:
        """What the arm is meant to do at `t` (s); only its rates count."""
        still = PalmMotion(0.0, 0.0)
        if state in RESTING:
            return still if t - self._t_moving > COMING_TO_REST_S else None
        self._t_moving = t
        if state is ArmState.TRACKING:
            return self.lag.motion(t) or still
        return None
