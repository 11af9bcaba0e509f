"""Two emulated Feetech STS3215 servos behind one line: friction, give under load, and no watchdog. Pure.

A servo goes to its goal at the speed that came with it, which it has at once where its acceleration is 0. Friction
holds it until its goal is half of `friction_deg` away, and it stays that far behind. It gives by `COMPLIANCE_RAD_N_M`
under load, which its encoder reports; the play of its gears lies between encoder and palm, where nothing reports it.
Settings that are written while LOCK is 1 are lost with the power. Hardware errors let go, and end when the torque is
written.
Sources: docs/reference/devices.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from palmd.config.arms import FeetechConfig, ServoConfig
from palmd.config.two_palms import Config
from palmd.devices import feetech as sts
from palmd.devices.feetech import BROADCAST, FeetechError, FeetechInstruction, packet_reader
from palmd.devices.servobus import Packet, PacketReader, Register
from palmd.events import Joints
from palmd.rig.actuators import Utterance
from palmd.rig.servos import RADIANS_PER_COUNT, REBOOT_S, ServoArm, ServoArmFactory, ServoShaft, palms_of

COMPLIANCE_RAD_N_M = math.radians(2.2) / 1.04
"""1.8 to 2.6° under 1.5 kg at 10 cm and 45° (SO-ARM100 issue 134)."""

FASTEST = 3000  # counts/s without a speed: 45 to 46 turns a minute
BAUD_CODES: Mapping[int, int] = {1000000: 0, 115200: 4}
_TROUBLES = {
    "overload": FeetechError.OVERLOAD,
    "overheat": FeetechError.HOT,
    "undervoltage": FeetechError.VOLTAGE,
}
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
    """One servo: its table, and a shaft with friction."""

    def __init__(
        self, config: ServoConfig, direction: float, friction_rad: float, baud_code: int, rng: np.random.Generator,
        t: float,
    ) -> None:  # fmt: skip
        """Standing with its palm at `direction` (rad), as it comes from the factory but for id and baud."""
        super().__init__(config, direction, rng, t)
        self._hold = 0.5 * friction_rad / RADIANS_PER_COUNT
        self._table = bytearray(sts.TABLE_BYTES)
        for register, value in {**_FACTORY, sts.ID: config.id, sts.BAUD: baud_code}.items():
            self._set(register, value)
        self._kept = bytes(self._table[: sts.EEPROM_END])
        self._given = 0.0  # counts that it has given under load
        self._t_stepped = t
        self._set(sts.GOAL, round(self._shaft.goal(t)))

    def get(self, register: Register) -> int:
        """A register's value."""
        return register.decode(self._table[register.address : register.end])

    def _set(self, register: Register, value: int) -> None:
        self._table[register.address : register.end] = register.encode(value)

    @property
    def id(self) -> int:
        """Its number on the bus."""
        return self.get(sts.ID)

    @property
    def torque(self) -> bool:
        """Whether it holds its goal."""
        return bool(self.get(sts.TORQUE))

    @property
    def has_failed(self) -> bool:
        """By its status."""
        return bool(self.get(sts.STATUS))

    @property
    def follows(self) -> bool:
        """It has no state of following but its torque."""
        return self.torque

    def hears(self, baud_code: int, t: float) -> bool:
        """Whether it hears and speaks on a bus of that speed."""
        return t >= self._t_awake and self.get(sts.BAUD) == baud_code

    def step(self, t: float) -> None:
        """The goal's end, and what the load makes of where it stands."""
        if t >= self._t_there:
            self._stop(t)
        if self.torque:
            self._give(t)
        self._t_stepped = t

    def _give(self, t: float) -> None:
        """The load moves it within what the controller's stiffness and friction leave."""
        wanted = COMPLIANCE_RAD_N_M * self._load / RADIANS_PER_COUNT
        off = wanted - self._given
        if abs(off) > self._hold and math.isinf(self._t_there):
            step = math.copysign(min(abs(off) - self._hold, FASTEST * (t - self._t_stepped)), off)
            self._given += step
            self._go(self._shaft.goal(t) + step, FASTEST, t)

    def hurt(self, trouble: str, t: float) -> None:
        """A hardware error; where the mask says so, it lets go."""
        error = _TROUBLES[trouble]
        self._set(sts.STATUS, self.get(sts.STATUS) | error)
        if self.get(sts.UNLOADING) & error:
            self._set(sts.TORQUE, 0)
            self._stop(t)

    def restart(self, t: float, silent_s: float = REBOOT_S) -> None:
        """As without power for a while: what was not kept is as from the factory."""
        self._table = bytearray(sts.TABLE_BYTES)
        for register, value in _FACTORY.items():
            self._set(register, value)
        self._table[: sts.EEPROM_END] = self._kept
        self._set(sts.GOAL, round(self._shaft.goal(t)))
        self._given = 0.0
        self._stop(t)
        self._t_awake = t + silent_s

    def read(self, address: int, size: int, t: float) -> bytes:
        """A stretch of the table as it is at t (s); beyond its end zeros."""
        x, v = self._told(t)
        self._set(sts.POSITION, round(x))
        self._set(sts.SPEED, round(v))
        self._set(sts.LOAD, max(-1000, min(1000, round(self._load / 3.0 * 1000))))  # of 3 N m
        self._set(sts.MOVING, int(abs(v) > 1.0))
        return bytes(self._table[address : address + size]).ljust(size, b"\0")

    def write(self, address: int, data: bytes, t: float) -> None:
        """Sets what may be set, and goes where its goal says."""
        before = self.torque
        for at, byte in enumerate(data, address):
            if at < sts.TABLE_BYTES and not any(at in span for span in _READ_ONLY):
                self._table[at] = byte
        if not self.get(sts.LOCK):
            self._kept = bytes(self._table[: sts.EEPROM_END])
        covered = range(address, address + len(data))
        if sts.TORQUE.address in covered:
            self._set(sts.STATUS, 0)
            if before and not self.torque:
                self._stop(t)
        if self.torque and (sts.GOAL.address in covered or not before):
            self._aim(t)

    def _aim(self, t: float) -> None:
        if self.get(sts.OPERATING_MODE) != 0:
            return
        low, high = self.get(sts.MIN_POSITION), self.get(sts.MAX_POSITION)
        wanted = min(max(self.get(sts.GOAL), low), high) if high > low else self.get(sts.GOAL)
        goal = wanted + self.get(sts.HOMING_OFFSET) + self._given
        way = goal - self._shaft.goal(t)
        if abs(way) <= self._hold:
            self._stop(t)
            return
        self._go(goal - math.copysign(self._hold, way), self.get(sts.GOAL_SPEED) or FASTEST, t)

    def _go(self, goal: float, speed: float, t: float) -> None:
        way = goal - self._shaft.goal(t)
        span = max(abs(way) / min(speed, FASTEST), 1e-4)
        self._shaft.follow(t, way / span)
        self._t_there = t + span


