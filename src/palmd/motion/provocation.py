"""Moves that make an object that sticks slip where it sticks, now along the one palm, now along the other. Pure.

What sticks to one palm all the time lies the same at the same angles (`model.rolling`: Q is kept), so that no motion
shows more of it than those angles do. It lets go where more friction is asked for than there is: of the palm that bears
less as they lean to the other. A round leans to palm 1 and opens, leans to palm 2 and closes. Rolled along palm 1 on
the way out and along palm 2 on the way back, a round object is turned on by

    2 (cot φ2c/2 − cot φ2o/2) − (φ2o − φ2c)

between the openings closed and open; leaning to the other palm each time turns it back. How far to lean is foreseen for
a round object of which the contacts tell the radius.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np

from palmd.model.rolling import SLIPS_SIGN, friction_asked, normal_forces
from palmd.motion.kinematics import PoseError
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import approach
from palmd.motion.segments import Angles, Move
from palmd.system.mechanism import OPENING, PALMS

CLOSED, OPEN = math.radians(65.0), math.radians(118.0)  # between these, as far as the pads allow
NEAREST_M, FARTHEST = 8e-3, 0.75  # of a contact from the hinge, in m and of the pad's length
ASKED = 0.6  # friction over normal force that makes anything let go
KINETIC = 0.2  # of what slips already: little depends on it
MOST_LEAN = math.radians(22.0)
BRISK = 1.6  # times as fast as the gentle moves for what may slide off; still within the limits: what sticks does not
ROUNDS = 3  # the one way, before as many the other way


def slips(angles: Angles, palm: int, opens: bool) -> bool:
    """Whether a round object cannot stick to `palm` (0 or 1) as the palms begin to open, or to close, at `angles`."""
    sense = 1.0 if opens else -1.0
    stuck, ratio = np.array([palm]), np.array([KINETIC * SLIPS_SIGN[1 - palm] * sense])
    palms, round_one, level = np.array([[*angles, 0.0, 0.0, 0.0, 0.0]]), (np.ones(1),) * 2, (np.zeros(1),) * 2
    weight = np.zeros(1), np.ones(1)
    forces = normal_forces(stuck, ratio, palms, round_one, level, weight, np.zeros(1))
    return bool(abs(friction_asked(stuck, ratio, palms, weight, forces)[0]) > ASKED)


@cache
def lean(opening: float, opens: bool) -> float:
    """How far (rad) both palms must lean to palm 2 so that nothing sticks to palm 1, opened so far (rad)."""
    for tried in np.arange(0.0, MOST_LEAN, math.radians(1.0)).tolist():
        if slips(_leaning(opening, tried), 0, opens):
            return float(tried)
    return MOST_LEAN


def rounds(contacts: tuple[float, ...], here: Angles, limits: MotionLimits) -> tuple[Angles, ...]:
    """The corners of `ROUNDS` rounds the one way and as many the other; contacts (m) as they are at `here` (rad)."""
    radius = max(contacts) * math.tan(here[OPENING] / 2)
    closed = max(CLOSED, 2.0 * math.atan(radius / (FARTHEST * limits.pad_length)))
    opened = max(closed, min(OPEN, 2.0 * math.atan(min(contacts) * math.tan(here[OPENING] / 2) / NEAREST_M)))
    leans = lean(closed, True), lean(opened, False)
    either_way = []
    for palm in PALMS:  # on which it is rolled as they open
        sign = -1.0 if palm == 1 else 1.0
        out = [_leaning(each, sign * leans[0]) for each in (closed, opened)]
        back = [_leaning(each, -sign * leans[1]) for each in (opened, closed)]
        either_way += [*out, *back] * ROUNDS
    return tuple(either_way)


def provoke(here: Angles, corners: tuple[Angles, ...], limits: MotionLimits) -> Move | None:
    """The move from `here` (rad) to the first of the `corners`; None where its way leaves the limits."""
    try:
        gentle = approach(here, corners[0], limits, 0.0)
    except PoseError:
        return None
    return replace(gentle, duration=gentle.duration / BRISK)


def _leaning(opening: float, lean: float) -> Angles:
    """Leaning to palm 2 by that much: the V's middle is turned from the vertical."""
    return lean + (math.pi - opening) / 2, opening
