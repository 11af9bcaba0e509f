"""Two emulated DYNAMIXEL servos behind one line. Pure.

Each servo consists of its control table (`dynamixel_table`) and a shaft: EEPROM is locked while torque is on, profiles
are time-based, a watchdog stops the servo, hardware errors are cleared by a restart only, and the encoder has 4096
counts a turn and noise. A servo receives at its own baud rate only, under its id or its secondary id, and answers
according to its status return level. Sync Writes and Bulk Writes are never answered; answers follow one another after
the return delay of each. It moves in position mode and extended position mode. Source: ROBOTIS e-Manual, DYNAMIXEL
Protocol 2.0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from palmd.config.arms import DynamixelConfig, ServoConfig
from palmd.config.two_palms import Config
from palmd.devices import dynamixel as dxl
from palmd.devices.dynamixel import HardwareError, packet_reader
from palmd.devices.servobus import BROADCAST, COUNTS_PER_TURN, Instruction, Packet, PacketReader, Register
from palmd.events import Joints
from palmd.rig.actuators import Transmission
from palmd.rig.servokinds import dynamixel_table as servotable
from palmd.rig.servokinds.dynamixel_table import TableRefusal
from palmd.rig.servos import RADIANS_PER_COUNT, REBOOT_S, ServoArm, ServoArmFactory, ServoShaft, servos_with_directions

STEP_RAD_S = math.radians(360.0)  # speed of a servo without a profile

_HARDWARE_ERRORS = {
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
_POSITION_MODES = (servotable.POSITION_MODE, servotable.EXTENDED_MODE)


class EmulatedServo(ServoShaft):
    """One servo: control table and shaft. Counts increase with the palm's direction as configured."""

    def __init__(
        self, config: ServoConfig, direction: float, baud_code: int, rng: np.random.Generator, t: float
    ) -> None:
        """At rest with its palm at `direction` (rad), with factory settings except id and baud rate."""
        super().__init__(config, direction, rng, t)
        self._registered: tuple[int, bytes] | None = None
        self._cleared_counts = 0  # whole turns that CLEAR has subtracted from the position
        self._t_instruction = t
        self._table = bytearray(servotable.TABLE_BYTES)
        self._start({dxl.ID: config.id, dxl.BAUD: baud_code})

    @property
    def id(self) -> int:
        """Its number on the bus."""
        return self.get(dxl.ID)

    def _start(self, kept: Mapping[Register, int]) -> None:
        """Set all registers to factory values, except those given."""
        for entry in servotable.ENTRIES:
            self._set(entry.register, kept.get(entry.register, entry.factory))
        self._registered, self._cleared_counts = None, 0

    def get(self, register: Register) -> int:
        """A register's value."""
        return register.decode(self._table[register.address : register.end])

    def _set(self, register: Register, value: int) -> None:
        self._table[register.address : register.end] = register.encode(value)

    @property
    def torque(self) -> bool:
        """Whether its torque is enabled."""
        return bool(self.get(dxl.TORQUE))

    @property
    def tripped(self) -> bool:
        """Whether its watchdog has stopped it."""
        return self.get(dxl.WATCHDOG) < 0

    @property
    def has_failed(self) -> bool:
        """Whether it has a hardware error or its watchdog has tripped."""
        return bool(self.get(dxl.HARDWARE_ERROR)) or self.tripped

    @property
    def follows(self) -> bool:
        """Whether its watchdog is running."""
        return self.get(dxl.WATCHDOG) > 0

    def step(self, t: float) -> None:
        """End the profile when it is due, and check the watchdog."""
        if t >= self._t_arrival:
            self._stop(t)
        units = self.get(dxl.WATCHDOG)
        if units > 0 and t - self._t_instruction > units * 0.020:
            self._set(dxl.WATCHDOG, -1)
            self._set(dxl.PROFILE_ACCELERATION, 0)
            self._set(dxl.PROFILE_VELOCITY, 0)
            self._stop(t)

    def fail(self, trouble: str, t: float) -> None:
        """Raise a hardware error; torque goes off if the shutdown mask says so."""
        error = _HARDWARE_ERRORS[trouble]
        self._set(dxl.HARDWARE_ERROR, self.get(dxl.HARDWARE_ERROR) | error)
        if self.get(dxl.SHUTDOWN) & error:
            self._set(dxl.TORQUE, 0)
            self._stop(t)

    def restart(self, t: float, silent_s: float = REBOOT_S) -> None:
        """Restart as after `reboot` or a loss of power: RAM is reset, and it does not answer for `silent_s`."""
        stored = (entry.register for entry in servotable.ENTRIES if entry.register.address < dxl.EEPROM_END)
        self._start({register: self.get(register) for register in stored})
        self._stop(t)
        self._t_ready = t + silent_s

    def reset(self, option: int, t: float) -> int:
        """Factory reset except for what the option keeps, and restart. Returns the error code of the answer."""
        if option not in (_RESET_ALL, _KEEP_ID, _KEEP_ID_AND_BAUD):
            return self._refuse(TableRefusal.RANGE)
        kept = () if option == _RESET_ALL else (dxl.ID,) if option == _KEEP_ID else (dxl.ID, dxl.BAUD)
        self._start({register: self.get(register) for register in kept})
        self.restart(t)
        return 0

    def is_listening(self, baud_code: int, t: float) -> bool:
        """Whether it receives and answers on a bus of this speed."""
        return t >= self._t_ready and self.get(dxl.BAUD) == baud_code and self.get(servotable.PROTOCOL) == 2

    def answers(self, instruction: int) -> bool:
        """Whether its status return level requires an answer to the instruction."""
        least = 0 if instruction == Instruction.PING else 1 if instruction in _READS else 2
        return self.get(dxl.STATUS_LEVEL) >= least

    @property
    def delay_s(self) -> float:
        """Delay from a request's last byte to the answer's first."""
        return self.get(dxl.RETURN_DELAY) * 2e-6

    @property
    def error(self) -> int:
        """The alert bit of every answer, set while there is a hardware error."""
        return dxl.ALERT if self.get(dxl.HARDWARE_ERROR) else 0

    def note_instruction(self, t: float) -> None:
        """Note that an instruction arrived at t (s), for the watchdog."""
        self._t_instruction = t

    def read(self, address: int, size: int, t: float) -> bytes:
        """Bytes of the table at t (s)."""
        x, v = self._encoder_counts(t)
        self._set(dxl.POSITION, round(x + self._offset))
        self._set(dxl.VELOCITY, round(v / COUNTS_PER_TURN * 60.0 / dxl.VELOCITY_UNIT_RPM))
        self._set(dxl.TICK, int(t * 1e3) % 32768)
        self._set(dxl.MOVING, int(abs(v) > 1.0))
        return bytes(self._table[address : address + size])

    @property
    def _offset(self) -> int:
        """Counts added to the shaft's for the reported position."""
        return self.get(dxl.HOMING_OFFSET) - self._cleared_counts

    def write(self, address: int, data: bytes, t: float) -> int:
        """Write registers; returns the error code of the answer, 0 if done. Nothing is written on an error."""
        error = servotable.refusal(address, data, self.get)
        if error is not None:
            return self._refuse(error)
        was_enabled = self.torque
        self._table[address : address + len(data)] = data
        has_new_goal = address <= dxl.GOAL.address < address + len(data)
        if self.torque and (has_new_goal or not was_enabled):
            self._aim(t)  # at the last goal, wherever that is
        elif was_enabled and not self.torque:
            self._stop(t)
        return 0

    def register(self, address: int, data: bytes) -> int:
        """Store a write until `act`; returns the error code of the answer."""
        error = servotable.refusal(address, data, self.get)
        if error is not None:
            return self._refuse(error)
        self._registered = address, data
        self._set(servotable.REGISTERED, 1)
        return 0

    def act(self, t: float) -> int:
        """Execute the stored write; returns the error code of the answer, also if nothing is stored."""
        if self._registered is None:
            return self._refuse(TableRefusal.INSTRUCTION)
        registered, self._registered = self._registered, None
        self._set(servotable.REGISTERED, 0)
        return self.write(*registered, t)

    def clear(self, parameters: bytes, t: float) -> int:
        """Reset the position to within one turn; returns the error code of the answer, also while it moves."""
        if parameters != _CLEAR_TURNS:
            return self._refuse(TableRefusal.RANGE)
        x, v, _ = self._shaft.at(t)
        if abs(v) > 1.0:
            return self._refuse(TableRefusal.FAILED)
        self._cleared_counts += (round(x) + self._offset) // COUNTS_PER_TURN * COUNTS_PER_TURN
        return 0

    def _aim(self, t: float) -> None:
        if self.get(dxl.OPERATING_MODE) not in _POSITION_MODES:
            return
        distance = self.get(dxl.GOAL) - self._offset - self._shaft.goal(t)
        by_time = self.get(dxl.DRIVE_MODE) & 4
        duration = self.get(dxl.PROFILE_VELOCITY) * 1e-3 if by_time else 0.0
        duration = duration or max(abs(distance) * RADIANS_PER_COUNT / STEP_RAD_S, 1e-3)
        self._shaft.follow(t, distance / duration)
        self._t_arrival = t + duration

    def _refuse(self, error: int) -> int:
        self.refusals += 1
        return error


