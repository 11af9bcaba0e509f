"""Sample a plan's motion and compute how much of every limit it uses. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray, PalmMotion
from palmd.motion.limits import MotionLimits, QuantityLimit
from palmd.motion.plan import Trajectory

LONGEST_S = 120.0
"""Longest part of a plan that is sampled; a longer plan repeats itself by then."""

STEP_S = 0.005
_MOST_SAMPLES = 24_000


@dataclass(frozen=True, slots=True)
class LimitUsage:
    """Range of one limited quantity in a plan (SI): lowest, highest, and the share of the limit that it uses.

    A share of 1 is the limit: of the magnitude for rates and accelerations, of the distance from the middle for poses.
    """

    bound: QuantityLimit
    lowest: float
    highest: float
    share: float

    def text(self) -> str:
        """Format the usage for people."""
        scale, unit = self.bound.scale, self.bound.unit
        if self.bound.order:
            reached, most = max(-self.lowest, self.highest), self.bound.high
            return f"{self.bound.what} {reached * scale:.3g} of {most * scale:.3g}{unit}"
        low, high = (f"{each * scale:.4g}" for each in (self.lowest, self.highest))
        allowed = f"{self.bound.low * scale:.4g} to {self.bound.high * scale:.4g}{unit}"
        return f"{self.bound.what} {low} to {high} of {allowed}"


@dataclass(frozen=True, slots=True)
class Sampled:
    """A plan's motion over plan time: angles, rates, accelerations of each joint (rad, rad/s, rad/s²)."""

    t: FloatArray
    angles: FloatArray
    rates: FloatArray
    accelerations: FloatArray
    whole: bool  # True if the whole plan was sampled

    def motions(self) -> list[PalmMotion]:
        """Return the motion at each time."""
        rows = zip(self.angles, self.rates, self.accelerations, strict=True)
        return [PalmMotion(tuple(a), tuple(w), tuple(b)) for a, w, b in rows]


def sampled(trajectory: Trajectory) -> Sampled:
    """Sample the plan up to its end, its exploration or `LONGEST_S`; the first two rounds of an endless plan."""
    end, whole = trajectory.duration, True
    first = trajectory.rounds[0]
    if math.isinf(first.duration):
        end, whole = first.begins[-1], False
    elif math.isinf(end):
        end, whole = sum((*trajectory.rounds, trajectory.rounds[-1])[i].duration for i in range(2)), False
    if end > LONGEST_S:
        end, whole = LONGEST_S, False
    t = np.linspace(0.0, end, min(_MOST_SAMPLES, max(2, math.ceil(end / STEP_S) + 1)))
    motions = [trajectory.at(each) for each in t]
    return Sampled(
        t,
        np.array([each.angles for each in motions]),
        np.array([each.rates for each in motions]),
        np.array([each.accelerations for each in motions]),
        whole,
    )


def usage(motion: Sampled, limits: MotionLimits) -> list[LimitUsage]:
    """Return the usage of every limit, the most used first."""
    values = np.array([limits.values(each) for each in motion.motions()])
    found = []
    for bound, lowest, highest in zip(limits.bounds, values.min(axis=0), values.max(axis=0), strict=True):
        middle, room = (
            (0.0, bound.high) if bound.order else ((bound.low + bound.high) / 2, (bound.high - bound.low) / 2)
        )
        share = max(highest - middle, middle - lowest) / room if room > 0.0 else math.inf
        found.append(LimitUsage(bound, float(lowest), float(highest), float(share)))
    return sorted(found, key=lambda each: -each.share)
