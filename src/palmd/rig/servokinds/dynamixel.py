"""Two emulated DYNAMIXEL servos behind one line. Pure.

Each servo is its control table (`dynamixel_table`) and a shaft: EEPROM that the torque locks, profiles by time, a
watchdog that stops it, hardware errors that only a restart clears, an encoder of 4096 counts a turn that flickers. It
hears the bus at its own baud alone, under its id or its secondary id, and answers as its status return level says. Sync
Writes and Bulk Writes are never answered, answers follow one another after the return delay of each. It moves in
position mode and extended position mode. Source: ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from palmd.config.arms import DynamixelConfig, ServoConfig
from palmd.config.two_palms import Config
from palmd.devices import dynamixel as dxl
from palmd.devices.dynamixel import BROADCAST, HardwareError, Instruction, packet_reader
from palmd.devices.servobus import COUNTS_PER_TURN, Packet, PacketReader, Register
from palmd.events import Joints
from palmd.rig.actuators import Utterance
from palmd.rig.servokinds import dynamixel_table as servotable
from palmd.rig.servokinds.dynamixel_table import TableRefusal
from palmd.rig.servos import RADIANS_PER_COUNT, REBOOT_S, ServoArm, ServoArmFactory, ServoShaft, palms_of

STEP_RAD_S = math.radians(360.0)  # how fast a servo goes to a goal without a profile

_TROUBLES = {
    "overload": HardwareError.OVERLOAD,
    "overheat": HardwareError.HOT,
    "undervoltage": HardwareError.VOLTAGE,
}
_RESET_ALL, _KEEP_ID, _KEEP_ID_AND_BAUD = 0xFF, 0x01, 0x02
_CLEAR_TURNS = bytes.fromhex("01 44 58 4C 22")
_READS = (
    Instruction.READ, Instruction.SYNC_READ, Instruction.BULK_READ, Instruction.FAST_SYNC_READ,
    Instruction.FAST_BULK_READ,
)  # fmt: skip
_FOLLOWED = (servotable.POSITION_MODE, servotable.EXTENDED_MODE)


class EmulatedServo(ServoShaft):
    """One servo: control table and shaft. `counts` grow with the palm's direction as configured."""

    def __init__(
        self, config: ServoConfig, direction: float, baud_code: int, rng: np.random.Generator, t: float
    ) -> None:
        """Standing with its palm at `direction` (rad), as it comes from the factory but for id and baud."""
        super().__init__(config, direction, rng, t)
        self._registered: tuple[int, bytes] | None = None
        self._turns = 0  # counts that CLEAR has taken off the position
        self._t_heard = t
        self._table = bytearray(servotable.TABLE_BYTES)
        self._start({dxl.ID: config.id, dxl.BAUD: baud_code})

    @property
    def id(self) -> int:
        """Its number on the bus."""
        return self.get(dxl.ID)

    def _start(self, kept: Mapping[Register, int]) -> None:
        """As from the factory, but for these registers."""
        for entry in servotable.ENTRIES:
            self._set(entry.register, kept.get(entry.register, entry.factory))
        self._registered, self._turns = None, 0

    def get(self, register: Register) -> int:
        """A register's value."""
        return register.decode(self._table[register.address : register.end])

    def _set(self, register: Register, value: int) -> None:
        self._table[register.address : register.end] = register.encode(value)

    @property
    def torque(self) -> bool:
        """Whether it holds its goal."""
        return bool(self.get(dxl.TORQUE))

    @property
    def tripped(self) -> bool:
        """Whether its watchdog has stopped it."""
        return self.get(dxl.WATCHDOG) < 0

    @property
    def has_failed(self) -> bool:
        """By its hardware errors and its watchdog."""
        return bool(self.get(dxl.HARDWARE_ERROR)) or self.tripped

    @property
    def follows(self) -> bool:
        """While its watchdog is awake."""
        return self.get(dxl.WATCHDOG) > 0

    def step(self, t: float) -> None:
        """The profile's end, and the watchdog."""
        if t >= self._t_there:
            self._stop(t)
        units = self.get(dxl.WATCHDOG)
        if units > 0 and t - self._t_heard > units * 0.020:
            self._set(dxl.WATCHDOG, -1)
            self._set(dxl.PROFILE_ACCELERATION, 0)
            self._set(dxl.PROFILE_VELOCITY, 0)
            self._stop(t)

    def hurt(self, trouble: str, t: float) -> None:
        """A hardware error; where the mask says so, it lets go."""
        error = _TROUBLES[trouble]
        self._set(dxl.HARDWARE_ERROR, self.get(dxl.HARDWARE_ERROR) | error)
        if self.get(dxl.SHUTDOWN) & error:
            self._set(dxl.TORQUE, 0)
            self._stop(t)

    def restart(self, t: float, silent_s: float = REBOOT_S) -> None:
        """As after `reboot`, or without power for a while: RAM is wiped, and it is silent for so long."""
        stored = (entry.register for entry in servotable.ENTRIES if entry.register.address < dxl.EEPROM_END)
        self._start({register: self.get(register) for register in stored})
        self._stop(t)
        self._t_awake = t + silent_s

    def reset(self, option: int, t: float) -> int:
        """As from the factory, but for what the option keeps; starts anew. The error in the answer."""
        if option not in (_RESET_ALL, _KEEP_ID, _KEEP_ID_AND_BAUD):
            return self._refuse(TableRefusal.RANGE)
        kept = () if option == _RESET_ALL else (dxl.ID,) if option == _KEEP_ID else (dxl.ID, dxl.BAUD)
        self._start({register: self.get(register) for register in kept})
        self.restart(t)
        return 0

    def hears(self, baud_code: int, t: float) -> bool:
        """Whether it hears and speaks on a bus of that speed."""
        return t >= self._t_awake and self.get(dxl.BAUD) == baud_code and self.get(servotable.PROTOCOL) == 2

    def answers(self, instruction: int) -> bool:
        """Whether its status return level has it answer an instruction."""
        least = 0 if instruction == Instruction.PING else 1 if instruction in _READS else 2
        return self.get(dxl.STATUS_LEVEL) >= least

    @property
    def delay_s(self) -> float:
        """Between a question's last byte and the answer's first."""
        return self.get(dxl.RETURN_DELAY) * 2e-6

    @property
    def error(self) -> int:
        """The bit of every answer that tells of a hardware error."""
        return dxl.ALERT if self.get(dxl.HARDWARE_ERROR) else 0

    def heard(self, t: float) -> None:
        """An instruction has come at t (s)."""
        self._t_heard = t

    def read(self, address: int, size: int, t: float) -> bytes:
        """A stretch of the table as it is at t (s)."""
        x, v = self._told(t)
        self._set(dxl.POSITION, round(x + self._offset))
        self._set(dxl.VELOCITY, round(v / COUNTS_PER_TURN * 60.0 / dxl.VELOCITY_UNIT_RPM))
        self._set(dxl.TICK, int(t * 1e3) % 32768)
        self._set(dxl.MOVING, int(abs(v) > 1.0))
        return bytes(self._table[address : address + size])

    @property
    def _offset(self) -> int:
        """What is added to the shaft's counts for the position that it reports."""
        return self.get(dxl.HOMING_OFFSET) - self._turns

    def write(self, address: int, data: bytes, t: float) -> int:
        """Sets registers; the error that the answer tells, 0 when it is done. Nothing is set where there is one."""
        refused = servotable.refusal(address, data, self.get)
        if refused is not None:
            return self._refuse(refused)
        before = self.torque
        self._table[address : address + len(data)] = data
        aimed = address <= dxl.GOAL.address < address + len(data)
        if self.torque and (aimed or not before):
            self._aim(t)  # where it was told last, wherever that is
        elif before and not self.torque:
            self._stop(t)
        return 0

    def register(self, address: int, data: bytes) -> int:
        """Keeps what is to be written until `act`; the error in the answer."""
        refused = servotable.refusal(address, data, self.get)
        if refused is not None:
            return self._refuse(refused)
        self._registered = address, data
        self._set(servotable.REGISTERED, 1)
        return 0

    def act(self, t: float) -> int:
        """Writes what is registered; the error in the answer, one too where nothing is."""
        if self._registered is None:
            return self._refuse(TableRefusal.INSTRUCTION)
        registered, self._registered = self._registered, None
        self._set(servotable.REGISTERED, 0)
        return self.write(*registered, t)

    def clear(self, parameters: bytes, t: float) -> int:
        """Counts the position within one turn again; the error in the answer, one too while it moves."""
        if parameters != _CLEAR_TURNS:
            return self._refuse(TableRefusal.RANGE)
        x, v, _ = self._shaft.at(t)
        if abs(v) > 1.0:
            return self._refuse(TableRefusal.FAILED)
        self._turns += (round(x) + self._offset) // COUNTS_PER_TURN * COUNTS_PER_TURN
        return 0

    def _aim(self, t: float) -> None:
        if self.get(dxl.OPERATING_MODE) not in _FOLLOWED:
            return
        way = self.get(dxl.GOAL) - self._offset - self._shaft.goal(t)
        by_time = self.get(dxl.DRIVE_MODE) & 4
        span = self.get(dxl.PROFILE_VELOCITY) * 1e-3 if by_time else 0.0
        span = span or max(abs(way) * RADIANS_PER_COUNT / STEP_RAD_S, 1e-3)
        self._shaft.follow(t, way / span)
        self._t_there = t + span

    def _refuse(self, error: int) -> int:
        self.refusals += 1
        return error


