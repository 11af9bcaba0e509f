"""The table of symbols: meaning, unit and source of each name in the code.

Numbers in brackets are equations of CMU-CS-01-107. The documentation's page is generated from this table.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Symbol:
    """One quantity: name in the code, symbol in the paper, SI unit, meaning, equation or section."""

    name: str
    glyph: str
    unit: str
    meaning: str
    source: str


SYMBOLS: tuple[Symbol, ...] = (
    Symbol("phi1", "φ1", "rad", "from the world X axis to palm 1", "fig. 3.1"),
    Symbol("phi2", "φ2", "rad", "from palm 1 to palm 2", "fig. 3.1"),
    Symbol("phi12", "φ12", "rad", "φ1 + φ2, the world angle of palm 2; below 172° in practice", "3.1"),
    Symbol("omega1, omega2", "ω1, ω2", "rad/s", "rates of φ1, φ2", "4.2"),
    Symbol("alpha1, alpha2", "α1, α2", "rad/s²", "accelerations of φ1, φ2", "4.2"),
    Symbol("s1, s2", "s1, s2", "m", "distance from the hinge to each contact, both positive", "(3.13), (3.14)"),
    Symbol("psi", "ψ", "rad", "orientation of the object; 0 at the first fused reading", "3.1"),
    Symbol("omega0, alpha0", "ω0, α0", "rad/s, rad/s²", "angular rate and acceleration of the object", "4.1"),
    Symbol("theta1, theta2", "θ1, θ2", "rad", "outward normal at each contact, in the object's frame", "(3.1)"),
    Symbol("h", "h(θ)", "m", "support function of the outline about the centre of mass", "3.1"),
    Symbol("r1, r2", "r = h", "m", "radius function: distance of the centre of mass from each palm", "3.1"),
    Symbol("d1, d2", "d = −h′", "m", "offset of the contact along the palm from the foot of the centre of mass", "3.1"),
    Symbol("v1, v2", "v = h + h″", "m", "radius of curvature of the outline at each contact; ≥ 0 if convex", "3.1"),
    Symbol("Generalized.r1, .d1", "r̃1, d̃1", "m", "x1 − x2 along palm 1's normal and tangent", "(3.2), (3.3), (3.6)"),
    Symbol("Generalized.r2, .d2", "r̃2, d̃2", "m", "x1 − x2 along palm 2's normal and tangent", "(3.4), (3.5), (3.6)"),
    Symbol("centre_of_mass", "c_m", "m", "where gravity acts; its height is the potential energy", "(3.17)"),
    Symbol("centre_of_rotation", "c_r", "m", "where the normals at the contacts meet", "(3.18)"),
    Symbol("e_f", "e_f", "m", "error of balance: how far c_m is beside c_r", "(3.29), (3.36)"),
    Symbol("e_c", "e_c", "m", "error of contact: x1 − x2 minus its value from the readings", "(3.9), (3.37)"),
    Symbol("rho", "ρ", "m", "radius of gyration, √(I0/m)", "4.1"),
    Symbol("f1, f2", "f1, f2", "m/s²", "normal force of each contact per unit mass; > 0 while it touches", "4.1"),
    Symbol("mu", "μ", "–", "friction coefficient", "beyond the paper"),
    Symbol("dither", "u_d", "m/s", "speed of the palm's vibration, below which it hides friction", "beyond the paper"),
    Symbol("damping", "c", "m²/s", "viscous damping of the spin, per unit mass", "beyond the paper"),
    Symbol("gravity", "g", "m/s²", "gravity along −Y, positive; the paper's scalar g is its negative", "4.1"),
)
