"""Excitation: gentle moves to and fro about a pose, for an object of which nothing is known yet."""

from __future__ import annotations

import math

from palmd.motion.kinematics import PoseError
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import approach
from palmd.motion.segments import Angles, Move

# From the centre, degrees of both joints, one after the other: both palms turn, with and against each other.
CORNERS_DEG: tuple[Angles, ...] = ((6.0, 3.0), (-6.0, -3.0), (6.0, -3.0), (-6.0, 3.0))


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
