"""The servos' host and their emulated bus in one loop without wires, in steps of 0.5 ms."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from palmd.config.two_palms import Config
from palmd.devices.actuator import ArmReport, JointPose, make_actuator
from palmd.rig.fault_injection import FaultOrder
from palmd.rig.line import Wire
from palmd.rig.servos import make_servo_arm

STEP_S = 5e-4
HOME = (math.radians(45.0), math.radians(90.0))
MAKES = ("dynamixel", "feetech")


def tabletop(**arm) -> Config:
    """A rig with two servos."""
    return Config.model_validate(
        {
            "rig": {"hinge": "fixed"},
            "pads": {"palm1": {"kind": "strip", "port": "a"}, "palm2": {"kind": "strip", "port": "b"}},
            "arm": {"kind": "dynamixel", "port": "c"} | arm,
        }
    )


class ServoBench:
    """`host` is the daemon's driver, `rig` the servos; `spoil` may alter the bytes to the host.

    `held_s`: the adapter delivers bytes only at multiples of this time, as one with a latency timer.
    """

    def __init__(
        self, config: Config | None = None, spoil: Callable[[bytes], bytes] = bytes, held_s: float = 0.0, **arm
    ) -> None:
        config = config or tabletop(**arm)
        self.t = 0.0
        self.host = make_actuator(config.arm)
        self.rig = make_servo_arm(config, config.arm, HOME, np.random.default_rng(1), 0.0)
        self.reports: list[ArmReport] = []
        self.sent = 0
        self.target: Callable[[float], tuple[float, float]] | None = None
        self.deaf = False
        self._spoil = spoil
        self._out = Wire(config.arm.baud)
        self._held_s = held_s

    def go(self, seconds: float, until: Callable[[], bool] = lambda: False) -> ServoBench:
        """Runs for so long (s), or until a condition holds."""
        t_end = self.t + seconds
        while self.t < t_end and not until():
            self.t += STEP_S
            t = self.t
            for said in self.rig.step(t):
                self._out.send(self._spoil(said.data), said.t)
            handed_over = math.floor(t / self._held_s + 1e-9) * self._held_s if self._held_s else t
            if (data := self._out.take(handed_over)) and not self.deaf:
                self.reports += self.host.feed(data, t)
            if not self.deaf and t >= self.host.due():
                place = JointPose(self.target(t)) if self.target and self.host.tracking else None
                sent = self.host.poll(t, place)
                self.sent += sent.setpoint is not None
                self.rig.receive(sent.data, sent.data, t)
        return self

    def armed(self) -> ServoBench:
        """Follows; stands at home unless there is a target."""
        self.go(1.0, lambda: self.host.linked(self.t))
        self.host.request_tracking()
        return self.go(0.5, lambda: self.host.tracking)

    def play(self, name: str, begins: bool = True) -> None:
        """Starts or ends a fault injection on the servos."""
        self.rig.inject_fault(FaultOrder(name, "arm", 1.0, self.t, math.inf), begins, HOME)

    @property
    def speed(self) -> float:
        """Speed of the faster palm (rad/s)."""
        return max(map(abs, self.rig.palms_at(self.t).rates))


class BenchTalk:
    """A `Talk` with the emulated servos, in their own time."""

    def __init__(self, bench, late_s=0.0):
        self.bench, self.late_s = bench, late_s
        self.baud = 1_000_000
        self.axes = bench.host.axes
        self._out = Wire(self.baud)

    def ask(self, packet, patience_s=0.04, answers=1):
        bench, reader, found = self.bench, self.axes[0].make.reader(self.baud), []
        t_sent = bench.t
        bench.rig.receive(packet, packet, bench.t)
        while len(found) < answers and bench.t < t_sent + patience_s:
            bench.t += 5e-4
            for said in bench.rig.step(bench.t):
                self._out.send(said.data, said.t + self.late_s)
            found += [(each, bench.t - t_sent) for each in reader.feed(self._out.take(bench.t), bench.t)]
        return found

    def wait(self, seconds):
        for _ in range(round(seconds / 5e-4)):
            self.bench.t += 5e-4
            self.bench.rig.step(self.bench.t)
