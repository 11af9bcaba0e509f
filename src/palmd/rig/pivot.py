"""A body that turns freely in a gripper over one pad, as the emulated rig simulates it.

The plant uses the outline about the centre of mass and the constraint forces of pivot and contact (Newton–Euler with
one multiplier each), not the support function about the pivot that observers use. The pad lies along world x at y = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.rig.shapes import Body

GRAVITY = 9.81
TUMBLING_RAD_S = 100.0

Axis = tuple[float, float, float]
"""Position (m), velocity (m/s), acceleration (m/s²) along one axis."""


@dataclass(frozen=True, slots=True)
class Grasp:
    """A body in the gripper over the pad: pivot (m, from the centre of mass, in the body), carriage in kg and N s/m.

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
        """Vector from the centre of mass to the pivot, in the world (m)."""
        c, s = math.cos(psi), math.sin(psi)
        x, y = self.pivot
        return c * x - s * y, s * x + c * y

    def height(self, psi: float) -> float:
        """Height of the pivot over the pad while the body touches it (m)."""
        return self.body.support.at(-0.5 * math.pi - psi)[0] + self.arm(psi)[1]

    def offset(self, psi: float) -> float:
        """Distance along the pad from below the pivot to the contact (m)."""
        return self.body.support.at(-0.5 * math.pi - psi)[1] - self.arm(psi)[0]

    def bend(self, psi: float) -> float:
        """h_P″ at the contact (m)."""
        return self.body.support.at(-0.5 * math.pi - psi)[2] - self.arm(psi)[1]

    def friction_phases(self, slip: float) -> tuple[tuple[float, float], ...]:
        """(fraction of the time, friction over normal force) for each direction of slip, at a mean slip (m/s)."""
        if self.coulomb:
            return ((1.0, self.mu * math.tanh(slip / self.dither)),)
        forward = 0.5 + math.asin(min(max(slip / self.vibration, -1.0), 1.0)) / math.pi
        return tuple(
            (fraction, friction_ratio)
            for fraction, friction_ratio in ((forward, self.mu), (1.0 - forward, -self.mu))
            if fraction > 0.0
        )

    @property
    def vibration(self) -> float:
        """Amplitude of the pad's speed along itself (m/s) that gives slow slip the same friction as `dither`."""
        return 2.0 / math.pi * self.dither

    def torque_residual(
        self, psi: float, omega: float, alpha: float, x: Axis, vertical: Axis | None, friction_ratio: float
    ) -> tuple[float, float]:
        """(residual torque about the centre of mass, N m; the pad's force, N) for an angular acceleration `alpha`.

        vertical: the pivot's motion if the gripper is rigid; otherwise the carriage moves under its own weight.
        friction_ratio: friction over normal force, at one instant.
        """
        body = self.body
        m, inertia = body.mass, body.mass * body.rho**2
        h, h1, h2 = body.support.at(-0.5 * math.pi - psi)
        rx, ry = self.arm(psi)
        ax = x[2] + alpha * ry + omega * omega * rx  # of the centre of mass: the pivot's minus the lever arm's
        ay = -h1 * alpha + h2 * omega * omega  # its height is h above the pad
        if vertical is None:
            z1 = -h1 * omega + omega * rx
            z2 = ay + alpha * rx - omega * omega * ry
            py = -self.carriage * (z2 + GRAVITY) - self.carriage_damping * z1
            normal = m * (ay + GRAVITY) - py
        if vertical is not None:
            ay = vertical[2] - alpha * rx + omega * omega * ry
            # torque: N (h' − ratio·h) + rx py − ry px − C ω = I α, with px, py from Newton's law, linear in N
            lever = (h1 - friction_ratio * h) - rx - ry * friction_ratio
            constant = rx * m * (ay + GRAVITY) - ry * m * ax - m * self.damping * omega - inertia * alpha
            normal = -constant / lever if abs(lever) > 1e-9 else math.nan
            return 0.0, normal
        px = m * ax + friction_ratio * normal
        torque = normal * (h1 - friction_ratio * h) + rx * py - ry * px - m * self.damping * omega - inertia * alpha
        return torque, normal

    def rigid_contact_force(self, psi: float, omega: float, alpha: float, x: Axis, z: Axis) -> float:
        """The pad's mean force (N) under a rigid gripper; NaN where the body wedges for part of the time."""
        mean = 0.0
        for fraction, friction_ratio in self.friction_phases(self._slip(psi, omega, x)):
            force = self.torque_residual(psi, omega, alpha, x, z, friction_ratio)[1]
            if not force > 0.0:
                return math.nan
            mean += fraction * force
        return mean

    def motion(self, psi: float, omega: float, x: Axis) -> tuple[float, float]:
        """(angular acceleration, the pad's force in N) of the sliding gripper, mean over the vibration."""
        mean_alpha = mean_force = 0.0
        for fraction, friction_ratio in self.friction_phases(self._slip(psi, omega, x)):
            residual0, force0 = self.torque_residual(psi, omega, 0.0, x, None, friction_ratio)
            residual1, force1 = self.torque_residual(psi, omega, 1.0, x, None, friction_ratio)
            alpha = residual0 / (residual0 - residual1)
            mean_alpha += fraction * alpha
            mean_force += fraction * (force0 + alpha * (force1 - force0))
        return mean_alpha, mean_force

    def _slip(self, psi: float, omega: float, x: Axis) -> float:
        """Slip along the pad (m/s)."""
        return x[1] + omega * self.height(psi)


@dataclass(slots=True)
class Slide:
    """A body in a gripper on a vertical slide, standing on the pad: it rolls under friction and its weight.

    Orientation (rad) and its rate (rad/s). It starts at rest: an impact of the falling carriage is dissipated.
    """

    grasp: Grasp
    psi: float
    omega: float = 0.0

    def advance(self, before: Axis, now: Axis, step_s: float, middle: Axis | None = None) -> float:
        """Advance by a step (s) in which the arm moves along the pad from `before` to `now`; returns the force (N).

        One step of the fourth-order Runge–Kutta method; `middle`: motion at half the step, by default the mean of both
        ends. NaN if the body tumbles.
        """
        grasp, h, psi, omega = self.grasp, step_s, self.psi, self.omega
        middle = middle or (0.5 * (before[0] + now[0]), 0.5 * (before[1] + now[1]), 0.5 * (before[2] + now[2]))
        a1, _ = grasp.motion(psi, omega, before)
        w2 = omega + 0.5 * h * a1
        a2, _ = grasp.motion(psi + 0.5 * h * omega, w2, middle)
        w3 = omega + 0.5 * h * a2
        a3, _ = grasp.motion(psi + 0.5 * h * w2, w3, middle)
        w4 = omega + h * a3
        a4, force = grasp.motion(psi + h * w3, w4, now)
        self.psi += h / 6.0 * (omega + 2.0 * w2 + 2.0 * w3 + w4)
        self.omega += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        return force if abs(self.omega) < TUMBLING_RAD_S else math.nan