class DynamixelArm(ServoArm[EmulatedServo]):
    """Both servos on their bus."""

    def __init__(self, config: Config, arm: DynamixelConfig, home: Joints, rng: np.random.Generator, t: float) -> None:
        """At rest at `home` (rad) at t (s), without torque."""
        self._code = code = {115200: 2, 1000000: 3, 2000000: 4, 3000000: 5, 4000000: 6}[arm.baud]
        servos = [EmulatedServo(servo, direction, code, rng, t) for servo, direction in palms_of(arm, home)]
        super().__init__(config, arm, servos, packet_reader(arm.baud), rng, t)

    def listener(self) -> PacketReader:
        """Of its answers."""
        return packet_reader(self.baud)

    # -- the bus ------------------------------------------------------------------------------------------

    def _obey(self, packet: Packet, t: float) -> list[Utterance]:
        hearing = [servo for servo in self._servos if servo.hears(self._code, t)]
        asked = [
            servo for servo in hearing if packet.servo in (servo.id, servo.get(servotable.SECONDARY_ID), BROADCAST)
        ]
        for servo in asked:
            servo.heard(t)
        data = packet.parameters
        match packet.instruction:
            case Instruction.SYNC_WRITE if len(data) >= 4:
                address, size = _two(data)
                parts = [data[i : i + size + 1] for i in range(4, len(data), size + 1)]
                self._write_each(asked, [(part[0], address, part[1:]) for part in parts if len(part) == size + 1], t)
                return []
            case Instruction.BULK_WRITE:
                self._write_each(asked, list(_bulk_writes(data)), t)
                return []
            case Instruction.SYNC_READ | Instruction.FAST_SYNC_READ if len(data) >= 4:
                return self._read_each(asked, packet.instruction, [(each, *_two(data)) for each in data[4:]], t)
            case Instruction.BULK_READ | Instruction.FAST_BULK_READ:
                parts = [data[i : i + 5] for i in range(0, len(data) - 4, 5)]
                return self._read_each(asked, packet.instruction, [(part[0], *_two(part[1:])) for part in parts], t)
        said = []
        t_free = t
        for servo in asked:
            answers = servo.answers(packet.instruction) and packet.servo in (servo.id, BROADCAST)
            answer = self._answer(servo, packet, t)
            if answer is not None and answers:
                t_free += servo.delay_s
                said.append(Utterance(answer, t_free))
        return said

    def _answer(self, servo: EmulatedServo, packet: Packet, t: float) -> bytes | None:
        """Carries an instruction out; the answer, None where there is none to it in any case."""
        data, error, out, number = packet.parameters, 0, b"", servo.id
        match packet.instruction:
            case Instruction.PING:
                out = servo.read(dxl.MODEL.address, 2, t) + servo.read(dxl.FIRMWARE.address, 1, t)
            case Instruction.READ if len(data) == 4:
                address, size = _two(data)
                if address + size > servotable.TABLE_BYTES:
                    error = TableRefusal.ACCESS
                else:
                    out = servo.read(address, size, t)
            case Instruction.WRITE if len(data) > 2:
                error = servo.write(int.from_bytes(data[:2], "little"), data[2:], t)
            case Instruction.REG_WRITE if len(data) > 2:
                error = servo.register(int.from_bytes(data[:2], "little"), data[2:])
            case Instruction.ACTION:
                error = servo.act(t)
            case Instruction.CLEAR:
                error = servo.clear(data, t)
            case Instruction.FACTORY_RESET if len(data) == 1:
                if packet.servo == BROADCAST and data[0] == _RESET_ALL:
                    return None  # all of a bus would have one id afterwards
                error = servo.reset(data[0], t)
            case Instruction.REBOOT:
                servo.restart(t)
            case Instruction.READ | Instruction.WRITE | Instruction.REG_WRITE | Instruction.FACTORY_RESET:
                error = TableRefusal.LENGTH
            case _:
                error = TableRefusal.INSTRUCTION
        if packet.servo == BROADCAST and packet.instruction != Instruction.PING:
            return None
        return dxl.encode_status(number, error | servo.error, out)

    def _write_each(self, asked: Sequence[EmulatedServo], writes: Sequence[tuple[int, int, bytes]], t: float) -> None:
        """Id, address and data of each; never answered."""
        self._goals += any(address == dxl.GOAL.address for _, address, _ in writes)
        values = {number: (address, data) for number, address, data in writes}
        for servo in asked:
            if servo.id in values:
                address, data = values[servo.id]
                before = servo.refusals
                servo.write(address, data, t)
                self._outside += address == dxl.GOAL.address and servo.refusals > before and not servo.tripped

    def _read_each(
        self, asked: Sequence[EmulatedServo], instruction: int, reads: Sequence[tuple[int, int, int]], t: float
    ) -> list[Utterance]:
        """Id, address and size of each. A servo answers once it has heard the one before: after one that does not,
        none does."""
        heard = {servo.id: servo for servo in asked if servo.answers(instruction)}
        t_free, found = t, []
        for number, address, size in reads:
            servo = heard.get(number)
            if servo is None:
                break
            t_free += servo.delay_s
            inside = address + size <= servotable.TABLE_BYTES
            error = servo.error if inside else servo.error | TableRefusal.ACCESS
            found.append((number, error, servo.read(address, size, t) if inside else bytes(0), t_free))
        if instruction in (Instruction.SYNC_READ, Instruction.BULK_READ):
            return [Utterance(dxl.encode_status(number, error, out), t_said) for number, error, out, t_said in found]
        answer = _fast_answer([(number, error, out) for number, error, out, _ in found], [size for _, _, size in reads])
        return [Utterance(answer, found[0][-1])] if found else []


def _two(data: bytes) -> tuple[int, int]:
    """An address and a size."""
    return int.from_bytes(data[:2], "little"), int.from_bytes(data[2:4], "little")


def _bulk_writes(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Id, address and data of each part of a Bulk Write."""
    while len(data) >= 5:
        address, size = _two(data[1:])
        if len(data) >= 5 + size:
            yield data[0], address, data[5 : 5 + size]
        data = data[5 + size :]


def _fast_answer(parts: Sequence[tuple[int, int, bytes]], sizes: Sequence[int]) -> bytes:
    """What servos answer together to a fast read: one packet without stuffing, each with the checksum so far."""
    length = 1 + sum(size + 4 for size in sizes)
    said = dxl.HEADER + bytes((BROADCAST,)) + length.to_bytes(2, "little") + bytes((Instruction.STATUS,))
    for (number, error, out), size in zip(parts, sizes, strict=False):
        said += bytes((error, number)) + out.ljust(size, bytes(1))
        said += dxl.crc16(said).to_bytes(2, "little")
    return said


EMULATOR: ServoArmFactory = DynamixelArm
