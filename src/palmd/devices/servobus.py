"""Servo buses, common to all makes: packets, registers, the interface of a make, and the axis that a servo turns.

Everything here is pure and safe inside the 100 Hz loop.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from palmd.config.arms import ServoConfig
from palmd.devices.framing import Frame, FrameScanner

COUNTS_PER_TURN = 4096
CENTRE = COUNTS_PER_TURN // 2
RADIANS_PER_COUNT = math.tau / COUNTS_PER_TURN
BROADCAST = 0xFE
"""The id to which all servos listen."""


class Instruction(IntEnum):
    """Instruction of a packet that palmd sends, equal for all makes; STATUS is an answer."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class Register(NamedTuple):
    """An entry of a servo's control table: address, size in bytes, and sign format. Numbers are little-endian.

    signed: two's complement. sign_bit: the number of the sign bit of a sign-magnitude value, None if there is none.
    """

    address: int
    size: int
    signed: bool = False
    sign_bit: int | None = None

    @property
    def end(self) -> int:
        """The address behind the register."""
        return self.address + self.size

    def encode(self, value: int) -> bytes:
        """Encode a value. Raises OverflowError if it does not fit."""
        if self.sign_bit is None:
            return value.to_bytes(self.size, "little", signed=self.signed)
        if abs(value) >= 1 << self.sign_bit:
            raise OverflowError(f"register {self.address} holds less than {1 << self.sign_bit} in size, not {value}")
        return (abs(value) | (value < 0) << self.sign_bit).to_bytes(self.size, "little")

    def decode(self, raw: bytes | bytearray) -> int:
        """Decode a value from its bytes."""
        if self.sign_bit is None:
            return int.from_bytes(raw, "little", signed=self.signed)
        value = int.from_bytes(raw, "little")
        size = value & ((1 << self.sign_bit) - 1)
        return -size if value >> self.sign_bit & 1 else size


class Registers:
    """A block of one servo's control table: `registers[POSITION]` is a number."""

    def __init__(self, address: int, data: bytes) -> None:
        self._address, self._data = address, data

    def __contains__(self, register: Register) -> bool:
        return self._address <= register.address and register.end <= self._address + len(self._data)

    def __getitem__(self, register: Register) -> int:
        """Raises KeyError for a register outside the block."""
        if register not in self:
            raise KeyError(register)
        start = register.address - self._address
        return register.decode(self._data[start : start + register.size])

    def get(self, register: Register) -> int | None:
        """Return None for a register outside the block."""
        return self[register] if register in self else None  # noqa: SIM401


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet; `t_first` is when its first byte arrived (s). `parameters` do not include the error.

    is_status: it is a servo's answer; `instruction` is then meaningless for makes that do not send it.
    """

    t_first: float
    servo: int
    instruction: int
    error: int
    parameters: bytes
    is_status: bool


class PacketReader:
    """Decodes a bus's bytes into packets; garbage is only counted."""

    def __init__(self, scanner: FrameScanner, packet: Callable[[Frame], Packet]) -> None:
        """`scanner` finds the make's frames, `packet` decodes one."""
        self._scanner, self._packet = scanner, packet
        self.counters = scanner.counters

    @property
    def pending(self) -> int:
        """Number of buffered bytes."""
        return self._scanner.pending

    def feed(self, data: bytes, t_recv: float) -> list[Packet]:
        """Process the bytes read at `t_recv` (s, monotonic) and return the packets that they complete."""
        return list(map(self._packet, self._scanner.feed(data, t_recv)))

    def flush(self) -> list[Packet]:
        """Give up the incomplete packet at the front and return the packets found behind its start."""
        return list(map(self._packet, self._scanner.flush()))

    def reset(self) -> None:
        """Discard the buffer after an interruption of the line."""
        self._scanner.reset()


class UnsupportedModel(NamedTuple):
    """A model that must not be used: its name, the reason, and what to use instead."""

    what: str
    reason: str
    fix: str


Span = tuple[int, int]
"""Address and number of bytes of a block of registers."""

Settings = Sequence[tuple[Register, int]]


