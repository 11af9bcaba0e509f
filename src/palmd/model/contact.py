"""Contact geometry of two palms and a convex object, as CasADi expressions (CMU-CS-01-107, chapter 3).

All lengths in m, angles in rad. `phi2` is the angle from palm 1 to palm 2 and must lie in (0, π): at its ends
the palms are parallel and every formula here divides by sin φ2 = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

from palmd.model.symbolic import SX, ca


@dataclass(frozen=True, slots=True)
class Contact:
    """What one palm feels: r = h, d = −h′, v = h + h″ at the contact's normal (m)."""

    r: SX
    d: SX
    v: SX


def tangent(angle: SX, palm: int) -> SX:
    """t1 = (cos φ1, sin φ1) or t2 = (−cos φ12, −sin φ12): unit vector along the palm's surface."""
    sign = 1.0 if palm == 1 else -1.0
    return ca.vertcat(sign * ca.cos(angle), sign * ca.sin(angle))


def normal(angle: SX, palm: int) -> SX:
    """n_i = t_i turned by +90°: unit normal of the palm, pointing at the object."""
    t = tangent(angle, palm)
    return ca.vertcat(-t[1], t[0])


def solve_from_normals(phi1: SX, phi2: SX, along1: SX, along2: SX) -> SX:
    """The plane vector w with n1·w = along1 and n2·w = along2; w is the COM when given r1, r2."""
    n1, n2 = normal(phi1, 1), normal(phi1 + phi2, 2)
    return ca.vertcat(n2[1] * along1 - n1[1] * along2, n1[0] * along2 - n2[0] * along1) / -ca.sin(phi2)


def offsets(phi2: SX, r1: SX, r2: SX, s1: SX, s2: SX) -> tuple[SX, SX]:
    """(d1, d2) from the readings and the radii: (3.13) and (3.14) read backwards."""
    d1 = (r1 * ca.cos(phi2) + r2) / ca.sin(phi2) - s1
    d2 = s2 - (r2 * ca.cos(phi2) + r1) / ca.sin(phi2)
    return d1, d2


def readings(phi2: SX, one: Contact, two: Contact) -> tuple[SX, SX]:
    """(s1, s2), the distances hinge → contact: (3.13) and (3.14)."""
    s1 = (one.r * ca.cos(phi2) + two.r) / ca.sin(phi2) - one.d
    s2 = (two.r * ca.cos(phi2) + one.r) / ca.sin(phi2) + two.d
    return s1, s2
