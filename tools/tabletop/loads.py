"""Weights, servo torques, deflection of the palm and vibration of its carrier, from geometry and limits. Pure.

Statics of two contacts (docs/theory/theory.md): f1 = m g sin φ12 / sin φ2, f2 = m g sin φ1 / sin φ2, each normal to its
palm, at s = R / tan(φ2/2) for a cylinder of radius R.

The carrier is a mass m on pads of foam, shear stiffness k = G A/h, driven by the motor's force F along the palm. Below
the resonance f_c = √(k/m)/2π the amplitude of its speed at f is V = 2πf F / (k |1 − (f/f_c)²|), nearly independent
of m.
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
FOAM_YOUNG_MPA = 0.058 / 0.25
"""Young's modulus of PORON 4701-30 of 1 mm: 58 kPa at a compression of 25 % (maker's data, 35 to 83 kPa), at rest."""
FOAM_RANGE = (35.0 / 58.0, 2.0 * 83.0 / 58.0)
"""Stiffness of the foam over the typical one: the maker's limits, the upper one doubled for 235 Hz (an assumption)."""
FOAM_POISSON = 0.3
STRIP_KG_M3 = 1400.0
"""Density of strip and film: that of polyester."""
MOTOR_KG = 1.0e-3
"""Assumed mass of the motor; measure it."""
MOTOR_G_RMS, JIG_KG = 1.0, 0.1
"""Least acceleration (RMS, g) that the motor must give a test mass (kg) at its resonance."""
STEP_S = 98.46e-6
"""Unit of the driver's period in open loop."""
MOTOR_PERIODS = (43, 44)
"""Periods of the motors of palm 1 and 2 in this unit, as in tools/strip/strip.ino."""
MOTORS_HZ = tuple(1.0 / (STEP_S * period) for period in MOTOR_PERIODS)
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
    """Mass (kg) of one printed palm without its carrier, ignoring its holes but not the motor's notch."""
    notch = (g.palm_length - g.motor_start + g.motor_gap) * (g.motor_diameter + 2.0 * g.motor_gap)
    plate = ((g.palm_length - g.palm_start) * g.palm_width - notch) * g.palm_thickness
    arm = g.arm_length * g.cheek_thickness * (g.arm_depth - g.surface)
    bridge = (g.arm_length - g.arm_start) * (g.cheek_start - g.palm_width / 2) * g.palm_thickness
    cheek = 0.5 * math.pi * g.cheek_radius**2 * g.cheek_thickness  # the other half is part of the arm
    eye = math.pi * (g.eye_radius**2 - (g.bearing_outer / 2) ** 2) * g.bearing_width
    return (plate + arm + bridge + cheek + eye) * 1e-9 * PLA_KG_M3


def carrier_mass_kg(g: Tabletop) -> float:
    """Mass (kg) that vibrates: carrier, strip, skin and motor, ignoring the carrier's openings except the motor's."""
    window = (g.motor_thickness + g.motor_gap) * (g.motor_diameter + g.motor_gap)
    plate = ((g.palm_length - g.palm_start) * g.carrier_width - window) * g.carrier_thickness
    wall = g.motor_wall * g.motor_diameter * (g.motor_depth + 0.5 * g.motor_diameter - g.carrier_under)
    strip = (g.strip_length + 2.0 * g.strip_edge) * g.strip_width * (g.strip_thickness + g.skin_thickness)
    return ((plate + wall) * PLA_KG_M3 + strip * STRIP_KG_M3) * 1e-9 + MOTOR_KG


@dataclass(frozen=True, slots=True)
class Mount:
    """The carrier's mount: shear and normal stiffness (N/m), tilting stiffness (N·m/rad), middle of the pads (mm)."""

    mass_kg: float
    shear_n_m: float
    normal_n_m: float
    tilting_nm_rad: float
    middle_mm: float

    @property
    def resonance_hz(self) -> float:
        """Frequency f_c of the carrier along the palm."""
        return math.sqrt(self.shear_n_m / self.mass_kg) / (2.0 * math.pi)

    def speed_m_s(self, force_n: float, frequency_hz: float) -> float:
        """Amplitude of the carrier's speed along the palm under a force of this amplitude, without damping."""
        ratio = frequency_hz / self.resonance_hz
        return 2.0 * math.pi * frequency_hz * force_n / (self.shear_n_m * abs(1.0 - ratio**2))

    def tilt_rad(self, force_n: float, s_mm: float) -> float:
        """Tilt of the carrier under a normal force at s."""
        return force_n * 1e-3 * (s_mm - self.middle_mm) / self.tilting_nm_rad

    def sink_mm(self, force_n: float, s_mm: float) -> float:
        """Normal displacement of the carrier at s under a normal force there."""
        sink_m = force_n / self.normal_n_m + self.tilt_rad(force_n, s_mm) * 1e-3 * (s_mm - self.middle_mm)
        return 1e3 * sink_m


def mount(g: Tabletop, stiffness: float = 1.0) -> Mount:
    """Return the mount, with foam of this stiffness over the typical one; the pads' sides are treated as free."""
    area_m2 = 1e-6 * g.foam_pads * g.foam_length * g.carrier_width
    normal = 1e6 * stiffness * FOAM_YOUNG_MPA * area_m2 / (1e-3 * g.foam_thickness)
    spread = (g.foam_pitch**2 * (g.foam_pads**2 - 1) + g.foam_length**2) / 12.0  # mean square distance from the middle
    middle = g.foam_first + 0.5 * (g.foam_length + (g.foam_pads - 1) * g.foam_pitch)
    shear = normal / (2.0 * (1.0 + FOAM_POISSON))
    return Mount(carrier_mass_kg(g), shear, normal, normal * spread * 1e-6, middle)


def motor_force_n(acceleration_g: float = MOTOR_G_RMS) -> float:
    """Amplitude of the motor's force that gives the test mass this acceleration (RMS, g)."""
    return math.sqrt(2.0) * acceleration_g * GRAVITY_M_S2 * JIG_KG


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
    weight, own = mass_kg * GRAVITY_M_S2, (palm_mass_kg(g) + carrier_mass_kg(g)) * GRAVITY_M_S2
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
