"""One servo of a bus: conversion of its counts to its palm's direction, and its settings."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.config.arms import ServoConfig
from palmd.devices.servobus import COUNTS_PER_TURN, ServoMake, Settings

RADIANS_PER_COUNT = math.tau / COUNTS_PER_TURN
CENTRE = COUNTS_PER_TURN // 2


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
