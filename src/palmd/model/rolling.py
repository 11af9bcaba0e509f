"""An object that sticks to one palm and slips along the other: kinematics, normal forces and friction. Pure.

A sticking contact rolls: it moves as far along the palm as along the outline, ṡ1 = v1 θ̇1 or ṡ2 = −v2 θ̇2. By (3.13)
and (3.14) both can be integrated. While the object sticks to palm 1 or palm 2, the invariant is

    Q1 = (r1 cos φ2 + r2)/sin φ2 − ∫h(θ1),        Q2 = (r2 cos φ2 + r1)/sin φ2 + ∫h(θ2).

Hence ψ follows from the palms' angles alone: no force, no inertia, no process noise. Along the other palm the object
slips, against t at dQ1/dt, or along t at −dQ2/dt. It turns about the sticking contact as the palms prescribe; by the
theorem of three centres (Kennedy)

    u2 = ω2 s1 s2 sin φ2/(s2 − s1 cos φ2)    if it sticks to palm 1,
    u1 = −ω2 s1 s2 sin φ2/(s1 − s2 cos φ2)   if it sticks to palm 2.

The direction of slip thus depends on the palms' motion only. Friction at the slipping contact is μN; the three
Newton–Euler equations then give both normal forces and the friction of the sticking contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model import shape
from palmd.system.mechanism import JOINTS, OPENING, directions, normal_directions

SLIPS_SIGN = (-1.0, 1.0)
"""Sign of the slip along t at palms 1 and 2, relative to the sign of ω2, while the object sticks to the other palm."""


@dataclass(frozen=True, slots=True)
class Lying:
    """Rows that map coefficients of h to h, h′, h″ and ∫h at the contacts of an object with both palms, at n instants.

    h, slope: a pair, (n, coefficients) for each palm. palms: (n, 6), φ1, φ2, their rates and accelerations. theta: the
    normals at the contacts, (n,) each. k: harmonic of each coefficient.
    """

    palms: FloatArray
    theta: tuple[FloatArray, FloatArray]
    k: FloatArray
    h: tuple[FloatArray, FloatArray]
    slope: tuple[FloatArray, FloatArray]

    @classmethod
    def at(cls, palms: FloatArray, psi: FloatArray, order: int) -> Lying:
        """Rows at orientations psi (n, rad) for an outline with `order` harmonics."""
        one, two = normal_directions(palms[:, : len(JOINTS)].T, psi)
        h = shape.basis(one, order), shape.basis(two, order)
        k = shape.harmonic_of_coefficient(order)
        return cls(palms, (one, two), k, h, (shape.slope_of(h[0]), shape.slope_of(h[1])))

    def bend(self, palm: int) -> FloatArray:
        """Rows of h″ at a palm."""
        rows: FloatArray = -(self.k**2) * self.h[palm]
        return rows

    def integral(self, palm: int) -> FloatArray:
        """Rows of ∫h at a palm."""
        rows: FloatArray = -self.slope[palm] / np.maximum(self.k, 1.0) ** 2
        rows[:, 0] = self.theta[palm]
        return rows

    def kept(self, palm: int) -> FloatArray:
        """Rows that map the coefficients to Q1 (`palm` 0) or Q2 (1)."""
        sign = 1.0 if palm else -1.0
        return self._lever(self.h, palm) + sign * self.integral(palm)

    def kept_turned(self, palm: int) -> FloatArray:
        """Rows that map the coefficients to dQ/dψ (m/rad)."""
        sign = 1.0 if palm else -1.0
        return -(self._lever(self.slope, palm) + sign * self.h[palm])

    def kept_opened(self, palm: int, shape_of: FloatArray, standoffs: FloatArray) -> FloatArray:
        """dQ/dφ2 (m/rad) at constant φ1 and ψ; `standoffs`: of the palms' surfaces (m)."""
        return self._opened(palm, self.h[1], shape_of, standoffs)

    def contact(self, palm: int) -> FloatArray:
        """Rows that map the coefficients to s of a palm; (3.13), (3.14)."""
        sign = 1.0 if palm else -1.0
        return self._lever(self.h, palm) - sign * self.slope[palm]

    def contact_turned(self, palm: int) -> FloatArray:
        """Rows that map the coefficients to ds/dψ (m/rad)."""
        sign = 1.0 if palm else -1.0
        return -(self._lever(self.slope, palm) - sign * self.bend(palm))

    def contact_opened(self, palm: int, shape_of: FloatArray, standoffs: FloatArray) -> FloatArray:
        """ds/dφ2 (m/rad) at constant φ1 and ψ, as in `kept_opened`."""
        return self._opened(palm, -self.bend(1), shape_of, standoffs)

    def standing_off(self, palm: int) -> FloatArray:
        """Rows (n, 2) that map the palms' standoffs (m) to their contribution to Q and s of a palm."""
        opening = self.palms[:, OPENING]
        own, other = np.cos(opening) / np.sin(opening), 1.0 / np.sin(opening)
        return np.stack([other, own] if palm else [own, other], axis=1)

    def _opened(self, palm: int, moved: FloatArray, shape_of: FloatArray, standoffs: FloatArray) -> FloatArray:
        """Derivative by φ2; moved: rows of ∂/∂θ2 of what is added to the lever on palm 2."""
        opening = self.palms[:, OPENING]
        rows = self.slope[1] * np.cos(opening[:, None]) ** palm / np.sin(opening[:, None]) + palm * moved
        # the derivative of (own cos φ2 + other)/sin φ2 with both distances from the hinge lines held constant
        one, two = (rows @ shape_of + off for rows, off in zip(self.h, standoffs.tolist(), strict=True))
        own, other = (two, one) if palm else (one, two)
        opened: FloatArray = rows @ shape_of - (own + other * np.cos(opening)) / np.sin(opening) ** 2
        return opened

    def _lever(self, rows: tuple[FloatArray, FloatArray], palm: int) -> FloatArray:
        opening = self.palms[:, OPENING, None]
        lever: FloatArray = (rows[palm] * np.cos(opening) + rows[1 - palm]) / np.sin(opening)
        return lever


