"""Codec of DYNAMIXEL Protocol 2.0, both directions: packets, byte stuffing, checksum, and the X series' registers.

    FF FF FD 00 | id | length, 2 bytes | instruction | parameters | CRC-16, 2 bytes

Numbers are little-endian. `length` counts the bytes behind it. If FF FF FD occurs between length and CRC, an FD is
inserted behind it (stuffing), so that a header occurs only at the start of a packet. A servo's answer has the
instruction 55, and its first parameter is an error.
Everything here is pure and safe inside the 100 Hz loop. Source: ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0 and X series.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import IntEnum

from palmd.devices.framing import Frame, FrameScanner, Head, crc_table
from palmd.devices.servobus import (
    BROADCAST,
    Instruction,
    Packet,
    PacketReader,
    Register,
    ServoMake,
    Settings,
    UnsupportedModel,
)

HEADER = b"\xff\xff\xfd\x00"
ID_MAX = 252
MAX_LENGTH = 512
"""Upper limit of `length`: far above any packet on the bus, far below what garbage can contain."""

_HEAD_BYTES = 7  # up to and including the length
_STUFFED, _PLAIN = b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"


MODEL = Register(0, 2)
FIRMWARE = Register(6, 1)
ID = Register(7, 1)
BAUD = Register(8, 1)
RETURN_DELAY = Register(9, 1)  # 2 µs
DRIVE_MODE = Register(10, 1)  # 1 reversed, 4 time-based profiles
OPERATING_MODE = Register(11, 1)  # 3 position
HOMING_OFFSET = Register(20, 4, True)
TEMPERATURE_LIMIT = Register(31, 1)  # °C
MAX_POSITION = Register(48, 4)
MIN_POSITION = Register(52, 4)
SHUTDOWN = Register(63, 1)
TORQUE = Register(64, 1)
STATUS_LEVEL = Register(68, 1)  # 2: every instruction is answered
HARDWARE_ERROR = Register(70, 1)
WATCHDOG = Register(98, 1, True)  # 20 ms; 0 off, -1 tripped
PROFILE_ACCELERATION = Register(108, 4)
PROFILE_VELOCITY = Register(112, 4)  # ms, if profiles are time-based
GOAL = Register(116, 4, True)
TICK = Register(120, 2)  # ms
MOVING = Register(122, 1)
VELOCITY = Register(128, 4, True)  # 0.229 /min
POSITION = Register(132, 4, True)  # counts
VOLTAGE = Register(144, 2)  # 0.1 V
TEMPERATURE = Register(146, 1)  # °C

TABLE_BYTES = 147
VELOCITY_UNIT_RPM = 0.229
EEPROM_END = 64
"""Registers below this address keep their values without power and are locked while the torque is enabled."""

ALERT = 0x80
"""Bit of an answer's error: the hardware error register is not 0."""

ERRORS: Mapping[int, str] = {
    1: "the instruction failed",
    2: "no such instruction",
    3: "the checksum was wrong",
    4: "the value is out of range",
    5: "the data are too long or too short",
    6: "the value is beyond its limit",
    7: "the register cannot be read or written now",
}
"""Texts of the other bits of an answer's error."""


class HardwareError(IntEnum):
    """Bits of the hardware error register."""

    VOLTAGE = 0x01
    HOT = 0x04
    ENCODER = 0x08
    SHOCK = 0x10
    OVERLOAD = 0x20


_CRC = crc_table(0x8005, 16)


def crc16(data: bytes) -> int:
    """CRC-16, polynomial 8005, not reflected, initial value 0."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFF00) ^ _CRC[crc >> 8 ^ byte]
    return crc


def stuffed(body: bytes) -> bytes:
    """Insert stuffing bytes into instruction and parameters."""
    return body.replace(_PLAIN, _STUFFED)


def unstuffed(body: bytes) -> bytes:
    """Remove stuffing bytes; the inverse of `stuffed`."""
    return body.replace(_STUFFED, _PLAIN)


def encode(servo: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Encode a packet to (with STATUS: from) a servo; `BROADCAST`: to all. Raises ValueError for a bad id or length."""
    if not (0 <= servo <= ID_MAX or servo == BROADCAST):
        raise ValueError(f"a servo's id is 0 to {ID_MAX}, not {servo}")
    return _framed(servo, stuffed(bytes((instruction,)) + parameters))


def _framed(servo: int, body: bytes) -> bytes:
    if len(body) + 2 > MAX_LENGTH:
        raise ValueError(f"a packet's length is at most {MAX_LENGTH}, not {len(body) + 2}")
    packet = HEADER + struct.pack("<BH", servo, len(body) + 2) + body
    return packet + struct.pack("<H", crc16(packet))


def encode_status(servo: int, error: int, parameters: bytes = b"") -> bytes:
    """Encode a servo's answer."""
    return encode(servo, Instruction.STATUS, bytes((error,)) + parameters)


