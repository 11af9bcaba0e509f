"""Two emulated Feetech STS3215 servos behind one line, with friction and compliance, without a watchdog. Pure.

A servo moves to its goal at the speed sent with it, which it reaches immediately if its acceleration is 0. Friction
keeps it at rest until the goal is half of `friction_deg` away, and it stops that far from the goal. It yields by
`COMPLIANCE_RAD_N_M` under load, which its encoder reports; the backlash of its gears lies between encoder and palm and
is not reported. Settings written while LOCK is 1 are lost with the power. Hardware errors switch torque off, and end
when the torque register is written.
Sources: docs/reference/devices.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from palmd.config.arms import FeetechConfig, ServoConfig
from palmd.config.two_palms import Config
from palmd.devices import feetech as sts
from palmd.devices.feetech import FeetechError, packet_reader
from palmd.devices.servobus import BROADCAST, Instruction, Packet, PacketReader, Register
from palmd.events import Joints
from palmd.rig.actuators import Transmission
from palmd.rig.servos import (
    RADIANS_PER_COUNT,
    REBOOT_S,
    CommonRegisters,
    ServoArm,
    ServoArmFactory,
    ServoShaft,
    servos_with_directions,
)

COMPLIANCE_RAD_N_M = math.radians(2.2) / 1.04
"""1.8 to 2.6° under 1.5 kg at 10 cm and 45° (SO-ARM100 issue 134)."""

FASTEST = 3000  # counts/s if no speed is given: 45 to 46 turns a minute
BAUD_CODES: Mapping[int, int] = {1000000: 0, 115200: 4}
_FACTORY: Mapping[Register, int] = {
    sts.FIRMWARE: 3,
    sts.MODEL: 777,
    sts.ID: 1,
    sts.RETURN_DELAY: 0,
    sts.STATUS_LEVEL: 1,
    sts.MAX_POSITION: 4095,
    sts.UNLOADING: 44,
    sts.LOCK: 1,
    sts.VOLTAGE: 121,
    sts.TEMPERATURE: 32,
}
_READ_ONLY = (range(5), range(56, sts.TABLE_BYTES))


class FeetechServo(ServoShaft):
    """One servo: its register table, and a shaft with friction."""

    registers = CommonRegisters(sts.ID, sts.BAUD, sts.TORQUE, sts.STATUS, sts.UNLOADING)
    hardware_errors = {  # noqa: RUF012
        "overload": FeetechError.OVERLOAD, "overheat": FeetechError.HOT, "undervoltage": FeetechError.VOLTAGE,
    }  # fmt: skip

    def __init__(
        self, config: ServoConfig, direction: float, friction_rad: float, baud_code: int, rng: np.random.Generator,
        t: float,
    ) -> None:  # fmt: skip
        """At rest with its palm at `direction` (rad), with factory settings except id and baud rate."""
        super().__init__(config, direction, rng, t)
        self._friction_counts = 0.5 * friction_rad / RADIANS_PER_COUNT
        self._table = bytearray(sts.TABLE_BYTES)
        for register, value in {**_FACTORY, sts.ID: config.id, sts.BAUD: baud_code}.items():
            self._set(register, value)
        self._stored = bytes(self._table[: sts.EEPROM_END])
        self._compliance_counts = 0.0  # counts by which it has yielded under load
        self._t_stepped = t
        self._set(sts.GOAL, round(self._shaft.goal(t)))

    @property
    def has_failed(self) -> bool:
        """Whether its status reports a hardware error."""
        return bool(self.get(sts.STATUS))

    @property
    def follows(self) -> bool:
        """The same as its torque: it has no separate state."""
        return self.torque

    def step(self, t: float) -> None:
        """End the motion when it is due, and yield under load."""
        if t >= self._t_arrival:
            self._stop(t)
        if self.torque:
            self._apply_compliance(t)
        self._t_stepped = t

    def _apply_compliance(self, t: float) -> None:
        """Move under the load, within what friction holds."""
        wanted = COMPLIANCE_RAD_N_M * self._load / RADIANS_PER_COUNT
        difference = wanted - self._compliance_counts
        if abs(difference) > self._friction_counts and math.isinf(self._t_arrival):
            step = math.copysign(
                min(abs(difference) - self._friction_counts, FASTEST * (t - self._t_stepped)), difference
            )
            self._compliance_counts += step
            self._go(self._shaft.goal(t) + step, FASTEST, t)

    def restart(self, t: float, silent_s: float = REBOOT_S) -> None:
        """Restart as after a loss of power: settings that were not stored return to factory values."""
        self._table = bytearray(sts.TABLE_BYTES)
        for register, value in _FACTORY.items():
            self._set(register, value)
        self._table[: sts.EEPROM_END] = self._stored
        self._set(sts.GOAL, round(self._shaft.goal(t)))
        self._compliance_counts = 0.0
        self._stop(t)
        self._t_ready = t + silent_s

    def read(self, address: int, size: int, t: float) -> bytes:
        """Bytes of the table at t (s); zeros beyond its end."""
        x, v = self._encoder_counts(t)
        self._set(sts.POSITION, round(x))
        self._set(sts.SPEED, round(v))
        self._set(sts.LOAD, max(-1000, min(1000, round(self._load / 3.0 * 1000))))  # of 3 N m
        self._set(sts.MOVING, int(abs(v) > 1.0))
        return bytes(self._table[address : address + size]).ljust(size, b"\0")

    def write(self, address: int, data: bytes, t: float) -> None:
        """Write the writable registers, and move to the goal if it was set or torque came on."""
        was_enabled = self.torque
        for at, byte in enumerate(data, address):
            if at < sts.TABLE_BYTES and not any(at in span for span in _READ_ONLY):
                self._table[at] = byte
        if not self.get(sts.LOCK):
            self._stored = bytes(self._table[: sts.EEPROM_END])
        covered = range(address, address + len(data))
        if sts.TORQUE.address in covered:
            self._set(sts.STATUS, 0)
            if was_enabled and not self.torque:
                self._stop(t)
        if self.torque and (sts.GOAL.address in covered or not was_enabled):
            self._aim(t)

    def _aim(self, t: float) -> None:
        if self.get(sts.OPERATING_MODE) != 0:
            return
        low, high = self.get(sts.MIN_POSITION), self.get(sts.MAX_POSITION)
        wanted = min(max(self.get(sts.GOAL), low), high) if high > low else self.get(sts.GOAL)
        goal = wanted + self.get(sts.HOMING_OFFSET) + self._compliance_counts
        distance = goal - self._shaft.goal(t)
        if abs(distance) <= self._friction_counts:
            self._stop(t)
            return
        self._go(goal - math.copysign(self._friction_counts, distance), self.get(sts.GOAL_SPEED) or FASTEST, t)

    def _go(self, goal: float, speed: float, t: float) -> None:
        distance = goal - self._shaft.goal(t)
        duration = max(abs(distance) / min(speed, FASTEST), 1e-4)
        self._shaft.follow(t, distance / duration)
        self._t_arrival = t + duration


class FeetechArm(ServoArm[FeetechServo]):
    """Both servos on their bus."""

    def __init__(self, config: Config, arm: FeetechConfig, home: Joints, rng: np.random.Generator, t: float) -> None:
        """At rest at `home` (rad) at t (s), without torque."""
        self._code = code = BAUD_CODES[arm.baud]
        friction = math.radians(arm.friction_deg)
        servos = [
            FeetechServo(servo, direction, friction, code, rng, t)
            for servo, direction in servos_with_directions(arm, home)
        ]
        super().__init__(config, arm, servos, packet_reader(arm.baud, answers=False), rng, t)

    def make_decoder(self) -> PacketReader:
        return packet_reader(self.baud)

    def _execute(self, packet: Packet, t: float) -> list[Transmission]:
        listening = {servo.id: servo for servo in self._servos if servo.is_listening(self._code, t)}
        data = packet.parameters
        match packet.instruction:
            case Instruction.SYNC_WRITE if len(data) >= 2:
                self._write_each(listening, data, t)
                return []
            case Instruction.SYNC_READ if len(data) >= 2:
                return self._read_each(listening, data[0], data[1], data[2:], t)
        transmissions = []
        for servo in [each for each in listening.values() if packet.servo in (each.id, BROADCAST)]:
            answer = self._answer(servo, packet, t)
            if answer is not None and packet.servo != BROADCAST:
                transmissions.append(Transmission(answer, t + servo.get(sts.RETURN_DELAY) * 2e-6))
        return transmissions

    def _answer(self, servo: FeetechServo, packet: Packet, t: float) -> bytes | None:
        """Execute an instruction; returns the answer, None if it is not answered."""
        data, out, always = packet.parameters, b"", False
        match packet.instruction:
            case Instruction.PING:
                always = True
            case Instruction.READ if len(data) == 2:
                out, always = servo.read(data[0], data[1], t), True
            case Instruction.WRITE if len(data) > 1:
                servo.write(data[0], data[1:], t)
            case _:
                return None
        if not (always or servo.get(sts.STATUS_LEVEL)):
            return None
        return sts.encode_status(servo.id, servo.get(sts.STATUS), out)

    def _write_each(self, listening: Mapping[int, FeetechServo], data: bytes, t: float) -> None:
        address, size = data[0], data[1]
        covered = range(address, address + size)
        self._goals += sts.GOAL.address in covered
        for start in range(2, len(data) - size, size + 1):
            servo = listening.get(data[start])
            if servo is None:
                continue
            servo.write(address, data[start + 1 : start + 1 + size], t)
            if sts.GOAL.address in covered:
                self._outside += not servo.get(sts.MIN_POSITION) <= servo.get(sts.GOAL) <= servo.get(sts.MAX_POSITION)

    def _read_each(
        self, listening: Mapping[int, FeetechServo], address: int, size: int, ids: Sequence[int], t: float
    ) -> list[Transmission]:
        """A servo answers after the one before it; if one does not answer, none of the following does."""
        transmissions = []
        for number in ids:
            servo = listening.get(number)
            if servo is None:
                break
            out = servo.read(address, size, t)
            transmissions.append(Transmission(sts.encode_status(number, servo.get(sts.STATUS), out), t))
        return transmissions


EMULATOR: ServoArmFactory = FeetechArm
