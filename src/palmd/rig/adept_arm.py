"""The emulated Adept arm: the controller's program at the end of its line, servos, and the palms' linkage. Pure."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from palmd.config import AdeptConfig, Config
from palmd.devices.actuator import ArmState, Pose
from palmd.devices.armlink import CONTROLLER_NEWLINE, LineReader
from palmd.events import Joints, PalmMotion
from palmd.rig.actuators import Utterance
from palmd.rig.arm import Linkage, Servo, turn
from palmd.rig.controller import BREAK_RECEIVED, CYCLE_S, ArmLimits, Controller
from palmd.rig.fault_injection import FaultOrder
from palmd.rig.line import Wire
from palmd.rig.plant import Hinge, PlantContact
from palmd.rig.setpoint_checker import SetPointChecker
from palmd.rig.tally import HostLines

_ENCODER_NOISE_M = 1.5e-5
_WORKSPACE_MARGIN_M = 5e-3
_ROOM = 1.2  # what the controller allows beyond what the palms' limits need
_MOST_PHI12_DEG = 172.0
_JOG_DEG = 4.0


class AdeptArm:
    """See `EmulatedActuator`."""

    def __init__(
        self,
        config: Config,
        arm: AdeptConfig,
        home: Joints,
        rng: np.random.Generator,
        *,
        step_s: float,
        lag_s: float,
    ) -> None:
        """At rest at `home` (rad); `lag_s` is what the servos lag beyond their own."""
        self.baud = arm.baud
        self.hinge = Hinge("arc", config.rig.palm_lengths_mm[0] * 1e-3, _base(config))
        self.jams = 0
        self._rng, self._home = rng, home
        self._linkage = Linkage.from_config(config)
        start = self._linkage.pose(*home)
        self.judge = SetPointChecker(self._linkage, config.limits)
        self._controller = Controller(arm_limits(config), start, arm.baud, self._hear_setpoint)
        self._servos = [Servo(r, 0.016 + lag_s) for r in (start.x_m, start.y_m, start.t_rad)]
        self._steps_per_cycle = round(CYCLE_S / step_s)
        self._steps = 0
        self._next_cycle = int(rng.integers(self._steps_per_cycle))
        self._angles: Joints = home
        self._in = Wire(arm.baud)
        self._host_lines = HostLines(arm.baud)
        self._led: Joints | None = None

    @property
    def state(self) -> ArmState:
        """The controller's."""
        return self._controller.state

    def palms_at(self, t: float) -> PalmMotion:
        """As the arm's pose tells them."""
        x, y = self._servos[0].at(t), self._servos[1].at(t)
        palms = self._linkage.motion(x, y)
        if palms is None:  # the linkage is at its stop: the palms stay where they were
            self.jams += 1
            return PalmMotion.at_rest(self._angles)
        self._angles = palms.angles
        return palms

    def receive(self, heard: bytes, spoilt: bytes, t: float, late_s: float = 0.0) -> None:
        """What the host has written, as the line leaves it."""
        self.judge.listened_late(t, late_s)
        self._host_lines.take(heard, spoilt, t)
        self._in.send(spoilt, t)

    def step(self, t: float) -> Sequence[Utterance]:
        """The controller hears what has arrived and runs its cycles; the servos follow the path of each for 16 ms."""
        self._steps += 1
        said = []
        if arrived := self._in.take(t):
            said.append(_said(self._controller.feed(arrived, t, self._actual_pose(t)), t))
        if self._steps >= self._next_cycle:
            self._next_cycle += self._steps_per_cycle
            if self._led is not None:
                self._controller.lead(self._linkage.pose(*self._led))
            said.append(_said(self._controller.cycle(t, self._actual_pose(t)), t))
            path = self._controller.path
            along_x, along_y, tool = self._servos
            along_x.follow(t, (path.x_m - along_x.goal(t)) / CYCLE_S)
            along_y.follow(t, (path.y_m - along_y.goal(t)) / CYCLE_S)
            tool.follow(t, turn(path.t_rad - tool.goal(t)) / CYCLE_S)
        return said

    def feel(self, palms: PalmMotion, contacts: Sequence[PlantContact], t: float) -> None:
        """It is too strong to feel anything."""

    def play(self, order: FaultOrder, begins: bool, palms: Joints) -> None:
        """What is done to the controller."""
        controller = self._controller
        match order.name, begins:
            case "estop", True:
                controller.press_emergency_stop()
            case "power_off", True:
                controller.switch_power_off()
            case "manual", True:
                controller.switch_to_manual(self._linkage.pose(*_jogged(palms, self._home)))
            case (("estop" | "power_off" | "manual"), False):
                controller.make_ready()
            case "break", True:
                controller.line_fault(BREAK_RECEIVED)

    def hold_by_hand(self, palms: Joints) -> None:
        """In manual mode."""
        self._led = palms

    def status(self) -> dict[str, Any]:
        """The controller's counts and those of what it heard."""
        return {
            "crc_errors": self._controller.reader.counters.crc_errors,
            **{f"host_{what}": n for what, n in self._host_lines.as_dict().items()},
            **self._controller.counters.as_dict(),
            **self.judge.as_dict(),
        }

    def listener(self) -> LineReader:
        """Of its lines."""
        return LineReader(self.baud)

    def _actual_pose(self, t: float) -> Pose:
        """The arm's pose as its encoders tell it."""
        x, y, angle = (servo.at(t)[0] for servo in self._servos)
        noise = self._rng.normal(0.0, _ENCODER_NOISE_M, 2)
        return Pose(x + float(noise[0]), y + float(noise[1]), turn(angle))

    def _hear_setpoint(self, pose: Pose, t: float) -> None:
        x, y, angle = (servo.at(t)[0] for servo in self._servos)
        holds = self._controller.state is ArmState.HOLD
        self.judge.hear(pose, t, Pose(x, y, turn(angle)) if holds else None)