def _size(head: Head) -> int | None:
    """Size of the packet that begins with these bytes; see `FrameScanner`."""
    if not HEADER.startswith(head[: len(HEADER)]):
        return 0
    if len(head) < _HEAD_BYTES:
        return None
    length = int.from_bytes(head[5:_HEAD_BYTES], "little")
    return _HEAD_BYTES + length if 3 <= length <= MAX_LENGTH else 0


def _is_valid(raw: bytes) -> bool:
    return crc16(raw[:-2]) == int.from_bytes(raw[-2:], "little")


def _packet(frame: Frame) -> Packet:
    t_first, raw = frame
    servo, instruction, body = raw[4], raw[7], unstuffed(raw[7:-2])
    answers = instruction == Instruction.STATUS
    has_error = answers and len(body) > 1
    return Packet(
        t_first, servo, instruction, body[1] if has_error else 0, body[2:] if has_error else body[1:], answers
    )


def packet_reader(baud: int) -> PacketReader:
    """Create a reader; raises ValueError if `baud` (bit/s, used for timestamps) is not positive."""
    return PacketReader(FrameScanner(baud, _size, _is_valid, first_byte=HEADER[0]), _packet)


_SHUTDOWN = HardwareError.HOT | HardwareError.SHOCK | HardwareError.OVERLOAD
_UNSUPPORTED_FIX = "use a servo of the 430 size"
_UNSUPPORTED_REASON = "whose watchdog trips without stopping it"


class DynamixelMake(ServoMake):
    """The X series, with time-based profiles and a watchdog."""

    name = "DYNAMIXEL"
    model, firmware, torque, status_level, return_delay = MODEL, FIRMWARE, TORQUE, STATUS_LEVEL, RETURN_DELAY
    hardware_error, goal, position, voltage, temperature = HARDWARE_ERROR, GOAL, POSITION, VOLTAGE, TEMPERATURE
    min_position, max_position = MIN_POSITION, MAX_POSITION
    watchdog = WATCHDOG
    unlock = None
    settings_end = EEPROM_END
    table_bytes = TABLE_BYTES
    status_span = (TORQUE.address, TEMPERATURE.end - TORQUE.address)
    cycle_span = (WATCHDOG.address, POSITION.end - WATCHDOG.address)
    fixed_settings = (RETURN_DELAY, 0), (OPERATING_MODE, 3), (DRIVE_MODE, 4), (HOMING_OFFSET, 0), (SHUTDOWN, _SHUTDOWN)
    all_answered, ping_bytes = 2, 3
    alert, refusals = ALERT, 0x7F
    supply_v = (9.0, 14.0)
    error_bits: Mapping[int, tuple[str, str]] = {
        HardwareError.VOLTAGE: ("voltage", "its supply is out of range"),
        HardwareError.HOT: ("hot", "it is too hot"),
        HardwareError.ENCODER: ("encoder", "its encoder fails"),
        HardwareError.SHOCK: ("shock", "its circuit has had a shock"),
        HardwareError.OVERLOAD: ("overload", "it was overloaded"),
    }
    models: Mapping[int, str] = {
        1020: "XM430-W350",
        1030: "XM430-W210",
        1060: "XL430-W250",
        1070: "XC430-W150",
        1080: "XC430-W240",
    }
    """Models that are known to stop when their watchdog trips, and that have the registers used here."""
    unsupported: Mapping[int, UnsupportedModel] = {
        1190: UnsupportedModel("XL330-M077", _UNSUPPORTED_REASON, _UNSUPPORTED_FIX),
        1200: UnsupportedModel("XL330-M288", _UNSUPPORTED_REASON, _UNSUPPORTED_FIX),
        1220: UnsupportedModel("XC330-T181", _UNSUPPORTED_REASON, _UNSUPPORTED_FIX),
        1230: UnsupportedModel("XC330-T288", _UNSUPPORTED_REASON, _UNSUPPORTED_FIX),
    }
    reader, encode, status = staticmethod(packet_reader), staticmethod(encode), staticmethod(encode_status)

    def numbers(self, *values: int) -> bytes:
        """Two bytes each."""
        return struct.pack(f"<{len(values)}H", *values)

    def restart(self, servo: int) -> bytes:
        """Reboot the servo, which also clears all values outside the EEPROM."""
        return encode(servo, Instruction.REBOOT)

    def profile(self, span_ms: int) -> Settings:
        """Time-based, without acceleration phase."""
        return (PROFILE_ACCELERATION, 0), (PROFILE_VELOCITY, span_ms)

    def goals(self, counts: Mapping[int, int], distances: Mapping[int, float], span_ms: int) -> bytes:  # noqa: ARG002
        """Send the goals; the profile sets the speed."""
        return self.sync_write(GOAL, counts)


MAKE = DynamixelMake()
