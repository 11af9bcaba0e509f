"""Excitation: gentle moves for an object of which nothing is known: back to where any lies well, and to and fro."""

from __future__ import annotations

import math

from palmd.motion.kinematics import PoseError
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import approach, home
from palmd.motion.segments import Angles, Move

# From the centre, degrees of both joints, one after the other: both palms turn, with and against each other.
CORNERS_DEG: tuple[Angles, ...] = ((6.0, 3.0), (-6.0, -3.0), (6.0, -3.0), (-6.0, 3.0))

STEP_RAD = math.radians(12.0)  # of a joint, on the way home; nearer than that it is as good


def homewards(here: Angles, limits: MotionLimits) -> Move | None:
    """A step from `here` (rad) towards HOME; None near it, or where the way leaves the limits. Not for the loop.

    Far from it an object hardly presses on one of the palms, and who rocks it there loses it.
    """
    there = home(limits)
    farthest = max(abs(b - a) for a, b in zip(here, there, strict=True))
    if farthest <= STEP_RAD:
        return None
    step = tuple(a + STEP_RAD / farthest * (b - a) for a, b in zip(here, there, strict=True))
    try:
        return approach(here, step, limits, 0.0)
    except PoseError:
        return None


def rock(here: Angles, centre: Angles, limits: MotionLimits) -> Move | None:
    """The move from `here` to the next corner about `centre` (rad); None where none is left. Not for the loop."""
    corners = [tuple(at + math.radians(way) for at, way in zip(centre, each, strict=True)) for each in CORNERS_DEG]
    if here in corners:
        turn = corners.index(here)
        corners = corners[turn + 1 :] + corners[:turn]
    for corner in corners:
        try:
            return approach(here, corner, limits, 0.0)
        except PoseError:
            continue
    return None
