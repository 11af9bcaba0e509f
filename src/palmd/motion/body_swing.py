"""Moves of three palms for an unknown body: brisk swings about a pose at which most bodies are stable. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.motion.limits import MotionLimits
from palmd.motion.plan import approach
from palmd.motion.segments import PEAK_RATE, Angles, Move

MIDDLE_DEG = (51.5, 46.0, 46.0)  # pose at which the palms bear about equally
SWING_RAD, SWING_RATE, SHORTEST_S = math.radians(10.0), math.radians(25.0), 0.6
FARTHEST_RAD = math.radians(20.0)  # distance from the middle beyond which the palms return there slowly


@dataclass(frozen=True, slots=True)
class Swing:
    """Swings within the motion limits."""

    limits: MotionLimits

    @property
    def middle(self) -> Angles:
        """Middle of the swings (rad)."""
        each = zip(map(math.radians, MIDDLE_DEG), self.limits.angles, strict=True)
        return tuple(min(max(at, low + SWING_RAD), high - SWING_RAD) for at, (low, high) in each)

    def next(self, here: Angles, random: np.random.Generator) -> Move:
        """Next move from rest at `here` (rad): joints move by random amounts, mostly to the middle's other side."""
        middle = np.array(self.middle)
        deviation = np.array(here) - middle
        if np.abs(deviation).max() > FARTHEST_RAD:
            return approach(here, self.middle, self.limits, SHORTEST_S)
        sides = np.where(random.random(3) < 0.7, -1.0, 1.0) * np.where(deviation < 0.0, -1.0, 1.0)
        end = middle + sides * random.uniform(0.3, 1.0, 3) * SWING_RAD
        distance = float(np.abs(end - here).max())
        return Move(here, tuple(end.tolist()), max(PEAK_RATE * distance / SWING_RATE, SHORTEST_S))
