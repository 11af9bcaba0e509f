"""Drivers of both pads and the arm: bytes in, events out, and what is known of each device. Pure."""

from __future__ import annotations

import logging
import math
from typing import Literal, cast

from palmd.config import Config, PadConfig
from palmd.daemon.latency_estimator import LatencyEstimator
from palmd.devices.armhost import ArmHost, ArmReport
from palmd.devices.armlink import ArmState
from palmd.devices.handshake import Handshake
from palmd.devices.versapad import PadCalibration, PadReceiver, PressureFormat
from palmd.events import Pad, PadLift, PadSample, PalmMotion, PalmSample
from palmd.messages import PadView
from palmd.motion.kinematics import PoseError, RigGeometry

log = logging.getLogger(__name__)

EndName = Literal["pad1", "pad2", "arm"]

RESTING = frozenset({ArmState.READY, ArmState.POWER_OFF, ArmState.UNCALIBRATED, ArmState.FAULT, ArmState.ESTOP})
"""States in which the controller lets the arm stand, once it has come to rest."""

COMING_TO_REST_S = 0.3


class PadDriver:
    """One pad's line.

    `parted` says how the last touch ended, None while touching or before any touch. `in_break` says whether
    its start-up wants the line in break, `unanswered` whether it ended without the pad's identity.
    """

    def __init__(self, number: Pad, config: PadConfig) -> None:
        pressure = PressureFormat(
            config.pressure.byte, config.pressure.mask, config.pressure.shift, config.pressure.invert
        )
        calibration = PadCalibration(
            number,
            config.zero_mm,
            config.counts_per_mm,
            config.newtons_per_count,
            config.axis,
            cast(Literal[1, -1], config.sign),
            config.length_mm,
            pressure.full_scale,
        )
        self.receiver = PadReceiver(calibration, config.baud, pressure)
        self.is_open = False
        self.in_break = False
        self.unanswered = False
        self.parted: Literal["lifted", "silent"] | None = None
        self._number: Pad = number
        self._s = math.nan
        self._kind = config.handshake
        self._handshake: Handshake | None = None

    @property
    def touching(self) -> bool:
        """Whether the object touches the pad, as far as is known."""
        return self.receiver.touch.touching

    def opened(self, t: float) -> None:
        """The port has been opened at `t` (s)."""
        self.is_open = True
        self.unanswered = False
        self._handshake = Handshake(self._kind, t)

    def lost(self, t: float) -> list[PadLift]:
        """The port has gone at `t` (s)."""
        self.is_open = self.in_break = False
        self._handshake = None
        self.receiver.decoder.reset()
        lift = self.receiver.poll(math.inf)
        return [] if lift is None else [self._part(PadLift(t, self._number), "silent")]

    def feed(self, data: bytes, t: float) -> list[PadSample | PadLift]:
        """Take bytes read at `t` (s)."""
        self._shake(data, t)
        events = self.receiver.feed(data, t)
        for event in events:
            if isinstance(event, PadLift):
                self._part(event, "lifted")
            else:
                self._s, self.parted = event.s, None
        return events

    def poll(self, t: float) -> list[PadLift]:
        """The lift-off that silence tells of at `t` (s). Once a tick."""
        self._shake(b"", t)
        lift = self.receiver.poll(t)
        return [] if lift is None else [self._part(lift, "silent")]

    def view(self, t: float) -> PadView:
        """What is to be told of the pad at `t` (s)."""
        latest = self.receiver.latest
        if latest is None:
            return PadView()
        return PadView(self._s, latest.pressure, t - latest.t_first, self.touching, latest.batched)

    def _shake(self, data: bytes, t: float) -> None:
        """Let the start-up go on."""
        handshake = self._handshake
        if handshake is None:
            return
        self.in_break = handshake.step(t, data)
        if handshake.done:
            self._handshake = None
            if handshake.error is not None:
                self.unanswered = True
                log.warning("pad%d: %s", self._number, handshake.error)

    def _part(self, lift: PadLift, how: Literal["lifted", "silent"]) -> PadLift:
        self._s, self.parted = math.nan, how
        return lift


class ArmDriver:
    """The arm's line. `actual` are the palm angles of the last report, None before; rates are the plan's."""

    def __init__(self, config: Config, geometry: RigGeometry) -> None:
        self.host = ArmHost(config.arm.baud)
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
