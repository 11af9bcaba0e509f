"""The symbolic dynamics against other formulations: constraint geometry, statics, and the Newton-Euler plant."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from palmd.model.contact import Contact, offsets, readings
from palmd.model.dynamics import BodyConstants, Palms, newton_euler

GRAVITY = 9.81
AVERAGED = (*[0] * 6, 1, 1, *[0] * 5)  # after (g, L1): friction by the averaged law, as in the plant


class Lump:
    """A smooth convex body in plain Python: h(θ) = a + b cos(kθ + c)."""

    def __init__(self, random: np.random.Generator) -> None:
        self.terms = [(0, random.uniform(0.016, 0.024), 0.0)] + [
            (k, random.uniform(-1, 1) * 0.8e-3 * (2 / k) ** 2, random.uniform(0, 6)) for k in range(1, 6)
        ]

    def h(self, theta: float) -> float:
        return sum(a * math.cos(k * theta + c) for k, a, c in self.terms)

    def contact(self, theta: float) -> tuple[float, float, float]:
        d = sum(a * k * math.sin(k * theta + c) for k, a, c in self.terms)
        v = sum(a * (1 - k * k) * math.cos(k * theta + c) for k, a, c in self.terms)
        return self.h(theta), d, v


def _model(rig: tuple[float, float]) -> ca.Function:
    p, w, body = ca.SX.sym("p", 6), ca.SX.sym("w"), ca.SX.sym("b", 4)
    c = ca.SX.sym("c", 6)
    palms = Palms(*(p[i] for i in range(6)))
    motion = newton_euler(
        palms, w, Contact(c[0], c[1], c[2]), Contact(c[3], c[4], c[5]),
        BodyConstants(*(body[i] for i in range(4))), ca.SX([*rig, *AVERAGED]),
    )  # fmt: skip
    return ca.Function("m", [p, w, c, body], [motion.alpha0, motion.f1, motion.f2])


def _com(lump: Lump, phi1: float, phi2: float, psi: float) -> np.ndarray:
    """The COM from its distances to both palms, by a plain linear solve."""
    phi12 = phi1 + phi2
    normals = np.array([[-math.sin(phi1), math.cos(phi1)], [math.sin(phi12), -math.cos(phi12)]])
    h = [lump.h(phi1 - psi - math.pi / 2), lump.h(phi12 - psi - 3 * math.pi / 2)]
    return np.linalg.solve(normals, h)


def _state(random: np.random.Generator) -> tuple[Lump, np.ndarray, float, float]:
    palms = np.array([
        random.uniform(0.3, 1.2), random.uniform(1.3, 1.8), *random.uniform(-1, 1, 2), *random.uniform(-5, 5, 2)
    ])  # fmt: skip
    return Lump(random), palms, random.uniform(-math.pi, math.pi), random.uniform(-3, 3)


def _contacts(lump: Lump, palms: np.ndarray, psi: float) -> list[float]:
    theta1 = palms[0] - psi - math.pi / 2
    theta2 = palms[0] + palms[1] - psi - 3 * math.pi / 2
    return [*lump.contact(theta1), *lump.contact(theta2)]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("arm", [0.0, 0.12])
def test_the_forces_produce_the_motion_that_the_constraint_requires(seed: int, arm: float) -> None:
    """Differentiates the constraint's geometry numerically and solves Newton's and Euler's equations for f1, f2, α0."""
    random = np.random.default_rng(seed)
    lump, palms, psi, omega0 = _state(random)
    rho, mu, dither, damping = 0.014, 0.2, 0.01, 3e-4
    alpha0, f1, f2 = (
        float(v)
        for v in _model((GRAVITY, arm)).call([palms, omega0, _contacts(lump, palms, psi), [rho, mu, dither, damping]])
    )

    def world_com(t: float) -> np.ndarray:
        phi1, phi2 = palms[:2] + palms[2:4] * t + palms[4:] * t * t / 2
        hinge = -arm * np.array([math.cos(phi1), math.sin(phi1)])
        return hinge + _com(lump, phi1, phi2, psi + omega0 * t + alpha0 * t * t / 2)

    def material(t: float, number: int) -> np.ndarray:
        """Position of the material point that touches palm `number` at t = 0, relative to the palm's own points."""
        phi1, phi2 = palms[:2] + palms[2:4] * t
        angle = phi1 if number == 0 else phi1 + phi2
        sign = 1 - 2 * number
        along = sign * np.array([math.cos(angle), math.sin(angle)])
        r, d = _contacts(lump, palms, psi)[3 * number : 3 * number + 2]
        start = palms[0] if number == 0 else palms[0] + palms[1]
        t0 = sign * np.array([math.cos(start), math.sin(start)])
        n0 = np.array([-t0[1], t0[0]])
        turn = omega0 * t
        arm_ = -(r * n0 + d * t0)
        turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]) @ arm_
        return float(along @ (_com(lump, phi1, phi2, psi + omega0 * t) + turned))

    step = 1e-4
    acceleration = (world_com(step) - 2 * world_com(0) + world_com(-step)) / step**2
    force = np.array([0.0, -GRAVITY])
    torque = -damping * omega0
    for number, f in enumerate((f1, f2)):
        angle = palms[0] + number * palms[1]
        t = (1 - 2 * number) * np.array([math.cos(angle), math.sin(angle)])
        n = np.array([-t[1], t[0]])
        r, d = _contacts(lump, palms, psi)[3 * number : 3 * number + 2]
        slip = (material(step, number) - material(-step, number)) / (2 * step)
        pull = f * (n - mu * slip / math.hypot(slip, dither) * t)
        arm_ = -(r * n + d * t)
        force += pull
        torque += arm_[0] * pull[1] - arm_[1] * pull[0]
    assert force == pytest.approx(acceleration, abs=2e-4)
    assert torque == pytest.approx(rho**2 * alpha0, abs=1e-7)


def test_a_disc_at_rest_has_the_forces_of_statics() -> None:
    """f1 = g sin φ12 / sin φ2 and f2 = g sin φ1 / sin φ2 per unit mass."""
    phi1, phi2 = 0.6, 1.6
    contacts = [0.02, 0.0, 0.02] * 2
    alpha0, f1, f2 = _model((GRAVITY, 0.0)).call([[phi1, phi2, 0, 0, 0, 0], 0, contacts, [0.014, 0.0, 0.01, 0.0]])
    assert float(alpha0) == pytest.approx(0.0, abs=1e-12)
    assert float(f1) == pytest.approx(GRAVITY * math.sin(phi1 + phi2) / math.sin(phi2))
    assert float(f2) == pytest.approx(GRAVITY * math.sin(phi1) / math.sin(phi2))


def test_offsets_invert_readings() -> None:
    phi2, r1, r2, d1, d2 = 1.4, 0.02, 0.019, 1e-3, -2e-3
    one, two = (Contact(ca.SX(r), ca.SX(d), ca.SX(0)) for r, d in ((r1, d1), (r2, d2)))
    s1, s2 = readings(ca.SX(phi2), one, two)
    back = offsets(ca.SX(phi2), ca.SX(r1), ca.SX(r2), s1, s2)
    assert [float(ca.DM(v)) for v in back] == pytest.approx([d1, d2])
