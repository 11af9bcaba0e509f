"""Codec of the bus protocol of Feetech's STS servos, both directions, and the registers of the STS3215.

    FF FF | id | length | instruction | parameters | checksum         request
    FF FF | id | length | hardware errors | parameters | checksum     answer

`length` counts the bytes behind it; the checksum is the complement of the sum of all bytes from the id on. Numbers are
little-endian; signed ones are sign and magnitude. Requests and answers have the same format: a reader must know which
it reads, and an adapter that echoes requests cannot be used. Answers report no refusals: whether a servo has accepted a
value is checked by reading it. There is no watchdog.
Everything here is pure and safe inside the 100 Hz loop. Sources: docs/reference/devices.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from functools import partial

from palmd.devices.framing import Frame, FrameScanner, Head
from palmd.devices.servobus import BROADCAST, Packet, PacketReader, Register, ServoMake, Settings, UnsupportedModel

HEADER = b"\xff\xff"
ID_MAX = 253
MAX_LENGTH = 0x80
"""Upper limit of `length`: above any packet of a few servos, far below what garbage can contain."""

_HEAD_BYTES = 4  # up to and including the length
_FILLER = HEADER[0]


class FeetechError(IntEnum):
    """Bits of the status register and of the error in every answer."""

    VOLTAGE = 0x01
    ENCODER = 0x02
    HOT = 0x04
    CURRENT = 0x08
    OVERLOAD = 0x20


FIRMWARE = Register(0, 1)
MODEL = Register(3, 2)
ID = Register(5, 1)
BAUD = Register(6, 1)  # 0: 1 Mbit/s, 4: 115200
RETURN_DELAY = Register(7, 1)  # 2 µs
STATUS_LEVEL = Register(8, 1)  # 1: every instruction is answered, 0: PING and reads only
MIN_POSITION = Register(9, 2)
MAX_POSITION = Register(11, 2)
UNLOADING = Register(19, 1)  # hardware errors that turn the torque off
HOMING_OFFSET = Register(31, 2, sign_bit=11)
OPERATING_MODE = Register(33, 1)  # 0 position
TORQUE = Register(40, 1)
ACCELERATION = Register(41, 1)  # 100 counts/s², 0: no limit
GOAL = Register(42, 2, sign_bit=15)
GOAL_SPEED = Register(46, 2, sign_bit=15)  # counts/s, 0: no limit
LOCK = Register(55, 1)  # 0: settings are written to the EEPROM
POSITION = Register(56, 2, sign_bit=15)
SPEED = Register(58, 2, sign_bit=15)
LOAD = Register(60, 2, sign_bit=10)
VOLTAGE = Register(62, 1)  # 0.1 V
TEMPERATURE = Register(63, 1)  # °C
STATUS = Register(65, 1)
MOVING = Register(66, 1)
CURRENT = Register(69, 2)  # 6.5 mA

TABLE_BYTES = 71
EEPROM_END = 40
MAX_SPEED = (1 << 15) - 1
_UNLOADING = FeetechError.HOT | FeetechError.CURRENT | FeetechError.OVERLOAD


def checksum(body: bytes) -> int:
    """Checksum of the bytes from the id to the last parameter."""
    return ~sum(body) & 0xFF


def encode(servo: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Encode a request; with the error bits as `instruction`, an answer. Raises ValueError for a wrong id or length."""
    if not (0 <= servo <= ID_MAX or servo == BROADCAST):
        raise ValueError(f"a servo's id is 0 to {ID_MAX}, not {servo}")
    if len(parameters) + 2 > MAX_LENGTH:
        raise ValueError(f"a packet's length is at most {MAX_LENGTH}, not {len(parameters) + 2}")
    body = bytes((servo, len(parameters) + 2, instruction)) + parameters
    return HEADER + body + bytes((checksum(body),))


def encode_status(servo: int, error: int, parameters: bytes = b"") -> bytes:
    """Encode a servo's answer."""
    return encode(servo, error, parameters)


