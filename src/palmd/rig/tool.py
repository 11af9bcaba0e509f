"""The emulated Adept arm up to its tool: the controller's program at the end of the line, and axis servos. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from palmd.devices.actuator import ArmState, Pose
from palmd.devices.armlink import CONTROLLER_NEWLINE, LineReader
from palmd.events import Joints
from palmd.rig.actuators import Transmission
from palmd.rig.arm import Servo, wrap_angle
from palmd.rig.controller import BREAK_RECEIVED, CYCLE_S, ArmLimits, Controller
from palmd.rig.fault_injection import FaultOrder
from palmd.rig.line import Wire
from palmd.rig.tally import HostLines

_ENCODER_NOISE_M = 1.5e-5
_SERVO_LAG_S = 0.016
_MARGIN_M = 5e-3


class DrivenTool:
    """Controller and servos of an arm; subclasses define what the tool moves. Poses are in arm coordinates."""

    def __init__(
        self, baud: int, limits: ArmLimits, start: Pose, rng: np.random.Generator, *, step_s: float, lag_s: float = 0.0
    ) -> None:
        """At rest at `start`, stepped every `step_s`; `lag_s` is added to the servos' own lag."""
        self.baud = baud
        self._rng = rng
        self._controller = Controller(limits, start, baud, self._on_setpoint)
        self._servos = [Servo(r, _SERVO_LAG_S + lag_s) for r in (start.x_m, start.y_m, start.t_rad)]
        self._steps_per_cycle = round(CYCLE_S / step_s)
        self._steps = 0
        self._next_cycle = int(rng.integers(self._steps_per_cycle))
        self._in, self._host_lines = Wire(baud), HostLines(baud)
        self._hand_pose: Pose | None = None
        self._now = 0.0
        self._frozen: Pose | None = None  # the pose that frozen encoders report
        self._jump_m = 0.0  # injected error of the reported x

    @property
    def state(self) -> ArmState:
        """The controller's state."""
        return self._controller.state

    def receive(self, sent: bytes, corrupted: bytes, t: float, late_s: float = 0.0) -> None:  # noqa: ARG002
        """Receive what the host wrote, as corrupted on the line; see `LineDevice`."""
        self._host_lines.take(sent, corrupted, t)
        self._in.send(corrupted, t)

    def step(self, t: float) -> Sequence[Transmission]:
        """Pass what has arrived to the controller and run its cycles; the servos follow each cycle's path for 16 ms."""
        self._steps += 1
        self._now = t
        transmissions = []
        if arrived := self._in.take(t):
            transmissions.append(_transmission(self._controller.feed(arrived, t, self._actual_pose(t)), t))
        if self._steps >= self._next_cycle:
            self._next_cycle += self._steps_per_cycle
            if self._hand_pose is not None:
                self._controller.move_by_hand(self._hand_pose)
            transmissions.append(_transmission(self._controller.cycle(t, self._actual_pose(t)), t))
            path = self._controller.path
            along_x, along_y, tool = self._servos
            along_x.follow(t, (path.x_m - along_x.goal(t)) / CYCLE_S)
            along_y.follow(t, (path.y_m - along_y.goal(t)) / CYCLE_S)
            tool.follow(t, wrap_angle(path.t_rad - tool.goal(t)) / CYCLE_S)
        return transmissions

    def inject_fault(self, order: FaultOrder, begins: bool, palms: Joints = ()) -> None:
        """Begin or end a fault of the controller; `palms` are the joint angles (rad) of what the tool holds."""
        controller = self._controller
        match order.name, begins:
            case "estop", True:
                controller.press_emergency_stop()
            case "power_off", True:
                controller.switch_power_off()
            case "manual", True:
                controller.switch_to_manual(self._jogged(palms))
            case (("estop" | "power_off" | "manual"), False):
                controller.make_ready()
            case "break", True:
                controller.line_fault(BREAK_RECEIVED)
            case "block", True:
                for servo in self._servos:
                    servo.block(self._now)
            case "block", False:
                for servo in self._servos:
                    servo.release(self._now)
            case "freeze", _:
                self._frozen = self._actual_pose(self._now) if begins else None
            case "jump", _:
                self._jump_m = order.strength if begins else 0.0

    def status(self) -> dict[str, Any]:
        """Counters of the controller and of what it received."""
        return {
            "crc_errors": self._controller.reader.counters.crc_errors,
            **{f"host_{what}": n for what, n in self._host_lines.as_dict().items()},
            **self._controller.counters.as_dict(),
        }

    def make_decoder(self) -> LineReader:
        """A new decoder of its lines."""
        return LineReader(self.baud)

    def _jogged(self, palms: Joints) -> Pose:  # noqa: ARG002
        """The pose to which an operator in manual mode jogs the arm; here unchanged."""
        return self._controller.path

    def _on_setpoint(self, pose: Pose, t: float) -> None:
        """Called with each received set-point."""

    def _true_pose(self, t: float) -> Pose:
        along_x, along_y, tool = self._servos
        return Pose(along_x.at(t)[0], along_y.at(t)[0], wrap_angle(tool.at(t)[0]))

    def _actual_pose(self, t: float) -> Pose:
        """The pose that the encoders report."""
        if self._frozen is not None:
            return self._frozen
        true, (error_x, error_y) = self._true_pose(t), self._rng.normal(0.0, _ENCODER_NOISE_M, 2).tolist()
        return Pose(true.x_m + error_x + self._jump_m, true.y_m + error_y, true.t_rad)


def limits_around(poses: Sequence[Pose], *, v_max: float, a_max: float) -> ArmLimits:
    """The controller's limits: the bounding box of these poses with a margin, speed and acceleration (m/s, m/s²)."""
    xs, ys = [pose.x_m for pose in poses], [pose.y_m for pose in poses]
    return ArmLimits(
        min(xs) - _MARGIN_M,
        max(xs) + _MARGIN_M,
        min(ys) - _MARGIN_M,
        max(ys) + _MARGIN_M,
        v_max=v_max,
        a_max=a_max,
    )


def _transmission(data: bytes, t: float) -> Transmission:
    return Transmission(data, t, data.count(CONTROLLER_NEWLINE))
