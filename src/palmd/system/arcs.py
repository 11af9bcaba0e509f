"""Palms that are circular arcs through the hinge: points on them, and an object's size from readings.

φ1, φ12 are their directions at the hinge, κ their signed curvatures (1/m, > 0 concave, 0 flat), s arc lengths (m). Each
function takes floats or arrays. Pure, safe in the loop.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from palmd.events import FloatArray
from palmd.system.mechanism import OPENING, SIDES, directions

Value = TypeVar("Value")

FLAT = (0.0,) * len(SIDES)
"""Curvatures of flat palms."""

_ITERATIONS, _TOLERANCE_M = 12, 1e-12

MOST_LYING = 0.95
"""κv above which an object sits inside a concave palm: the contact runs away, and no estimate is valid."""


def tangents(joints: Iterable[Value], contacts: Iterable[Value], curvatures: Sequence[float]) -> tuple[Value, ...]:
    """Joint angles of flat palms that coincide with the palms' tangents at the contacts: β1 and β2 − β1 (rad)."""
    if not any(curvatures):
        return tuple(joints)
    angles: tuple[Any, ...] = directions(joints)
    contact_list: Any = contacts
    turned = [
        angle + side * kappa * s for angle, side, kappa, s in zip(angles, SIDES, curvatures, contact_list, strict=True)
    ]
    return (turned[0], *(angle - before for before, angle in pairwise(turned)))


def palm_points(joints: Iterable[Value], contacts: Iterable[Value], curvatures: Sequence[float]) -> list[Any]:
    """Points on the palms relative to the hinge (m, world), each (…, 2): s sinc(κs/2)·(cos, sin)(φ ± κs/2)."""
    angles: tuple[Any, ...] = directions(joints)
    contact_list: Any = contacts
    points = []
    for angle, side, kappa, s in zip(angles, SIDES, curvatures, contact_list, strict=True):
        half = kappa * np.asarray(s) / 2
        chord = s * np.sinc(half / np.pi)
        points.append(np.stack([chord * np.cos(angle + side * half), chord * np.sin(angle + side * half)], axis=-1))
    return points


def opening_at(radius: float, s: float, curvatures: Sequence[float] = FLAT) -> float:
    """φ2 (rad) at which a circle of that radius touches both palms at distance `s` from the hinge (m).

    The sum of the angles, seen from the hinge, between its centre and each palm's direction there; 2 atan(r/s) on flat
    palms.
    """
    if not any(curvatures):
        return 2.0 * math.atan(radius / s)
    return sum(_angle_from_palm(radius, s, kappa) for kappa in curvatures)


def _angle_from_palm(radius: float, s: float, kappa: float) -> float:
    x, y = s * float(np.sinc(kappa * s / np.pi)), kappa / 2 * (s * float(np.sinc(kappa * s / (2 * np.pi)))) ** 2
    return math.atan2(y + radius * math.cos(kappa * s), x - radius * math.sin(kappa * s))


def joints_of(radius: float, touching: Sequence[float], curvatures: Sequence[float] = FLAT) -> tuple[float, float]:
    """φ1, φ2 at which a circle of that radius (m) has contact tangents at β1 and β2 = β1 + an opening (rad)."""
    beta1, opening = touching
    s = arc_lengths(np.full(2, radius), np.zeros(2), np.asarray(opening), curvatures)
    turn1, turn2 = (np.array(curvatures) * s).tolist()
    return beta1 - turn1, opening + turn1 + turn2


def arc_lengths(
    radii: FloatArray, offsets: FloatArray, opening: FloatArray, curvatures: Sequence[float] = FLAT
) -> FloatArray:
    """s1, s2 (2, …) (m) of contacts with r and d (2, …) (m) whose tangents are an `opening` (…) (rad) apart.

    (3.13), (3.14) with each tangent's height over the hinge, solved by Newton's method in both from the values of flat
    palms; its determinant is sin φ2 over that of the opening. NaN where the palms would have to be closed or open by
    180°.
    """
    kappa = np.array(curvatures).reshape(-1, *[1] * np.ndim(opening))
    sin, cos = np.sin(opening), np.cos(opening)

    def along(above: FloatArray) -> FloatArray:
        return np.asarray((above * cos + above[::-1]) / sin - np.stack([offsets[0], -offsets[1]]))

    s = along(radii)
    if not kappa.any():
        return s
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for _ in range(_ITERATIONS):
            turn = kappa * s
            residual = s * np.sinc(turn / np.pi) - along(radii - kappa / 2 * (s * np.sinc(turn / math.tau)) ** 2)
            step = residual * np.sin(opening + turn[::-1]) - residual[::-1] * np.sin(turn[::-1])
            step = step / np.sin(opening + turn.sum(axis=0))
            s = s - step
            if not (np.abs(step) >= _TOLERANCE_M).any():
                break
        total_opening = opening + (kappa * s).sum(axis=0)
        converged = np.asarray((np.abs(step) < _TOLERANCE_M) & (total_opening > 0.0) & (total_opening < np.pi))
    return np.where(converged, s, np.nan)


def circle_radius(joints: Sequence[float], contacts: Sequence[float], curvatures: Sequence[float] = FLAT) -> float:
    """Radius (m) of the circle that touches the palms near these contacts.

    On flat palms r / tan(φ2/2) are both readings of a circle, from (3.13) with d = 0; on arcs the normals at both
    contacts lead to one centre, by least squares.
    """
    if not any(curvatures):
        return sum(contacts) / len(contacts) * math.tan(joints[OPENING] / 2)
    one, two = palm_points(joints, contacts, curvatures)
    beta = directions(tangents(joints, contacts, curvatures))
    n1, n2 = (
        np.stack([-side * np.sin(angle), side * np.cos(angle)], axis=-1)
        for side, angle in zip(SIDES, beta, strict=True)
    )
    return float((two - one) @ (n1 - n2) / ((n1 - n2) @ (n1 - n2)))
