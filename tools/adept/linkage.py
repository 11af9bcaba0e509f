"""Loads of the gripper of an Adept arm that holds palm 2, and a drawing of hinge and palms. Pure.

Palm 1 is a link between the fixed hinge B and the hinge O, so O transmits the transverse part of its loads to palm 2,
which the gripper holds at E. Forces along palm 1 are assumed to be carried by B: in a rigid linkage, statics leave them
undetermined, and a position error of the arm along palm 1 adds to them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from palmd.config.two_palms import Config, LimitsConfig, RigConfig
from palmd.events import FloatArray
from tools.tabletop.loads import GRAVITY_M_S2, LARGEST_KG, LARGEST_RADIUS_MM, WIDEST_DEG
from tools.tabletop.svg import BODY, THIN, Point, View, document

PALM_KG = 0.3
"""Assumed mass of a palm with its pad: weigh yours."""
PAD_MM = 55.5
DRAWN_DEG = (45.0, 90.0)
_STEP_DEG = 3


@dataclass(frozen=True, slots=True)
class Grip:
    """Load of the gripper at E in a pose: force (x, y in N), and moment about the plane's normal (N·m)."""

    angles_deg: tuple[float, float]
    force: FloatArray
    moment_nm: float

    @property
    def force_n(self) -> float:
        """Magnitude of the force (N)."""
        return float(np.hypot(*self.force))


def grip(rig: RigConfig, angles_deg: tuple[float, float], radius_mm: float, mass_kg: float, palm_kg: float) -> Grip:
    """Return the load at rest with a cylinder of that radius between the palms, gravity in their plane."""
    phi1, phi2 = map(math.radians, angles_deg)
    first, second = phi1, phi1 + phi2
    length1, length2 = (1e-3 * length for length in rig.palm_lengths_mm)
    s = 1e-3 * radius_mm / math.tan(phi2 / 2.0)
    weight, own = mass_kg * GRAVITY_M_S2, palm_kg * GRAVITY_M_S2
    pressed1, pressed2 = (weight * math.sin(angle) / math.sin(phi2) for angle in (second, first))
    along = np.array([math.cos(second), math.sin(second)])
    normal1 = np.array([-math.sin(first), math.cos(first)])
    normal2 = np.array([math.sin(second), -math.cos(second)])
    passed_on = pressed1 * (length1 - s) / length1 + 0.5 * own * math.cos(first)
    loads: tuple[tuple[FloatArray, FloatArray], ...] = (
        (-length2 * along, -passed_on * normal1),
        (-(length2 - s) * along, -pressed2 * normal2),
        (-0.5 * length2 * along, np.array([0.0, -own])),
    )
    force: FloatArray = -np.sum([load for _, load in loads], axis=0)
    moment = -sum(float(at[0] * load[1] - at[1] * load[0]) for at, load in loads)
    return Grip(angles_deg, force, moment)


def poses(limits: LimitsConfig, radius_mm: float) -> Iterator[tuple[float, float]]:
    """Yield the poses in which the cylinder lies on both pads."""
    (low1, high1), (low2, high2) = limits.angles_deg
    for phi1 in np.arange(low1, high1 + 1, _STEP_DEG):
        for phi2 in np.arange(low2, high2 + 1, _STEP_DEG):
            if phi1 + phi2 < WIDEST_DEG and radius_mm / math.tan(math.radians(phi2) / 2.0) <= PAD_MM:
                yield float(phi1), float(phi2)


def worst(config: Config) -> tuple[Grip, Grip]:
    """Return the loads with the largest force and the largest moment, for the emulated rig's largest object."""
    found = [
        grip(config.rig, pose, LARGEST_RADIUS_MM, LARGEST_KG, PALM_KG)
        for pose in poses(config.limits, LARGEST_RADIUS_MM)
    ]
    return max(found, key=lambda each: each.force_n), max(found, key=lambda each: abs(each.moment_nm))


def drawing(config: Config) -> str:
    """Return the drawing of hinge and palms, with the gripper's loads."""
    view = View(330.0, 330.0, 2.2)
    first, second = math.radians(DRAWN_DEG[0]), math.radians(sum(DRAWN_DEG))
    lengths = config.rig.palm_lengths_mm
    ends = [
        (length * math.cos(angle), length * math.sin(angle))
        for length, angle in zip(lengths, (first, second), strict=True)
    ]
    for (x, y), angle, side, name in ((ends[0], first, 1, "palm 1"), (ends[1], second, -1, "palm 2")):
        back: Point = (side * 8 * math.sin(angle), -side * 8 * math.cos(angle))
        view.shape([(0, 0), (x, y), (x + back[0], y + back[1]), back], BODY)
        pad = PAD_MM / math.hypot(x, y)
        view.line((0, 0), (pad * x, pad * y), 'stroke="#bf616a" stroke-width="4"')
        view.text(0.75 * x + 3 * back[0], 0.75 * y + 3 * back[1], name)
    for (x, y), words, way in (
        ((0.0, 0.0), "O, hinge", 0),
        (ends[0], "B, fixed hinge", 1),
        (ends[1], "E, gripper", -1),
    ):
        view.circle(x, y, 2.5, 'fill="white" stroke="black"')
        view.text(x + 6 * way, y + (6 if way else -9), words, "start" if way > 0 else "end" if way else "middle")
    view.line((-20, 0), (60, 0), THIN)
    view.text(42, 3, "x")
    view.circle(0, LARGEST_RADIUS_MM * 2**0.5, LARGEST_RADIUS_MM, 'fill="none" stroke="#5e81ac" stroke-dasharray="5 4"')
    tip = 'stroke="black" marker-end="url(#tip)"'
    view.line((105, 60), (105, 40), tip)
    view.text(108, 48, "gravity in the plane", "start")
    force, moment = worst(config)
    lines = (
        f"palms {lengths[0]:g} and {lengths[1]:g} mm, hinge pins 3 mm or more, pads {PAD_MM:g} mm from O outwards",
        f"object up to {LARGEST_KG * 1e3:g} g, palms of {PALM_KG * 1e3:g} g each, gravity wholly in the plane:",
        f"the gripper holds {force.force_n:.1f} N at most (φ1 {force.angles_deg[0]:g}°, φ2 {force.angles_deg[1]:g}°)",
        f"and {abs(moment.moment_nm):.2f} N·m about the tool's axis (φ1 {moment.angles_deg[0]:g}°,"
        f" φ2 {moment.angles_deg[1]:g}°)",
    )
    for number, words in enumerate(lines):
        view.text(-140, -24 - 8 * number, words, "start")
    return document(760.0, 480.0, [view])
