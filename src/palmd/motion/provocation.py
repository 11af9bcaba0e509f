"""Moves that make a sticking object slip, along one palm and then along the other. Pure.

An object that sticks to one palm all the time returns to the same pose at the same angles (`model.rolling`: Q is
conserved), so no motion shows more of it than those angles do. It slips where the required friction exceeds the
available one: on the palm that carries less, when the palms lean to the other. A round leans to palm 1 and opens, then
leans to palm 2 and closes. A round object rolls along palm 1 on the way out and along palm 2 on the way back, and is
turned by

    2 (cot φ2c/2 − cot φ2o/2) − (φ2o − φ2c)

between the openings φ2c (closed) and φ2o (open); leaning to the other palm each time turns it back. The lean is
computed for a round object, whose radius follows from the contacts.
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

CLOSED, OPEN = math.radians(65.0), math.radians(118.0)  # range of openings, as far as the pads allow
NEAREST_M, FARTHEST = 8e-3, 0.75  # range of a contact's distance from the hinge: in m, and of the pad's length
SLIP_RATIO = 0.6  # ratio of required friction to normal force at which every object slips
KINETIC = 0.2  # friction coefficient of the contact that slips already; the result depends little on it
MOST_LEAN = math.radians(22.0)
BRISK = (
    1.6  # speed relative to gentle moves for objects that may slide off, which a sticking one does not; within limits
)
ROUNDS = 3  # in one direction, before as many in the other


def slips(angles: Angles, palm: int, opens: bool) -> bool:
    """True if a round object cannot stick to `palm` (0 or 1) when the palms start to open, or to close, at `angles`."""
    sense = 1.0 if opens else -1.0
    stuck, ratio = np.array([palm]), np.array([KINETIC * SLIPS_SIGN[1 - palm] * sense])
    palms, round_one, level = np.array([[*angles, 0.0, 0.0, 0.0, 0.0]]), (np.ones(1),) * 2, (np.zeros(1),) * 2
    weight = np.zeros(1), np.ones(1)
    forces = normal_forces(stuck, ratio, palms, round_one, level, weight, np.zeros(1))
    return bool(abs(friction_asked(stuck, ratio, palms, weight, forces)[0]) > SLIP_RATIO)


@cache
def lean(opening: float, opens: bool) -> float:
    """Return how far (rad) both palms must lean to palm 2 at this opening (rad) so that nothing sticks to palm 1."""
    for tried in np.arange(0.0, MOST_LEAN, math.radians(1.0)).tolist():
        if slips(_leaning(opening, tried), 0, opens):
            return float(tried)
    return MOST_LEAN


def rounds(contacts: tuple[float, ...], here: Angles, limits: MotionLimits) -> tuple[Angles, ...]:
    """Return the corners of `ROUNDS` rounds in each direction; `contacts`: s1, s2 (m) at the pose `here` (rad)."""
    radius = max(contacts) * math.tan(here[OPENING] / 2)
    closed = max(CLOSED, 2.0 * math.atan(radius / (FARTHEST * limits.pad_length)))
    opened = max(closed, min(OPEN, 2.0 * math.atan(min(contacts) * math.tan(here[OPENING] / 2) / NEAREST_M)))
    leans = lean(closed, True), lean(opened, False)
    either_way = []
    for palm in PALMS:  # along which the object rolls when they open
        sign = -1.0 if palm == 1 else 1.0
        out = [_leaning(each, sign * leans[0]) for each in (closed, opened)]
        back = [_leaning(each, -sign * leans[1]) for each in (opened, closed)]
        either_way += [*out, *back] * ROUNDS
    return tuple(either_way)


def provoke(here: Angles, corners: tuple[Angles, ...], limits: MotionLimits) -> Move | None:
    """Return the move from `here` (rad) to the first of `corners`; None if its way leaves the limits."""
    try:
        gentle = approach(here, corners[0], limits, 0.0)
    except PoseError:
        return None
    return replace(gentle, duration=gentle.duration / BRISK)


def _leaning(opening: float, lean: float) -> Angles:
    """Return the pose that leans to palm 2: the V's bisector is turned from the vertical by `lean`."""
    return lean + (math.pi - opening) / 2, opening