class DynamixelArm(ServoArm[EmulatedServo]):
    """Both servos on their bus."""

    def __init__(self, config: Config, arm: DynamixelConfig, home: Joints, rng: np.random.Generator, t: float) -> None:
        """At rest at `home` (rad) at t (s), without torque."""
        self._code = code = {115200: 2, 1000000: 3, 2000000: 4, 3000000: 5, 4000000: 6}[arm.baud]
        servos = [
            EmulatedServo(servo, direction, code, rng, t) for servo, direction in servos_with_directions(arm, home)
        ]
        super().__init__(config, arm, servos, packet_reader(arm.baud), rng, t)

    def make_decoder(self) -> PacketReader:
        """A new decoder of its answers."""
        return packet_reader(self.baud)

    # -- the bus ------------------------------------------------------------------------------------------

    def _execute(self, packet: Packet, t: float) -> list[Transmission]:
        listening = [servo for servo in self._servos if servo.is_listening(self._code, t)]
        addressed = [
            servo for servo in listening if packet.servo in (servo.id, servo.get(servotable.SECONDARY_ID), BROADCAST)
        ]
        for servo in addressed:
            servo.note_instruction(t)
        data = packet.parameters
        match packet.instruction:
            case Instruction.SYNC_WRITE if len(data) >= 4:
                address, size = _address_and_size(data)
                parts = [data[i : i + size + 1] for i in range(4, len(data), size + 1)]
                self._write_each(
                    addressed, [(part[0], address, part[1:]) for part in parts if len(part) == size + 1], t
                )
                return []
            case Instruction.BULK_WRITE:
                self._write_each(addressed, list(_bulk_writes(data)), t)
                return []
            case Instruction.SYNC_READ | Instruction.FAST_SYNC_READ if len(data) >= 4:
                return self._read_each(
                    addressed, packet.instruction, [(each, *_address_and_size(data)) for each in data[4:]], t
                )
            case Instruction.BULK_READ | Instruction.FAST_BULK_READ:
                parts = [data[i : i + 5] for i in range(0, len(data) - 4, 5)]
                return self._read_each(
                    addressed, packet.instruction, [(part[0], *_address_and_size(part[1:])) for part in parts], t
                )
        transmissions = []
        t_free = t
        for servo in addressed:
            answers = servo.answers(packet.instruction) and packet.servo in (servo.id, BROADCAST)
            answer = self._answer(servo, packet, t)
            if answer is not None and answers:
                t_free += servo.delay_s
                transmissions.append(Transmission(answer, t_free))
        return transmissions

    def _answer(self, servo: EmulatedServo, packet: Packet, t: float) -> bytes | None:
        """Execute an instruction; returns the answer, None if the instruction is never answered."""
        data, error, out, number = packet.parameters, 0, b"", servo.id
        match packet.instruction:
            case Instruction.PING:
                out = servo.read(dxl.MODEL.address, 2, t) + servo.read(dxl.FIRMWARE.address, 1, t)
            case Instruction.READ if len(data) == 4:
                address, size = _address_and_size(data)
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
                    return None  # it would give all servos of the bus the same id
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

    def _write_each(
        self, addressed: Sequence[EmulatedServo], writes: Sequence[tuple[int, int, bytes]], t: float
    ) -> None:
        """Write id, address and data of each; never answered."""
        self._goals += any(address == dxl.GOAL.address for _, address, _ in writes)
        values = {number: (address, data) for number, address, data in writes}
        for servo in addressed:
            if servo.id in values:
                address, data = values[servo.id]
                before = servo.refusals
                servo.write(address, data, t)
                self._outside += address == dxl.GOAL.address and servo.refusals > before and not servo.tripped

    def _read_each(
        self, addressed: Sequence[EmulatedServo], instruction: int, reads: Sequence[tuple[int, int, int]], t: float
    ) -> list[Transmission]:
        """Read id, address and size of each. A servo answers after the one before it; if one does not answer, none of
        the following does."""
        answering = {servo.id: servo for servo in addressed if servo.answers(instruction)}
        t_free, answers = t, []
        for number, address, size in reads:
            servo = answering.get(number)
            if servo is None:
                break
            t_free += servo.delay_s
            inside = address + size <= servotable.TABLE_BYTES
            error = servo.error if inside else servo.error | TableRefusal.ACCESS
            answers.append((number, error, servo.read(address, size, t) if inside else bytes(0), t_free))
        if instruction in (Instruction.SYNC_READ, Instruction.BULK_READ):
            return [
                Transmission(dxl.encode_status(number, error, out), t_answer)
                for number, error, out, t_answer in answers
            ]
        answer = _fast_answer(
            [(number, error, out) for number, error, out, _ in answers], [size for _, _, size in reads]
        )
        return [Transmission(answer, answers[0][-1])] if answers else []


def _address_and_size(data: bytes) -> tuple[int, int]:
    """Decode an address and a size."""
    return int.from_bytes(data[:2], "little"), int.from_bytes(data[2:4], "little")


def _bulk_writes(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Id, address and data of each part of a Bulk Write."""
    while len(data) >= 5:
        address, size = _address_and_size(data[1:])
        if len(data) >= 5 + size:
            yield data[0], address, data[5 : 5 + size]
        data = data[5 + size :]


def _fast_answer(parts: Sequence[tuple[int, int, bytes]], sizes: Sequence[int]) -> bytes:
    """The joint answer to a fast read: one packet without stuffing, each part with the checksum up to it."""
    length = 1 + sum(size + 4 for size in sizes)
    packet = dxl.HEADER + bytes((BROADCAST,)) + length.to_bytes(2, "little") + bytes((Instruction.STATUS,))
    for (number, error, out), size in zip(parts, sizes, strict=False):
        packet += bytes((error, number)) + out.ljust(size, bytes(1))
        packet += dxl.crc16(packet).to_bytes(2, "little")
    return packet


EMULATOR: ServoArmFactory = DynamixelArm
