"""Weights, servo torques and deflection of the palm, computed from the geometry and the configured limits. Pure.

Statics of two contacts (docs/theory/theory.md): f1 = m g sin φ12 / sin φ2, f2 = m g sin φ1 / sin φ2, each normal to its
palm, at s = R / tan(φ2/2) for a cylinder of radius R.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from palmd.config.two_palms import LimitsConfig
from tools.tabletop.geometry import Tabletop

GRAVITY_M_S2 = 9.81
PLA_KG_M3 = 1240.0
PLA_YOUNG_MPA = 2300.0
"""Young's modulus, a low value for printed PLA."""
PLA_SHEAR_MPA = PLA_YOUNG_MPA / (2.0 * 1.35)
LARGEST_RADIUS_MM, LARGEST_KG = 24.0, 0.25
"""The largest object of the emulated rig (`rig/shapes.py`)."""
WIDEST_DEG = 172.0
"""Largest φ1 + φ2 at which an object rests on both palms."""
_STEP_DEG = 2


@dataclass(frozen=True, slots=True)
class Load:
    """Load of a palm in a pose: force (N) at s (mm), and the servo's torque including the palm's weight (N·m)."""

    angles_deg: tuple[float, float]
    force_n: float
    s_mm: float
    torque_nm: float


def palm_mass_kg(g: Tabletop) -> float:
    """Mass (kg) of one printed palm, ignoring its holes."""
    plate = (g.palm_length - g.palm_start) * g.palm_width * g.palm_thickness
    arm = g.arm_length * g.cheek_thickness * (g.arm_depth - g.surface)
    bridge = (g.arm_length - g.arm_start) * (g.cheek_start - g.palm_width / 2) * g.palm_thickness
    cheek = 0.5 * math.pi * g.cheek_radius**2 * g.cheek_thickness  # the other half is part of the arm
    eye = math.pi * (g.eye_radius**2 - (g.bearing_outer / 2) ** 2) * g.bearing_width
    return (plate + arm + bridge + cheek + eye) * 1e-9 * PLA_KG_M3


def poses(g: Tabletop, limits: LimitsConfig, radius_mm: float) -> Iterator[tuple[float, float, float]]:
    """Yield φ1 and φ2 (degrees) within the limits, and the distance (mm) of the contacts from the axis."""
    (low1, high1), (low2, high2) = limits.angles_deg
    for phi1 in range(math.ceil(low1), math.floor(high1) + 1, _STEP_DEG):
        for phi2 in range(math.ceil(low2), math.floor(high2) + 1, _STEP_DEG):
            s = radius_mm / math.tan(math.radians(phi2) / 2.0)
            if phi1 + phi2 < WIDEST_DEG and s <= g.strip_end:
                yield float(phi1), float(phi2), s


def worst(g: Tabletop, limits: LimitsConfig, radius_mm: float = LARGEST_RADIUS_MM, mass_kg: float = LARGEST_KG) -> Load:
    """Return the load with the largest servo torque at rest; ValueError if the object fits in no pose."""
    weight, own = mass_kg * GRAVITY_M_S2, palm_mass_kg(g) * GRAVITY_M_S2
    loads = []
    for phi1, phi2, s in poses(g, limits, radius_mm):
        first, second = math.radians(phi1), math.radians(phi1 + phi2)
        for force, direction in (
            (weight * math.sin(second) / math.sin(math.radians(phi2)), first),
            (weight * math.sin(first) / math.sin(math.radians(phi2)), second),
        ):
            torque = force * s + own * abs(math.cos(direction)) * 0.5 * g.palm_length
            loads.append(Load((phi1, phi2), force, s, torque * 1e-3))
    if not loads:
        raise ValueError(f"an object of radius {radius_mm:g} mm does not touch both pads in any pose")
    return max(loads, key=lambda load: load.torque_nm)


def deflection_mm(g: Tabletop, force_n: float, s_mm: float) -> float:
    """Return the strip's deflection (mm) at s (mm) under a force (N): the arm bends and twists, the plate is stiff.

    Euler-Bernoulli: F s³ / (3 E I); torsion of a rectangle b × t, t < b: T s / (G b t³ (1 − 0.63 t/b) / 3).
    """
    depth, thickness = g.arm_depth - g.surface, g.cheek_thickness
    narrow, wide = sorted((depth, thickness))
    bending = force_n * s_mm**3 / (3.0 * PLA_YOUNG_MPA * thickness * depth**3 / 12.0)
    lever = 0.5 * (g.cheek_start + g.cheek_end)
    stiffness = PLA_SHEAR_MPA * wide * narrow**3 * (1.0 - 0.63 * narrow / wide) / 3.0
    return bending + force_n * lever * min(s_mm, g.arm_length) / stiffness * lever
