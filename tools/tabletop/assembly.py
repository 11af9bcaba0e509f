"""Assembly of the tabletop rig as meshes, for any angles of the palms, and its collision check. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from tools.tabletop.geometry import Tabletop
from tools.tabletop.mesh import Mesh, box, overlaps, turned

PARTS = ("palm", "carrier", "bracket", "base")
"""The printed parts."""
FIXED = {"base", "servo", "bracket"}
"""Parts that do not turn with a palm."""
POSES_DEG = ((45.0, 135.0), (6.0, 41.0), (6.0, 161.0), (90.0, 125.0), (137.0, 172.0))
"""Directions of both palms from the x axis: the middle and the extremes of the default limits."""


def assembled(geometry: Tabletop, parts: Mapping[str, Mesh], first_deg: float, second_deg: float) -> dict[str, Mesh]:
    """Return the parts by name, in the frame of the base plate (mm), with the palms in these directions."""
    g, still, about = geometry, np.zeros(3), turned("z", 180.0)
    up = np.array([0.0, 0.0, g.axis_height])
    case = box(
        (-g.servo_width / 2, g.servo_start, g.servo_axis - g.servo_height),
        (g.servo_width / 2, g.bracket_start, g.servo_axis),
    ).moved(np.eye(3), up)
    turns = turned("y", -first_deg), turned("y", 180.0 - second_deg) @ about
    motor = box(
        (g.motor_start, -g.motor_diameter / 2, -g.motor_depth - g.motor_diameter / 2),
        (g.palm_length - g.motor_wall, g.motor_diameter / 2, -g.motor_depth + g.motor_diameter / 2),
    )
    moving = {"palm": parts["palm"], "carrier": parts["carrier"], "motor": motor}
    bracket = parts["bracket"].moved(np.eye(3), np.array([0.0, g.bracket_start, 0.0]))
    return {
        "base": parts["base"],
        **{
            f"{name} {palm}": mesh.moved(turn, up)
            for palm, turn in enumerate(turns, 1)
            for name, mesh in moving.items()
        },
        "servo 1": case,
        "servo 2": case.moved(about, still),
        "bracket 1": bracket,
        "bracket 2": bracket.moved(about, still),
    }


def collisions(geometry: Tabletop, parts: Mapping[str, Mesh]) -> Iterator[str]:
    """Yield every overlap of two parts in any of the poses, as text."""
    for number, pose in enumerate(POSES_DEG):
        placed = assembled(geometry, parts, *pose)
        for one, other in combinations(placed, 2):
            moves = not {one.split()[0], other.split()[0]} <= FIXED
            if (moves or number == 0) and overlaps(placed[one], placed[other]):
                yield f"{one} and {other} overlap with the palms at {pose[0]:g}° and {pose[1]:g}°"
