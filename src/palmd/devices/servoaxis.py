"""One servo of a bus: how its counts are its palm's direction, and what must be so before its torque goes on."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.config.arms import ServoConfig
from palmd.devices.servobus import COUNTS_PER_TURN, ServoMake, Settings

RADIANS_PER_COUNT = math.tau / COUNTS_PER_TURN
CENTRE = COUNTS_PER_TURN // 2


@dataclass(frozen=True, slots=True)
class Axis:
    """One servo: which, of what make, and how its counts are its palm's direction (rad, from the world X axis)."""

    number: int
    id: int
    sign: int
    centre_rad: float
    low: int
    high: int
    make: ServoMake

    @classmethod
    def from_config(cls, number: int, config: ServoConfig, make: ServoMake) -> Axis:
        """The configured servo of the palm of that number."""
        plain = cls(number, config.id, config.sign, math.radians(config.centre_deg), 0, COUNTS_PER_TURN - 1, make)
        ends = sorted(plain.counts(math.radians(end)) for end in config.range_deg)
        low, high = max(ends[0], 0), min(ends[1], COUNTS_PER_TURN - 1)
        return cls(number, config.id, config.sign, plain.centre_rad, low, high, make)

    def counts(self, direction_rad: float) -> int:
        """Of a palm's direction, rounded."""
        return CENTRE + self.sign * round((direction_rad - self.centre_rad) / RADIANS_PER_COUNT)

    def direction(self, counts: int) -> float:
        """Of the palm (rad)."""
        return self.centre_rad + self.sign * (counts - CENTRE) * RADIANS_PER_COUNT

    def settings(self) -> Settings:
        """What must be so before the torque goes on, in the order in which it can be set."""
        return self.make.settings(self.low, self.high)