class FeetechArm(ServoArm[FeetechServo]):
    """Both servos on their bus."""

    def __init__(self, config: Config, arm: FeetechConfig, home: Joints, rng: np.random.Generator, t: float) -> None:
        """At rest at `home` (rad) at t (s), without torque."""
        self._code = code = BAUD_CODES[arm.baud]
        friction = math.radians(arm.friction_deg)
        servos = [FeetechServo(servo, direction, friction, code, rng, t) for servo, direction in palms_of(arm, home)]
        super().__init__(config, arm, servos, packet_reader(arm.baud, answers=False), rng, t)

    def listener(self) -> PacketReader:
        """Of its answers."""
        return packet_reader(self.baud)

    def _obey(self, packet: Packet, t: float) -> list[Utterance]:
        hearing = {servo.id: servo for servo in self._servos if servo.hears(self._code, t)}
        data = packet.parameters
        match packet.instruction:
            case FeetechInstruction.SYNC_WRITE if len(data) >= 2:
                self._write_each(hearing, data, t)
                return []
            case FeetechInstruction.SYNC_READ if len(data) >= 2:
                return self._read_each(hearing, data[0], data[1], data[2:], t)
        said = []
        for servo in [each for each in hearing.values() if packet.servo in (each.id, BROADCAST)]:
            answer = self._answer(servo, packet, t)
            if answer is not None and packet.servo != BROADCAST:
                said.append(Utterance(answer, t + servo.get(sts.RETURN_DELAY) * 2e-6))
        return said

    def _answer(self, servo: FeetechServo, packet: Packet, t: float) -> bytes | None:
        """Carries an instruction out; the answer, None where there is none to it."""
        data, out, always = packet.parameters, b"", False
        match packet.instruction:
            case FeetechInstruction.PING:
                always = True
            case FeetechInstruction.READ if len(data) == 2:
                out, always = servo.read(data[0], data[1], t), True
            case FeetechInstruction.WRITE if len(data) > 1:
                servo.write(data[0], data[1:], t)
            case _:
                return None
        if not (always or servo.get(sts.STATUS_LEVEL)):
            return None
        return sts.encode_status(servo.id, servo.get(sts.STATUS), out)

    def _write_each(self, hearing: Mapping[int, FeetechServo], data: bytes, t: float) -> None:
        address, size = data[0], data[1]
        covered = range(address, address + size)
        self._goals += sts.GOAL.address in covered
        for at in range(2, len(data) - size, size + 1):
            servo = hearing.get(data[at])
            if servo is None:
                continue
            servo.write(address, data[at + 1 : at + 1 + size], t)
            if sts.GOAL.address in covered:
                self._outside += not servo.get(sts.MIN_POSITION) <= servo.get(sts.GOAL) <= servo.get(sts.MAX_POSITION)

    def _read_each(
        self, hearing: Mapping[int, FeetechServo], address: int, size: int, ids: Sequence[int], t: float
    ) -> list[Utterance]:
        """A servo answers once it has heard the one before: after one that does not, none does."""
        said = []
        for number in ids:
            servo = hearing.get(number)
            if servo is None:
                break
            out = servo.read(address, size, t)
            said.append(Utterance(sts.encode_status(number, servo.get(sts.STATUS), out), t))
        return said


EMULATOR: ServoArmFactory = FeetechArm
