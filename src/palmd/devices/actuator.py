"""The interface of all actuator drivers, and the lookup of the configured one.

A kind `K` consists of `palmd/devices/actuators/K.py`, which defines `DRIVER`, and of a model in `palmd.config` with
`kind: Literal["K"]`. The daemon uses this interface only.
"""

from __future__ import annotations

import importlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

from palmd.config.arms import AdeptConfig, ArmConfig, ServosConfig
from palmd.devices.health import ErrorShares
from palmd.devices.port import DevicePort, Port
from palmd.events import Joints

FREEZE_S = 0.080
"""Time without a report (s) after which motion should halt."""

LOST_S = 0.250
"""Time without an answer (s) after which the controller is lost."""


class ArmState(StrEnum):
    """State of the controller; the value is the letter that `palm/motion` publishes."""

    UNCALIBRATED = "U"
    MANUAL = "M"
    POWER_OFF = "P"
    READY = "R"
    TRACKING = "T"
    HOLD = "H"
    DECELERATING = "D"
    FAULT = "F"
    ESTOP = "X"


FOLLOWING = (ArmState.TRACKING, ArmState.HOLD)
"""The states in which a controller accepts set-points."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of the tool in arm coordinates: position (m) and angle t = phi12 - yaw (rad)."""

    x_m: float
    y_m: float
    t_rad: float


@dataclass(frozen=True, slots=True)
class JointPose:
    """Joint angles (rad) of an actuator that turns the palms directly."""

    joints_rad: Joints


ArmPose = Pose | JointPose
"""What set-points and reports contain: the pose of the tool, or the joint angles."""


@dataclass(frozen=True, slots=True)
class ArmReport:
    """The controller's state and the actual pose; `t_sample` (s) is when the report's first byte arrived.

    fresh: the report came within a few cycles after its request, so `t_sample` is the time of the pose.
    """

    t_sample: float
    state: ArmState
    pose: ArmPose
    fresh: bool = True


@dataclass(frozen=True, slots=True)
class Reach:
    """Limits that the controller enforces: a box in arm coordinates, maximum speed and acceleration."""

    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float
    v_max_m_s: float
    a_max_m_s2: float


class Outgoing(NamedTuple):
    """Bytes to write, and the set-point that they contain (None: none)."""

    data: bytes
    setpoint: ArmPose | None = None


class Actuator(ABC):
    """Driver of one controller: bytes in and out, reports. No I/O except in `port`; safe in the loop.

    `state` and `pose` are the last reported ones, None while unknown. `refusal` is the reason why the last request
    failed, else None.
    """

    def __init__(self, config: AdeptConfig | ServosConfig, unit: str) -> None:
        """`unit` is what the line's errors are counted in. Nothing is opened yet."""
        self.state: ArmState | None = None
        self.pose: ArmPose | None = None
        self.refusal: str | None = None
        self._port, self._baud = config.port, config.baud
        self._t_report = -math.inf  # of the last report
        self._error_shares = ErrorShares({"garbled": (0.05, 10, unit)})

    @property
    @abstractmethod
    def reach(self) -> Reach | None:
        """The limits that the controller has reported, None before."""

    @property
    @abstractmethod
    def error(self) -> str:
        """Text of the controller's last error, until a start or reset succeeds; else empty."""

    @property
    @abstractmethod
    def tracking(self) -> bool:
        """Whether set-points are being sent."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """Whether a request is still unanswered."""

    def port(self) -> DevicePort:
        """Return the controller's port, not yet opened."""
        return Port("arm", self._port, self._baud)

    @abstractmethod
    def linked(self, t: float) -> bool:
        """Whether the controller answers at `t` (s)."""

    def lost(self, t: float) -> bool:
        """Whether the controller does not answer at `t` (s), or has not answered yet."""
        return not self.linked(t)

    def frozen(self, t: float) -> bool:
        """Whether, while tracking, the last report at `t` (s) is so old that motion should halt."""
        return self.tracking and self.age(t) > FREEZE_S

    def age(self, t: float) -> float:
        """Age (s) of the last report at `t` (s); infinite before the first."""
        return t - self._t_report

    @abstractmethod
    def request_tracking(self) -> None:
        """Request tracking; set-points are then sent automatically, the first at the actual pose."""

    @abstractmethod
    def request_stop(self) -> None:
        """Request a planned stop; no more set-points are sent."""

    @abstractmethod
    def request_reset(self) -> None:
        """Request that the controller clear a latched fault."""

    @abstractmethod
    def disconnected(self) -> None:
        """Handle the loss of the port."""

    @abstractmethod
    def feed(self, data: bytes, t_recv: float) -> list[ArmReport]:
        """Process the bytes read at `t_recv` (s, monotonic) and return the reports that they complete."""

    @abstractmethod
    def due(self) -> float:
        """Return the time (s) of the next `poll`; always after the last `poll`."""

    @abstractmethod
    def poll(self, t: float, target: ArmPose | None) -> Outgoing:
        """Return what to write at `t` (s); `target` is the set-point while tracking (None: repeat the last one)."""

    def health(self, refresh: bool) -> Iterator[str]:
        """Yield the active fault conditions, without the arm's name; `refresh`: evaluate the counters again first."""
        if refresh:
            self._error_shares.update({"garbled": self._garbled()})
        yield from self._error_shares

    @abstractmethod
    def _garbled(self) -> tuple[int, int]:
        """Total and damaged units received since the start."""

    @abstractmethod
    def evidence(self, condition: str, t: float) -> str:
        """Return the measurements behind a condition at `t` (s): line, age, limit. May be empty."""

    def finding(self, condition: str) -> str:  # noqa: ARG002
        """Return what came over the line, or the controller's error, as a code for a condition; empty if neither."""
        return ""

    @abstractmethod
    def counts(self) -> dict[str, float]:
        """All counters since the start, by name."""


ActuatorFactory = Callable[[Any], Actuator]
"""Creates an actuator from the configuration of its kind."""


def make_actuator(config: ArmConfig) -> Actuator:
    """Create the driver of the configured actuator."""
    factory: ActuatorFactory = importlib.import_module(f"palmd.devices.actuators.{config.kind}").DRIVER
    return factory(config)
