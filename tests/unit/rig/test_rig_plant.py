"""The emulated plant against statics, conservation laws and an independent simulator's runs."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from palmd.events import PalmMotion
from palmd.rig.friction import plant_on
from palmd.rig.plant import FrictionSurface, Hinge, Plant, PlantOptions, stable_poses
from palmd.rig.shapes import Body, Support, random_body
from palmd.rig.simulate import Rock, Rocking

G = 9.81
STEP = 5e-4
FIXED = Hinge("fixed", base=(0.0, 0.0))
REFERENCE = json.loads((Path(__file__).parents[2] / "data" / "rig_reference.json").read_text())["runs"]
AT_REST = PalmMotion.at_rest((0.7, 1.6))


def body(seed: int = 0) -> Body:
    return random_body("rig", np.random.default_rng(seed))


def disc(radius: float = 0.02) -> Body:
    return Body("disc", Support.from_coefficients((complex(radius), 0j)), radius / math.sqrt(2), 0.1)


def run(plant: Plant, palms: PalmMotion, seconds: float) -> None:
    for _ in range(round(seconds / STEP)):
        plant.advance(palms, palms, STEP)


@pytest.mark.parametrize("seed", range(3))
def test_static_forces_and_geometry(seed):
    plant = Plant(body(seed), FIXED, FrictionSurface(mu=0.2))
    phi1, phi2 = AT_REST.angles
    plant.place(AT_REST, stable_poses(plant.body, AT_REST)[0])
    contact1, contact2 = plant.contacts()
    mass = plant.body.mass
    assert contact1.force == pytest.approx(mass * G * math.sin(phi1 + phi2) / math.sin(phi2), rel=1e-5)
    assert contact2.force == pytest.approx(mass * G * math.sin(phi1) / math.sin(phi2), rel=1e-5)
    r1, r2 = plant.radii()
    psi = plant.state.psi
    d1 = -plant.body.support.at(phi1 - psi - math.pi / 2)[1]
    d2 = -plant.body.support.at(phi1 + phi2 - psi - 3 * math.pi / 2)[1]
    assert contact1.s == pytest.approx((r1 * math.cos(phi2) + r2) / math.sin(phi2) - d1, abs=1e-12)
    assert contact2.s == pytest.approx((r2 * math.cos(phi2) + r1) / math.sin(phi2) + d2, abs=1e-12)
    run(plant, AT_REST, 0.5)
    assert plant.state.psi == pytest.approx(psi, abs=1e-6)


def test_energy_is_conserved_without_friction():
    plant = Plant(body(1), FIXED, FrictionSurface())
    plant.place(AT_REST, stable_poses(plant.body, AT_REST)[0] + 0.5)
    start = plant.energy()
    swing = 0.0
    for _ in range(4000):
        plant.advance(AT_REST, AT_REST, STEP)
        swing = max(swing, abs(plant.state.omega0))
    assert swing > 1.0
    assert plant.touching == (True, True)
    assert plant.energy() == pytest.approx(start, abs=1e-8)


@pytest.mark.parametrize("surface", [FrictionSurface(mu=0.1), FrictionSurface(damping=5e-4)])
def test_friction_and_damping_only_dissipate_energy(surface):
    plant = Plant(body(1), FIXED, surface)
    plant.place(AT_REST, stable_poses(plant.body, AT_REST)[0] + 0.5)
    energies = []
    for _ in range(1000):
        plant.advance(AT_REST, AT_REST, STEP)
        energies.append(plant.energy())
    assert np.all(np.diff(energies) < 1e-9)
    assert energies[-1] < energies[0] - 1e-4


def test_a_disc_without_torque_does_not_turn():
    plant = Plant(disc(), Hinge("arc", 0.12, (0.12, 0.0)), FrictionSurface())
    rocking = Rocking(Rock(0.7, 0.4, 0.5, 0.3), Rock(1.6, 0.2, 0.4, 1.0))
    plant.place(rocking.at(0.0), 0.0, omega0=1.5)
    for k in range(2000):
        plant.advance(rocking.at((k + 0.5) * STEP), rocking.at((k + 1) * STEP), STEP)
    assert plant.state.omega0 == pytest.approx(1.5, abs=1e-12)
    assert plant.touching == (True, True)


@pytest.mark.parametrize("run_data", REFERENCE, ids=lambda run_data: run_data["name"])
def test_the_plant_agrees_with_an_independent_simulator(run_data):
    support = Support.from_coefficients(tuple(complex(*c) for c in run_data["h_harmonics_m"]))
    hinge = Hinge(run_data["hinge"]["mode"], run_data["hinge"].get("palm1_length_m", 0.12))
    surface = FrictionSurface(run_data["mu"], run_data["dither_m_s"], run_data["damping_m2_s"])
    plant = Plant(Body("given", support, run_data["rho_m"], run_data["mass_kg"]), hinge, surface)
    rocking = Rocking(Rock(*run_data["palm1"]), Rock(*run_data["palm2"]))
    plant.place(rocking.at(0.0), 0.0)
    psi, s1, f2 = [], [], []
    every = round(run_data["step_s"] / STEP)
    for k in range(every * (len(run_data["psi_rad"]) - 1) + 1):
        if k % every == 0:
            contact1, contact2 = plant.contacts()
            psi.append(plant.state.psi)
            s1.append(contact1.s)
            f2.append(contact2.force)
        plant.advance(rocking.at((k + 0.5) * STEP), rocking.at((k + 1) * STEP), STEP)
    np.testing.assert_allclose(psi, run_data["psi_rad"], atol=1e-6)
    np.testing.assert_allclose(s1, run_data["s1_m"], atol=1e-8)
    np.testing.assert_allclose(f2, run_data["f2_n"], atol=1e-5)


def test_palms_that_drop_away_lose_and_regain_contact():
    """The palms turn down faster than the body can fall; then they stop and it lands on them."""
    plant = Plant(disc(), FIXED, FrictionSurface(mu=0.1))
    phi1, rate, dt = 0.7, 0.0, STEP
    plant.place(PalmMotion.at_rest((phi1, 1.7)), 0.0)
    lost = 0
    for k in range(1000):
        alpha = -900.0 if k < 16 else 900.0 if k < 32 else 0.0
        middle = PalmMotion((phi1 + rate * dt / 2 + alpha * dt**2 / 8, 1.7), (rate + alpha * dt / 2, 0.0), (alpha, 0.0))
        phi1, rate = phi1 + rate * dt + alpha * dt**2 / 2, rate + alpha * dt
        plant.advance(middle, PalmMotion((phi1, 1.7), (rate, 0.0), (alpha, 0.0)), dt)
        lost += plant.touching != (True, True)
    assert lost > 5
    assert plant.touching == (True, True)
    assert not plant.fallen
    contact1, contact2 = plant.contacts()
    assert contact1.force == pytest.approx(0.1 * G * math.sin(phi1 + 1.7) / math.sin(1.7), rel=0.05)
    assert contact2.force == pytest.approx(0.1 * G * math.sin(phi1) / math.sin(1.7), rel=0.05)


def test_a_landing_dissipates_energy_and_does_not_bounce():
    plant = Plant(disc(), FIXED, FrictionSurface())
    plant.place(AT_REST, 0.0)
    plant.state.vx, plant.state.vy = 0.0, 0.5  # thrown up
    highest = plant.state.y
    before = plant.energy()
    for _ in range(400):
        plant.advance(AT_REST, AT_REST, STEP)
        highest = max(highest, plant.state.y)
    assert highest == pytest.approx(0.02 / math.sin(0.8) + 0.5**2 / (2 * G), abs=3e-3)
    assert plant.touching == (True, True)
    assert plant.energy() < before - 0.05
    assert math.hypot(plant.state.vx, plant.state.vy) < 1e-3


def test_a_body_beyond_the_pad_falls_off_and_can_be_put_back():
    plant = Plant(disc(), FIXED, FrictionSurface(), reach=(0.0555, 0.0555))
    narrow = PalmMotion.at_rest((0.9, 0.6))  # far out: s = r / tan(phi2 / 2) = 65 mm
    plant.place(narrow, 0.0)
    assert plant.fallen
    assert plant.touching == (False, False)
    before = plant.state.y
    run(plant, narrow, 0.01)
    assert plant.state.y == before
    plant.place(AT_REST, 0.0)
    assert not plant.fallen


def test_a_body_that_lands_beyond_the_pad_falls_off():
    plant = Plant(disc(), FIXED, FrictionSurface())
    flat = PalmMotion.at_rest((0.2, 2.0))
    plant.place(flat, 0.0)
    assert not plant.fallen
    plant.state.vx, plant.state.vy = 0.8, 0.5  # thrown over the end of palm 1
    run(plant, flat, 0.3)
    assert plant.fallen
    assert plant.touching == (False, False)


def test_a_pinned_hinge_is_the_fixed_rig():
    rocking = Rocking(Rock(0.7, 0.4, 0.5, 0.3), Rock(1.6, 0.2, 0.4, 1.0))
    ends = []
    for hinge, options in (
        (FIXED, PlantOptions()),
        (Hinge("arc", 0.12, (0.12, 0.0)), PlantOptions(hinge_travels=False)),
        (Hinge("arc", 0.12, (0.12, 0.0)), PlantOptions()),
    ):
        plant = Plant(body(2), hinge, FrictionSurface(mu=0.1), options=options)
        plant.place(rocking.at(0.0), stable_poses(plant.body, rocking.at(0.0))[0])
        for k in range(1000):
            plant.advance(rocking.at((k + 0.5) * STEP), rocking.at((k + 1) * STEP), STEP)
        ends.append(plant.state.psi)
    assert ends[0] == pytest.approx(ends[1], abs=1e-12)
    assert abs(ends[2] - ends[0]) > 1e-4


def test_dry_friction_sticks_where_vibrated_friction_creeps():
    """Beside its stable pose a body stays at rest under dry friction, and creeps to the pose under vibration."""
    moved = []
    for law in ("coulomb", "averaged"):
        plant = plant_on(body(1), FIXED, FrictionSurface(0.25, 0.02), options=PlantOptions(friction_law=law))
        start = stable_poses(plant.body, AT_REST)[0] + 0.02
        plant.place(AT_REST, start)
        run(plant, AT_REST, 0.5)
        moved.append(abs(plant.state.psi - start))
    assert moved[0] < 1e-9
    assert moved[1] > 1e-3
