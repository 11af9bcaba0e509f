"""Excitation: gentle moves for an unknown object, back to the home pose, where any object lies well, and rocking."""

from __future__ import annotations

import math

from palmd.motion.kinematics import PoseError
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import approach, home
from palmd.motion.segments import Angles, Move

# Offsets of both joints from the centre (degrees), in sequence: both palms turn, with and against each other.
CORNERS_DEG: tuple[Angles, ...] = ((6.0, 3.0), (-6.0, -3.0), (6.0, -3.0), (-6.0, 3.0))

STEP_RAD = math.radians(12.0)  # step of a joint on the way home; poses nearer than that are as good


def homewards(here: Angles, limits: MotionLimits) -> Move | None:
    """Return a step from `here` (rad) towards HOME; None near it, or if the way leaves the limits. Not for the loop.

    Far from HOME an object hardly presses on one of the palms, and rocking would lose its contact.
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
    """Return the move from `here` to the next corner about `centre` (rad), None if impossible. Not for the loop."""
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
