"""Kinematics of the mechanism: from joint angles to the palms, and to the contacts' normals on the object.

Joint 1 turns palm 1 against the world X axis, joint 2 turns palm 2 against palm 1; palms and joints are numbered from 1
and correspond in this order. Each function takes floats, arrays or CasADi symbols. Pure, safe in the loop.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import accumulate, pairwise
from typing import Any, TypeVar

from palmd.system.naming import Naming

Value = TypeVar("Value")  # floats, arrays or symbols

PALMS = (1, 2)
"""The palms' numbers; palm i carries pad i and is turned by joint i."""

JOINTS = tuple(f"phi{palm}" for palm in PALMS)
"""Names of the joint angles, in the order of every joint vector."""

NAMING = Naming(JOINTS, "rad", PALMS)

SIDES = (1.0, -1.0)
"""Side of each palm's direction on which the object is: 1 left, -1 right."""

RADII, CONTACTS, FORCES, BENDS = (tuple(f"{what}{palm}" for palm in PALMS) for what in "rsfv")
"""Names, one per palm: the palm's distance from the centre of mass, its contact's from the hinge, the contact force,
and the outline's radius of curvature there."""

HELD_BY = ("hinged to the base", "the arm holds")
"""Names of the palms for people: what is at each one's far end."""

JOINT_MEANINGS = ("palm 1 from the world X axis", "palm 2 from palm 1")
"""The joint angles in words."""

OPENING = 1
"""Index of the joint angle between the palms."""

JOINT_RATES = tuple(f"omega{palm}" for palm in PALMS)
"""Names of the joint rates."""

ENDS = (*(f"pad{palm}" for palm in PALMS), "arm")
"""Devices with a port of their own: each palm's pad, and the arm."""

_BEHIND = (0.5 * math.pi, 1.5 * math.pi)  # each palm's direction minus the outward normal at its contact (rad)


def directions(joints: Iterable[Value]) -> tuple[Value, ...]:
    """The palms' angles from the world X axis (rad): φ1 and φ12 = φ1 + φ2; the same for rates and accelerations."""
    return tuple(accumulate(joints))


def joints_between(palms: Iterable[Value]) -> tuple[Value, ...]:
    """The joint angles (rates, accelerations) for palms with these `directions`."""
    angles: list[Any] = list(palms)
    return (angles[0], *(angle - before for before, angle in pairwise(angles)))


def normal_directions(joints: Iterable[Value], psi: Value) -> tuple[Value, ...]:
    """θ1, θ2: outward normals at the contacts in the frame of an object turned by `psi` (rad): (3.1)."""
    angles: tuple[Any, ...] = directions(joints)
    return tuple(angle - psi - behind for angle, behind in zip(angles, _BEHIND, strict=True))


def joints_at(normals: Iterable[Value], psi: Value) -> tuple[Value, ...]:
    """The joint angles with these `normal_directions`."""
    normal_list: Any = normals
    return joints_between(normal + psi + behind for normal, behind in zip(normal_list, _BEHIND, strict=True))


def hinge_position(base: tuple[float, float], arm: float, phi1: float) -> tuple[float, float]:
    """Position of the hinge (m, world): O = B − L1·(cos φ1, sin φ1), with L1 = 0 if it is fixed."""
    return base[0] - arm * math.cos(phi1), base[1] - arm * math.sin(phi1)
