"""Limits of independent joints: a range for each, one speed and one acceleration for all."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from palmd.events import PalmMotion
from palmd.motion.limits import MotionLimits, QuantityLimit


@dataclass(frozen=True, slots=True)
class JointLimits(MotionLimits):
    """`MotionLimits` for independent joints; `angles`: their ranges, in rad or m."""

    names: ClassVar[tuple[str, ...]]
    """Names of the joints."""
    speeds: ClassVar[str]
    """Description of a rate, with {} for the joint's name."""
    accelerations: ClassVar[str]
    """Description of an acceleration, with {} for the joint's name."""
    unit: ClassVar[str]
    """Unit of positions in texts."""
    scale: ClassVar[float]
    """Factor from SI to that unit."""

    def __post_init__(self) -> None:
        """Set the bounds of each joint, of its speed and of its acceleration."""
        unit, scale = self.unit, self.scale
        bounds = [
            QuantityLimit(joint, unit, scale, low, high)
            for joint, (low, high) in zip(self.names, self.angles, strict=True)
        ]
        for order, what, per, most in (
            (1, self.speeds, "/s", self.rate),
            (2, self.accelerations, "/s²", self.acceleration),
        ):
            bounds += [QuantityLimit(what.format(joint), unit + per, scale, -most, most, order) for joint in self.names]
        object.__setattr__(self, "bounds", tuple(bounds))

    def values(self, motion: PalmMotion) -> tuple[float, ...]:
        """Return the quantities bounded by `bounds`, in that order."""
        return (*motion.angles, *motion.rates, *motion.accelerations)

    def clamp_step(self, previous: PalmMotion, wanted: PalmMotion, dt: float) -> PalmMotion:
        """Clamp `wanted` to the ranges and to a step of rate·dt, as `MotionLimits.clamp_step`. Safe in the loop."""
        if not all(map(math.isfinite, wanted.angles)):
            return PalmMotion.at_rest(previous.angles)
        inside = tuple(min(max(each, low), high) for each, (low, high) in zip(wanted.angles, self.angles, strict=True))
        steps = [each - before for each, before in zip(inside, previous.angles, strict=True)]
        longest, room = max(map(abs, steps)), self.rate * dt
        if inside == wanted.angles and longest <= room:
            return wanted
        share = 1.0 if longest <= room else room / longest
        clamped = tuple(before + share * step for before, step in zip(previous.angles, steps, strict=True))
        rates = tuple(share * step / dt for step in steps) if dt > 0.0 else (0.0,) * len(steps)
        return PalmMotion(clamped, rates, (0.0,) * len(steps))
