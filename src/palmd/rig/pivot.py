"""A body that turns freely in a gripper over one pad, as the emulated rig has it.

The plant knows the outline about the centre of mass and the constraint forces of pivot and contact (Newton–Euler with
one multiplier each), nothing of the support function about the pivot that observers go by. The pad lies along world x
at y = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.rig.shapes import Body

GRAVITY = 9.81

Axis = tuple[float, float, float]
"""Position (m), velocity (m/s), acceleration (m/s²) along one axis."""


@dataclass(frozen=True, slots=True)
class Grasp:
    """A body in the gripper over the pad: pivot (m, from the centre of mass, in the body), carriage kg and N s/m.

    The pad vibrates along itself much faster than the body moves; friction is dry, and the normal force alternates too.
    """

    body: Body
    pivot: tuple[float, float]
    mu: float
    dither: float
    damping: float
    carriage: float = 0.0
    carriage_damping: float = 0.0
    coulomb: bool = False

    def arm(self, psi: float) -> tuple[float, float]:
        """From the centre of mass to the pivot, in the world (m)."""
        c, s = math.cos(psi), math.sin(psi)
        x, y = self.pivot
        return c * x - s * y, s * x + c * y

    def height(self, psi: float) -> float:
        """Of the pivot over the pad while the body touches it (m)."""
        return self.body.support.at(-0.5 * math.pi - psi)[0] + self.arm(psi)[1]

    def offset(self, psi: float) -> float:
        """From below the pivot to the contact along the pad (m)."""
        return self.body.support.at(-0.5 * math.pi - psi)[1] - self.arm(psi)[0]

    def bend(self, psi: float) -> float:
        """h_P″ at the contact (m)."""
        return self.body.support.at(-0.5 * math.pi - psi)[2] - self.arm(psi)[1]

    def rubs(self, slip: float) -> tuple[tuple[float, float], ...]:
        """(share of the time, friction as a share of the normal force) of each way to slip, at a mean slip (m/s)."""
        if self.coulomb:
            return ((1.0, self.mu * math.tanh(slip / self.dither)),)
        forward = 0.5 + math.asin(min(max(slip / self.vibration, -1.0), 1.0)) / math.pi
        return tuple((share, grip) for share, grip in ((forward, self.mu), (1.0 - forward, -self.mu)) if share > 0.0)

    @property
    def vibration(self) -> float:
        """Amplitude of the pad's speed along itself (m/s), by which the friction of slow slip is that of `dither`."""
        return 2.0 / math.pi * self.dither

    def torque_left(
        self, psi: float, omega: float, alpha: float, x: Axis, vertical: Axis | None, grip: float
    ) -> tuple[float, float]:
        """(what is left of the torque about the centre of mass, N m; the pad's force, N) if it turned with `alpha`.

        vertical: the pivot's motion where the gripper is rigid; otherwise the carriage obeys its own weight. grip: of
        friction as a share of the normal force, at one instant.
        """
        body = self.body
        m, inertia = body.mass, body.mass * body.rho**2
        h, h1, h2 = body.support.at(-0.5 * math.pi - psi)
        rx, ry = self.arm(psi)
        ax = x[2] + alpha * ry + omega * omega * rx  # of the centre of mass: the pivot's less that of the arm between
        ay = -h1 * alpha + h2 * omega * omega  # it is h above the pad
        if vertical is None:
            z1 = -h1 * omega + omega * rx
            z2 = ay + alpha * rx - omega * omega * ry
            py = -self.carriage * (z2 + GRAVITY) - self.carriage_damping * z1
            normal = m * (ay + GRAVITY) - py
        if vertical is not None:
            ay = vertical[2] - alpha * rx + omega * omega * ry
            # torque: N (h' − grip·h) + rx py − ry px − C ω = I α, with px, py from Newton's law, linear in N
            lever = (h1 - grip * h) - rx - ry * grip
            rest = rx * m * (ay + GRAVITY) - ry * m * ax - m * self.damping * omega - inertia * alpha
            normal = -rest / lever if abs(lever) > 1e-9 else math.nan
            return 0.0, normal
        px = m * ax + grip * normal
        torque = normal * (h1 - grip * h) + rx * py - ry * px - m * self.damping * omega - inertia * alpha
        return torque, normal

    def pressed(self, psi: float, omega: float, alpha: float, x: Axis, z: Axis) -> float:
        """The pad's force (N) under a rigid gripper, on average; NaN where the body wedges for part of the time."""
        mean = 0.0
        for share, grip in self.rubs(self._slip(psi, omega, x)):
            force = self.torque_left(psi, omega, alpha, x, z, grip)[1]
            if not force > 0.0:
                return math.nan
            mean += share * force
        return mean

    def motion(self, psi: float, omega: float, x: Axis) -> tuple[float, float]:
        """(angular acceleration, the pad's force in N) of the sliding gripper, on average."""
        mean_alpha = mean_force = 0.0
        for share, grip in self.rubs(self._slip(psi, omega, x)):
            at0, force0 = self.torque_left(psi, omega, 0.0, x, None, grip)
            at1, force1 = self.torque_left(psi, omega, 1.0, x, None, grip)
            alpha = at0 / (at0 - at1)
            mean_alpha += share * alpha
            mean_force += share * (force0 + alpha * (force1 - force0))
        return mean_alpha, mean_force

    def _slip(self, psi: float, omega: float, x: Axis) -> float:
        """Along the pad (m/s)."""
        return x[1] + omega * self.height(psi)
