"""Moves of three palms for a body of which nothing is known yet: brisk ones about where most bodies lie well. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.motion.limits import MotionLimits
from palmd.motion.plan import approach
from palmd.motion.segments import PEAK_RATE, Angles, Move

MIDDLE_DEG = (51.5, 46.0, 46.0)  # where symmetrical palms bear about equally
SWING_RAD, SWING_RATE, SHORTEST_S = math.radians(10.0), math.radians(25.0), 0.6
FARTHEST_RAD = math.radians(20.0)  # from the middle, beyond which they go back there slowly


@dataclass(frozen=True, slots=True)
class Swing:
    """Within limits."""

    limits: MotionLimits

    @property
    def middle(self) -> Angles:
        """About which it goes (rad)."""
        each = zip(map(math.radians, MIDDLE_DEG), self.limits.angles, strict=True)
        return tuple(min(max(at, low + SWING_RAD), high - SWING_RAD) for at, (low, high) in each)

    def next(self, here: Angles, random: np.random.Generator) -> Move:
        """From `here` (rad), at rest: each joint to the other side of the middle as a rule, by chance how far."""
        middle = np.array(self.middle)
        off = np.array(here) - middle
        if np.abs(off).max() > FARTHEST_RAD:
            return approach(here, self.middle, self.limits, SHORTEST_S)
        sides = np.where(random.random(3) < 0.7, -1.0, 1.0) * np.where(off < 0.0, -1.0, 1.0)
        end = middle + sides * random.uniform(0.3, 1.0, 3) * SWING_RAD
        way = float(np.abs(end - here).max())
        return Move(here, tuple(end.tolist()), max(PEAK_RATE * way / SWING_RATE, SHORTEST_S))
