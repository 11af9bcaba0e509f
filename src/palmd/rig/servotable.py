"""The control table of an emulated servo: which registers there are, what may be written to each, and when not. Pure.

That of an XL430-W250 without its indirect addresses. Source: ROBOTIS e-Manual, XL430-W250 and DYNAMIXEL Protocol 2.0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

from palmd.devices import dynamixel as dxl
from palmd.devices.dynamixel import Register

TABLE_BYTES = 148
POSITION_MODE, EXTENDED_MODE = 3, 4
FARTHEST = 1_048_575
"""Goals in extended position mode: 256 turns either way."""


class Refusal(IntEnum):
    """The error in the answer to an instruction that is not carried out."""

    FAILED = 1
    INSTRUCTION = 2
    RANGE = 4
    LENGTH = 5
    LIMIT = 6
    ACCESS = 7


class Entry(NamedTuple):
    """A register: its value as it leaves the factory, and what it takes; nothing where it is read only."""

    register: Register
    factory: int = 0
    takes: Sequence[int] = ()


def _to(most: int, least: int = 0) -> range:
    return range(least, most + 1)


SECONDARY_ID, PROTOCOL = Register(12, 1), Register(13, 1)
PWM_LIMIT, VELOCITY_LIMIT = Register(36, 2), Register(44, 4)
REGISTERED = Register(69, 1)
GOAL_PWM, GOAL_VELOCITY = Register(100, 2, True), Register(104, 4, True)

ENTRIES: tuple[Entry, ...] = (
    Entry(dxl.MODEL, 1060), Entry(Register(2, 4)), Entry(dxl.FIRMWARE, 46),
    Entry(dxl.ID, 1, _to(252)), Entry(dxl.BAUD, 1, _to(7)), Entry(dxl.RETURN_DELAY, 250, _to(254)),
    Entry(dxl.DRIVE_MODE, 0, (0, 1, 4, 5, 8, 9, 12, 13)), Entry(dxl.OPERATING_MODE, POSITION_MODE, (1, 3, 4, 16)),
    Entry(SECONDARY_ID, 255, _to(255)), Entry(PROTOCOL, 2, _to(2, 1)),
    Entry(dxl.HOMING_OFFSET, 0, _to(1_044_479, -1_044_479)), Entry(Register(24, 4), 10, _to(1023)),
    Entry(dxl.TEMPERATURE_LIMIT, 72, _to(100)), Entry(Register(32, 2), 140, _to(140, 60)),
    Entry(Register(34, 2), 60, _to(140, 60)), Entry(PWM_LIMIT, 885, _to(885)), Entry(VELOCITY_LIMIT, 265, _to(1023)),
    Entry(dxl.MAX_POSITION, 4095, _to(4095)), Entry(dxl.MIN_POSITION, 0, _to(4095)), Entry(Register(60, 1), 0, _to(3)),
    Entry(dxl.SHUTDOWN, 52, _to(0x3D)), Entry(dxl.TORQUE, 0, _to(1)), Entry(Register(65, 1), 0, _to(1)),
    Entry(dxl.STATUS_LEVEL, 2, _to(2)), Entry(REGISTERED), Entry(dxl.HARDWARE_ERROR),
    Entry(Register(76, 2), 1000, _to(16383)), Entry(Register(78, 2), 100, _to(16383)),
    Entry(Register(80, 2), 4000, _to(16383)), Entry(Register(82, 2), 0, _to(16383)),
    Entry(Register(84, 2), 640, _to(16383)), Entry(Register(88, 2), 0, _to(16383)),
    Entry(Register(90, 2), 0, _to(16383)), Entry(dxl.WATCHDOG, 0, _to(127)), Entry(GOAL_PWM, 0, _to(32767, -32768)),
    Entry(GOAL_VELOCITY, 0, _to(2**31 - 1, -(2**31))), Entry(dxl.PROFILE_ACCELERATION, 0, _to(32767)),
    Entry(dxl.PROFILE_VELOCITY, 0, _to(32767)), Entry(dxl.GOAL, 0, _to(2**31 - 1, -(2**31))),
    Entry(dxl.TICK), Entry(dxl.MOVING), Entry(Register(123, 1)), Entry(Register(124, 2)), Entry(Register(126, 2)),
    Entry(dxl.VELOCITY), Entry(dxl.POSITION), Entry(Register(136, 4)), Entry(Register(140, 4)),
    Entry(dxl.VOLTAGE, 120), Entry(dxl.TEMPERATURE, 35), Entry(Register(147, 1), 1),
)  # fmt: skip
_BY_ADDRESS = {entry.register.address: entry for entry in ENTRIES}
_GOALS = (GOAL_PWM, GOAL_VELOCITY, dxl.GOAL)


def values_in(address: int, data: bytes) -> Iterator[tuple[Entry, int]] | Refusal:
    """The registers that `data` covers from an address on, each with its value; or why that cannot be written."""
    found, at, end = [], address, address + len(data)
    while at < end:
        entry = _BY_ADDRESS.get(at)
        if entry is None or not entry.takes:
            return Refusal.ACCESS
        if entry.register.end > end:
            return Refusal.LENGTH
        raw = data[at - address : entry.register.end - address]
        found.append((entry, int.from_bytes(raw, "little", signed=entry.register.signed)))
        at = entry.register.end
    return iter(found)


def refusal(address: int, data: bytes, get: Callable[[Register], int]) -> Refusal | None:
    """Why a servo whose registers `get` gives does not take this, None when it does."""
    values = values_in(address, data)
    if isinstance(values, Refusal):
        return values
    for entry, value in values:
        register = entry.register
        if register.address < dxl.EEPROM_END and get(dxl.TORQUE):
            return Refusal.ACCESS
        if value not in entry.takes or (register in _GOALS and get(dxl.WATCHDOG) < 0):
            return Refusal.RANGE
        if not _within_limit(register, value, get):
            return Refusal.LIMIT
        if register == dxl.TORQUE and value and get(dxl.HARDWARE_ERROR) & get(dxl.SHUTDOWN):
            return Refusal.FAILED
    return None


def _within_limit(register: Register, value: int, get: Callable[[Register], int]) -> bool:
    if register == dxl.GOAL:
        if get(dxl.OPERATING_MODE) == POSITION_MODE:
            return get(dxl.MIN_POSITION) <= value <= get(dxl.MAX_POSITION)
        return -FARTHEST <= value <= FARTHEST
    if register == GOAL_VELOCITY:
        return abs(value) <= get(VELOCITY_LIMIT)
    return register != GOAL_PWM or abs(value) <= get(PWM_LIMIT)
