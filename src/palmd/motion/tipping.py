"""Palm motions that tip any object with flat sides from side to side. Pure.

Closed palms that lean from palm 1 to palm 2 carry the object over; opened palms that lean back lay it on palm 1 with
another side: the sides that lie on both palms at once are turned against each other by 180° minus the opening. Rounds
differ, so that an object that rocks between the same two sides in one round proceeds in another. They were chosen by
the poses of least height of many polygons; `config/plans/tip.yaml` is the same motion as a plan.
"""

from __future__ import annotations

import math

from palmd.motion.kinematics import PoseError
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import approach
from palmd.motion.segments import Angles, Move

POSES_DEG: tuple[Angles, ...] = (
    (115.0, 45.0),
    (61.0, 82.0),
    (6.0, 150.0),
    (21.0, 116.0),
    (32.0, 80.0),
    (121.0, 45.0),
    (10.0, 120.0),
    (6.0, 91.0),
    (87.0, 45.0),
    (93.0, 73.0),
    (101.0, 48.0),
    (58.0, 108.0),
    (6.0, 128.0),
    (18.0, 110.0),
    (6.0, 55.0),
    (38.0, 110.0),
)
PACE_RAD_S, SHORTEST_S = math.radians(33.0), 1.5  # mean rate of the palm that turns farthest; shortest duration
SHARE = 0.9  # largest share of the limits


def tip(here: Angles, aim: Angles | None, limits: MotionLimits) -> Move | None:
    """Return the move from `here` to the pose `aim` (rad), or to the next one if `aim` is reached; None if impossible.

    aim: goal of the previous move, which may have been stopped on its way; None: the first pose. Not for the loop.
    """
    poses = [tuple(map(math.radians, pose)) for pose in POSES_DEG]
    if aim in poses:
        there = poses.index(aim) + (here == aim)
        poses = poses[there:] + poses[:there]
    for pose in poses:
        try:
            return approach(here, pose, limits, pace_s(here, pose), SHARE)
        except PoseError:
            continue
    return None


def pace_s(start: Angles, end: Angles) -> float:
    """Return a duration (s) of the move that lets a tipping object come to rest."""
    turns = [b - a for a, b in zip(start, end, strict=True)]
    return max(SHORTEST_S, max(map(abs, (*turns, sum(turns)))) / PACE_RAD_S)
