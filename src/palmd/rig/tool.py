"""The emulated Adept arm up to its tool: the controller's program at the end of its line, and servos. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from palmd.devices.actuator import ArmState, Pose
from palmd.devices.armlink import CONTROLLER_NEWLINE, LineReader
from palmd.events import Joints
from palmd.rig.actuators import Utterance
from palmd.rig.arm import Servo, turn
from palmd.rig.controller import BREAK_RECEIVED, CYCLE_S, ArmLimits, Controller
from palmd.rig.fault_injection import FaultOrder
from palmd.rig.line import Wire
from palmd.rig.tally import HostLines

_ENCODER_NOISE_M = 1.5e-5
_SERVO_LAG_S = 0.016
_MARGIN_M = 5e-3


class DrivenTool:
    """What the tool moves is for others to say. Poses are in arm coordinates."""

    def __init__(
        self, baud: int, limits: ArmLimits, start: Pose, rng: np.random.Generator, *, step_s: float, lag_s: float = 0.0
    ) -> None:
        """At rest at `start`, stepped every `step_s`; `lag_s` is what the servos lag beyond their own."""
        self.baud = baud
        self._rng = rng
        self._controller = Controller(limits, start, baud, self._hear_setpoint)
        self._servos = [Servo(r, _SERVO_LAG_S + lag_s) for r in (start.x_m, start.y_m, start.t_rad)]
        self._steps_per_cycle = round(CYCLE_S / step_s)
        self._steps = 0
        self._next_cycle = int(rng.integers(self._steps_per_cycle))
        self._in, self._host_lines = Wire(baud), HostLines(baud)
        self._led: Pose | None = None
        self._now = 0.0
        self._frozen: Pose | None = None  # what the encoders go on telling
        self._jump_m = 0.0  # what they tell too much of x

    @property
    def state(self) -> ArmState:
        """The controller's."""
        return self._controller.state

    def receive(self, heard: bytes, spoilt: bytes, t: float, late_s: float = 0.0) -> None:  # noqa: ARG002
        """What the host has written, as the line leaves it; see `LineDevice`."""
        self._host_lines.take(heard, spoilt, t)
        self._in.send(spoilt, t)

    def step(self, t: float) -> Sequence[Utterance]:
        """The controller hears what has arrived and runs its cycles; the servos follow the path of each for 16 ms."""
        self._steps += 1
        self._now = t
        said = []
        if arrived := self._in.take(t):
            said.append(_said(self._controller.feed(arrived, t, self._actual_pose(t)), t))
        if self._steps >= self._next_cycle:
            self._next_cycle += self._steps_per_cycle
            if self._led is not None:
                self._controller.lead(self._led)
            said.append(_said(self._controller.cycle(t, self._actual_pose(t)), t))
            path = self._controller.path
            along_x, along_y, tool = self._servos
            along_x.follow(t, (path.x_m - along_x.goal(t)) / CYCLE_S)
            along_y.follow(t, (path.y_m - along_y.goal(t)) / CYCLE_S)
            tool.follow(t, turn(path.t_rad - tool.goal(t)) / CYCLE_S)
        return said

    def play(self, order: FaultOrder, begins: bool, palms: Joints = ()) -> None:
        """What is done to the controller; `palms` are where what the tool holds stands (rad)."""
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
        """The controller's counts and those of what it heard."""
        return {
            "crc_errors": self._controller.reader.counters.crc_errors,
            **{f"host_{what}": n for what, n in self._host_lines.as_dict().items()},
            **self._controller.counters.as_dict(),
        }

    def listener(self) -> LineReader:
        """Of its lines."""
        return LineReader(self.baud)

    def _jogged(self, palms: Joints) -> Pose:  # noqa: ARG002
        """Where an operator who takes the arm moves it to: nowhere."""
        return self._controller.path

    def _hear_setpoint(self, pose: Pose, t: float) -> None:
        """A set-point has come."""

    def _true_pose(self, t: float) -> Pose:
        along_x, along_y, tool = self._servos
        return Pose(along_x.at(t)[0], along_y.at(t)[0], turn(tool.at(t)[0]))

    def _actual_pose(self, t: float) -> Pose:
        """As the encoders tell it."""
        if self._frozen is not None:
            return self._frozen
        true, (off_x, off_y) = self._true_pose(t), self._rng.normal(0.0, _ENCODER_NOISE_M, 2).tolist()
        return Pose(true.x_m + off_x + self._jump_m, true.y_m + off_y, true.t_rad)


def limits_round(poses: Sequence[Pose], *, v_max: float, a_max: float) -> ArmLimits:
    """What the controller allows: a box round these poses, and so fast (m/s, m/s²)."""
    xs, ys = [pose.x_m for pose in poses], [pose.y_m for pose in poses]
    return ArmLimits(
        min(xs) - _MARGIN_M,
        max(xs) + _MARGIN_M,
        min(ys) - _MARGIN_M,
        max(ys) + _MARGIN_M,
        v_max=v_max,
        a_max=a_max,
    )


def _said(data: bytes, t: float) -> Utterance:
    return Utterance(data, t, data.count(CONTROLLER_NEWLINE))
