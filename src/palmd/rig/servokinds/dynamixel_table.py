"""The control table of an emulated servo: its registers, their permitted values, and when they may be written. Pure.

That of an XL430-W250 without indirect addresses. Source: ROBOTIS e-Manual, XL430-W250 and DYNAMIXEL Protocol 2.0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import NamedTuple

from palmd.devices import dynamixel as dxl
from palmd.devices.servobus import Register

TABLE_BYTES = 148
POSITION_MODE, EXTENDED_MODE = 3, 4
EXTENDED_LIMIT = 1_048_575
"""Limit of goals in extended position mode: 256 turns either way."""


class TableRefusal(IntEnum):
    """The error code in the answer to an instruction that is not executed."""

    FAILED = 1
    INSTRUCTION = 2
    RANGE = 4
    LENGTH = 5
    LIMIT = 6
    ACCESS = 7


class TableEntry(NamedTuple):
    """A register, its factory value and its permitted values; none if it is read only."""

    register: Register
    factory: int = 0
    allowed: Sequence[int] = ()


def _to(most: int, least: int = 0) -> range:
    return range(least, most + 1)


SECONDARY_ID, PROTOCOL = Register(12, 1), Register(13, 1)
PWM_LIMIT, VELOCITY_LIMIT = Register(36, 2), Register(44, 4)
GOAL_PWM, GOAL_VELOCITY = Register(100, 2, True), Register(104, 4, True)

ENTRIES: tuple[TableEntry, ...] = (
    TableEntry(dxl.MODEL, 1060),
    TableEntry(Register(2, 4)),
    TableEntry(dxl.FIRMWARE, 46),
    TableEntry(dxl.ID, 1, _to(252)),
    TableEntry(dxl.BAUD, 1, _to(7)),
    TableEntry(dxl.RETURN_DELAY, 250, _to(254)),
    TableEntry(dxl.DRIVE_MODE, 0, (0, 1, 4, 5, 8, 9, 12, 13)),
    TableEntry(dxl.OPERATING_MODE, POSITION_MODE, (1, 3, 4, 16)),
    TableEntry(SECONDARY_ID, 255, _to(255)),
    TableEntry(PROTOCOL, 2, _to(2, 1)),
    TableEntry(dxl.HOMING_OFFSET, 0, _to(1_044_479, -1_044_479)),
    TableEntry(Register(24, 4), 10, _to(1023)),
    TableEntry(dxl.TEMPERATURE_LIMIT, 72, _to(100)),
    TableEntry(Register(32, 2), 140, _to(140, 60)),
    TableEntry(Register(34, 2), 60, _to(140, 60)),
    TableEntry(PWM_LIMIT, 885, _to(885)),
    TableEntry(VELOCITY_LIMIT, 265, _to(1023)),
    TableEntry(dxl.MAX_POSITION, 4095, _to(4095)),
    TableEntry(dxl.MIN_POSITION, 0, _to(4095)),
    TableEntry(Register(60, 1), 0, _to(3)),
    TableEntry(dxl.SHUTDOWN, 52, _to(0x3D)),
    TableEntry(dxl.TORQUE, 0, _to(1)),
    TableEntry(Register(65, 1), 0, _to(1)),
    TableEntry(dxl.STATUS_LEVEL, 2, _to(2)),
    TableEntry(Register(69, 1)),
    TableEntry(dxl.HARDWARE_ERROR),
    TableEntry(Register(76, 2), 1000, _to(16383)),
    TableEntry(Register(78, 2), 100, _to(16383)),
    TableEntry(Register(80, 2), 4000, _to(16383)),
    TableEntry(Register(82, 2), 0, _to(16383)),
    TableEntry(Register(84, 2), 640, _to(16383)),
    TableEntry(Register(88, 2), 0, _to(16383)),
    TableEntry(Register(90, 2), 0, _to(16383)),
    TableEntry(dxl.WATCHDOG, 0, _to(127)),
    TableEntry(GOAL_PWM, 0, _to(32767, -32768)),
    TableEntry(GOAL_VELOCITY, 0, _to(2**31 - 1, -(2**31))),
    TableEntry(dxl.PROFILE_ACCELERATION, 0, _to(32767)),
    TableEntry(dxl.PROFILE_VELOCITY, 0, _to(32767)),
    TableEntry(dxl.GOAL, 0, _to(2**31 - 1, -(2**31))),
    TableEntry(dxl.TICK),
    TableEntry(dxl.MOVING),
    TableEntry(Register(123, 1)),
    TableEntry(Register(124, 2)),
    TableEntry(Register(126, 2)),
    TableEntry(dxl.VELOCITY),
    TableEntry(dxl.POSITION),
    TableEntry(Register(136, 4)),
    TableEntry(Register(140, 4)),
    TableEntry(dxl.VOLTAGE, 120),
    TableEntry(dxl.TEMPERATURE, 35),
    TableEntry(Register(147, 1), 1),
)
_BY_ADDRESS = {entry.register.address: entry for entry in ENTRIES}
_GOALS = (GOAL_PWM, GOAL_VELOCITY, dxl.GOAL)


def refusal(address: int, data: bytes, get: Callable[[Register], int]) -> TableRefusal | None:
    """Why a servo, whose registers `get` returns, refuses this write; None if it accepts."""
    entries, position, end = [], address, address + len(data)
    while position < end:
        entry = _BY_ADDRESS.get(position)
        if entry is None or not entry.allowed:
            return TableRefusal.ACCESS
        if entry.register.end > end:
            return TableRefusal.LENGTH
        entries.append(entry)
        position = entry.register.end
    for entry in entries:
        register = entry.register
        value = register.decode(data[register.address - address : register.end - address])
        if register.address < dxl.EEPROM_END and get(dxl.TORQUE):
            return TableRefusal.ACCESS
        if value not in entry.allowed or (register in _GOALS and get(dxl.WATCHDOG) < 0):
            return TableRefusal.RANGE
        if not _within_limit(register, value, get):
            return TableRefusal.LIMIT
        if register == dxl.TORQUE and value and get(dxl.HARDWARE_ERROR) & get(dxl.SHUTDOWN):
            return TableRefusal.FAILED
    return None


def _within_limit(register: Register, value: int, get: Callable[[Register], int]) -> bool:
    if register == dxl.GOAL:
        if get(dxl.OPERATING_MODE) == POSITION_MODE:
            return get(dxl.MIN_POSITION) <= value <= get(dxl.MAX_POSITION)
        return -EXTENDED_LIMIT <= value <= EXTENDED_LIMIT
    if register == GOAL_VELOCITY:
        return abs(value) <= get(VELOCITY_LIMIT)
    return register != GOAL_PWM or abs(value) <= get(PWM_LIMIT)