def _size(head: Head) -> int | None:
    """Size of the packet that begins with these bytes; see `FrameScanner`."""
    if not HEADER.startswith(head[: len(HEADER)]):
        return 0
    if len(head) < _HEAD_BYTES:
        return 0 if len(head) == _HEAD_BYTES - 1 and head[2] == _FILLER else None
    servo, length = head[2], head[3]
    sound = (servo <= ID_MAX or servo == BROADCAST) and 2 <= length <= MAX_LENGTH
    return _HEAD_BYTES + length if sound else 0


def _is_valid(raw: bytes) -> bool:
    return checksum(raw[2:-1]) == raw[-1]


def _packet(answers: bool, frame: Frame) -> Packet:
    t_first, raw = frame
    instruction, error = (0, raw[4]) if answers else (raw[4], 0)
    return Packet(t_first, raw[2], instruction, error, raw[5:-1], is_status=answers)


def packet_reader(baud: int, *, answers: bool = True) -> PacketReader:
    """Create a reader of answers, or of requests. Raises ValueError if `baud` (bit/s) is not positive."""
    scanner = FrameScanner(baud, _size, _is_valid, first_byte=_FILLER)
    return PacketReader(scanner, partial(_packet, answers))


class FeetechMake(ServoMake):
    """The STS3215, with a speed for each goal and without watchdog."""

    name = "Feetech"
    model, firmware, torque, status_level, return_delay = MODEL, FIRMWARE, TORQUE, STATUS_LEVEL, RETURN_DELAY
    hardware_error, goal, position, voltage, temperature = STATUS, GOAL, POSITION, VOLTAGE, TEMPERATURE
    min_position, max_position = MIN_POSITION, MAX_POSITION
    watchdog = None
    unlock = LOCK
    settings_end = EEPROM_END
    table_bytes = TABLE_BYTES
    status_span = (TORQUE.address, STATUS.end - TORQUE.address)
    cycle_span = (TORQUE.address + 1, POSITION.end - TORQUE.address - 1)
    fixed_settings = (RETURN_DELAY, 0), (OPERATING_MODE, 0), (HOMING_OFFSET, 0), (UNLOADING, _UNLOADING)
    all_answered, ping_bytes = 1, 0
    alert = FeetechError.VOLTAGE | FeetechError.ENCODER | _UNLOADING
    refusals = 0
    supply_v = (6.0, 14.0)
    error_bits: Mapping[int, tuple[str, str]] = {
        FeetechError.VOLTAGE: ("voltage", "its supply is out of range"),
        FeetechError.ENCODER: ("encoder", "its encoder fails"),
        FeetechError.HOT: ("hot", "it is too hot"),
        FeetechError.CURRENT: ("overload", "its current is too high"),
        FeetechError.OVERLOAD: ("overload", "it was overloaded"),
    }
    models: Mapping[int, str] = {777: "STS3215", 2825: "STS3250"}
    unsupported: Mapping[int, UnsupportedModel] = {}
    reader, encode, status = staticmethod(packet_reader), staticmethod(encode), staticmethod(encode_status)

    def numbers(self, *values: int) -> bytes:
        """One byte each."""
        return bytes(values)

    def restart(self, servo: int) -> bytes:
        """Turn the torque off, which ends the protection mode."""
        return self.write(servo, TORQUE, 0)

    def profile(self, span_ms: int) -> Settings:  # noqa: ARG002
        """No acceleration limit; each goal is sent with its speed."""
        return ((ACCELERATION, 0),)

    def goals(self, counts: Mapping[int, int], distances: Mapping[int, float], span_ms: int) -> bytes:
        """Send each goal with the speed (counts/s) that reaches it within `span_ms`; at least 1 (0: no limit)."""
        data = {}
        for servo, goal in counts.items():
            speed = min(max(round(abs(distances[servo]) / (span_ms * 1e-3)), 1), MAX_SPEED)
            data[servo] = GOAL.encode(goal) + bytes(2) + GOAL_SPEED.encode(speed)
        return self.sync_write_bytes(GOAL.address, GOAL_SPEED.end - GOAL.address, data)


MAKE = FeetechMake()
