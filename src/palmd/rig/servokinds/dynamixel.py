"""Two emulated DYNAMIXEL servos behind one line. Pure.

Each servo consists of its control table (`dynamixel_table`) and a shaft: EEPROM is locked while torque is on, profiles
are time-based, a watchdog stops the servo, hardware errors are cleared by a restart only, and the encoder has 4096
counts a turn and noise. A servo receives at its own baud rate only, under its id or its secondary id, and answers
according to its status return level. Sync Writes are never answered; answers follow one another after the return delay
of each. It moves in position mode and extended position mode. It knows the instructions that palmd sends: Ping, Read,
Write, Reboot, Sync Read and Sync Write. Source: ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

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
from palmd.rig.servos import (
    RADIANS_PER_COUNT,
    REBOOT_S,
    CommonRegisters,
    ServoArm,
    ServoArmFactory,
    ServoShaft,
    servos_with_directions,
)

STEP_RAD_S = math.radians(360.0)  # speed of a servo without a profile

_ANSWERED_FROM_LEVEL: Mapping[int, int] = {Instruction.PING: 0, Instruction.READ: 1, Instruction.SYNC_READ: 1}
_POSITION_MODES = (servotable.POSITION_MODE, servotable.EXTENDED_MODE)


class EmulatedServo(ServoShaft):
    """One servo: control table and shaft. Counts increase with the palm's direction as configured."""

    registers = CommonRegisters(dxl.ID, dxl.BAUD, dxl.TORQUE, dxl.HARDWARE_ERROR, dxl.SHUTDOWN)
    hardware_errors = {  # noqa: RUF012
        "overload": HardwareError.OVERLOAD, "overheat": HardwareError.HOT, "undervoltage": HardwareError.VOLTAGE,
    }  # fmt: skip

    def __init__(
        self, config: ServoConfig, direction: float, baud_code: int, rng: np.random.Generator, t: float
    ) -> None:
        """At rest with its palm at `direction` (rad), with factory settings except id and baud rate."""
        super().__init__(config, direction, rng, t)
        self._t_instruction = t
        self._table = bytearray(servotable.TABLE_BYTES)
        self._start({dxl.ID: config.id, dxl.BAUD: baud_code})

    def _start(self, kept: Mapping[Register, int]) -> None:
        """Set all registers to factory values, except those given."""
        for entry in servotable.ENTRIES:
            self._set(entry.register, kept.get(entry.register, entry.factory))

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

    def restart(self, t: float, silent_s: float = REBOOT_S) -> None:
        stored = (entry.register for entry in servotable.ENTRIES if entry.register.address < dxl.EEPROM_END)
        self._start({register: self.get(register) for register in stored})
        self._stop(t)
        self._t_ready = t + silent_s

    def is_listening(self, baud_code: int, t: float) -> bool:
        return super().is_listening(baud_code, t) and self.get(servotable.PROTOCOL) == 2

    def answers(self, instruction: int) -> bool:
        """Whether its status return level requires an answer to the instruction."""
        return self.get(dxl.STATUS_LEVEL) >= _ANSWERED_FROM_LEVEL.get(instruction, 2)

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
        self._set(dxl.POSITION, round(x + self.get(dxl.HOMING_OFFSET)))
        self._set(dxl.VELOCITY, round(v / COUNTS_PER_TURN * 60.0 / dxl.VELOCITY_UNIT_RPM))
        self._set(dxl.TICK, int(t * 1e3) % 32768)
        self._set(dxl.MOVING, int(abs(v) > 1.0))
        return bytes(self._table[address : address + size])

    def write(self, address: int, data: bytes, t: float) -> int:
        """Write registers; returns the error code of the answer, 0 if done. Nothing is written on an error."""
        error = servotable.refusal(address, data, self.get)
        if error is not None:
            self.refusals += 1
            return error
        was_enabled = self.torque
        self._table[address : address + len(data)] = data
        has_new_goal = address <= dxl.GOAL.address < address + len(data)
        if self.torque and (has_new_goal or not was_enabled):
            self._aim(t)  # at the last goal, wherever that is
        elif was_enabled and not self.torque:
            self._stop(t)
        return 0

    def _aim(self, t: float) -> None:
        if self.get(dxl.OPERATING_MODE) not in _POSITION_MODES:
            return
        distance = self.get(dxl.GOAL) - self.get(dxl.HOMING_OFFSET) - self._shaft.goal(t)
        by_time = self.get(dxl.DRIVE_MODE) & 4
        duration = self.get(dxl.PROFILE_VELOCITY) * 1e-3 if by_time else 0.0
        duration = duration or max(abs(distance) * RADIANS_PER_COUNT / STEP_RAD_S, 1e-3)
        self._shaft.follow(t, distance / duration)
        self._t_arrival = t + duration


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
                self._sync_write(addressed, data, t)
                return []
            case Instruction.SYNC_READ if len(data) >= 4:
                return self._sync_read(addressed, data, t)
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
            case Instruction.REBOOT:
                servo.restart(t)
            case Instruction.READ | Instruction.WRITE:
                error = TableRefusal.LENGTH
            case _:
                error = TableRefusal.INSTRUCTION
        if packet.servo == BROADCAST and packet.instruction != Instruction.PING:
            return None
        return dxl.encode_status(number, error | servo.error, out)

    def _sync_write(self, addressed: Sequence[EmulatedServo], data: bytes, t: float) -> None:
        """Write the same registers of several servos; never answered."""
        address, size = _address_and_size(data)
        parts = {data[i]: data[i + 1 : i + 1 + size] for i in range(4, len(data) - size, size + 1)}
        is_goal = address == dxl.GOAL.address
        self._goals += is_goal and bool(parts)
        for servo in addressed:
            if servo.id in parts:
                is_refused = servo.write(address, parts[servo.id], t) != 0
                self._outside += is_goal and is_refused and not servo.tripped

    def _sync_read(self, addressed: Sequence[EmulatedServo], data: bytes, t: float) -> list[Transmission]:
        """A servo answers after the one before it; if one does not answer, none of the following does."""
        address, size = _address_and_size(data)
        answering = {servo.id: servo for servo in addressed if servo.answers(Instruction.SYNC_READ)}
        is_inside = address + size <= servotable.TABLE_BYTES
        t_free, transmissions = t, []
        for number in data[4:]:
            servo = answering.get(number)
            if servo is None:
                break
            t_free += servo.delay_s
            error = servo.error if is_inside else servo.error | TableRefusal.ACCESS
            out = servo.read(address, size, t) if is_inside else b""
            transmissions.append(Transmission(dxl.encode_status(number, error, out), t_free))
        return transmissions


def _address_and_size(data: bytes) -> tuple[int, int]:
    """Decode an address and a size."""
    return int.from_bytes(data[:2], "little"), int.from_bytes(data[2:4], "little")


EMULATOR: ServoArmFactory = DynamixelArm
