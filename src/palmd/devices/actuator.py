"""What every kind of actuator offers, and how the configured kind is found.

A kind `K` is `palmd/devices/actuators/K.py`, which says `DRIVER`, and a model in `palmd.config` with
`kind: Literal["K"]`. The daemon takes what stands here.
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
    """The controller's state, as the letter that `palm/motion` publishes."""

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
"""The states in which a controller takes set-points."""


@dataclass(frozen=True, slots=True)
class Pose:
    """The tool in arm coordinates: position (m) and angle t = phi12 - yaw (rad)."""

    x_m: float
    y_m: float
    t_rad: float


@dataclass(frozen=True, slots=True)
class JointPose:
    """The joint angles (rad), where the actuator turns the palms themselves."""

    joints_rad: Joints


Place = Pose | JointPose
"""What an actuator is told, and tells: where its tool shall be, or the joints themselves."""


@dataclass(frozen=True, slots=True)
class ArmReport:
    """The controller's state and the actual pose at `t_sample` (s), the first byte's arrival.

    fresh: it came within a few cycles of what it answers, so that `t_sample` is when the arm was there.
    """

    t_sample: float
    state: ArmState
    pose: Place
    fresh: bool = True


@dataclass(frozen=True, slots=True)
class Reach:
    """The limits that the controller itself enforces: a box in arm coordinates, speed and acceleration."""

    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float
    v_max_m_s: float
    a_max_m_s2: float


class Sent(NamedTuple):
    """What goes out: the bytes, and the set-point among them, None when there is none."""

    data: bytes
    setpoint: Place | None = None


class Actuator(Protocol):
    """The host's side of one controller: bytes in and out, reports. Pure but for `port`; safe in the loop.

    `state` is the last reported one, None while unknown. `refusal` says why the last request came to nothing, else
    None.
    """

    state: ArmState | None
    refusal: str | None

    @property
    def pose(self) -> Place | None:
        """The last one reported, None while unknown."""

    @property
    def reach(self) -> Reach | None:
        """What the controller has said that it can do, None before."""

    @property
    def error(self) -> str:
        """The last error that the controller told of, in words, until a start or reset succeeds; else empty."""

    @property
    def tracking(self) -> bool:
        """Whether set-points are being sent."""

    @property
    def busy(self) -> bool:
        """Whether a request still waits for its answer."""

    def port(self) -> DevicePort:
        """What the controller is behind, shut."""

    def linked(self, t: float) -> bool:
        """Whether the controller answers at `t` (s)."""

    def lost(self, t: float) -> bool:
        """Whether it does not, or not yet."""

    def frozen(self, t: float) -> bool:
        """Whether, while tracking, answers have been missing at `t` (s) for so long that motion should halt."""

    def age(self, t: float) -> float:
        """How old (s) the last report is at `t` (s); infinite before the first."""

    def want_tracking(self) -> None:
        """Ask for tracking; set-points follow by themselves, the first at the actual pose."""

    def want_stop(self) -> None:
        """Ask for a planned stop; no more set-points are sent."""

    def request_reset(self) -> None:
        """Ask the controller to clear a latched fault."""

    def disconnected(self) -> None:
        """The port is gone."""

    def feed(self, data: bytes, t_recv: float) -> list[ArmReport]:
        """Take the bytes read at `t_recv` (s) and return the reports they complete."""

    def due(self) -> float:
        """When (s) `poll` next has something to do; always after the time of the last `poll`."""

    def poll(self, t: float, target: Place | None) -> Sent:
        """What to write at `t` (s), `target` being where the arm should be, if tracking; None: the last set-point."""

    def health(self, look: bool) -> Iterator[str]:
        """The conditions of the line that hold, without the arm's name; with `look` counters are judged anew."""

    def evidence(self, condition: str, t: float) -> str:
        """What speaks for a condition at `t` (s), without the arm's name: which line, age, limit. May be empty."""

    def counts(self) -> dict[str, float]:
        """What has passed since the start, by cause."""


ActuatorFactory = Callable[[Any], Actuator]
"""Takes its kind's configuration."""


def make_actuator(config: ArmConfig) -> Actuator:
    """The driver of the configured actuator."""
    factory: ActuatorFactory = importlib.import_module(f"palmd.devices.actuators.{config.kind}").DRIVER
    return factory(config)