def arm_limits(config: Config) -> ArmLimits:
    """What the controller allows: a box round every pose the palms' limits allow, and room above their rates.

    E's speed is at most L1·ω1 + L2·(ω1 + ω2), its acceleration L1·(α + ω²) + L2·(2α + 4ω²).
    """
    linkage, limits = Linkage.from_config(config), config.limits
    poses = [
        linkage.pose(*map(math.radians, angles))
        for angles in itertools.product(*(np.linspace(low, high, 40).tolist() for low, high in limits.angles_deg))
        if sum(angles) < _MOST_PHI12_DEG
    ]
    xs, ys = [p.x_m for p in poses], [p.y_m for p in poses]
    omega, alpha = math.radians(limits.rate_deg_s), math.radians(limits.acceleration_deg_s2)
    (inner, outer), margin = linkage.lengths, _WORKSPACE_MARGIN_M
    return ArmLimits(
        min(xs) - margin,
        max(xs) + margin,
        min(ys) - margin,
        max(ys) + margin,
        v_max=_ROOM * (inner + 2.0 * outer) * omega,
        a_max=_ROOM * (inner * (alpha + omega**2) + outer * (2.0 * alpha + 4.0 * omega**2)),
    )


def _said(data: bytes, t: float) -> Utterance:
    return Utterance(data, t, data.count(CONTROLLER_NEWLINE))


def _base(config: Config) -> tuple[float, float]:
    x_mm, y_mm = config.rig.base_mm
    return x_mm * 1e-3, y_mm * 1e-3


def _jogged(angles: Joints, home: Joints) -> Joints:
    """Where an operator jogs the palms to (rad): a little nearer to home, or off it; so never out of the limits."""
    way = [goal - angle for goal, angle in zip(home, angles, strict=True)]
    far, step = max(map(abs, way)), math.radians(_JOG_DEG)
    if far < step:
        return (angles[0] + step, *angles[1:])
    return tuple(angle + step / far * each for angle, each in zip(angles, way, strict=True))