class ServoMake(ABC):
    """A make of servos: its protocol, its registers and the settings it requires.

    status_span, cycle_span: registers that are read at a low rate, and in every cycle. all_answered: status return
    level at which every instruction is answered. ping_bytes: number of parameters in the answer to a ping, which begin
    with the model if there are any. alert: bits of an answer's error that report a hardware error; refusals: bits that
    report that the instruction was not executed. settings_end: registers below this address keep their values without
    power. unlock: must be 0 while those are written. fixed_settings: required values that do not depend on the rig.
    watchdog: stops the servo when instructions cease; None if the make has none. error_bits: for each bit of the
    hardware error register, the code in the fault table without the arm's name, and its text.
    """

    name: str
    model: Register
    firmware: Register
    torque: Register
    status_level: Register
    return_delay: Register
    hardware_error: Register
    goal: Register
    min_position: Register
    max_position: Register
    position: Register
    voltage: Register
    temperature: Register
    watchdog: Register | None
    unlock: Register | None
    settings_end: int
    table_bytes: int
    status_span: Span
    cycle_span: Span
    fixed_settings: Settings
    all_answered: int
    ping_bytes: int
    alert: int
    refusals: int
    supply_v: tuple[float, float]
    error_bits: Mapping[int, tuple[str, str]]
    models: Mapping[int, str]
    unsupported: Mapping[int, UnsupportedModel]

    @abstractmethod
    def reader(self, baud: int) -> PacketReader:
        """Create a reader of the servos' packets. Raises ValueError if `baud` (bit/s) is not positive."""

    @abstractmethod
    def encode(self, servo: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Encode a request. Raises ValueError for a wrong id or length."""

    @abstractmethod
    def numbers(self, *values: int) -> bytes:
        """Encode addresses and sizes in parameters."""

    @abstractmethod
    def status(self, servo: int, error: int, parameters: bytes = b"") -> bytes:
        """Encode a servo's answer."""

    def ping(self, servo: int) -> bytes:
        """Ping: asks whether the servo is present."""
        return self.encode(servo, Instruction.PING)

    def read(self, servo: int, address: int, size: int) -> bytes:
        """Read `size` bytes of one servo's table."""
        return self.encode(servo, Instruction.READ, self.numbers(address, size))

    def write(self, servo: int, register: Register, value: int) -> bytes:
        """Write one register of one servo."""
        return self.encode(servo, Instruction.WRITE, self.numbers(register.address) + register.encode(value))

    def sync_write(self, register: Register, values: Mapping[int, int]) -> bytes:
        """Write one register of several servos, by id; never answered, so refusals are not reported."""
        data = {servo: register.encode(value) for servo, value in values.items()}
        return self.sync_write_bytes(register.address, register.size, data)

    def sync_write_bytes(self, address: int, size: int, data: Mapping[int, bytes]) -> bytes:
        """Write a block of registers of several servos, `size` bytes each; never answered."""
        parts = b"".join(bytes((servo,)) + each for servo, each in data.items())
        return self.encode(BROADCAST, Instruction.SYNC_WRITE, self.numbers(address, size) + parts)

    def sync_read(self, address: int, size: int, servos: Iterable[int]) -> bytes:
        """Read `size` bytes of several servos' tables; they answer in this order."""
        return self.encode(BROADCAST, Instruction.SYNC_READ, self.numbers(address, size) + bytes(servos))

    @abstractmethod
    def restart(self, servo: int) -> bytes:
        """Clear the servo's hardware errors; answered without parameters."""

    def settings(self, low: int, high: int) -> Settings:
        """Settings required before the torque is enabled, in writing order; `low` and `high` are limits in counts."""
        limits = (self.min_position, low), (self.max_position, high)
        return (*self.fixed_settings, *limits, (self.status_level, self.all_answered))

    @abstractmethod
    def profile(self, span_ms: int) -> Settings:
        """Settings for constant speed to a goal within `span_ms`; they must stay unchanged while it follows."""

    @abstractmethod
    def goals(self, counts: Mapping[int, int], distances: Mapping[int, float], span_ms: int) -> bytes:
        """Send goals by id, to be reached at constant speed within `span_ms`; `distances` (counts): remaining paths."""


@dataclass(frozen=True, slots=True)
class Axis:
    """One servo: number, id, make, and conversion of its counts to its palm's direction (rad from the world X axis)."""

    number: int
    id: int
    sign: int
    centre_rad: float
    low: int
    high: int
    make: ServoMake

    @classmethod
    def from_config(cls, number: int, config: ServoConfig, make: ServoMake) -> Axis:
        """Create the axis of palm `number` from its configuration."""
        plain = cls(number, config.id, config.sign, math.radians(config.centre_deg), 0, COUNTS_PER_TURN - 1, make)
        ends = sorted(plain.counts(math.radians(end)) for end in config.range_deg)
        low, high = max(ends[0], 0), min(ends[1], COUNTS_PER_TURN - 1)
        return cls(number, config.id, config.sign, plain.centre_rad, low, high, make)

    def counts(self, direction_rad: float) -> int:
        """Convert a palm's direction (rad) to counts, rounded."""
        return CENTRE + self.sign * round((direction_rad - self.centre_rad) / RADIANS_PER_COUNT)

    def direction(self, counts: int) -> float:
        """Convert counts to the palm's direction (rad)."""
        return self.centre_rad + self.sign * (counts - CENTRE) * RADIANS_PER_COUNT

    def settings(self) -> Settings:
        """Settings required before the torque is enabled, in the order in which they can be written."""
        return self.make.settings(self.low, self.high)