def normal_forces(
    stuck: npt.NDArray[np.intp], ratio: FloatArray, palms: FloatArray, h: tuple[FloatArray, FloatArray],
    slope: tuple[FloatArray, FloatArray], pull: tuple[FloatArray, FloatArray], spun: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """f1 and f2 (n,) per unit mass (m/s²) of an object that sticks to palm `stuck` (0 or 1) and slips on the other.

    ratio: friction over normal force at the slipping contact, against t. h, slope: h and h′ at both contacts (m). pull:
    acceleration of the COM minus gravity, along X and Y (m/s²). spun: ρ²α0 (m²/s²). The friction T of the sticking
    contact is eliminated from Σ f_i (n_i − k_i t_i) − T t = pull and Σ f_i (h_i′ − k_i h_i) − T h = ρ²α0.
    """
    first, second = directions(palms[:, : len(JOINTS)].T)
    sign = np.where(stuck, -1.0, 1.0)  # sign of sin φ2 as seen from the other palm
    cos, sin = np.cos(palms[:, OPENING]), sign * np.sin(palms[:, OPENING])
    angle = np.where(stuck, second + math.pi, first)
    along, across = (
        np.cos(angle) * pull[0] + np.sin(angle) * pull[1],
        np.cos(angle) * pull[1] - np.sin(angle) * pull[0],
    )
    h_own, h_other = np.where(stuck, h[::-1], h)
    slope_own, slope_other = np.where(stuck, slope[::-1], slope)
    through = ratio * sin - cos
    lever = slope_other - ratio * h_other - h_own * (sin + ratio * cos)
    other = (spun - h_own * along - slope_own * across) / (lever - slope_own * through)
    own = across - through * other
    return np.where(stuck, other, own), np.where(stuck, own, other)


def friction_asked(
    stuck: npt.NDArray[np.intp], ratio: FloatArray, palms: FloatArray, pull: tuple[FloatArray, FloatArray],
    forces: tuple[FloatArray, FloatArray],
) -> FloatArray:  # fmt: skip
    """Friction over normal force that the sticking contact needs, against t: t·(Σ f F − pull)/f."""
    first, second = directions(palms[:, : len(JOINTS)].T)
    sign = np.where(stuck, -1.0, 1.0)
    angle = np.where(stuck, second + math.pi, first)
    along = np.cos(angle) * pull[0] + np.sin(angle) * pull[1]
    own, other = np.where(stuck, forces[::-1], forces)
    needed: FloatArray = (other * (sign * np.sin(palms[:, OPENING]) + ratio * np.cos(palms[:, OPENING])) - along) / own
    return needed
