"""The interface of all actuator drivers, and the lookup of the configured one.

A kind `K` consists of `palmd/devices/actuators/K.py`, which defines `DRIVER`, and of a model in `palmd.config` with
`kind: Literal["K"]`. The daemon uses this interface only.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from palmd.config.arms import ArmConfig
from palmd.events import Joints

if TYPE_CHECKING:
    from palmd.devices.port import DevicePort


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


class Actuator(Protocol):
    """Driver of one controller: bytes in and out, reports. No I/O except in `port`; safe in the loop.

    `state` is the last reported state, None while unknown. `refusal` is the reason why the last request failed, else
    None.
    """

    state: ArmState | None
    refusal: str | None

    @property
    def pose(self) -> ArmPose | None:
        """The last reported pose, None while unknown."""

    @property
    def reach(self) -> Reach | None:
        """The limits that the controller has reported, None before."""

    @property
    def error(self) -> str:
        """Text of the controller's last error, until a start or reset succeeds; else empty."""

    @property
    def tracking(self) -> bool:
        """Whether set-points are being sent."""

    @property
    def busy(self) -> bool:
        """Whether a request is still unanswered."""

    def port(self) -> DevicePort:
        """Return the controller's port, not yet opened."""

    def linked(self, t: float) -> bool:
        """Whether the controller answers at `t` (s)."""

    def lost(self, t: float) -> bool:
        """Whether the controller does not answer at `t` (s), or has not answered yet."""

    def frozen(self, t: float) -> bool:
        """Whether, while tracking, the last answer at `t` (s) is so old that motion should halt."""

    def age(self, t: float) -> float:
        """Age (s) of the last report at `t` (s); infinite before the first."""

    def request_tracking(self) -> None:
        """Request tracking; set-points are then sent automatically, the first at the actual pose."""

    def request_stop(self) -> None:
        """Request a planned stop; no more set-points are sent."""

    def request_reset(self) -> None:
        """Request that the controller clear a latched fault."""

    def disconnected(self) -> None:
        """Handle the loss of the port."""

    def feed(self, data: bytes, t_recv: float) -> list[ArmReport]:
        """Process the bytes read at `t_recv` (s) and return the reports that they complete."""

    def due(self) -> float:
        """Return the time (s) of the next `poll`; always after the last `poll`."""

    def poll(self, t: float, target: ArmPose | None) -> Outgoing:
        """Return what to write at `t` (s); `target` is the set-point while tracking (None: repeat the last one)."""

    def health(self, refresh: bool) -> Iterator[str]:
        """Yield the active fault conditions, without the arm's name; `refresh`: evaluate the counters again first."""

    def evidence(self, condition: str, t: float) -> str:
        """Return the measurements behind a condition at `t` (s): line, age, limit. May be empty."""

    def counts(self) -> dict[str, float]:
        """All counters since the start, by name."""


ActuatorFactory = Callable[[Any], Actuator]
"""Creates an actuator from the configuration of its kind."""


def make_actuator(config: ArmConfig) -> Actuator:
    """Create the driver of the configured actuator."""
    factory: ActuatorFactory = importlib.import_module(f"palmd.devices.actuators.{config.kind}").DRIVER
    return factory(config)
