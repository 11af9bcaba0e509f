"""Contact geometry of two palms and a convex object, as CasADi expressions (CMU-CS-01-107, chapter 3).

All lengths in m, angles in rad. `phi2` is the angle from palm 1 to palm 2 and must lie in (0, π): at its ends
the palms are parallel and every formula here divides by sin φ2 = 0. A curved palm is replaced by its tangent at the
contact (found by `model.touch`): a flat palm turned by `Contact.turn` and displaced by `Contact.above`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from palmd.model.symbolic import SX, ca


@dataclass(frozen=True, slots=True)
class Contact:
    """Outline at one contact, r = h, d = −h′, v = h + h″ at its normal (m), and the palm's tangent there.

    v_rate: h′ + h‴, the derivative of v by the normal (m/rad); None if not computed. curvature: of the palm (1/m,
    > 0 concave). turn: angle of its tangent at the contact against its direction at the hinge (rad). above: height at
    which that tangent passes the hinge (m), on the object's side. For a flat palm these three are constant zeros, which
    CasADi drops from every expression.
    """

    r: SX
    d: SX
    v: SX
    v_rate: SX | None = None
    curvature: SX = field(default_factory=lambda: SX(0))
    turn: SX = field(default_factory=lambda: SX(0))
    above: SX = field(default_factory=lambda: SX(0))


def sinc(x: SX) -> SX:
    """sin x/x, regular at 0."""
    if x.is_zero():
        return SX(1)
    small = ca.fabs(x) < 1e-3
    return ca.if_else(small, 1 - x**2 / 6 + x**4 / 120, ca.sin(x) / ca.if_else(small, SX(1), x))


def tangent(angle: SX, palm: int) -> SX:
    """t1 = (cos φ1, sin φ1) or t2 = (−cos φ12, −sin φ12): unit vector along the palm's surface."""
    sign = 1.0 if palm == 1 else -1.0
    return ca.vertcat(sign * ca.cos(angle), sign * ca.sin(angle))


def normal(angle: SX, palm: int) -> SX:
    """n_i = t_i turned by +90°: unit normal of the palm, pointing at the object."""
    t = tangent(angle, palm)
    return ca.vertcat(-t[1], t[0])


def solve_from_normals(phi1: SX, phi2: SX, along1: SX, along2: SX) -> SX:
    """Return the plane vector w with n1·w = along1 and n2·w = along2; for r1, r2 it is the centre of mass."""
    n1, n2 = normal(phi1, 1), normal(phi1 + phi2, 2)
    return ca.vertcat(n2[1] * along1 - n1[1] * along2, n1[0] * along2 - n2[0] * along1) / -ca.sin(phi2)


def tangent_joints(joints: Sequence[SX], turns: Sequence[SX]) -> tuple[SX, ...]:
    """Return the joint angles of the tangents, turned by τ_i against the palms: (φ1 + τ1, φ2 + τ2 − τ1)."""
    rest = (angle + turn - before for angle, (before, turn) in zip(joints[1:], pairwise(turns), strict=True))
    return (joints[0] + turns[0], *rest)


def offsets(phi2: SX, r1: SX, r2: SX, s1: SX, s2: SX) -> tuple[SX, SX]:
    """Return (d1, d2) from readings and radii: (3.13) and (3.14) solved for d."""
    d1 = (r1 * ca.cos(phi2) + r2) / ca.sin(phi2) - s1
    d2 = s2 - (r2 * ca.cos(phi2) + r1) / ca.sin(phi2)
    return d1, d2


def alongs(phi2: SX, one: Contact, two: Contact) -> tuple[SX, SX]:
    """Return the contacts' positions along both tangents, counted from the hinge's foot on each: (3.13), (3.14)."""
    phi2, r1, r2 = phi2 + two.turn - one.turn, one.r + one.above, two.r + two.above
    along1 = (r1 * ca.cos(phi2) + r2) / ca.sin(phi2) - one.d
    along2 = (r2 * ca.cos(phi2) + r1) / ca.sin(phi2) + two.d
    return along1, along2


def readings(phi2: SX, one: Contact, two: Contact) -> tuple[SX, SX]:
    """Return (s1, s2), the distances hinge → contact along the palms: (3.13), (3.14); on an arc along = s sinc κs."""
    along1, along2 = alongs(phi2, one, two)
    return along1 / sinc(one.turn), along2 / sinc(two.turn)


def centre_of_mass(phi1: SX, phi2: SX, one: Contact, two: Contact) -> SX:
    """Return the centre of mass relative to the hinge (m)."""
    beta1, opening = phi1 + one.turn, phi2 + two.turn - one.turn
    return solve_from_normals(beta1, opening, one.r + one.above, two.r + two.above)
