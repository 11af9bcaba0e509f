"""From joint angles to where the palms are, and to where on the object they touch it.

Joint 1 turns palm 1 against the world X axis, joint 2 turns palm 2 against palm 1; palms and joints count from 1, and
belong together in this order. Each function takes floats, arrays or CasADi's symbols alike. Pure, safe in the loop.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import accumulate, pairwise
from typing import Any, TypeVar

from palmd.system.naming import Naming

Value = TypeVar("Value")  # what can be added: floats, arrays, symbols

PALMS = (1, 2)
"""The palms' numbers; palm i carries pad i and is turned by joint i."""

JOINTS = tuple(f"phi{palm}" for palm in PALMS)
"""What the joint angles are called, in the order of every joint vector."""

NAMING = Naming(JOINTS, "rad", PALMS)

SIDES = (1.0, -1.0)
"""On which side of each palm's direction the object is: 1 to its left, -1 to its right."""

RADII, CONTACTS, FORCES, BENDS = (tuple(f"{what}{palm}" for palm in PALMS) for what in "rsfv")
"""What is called the distance of each palm from the centre of mass, its contact's from the hinge, its force, and the
outline's radius of curvature there."""

HELD_BY = ("hinged to the base", "the arm holds")
"""How people tell the palms apart: what is at each one's far end."""

JOINT_MEANINGS = ("palm 1 from the world X axis", "palm 2 from palm 1")
"""What they are, in words."""

OPENING = 1
"""Which of them is the angle between the palms."""

JOINT_RATES = tuple(f"omega{palm}" for palm in PALMS)
"""What their rates are called."""

ENDS = (*(f"pad{palm}" for palm in PALMS), "arm")
"""What hangs on a line of its own: each palm's pad, and the arm that turns the palms."""

_BEHIND = (0.5 * math.pi, 1.5 * math.pi)  # by which the outward normal of what touches a palm lies behind its direction


def directions(joints: Iterable[Value]) -> tuple[Value, ...]:
    """The palms' angles from the world X axis (rad): φ1 and φ12 = φ1 + φ2; of joint rates and accelerations theirs."""
    return tuple(accumulate(joints))


def joints_between(palms: Iterable[Value]) -> tuple[Value, ...]:
    """The joint angles (rates, accelerations) of palms whose `directions` these are."""
    angles: list[Any] = list(palms)
    return (angles[0], *(angle - before for before, angle in pairwise(angles)))


def normal_directions(joints: Iterable[Value], psi: Value) -> tuple[Value, ...]:
    """θ1, θ2: the outward normals at the contacts in the object's frame, which is turned by `psi` (rad): (3.1)."""
    angles: tuple[Any, ...] = directions(joints)
    return tuple(angle - psi - behind for angle, behind in zip(angles, _BEHIND, strict=True))


def joints_at(normals: Iterable[Value], psi: Value) -> tuple[Value, ...]:
    """The joint angles whose `normal_directions` these are."""
    given: Any = normals
    return joints_between(normal + psi + behind for normal, behind in zip(given, _BEHIND, strict=True))


def hinge_position(base: tuple[float, float], arm: float, phi1: float) -> tuple[float, float]:
    """The hinge between the palms (m, world): O = B − L1·(cos φ1, sin φ1), with L1 = 0 where it does not move."""
    return base[0] - arm * math.cos(phi1), base[1] - arm * math.sin(phi1)
