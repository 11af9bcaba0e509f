"""Sticking and slipping bodies against Moreau's time stepping, solved by projected Gauss–Seidel.

Each step finds the impulses that satisfy the four contact conditions at its end, friction within its cone, without
distinguishing contact modes. The method is of first order. Static friction equals kinetic friction here; otherwise the
choice of the stuck palm at reversals would be ambiguous.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.rig.dry_plant import DryPlant
from palmd.rig.plant import FrictionSurface, Hinge, stable_poses
from palmd.rig.shapes import random_body
from palmd.rig.simulate import Rock, Rocking

STEP_S, G, SWEEPS = 5e-4, 9.81, 20
MU = 0.25
FIXED = Hinge("fixed", base=(0.0, 0.0))


@dataclass
class Stepped:
    """Position and velocity (x, y, ψ) of a body, by impulses; the hinge is the origin."""

    body: object
    q: np.ndarray
    v: np.ndarray

    def rows(self, palms):
        """For both contacts: gap, normal row, tangent row, and the palm's contribution to both rates."""
        (phi1, phi2), (w1, w2) = palms.angles, palms.rates
        x, y, psi = self.q
        found = []
        for rate, n in (
            (w1, (-math.sin(phi1), math.cos(phi1))),
            (w1 + w2, (math.sin(phi1 + phi2), -math.cos(phi1 + phi2))),
        ):
            out = math.atan2(-n[1], -n[0]) - psi
            h, slope, _ = self.body.support.at(out)
            u = np.array([math.cos(out + psi), math.sin(out + psi)])
            arm = h * u + slope * np.array([-u[1], u[0]])
            point = np.array([x, y]) + arm
            t = np.array([n[1], -n[0]])
            of_palm = rate * np.array([-point[1], point[0]])
            normal = np.array([*n, arm[0] * n[1] - arm[1] * n[0]])
            tangent = np.array([*t, arm[0] * t[1] - arm[1] * t[0]])
            gap = float(np.dot(n, point))
            found.append((gap, normal, tangent, float(np.dot(n, of_palm)), float(np.dot(t, of_palm))))
        return found

    def step(self, palms, dt, mu):
        inverse = np.array([1.0, 1.0, self.body.rho**-2])
        contacts = self.rows(palms)
        v = self.v + dt * np.array([0.0, -G, 0.0])
        pushed = np.zeros((2, 2))
        for _ in range(SWEEPS):
            for i, (gap, normal, tangent, lift, drag) in enumerate(contacts):
                closing = normal @ v - lift + gap / dt
                push = max(pushed[i, 0] - closing / (normal @ (inverse * normal)), 0.0)
                v = v + (push - pushed[i, 0]) * inverse * normal
                pushed[i, 0] = push
                rub = pushed[i, 1] - (tangent @ v - drag) / (tangent @ (inverse * tangent))
                rub = min(max(rub, -mu * push), mu * push)
                v = v + (rub - pushed[i, 1]) * inverse * tangent
                pushed[i, 1] = rub
        self.v, self.q = v, self.q + dt * v


def test_rolling_sticking_and_slipping_agree_with_time_stepping():
    """The stuck palm and the direction of slip change during the run."""
    rocking = Rocking(Rock(0.75, 0.5, 0.5, 0.3), Rock(1.65, 0.25, 0.8, 1.0))
    body = random_body("friction", np.random.default_rng(3))
    plant = DryPlant(body, FIXED, FrictionSurface(mu=MU))
    plant.place(rocking.at(0.0), stable_poses(body, rocking.at(0.0))[0])
    q = plant.state
    stepped = Stepped(body, np.array([q.x, q.y, q.psi]), np.array([q.vx, q.vy, q.omega0]))
    here, there, met = [], [], set()
    for k in range(1800):
        plant.advance(rocking.at((k + 0.5) * STEP_S), rocking.at((k + 1) * STEP_S), STEP_S)
        stepped.step(rocking.at((k + 1) * STEP_S), STEP_S, MU)
        here.append(plant.state.psi)
        there.append(stepped.q[2])
        met.add(plant.sticking())
    assert {(True, False), (False, True)} <= met
    assert np.ptp(here) > 0.2
    np.testing.assert_allclose(here, there, atol=6e-3)
