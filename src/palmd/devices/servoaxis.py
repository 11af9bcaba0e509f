"""One servo of a bus: how its counts are its palm's direction, and what must be so before its torque goes on."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.config.arms import ServoConfig
from palmd.devices import dynamixel as dxl
from palmd.devices.dynamixel import HardwareError, Register

RADIANS_PER_COUNT = math.tau / dxl.COUNTS_PER_TURN
CENTRE = dxl.COUNTS_PER_TURN // 2
ALL_ANSWERED = 2
"""Status return level at which every instruction is answered; 1: PING and reads only, 0: PING only."""

_SHUTDOWN = HardwareError.HOT | HardwareError.SHOCK | HardwareError.OVERLOAD


@dataclass(frozen=True, slots=True)
class Axis:
    """One servo: which, and how its counts are its palm's direction (rad, from the world X axis)."""

    number: int
    id: int
    sign: int
    centre_rad: float
    low: int
    high: int

    @classmethod
    def from_config(cls, number: int, config: ServoConfig) -> Axis:
        """The configured servo of the palm of that number."""
        plain = cls(number, config.id, config.sign, math.radians(config.centre_deg), 0, dxl.COUNTS_PER_TURN - 1)
        ends = sorted(plain.counts(math.radians(end)) for end in config.range_deg)
        low, high = max(ends[0], 0), min(ends[1], dxl.COUNTS_PER_TURN - 1)
        return cls(number, config.id, config.sign, plain.centre_rad, low, high)

    def counts(self, direction_rad: float) -> int:
        """Of a palm's direction, rounded."""
        return CENTRE + self.sign * round((direction_rad - self.centre_rad) / RADIANS_PER_COUNT)

    def direction(self, counts: int) -> float:
        """Of the palm (rad)."""
        return self.centre_rad + self.sign * (counts - CENTRE) * RADIANS_PER_COUNT

    def settings(self) -> tuple[tuple[Register, int], ...]:
        """What must be so before the torque goes on, in the order in which it can be set."""
        return (
            (dxl.RETURN_DELAY, 0),
            (dxl.OPERATING_MODE, 3),
            (dxl.DRIVE_MODE, 4),
            (dxl.HOMING_OFFSET, 0),
            (dxl.SHUTDOWN, _SHUTDOWN),
            (dxl.MIN_POSITION, self.low),
            (dxl.MAX_POSITION, self.high),
            (dxl.STATUS_LEVEL, ALL_ANSWERED),
        )
