"""The emulated slide: energy is conserved without friction, and friction makes it roll."""

import math
from dataclasses import replace

import numpy as np
import pytest

from palmd.rig.pivot import GRAVITY, Grasp, Slide
from palmd.rig.shapes import random_body

STEP_S = 5e-4


@pytest.fixture
def grasp():
    body = replace(random_body("rig", np.random.default_rng(4)), mass=0.08)
    return Grasp(body, (0.002, 0.001), mu=0.3, dither=0.012, damping=0.0, carriage=0.05)


def energy(slide):
    """Energy of body and carriage with the pivot at rest along the pad, from the positions of their centres."""
    grasp, psi, omega = slide.grasp, slide.psi, slide.omega
    h, slope, _ = grasp.body.support.at(-0.5 * math.pi - psi)
    m, carriage = grasp.body.mass, grasp.carriage
    across, up, lifted = omega * grasp.arm(psi)[1], -slope * omega, -grasp.offset(psi) * omega
    turning = 0.5 * m * (grasp.body.rho * omega) ** 2
    moving = 0.5 * m * (across**2 + up**2) + 0.5 * carriage * lifted**2
    return turning + moving + GRAVITY * (m * h + carriage * grasp.height(psi))


def test_without_friction_energy_is_conserved(grasp):
    slide = Slide(replace(grasp, mu=0.0), 0.4)
    before, still = energy(slide), (0.0277, 0.0, 0.0)
    rates = []
    for _ in range(2000):
        slide.advance(still, still, STEP_S)
        rates.append(abs(slide.omega))
    assert max(rates) > 0.5
    lost = 0.5 * grasp.body.mass * (grasp.body.rho * max(rates)) ** 2 * 1e-3
    assert energy(slide) == pytest.approx(before, abs=lost)


def test_a_dragged_body_rolls_and_the_pad_carries_its_weight(grasp):
    slide, speed, forces, began = Slide(grasp, 0.0), 0.01, [], 0.0
    places = [speed * k * STEP_S for k in range(4001)]
    for k in range(4000):
        forces.append(slide.advance((places[k], speed, 0.0), (places[k + 1], speed, 0.0), STEP_S))
        began = slide.psi if k == 1999 else began
    weight = (grasp.body.mass + grasp.carriage) * GRAVITY
    assert np.mean(forces) == pytest.approx(weight, rel=0.01)
    rolled, height = began - slide.psi, grasp.height(slide.psi)
    assert rolled == pytest.approx(speed * 1.0 / height, rel=0.5)  # minus the slip that its lever needs


def test_a_tumbling_body_has_no_force(grasp):
    assert math.isnan(Slide(grasp, 0.0, omega=500.0).advance((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), STEP_S))
