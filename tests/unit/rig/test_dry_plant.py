"""Dry friction: sticking contacts do not move, slipping ones have the force μN, and bodies at rest stay at rest."""

import math

import numpy as np
import pytest

from palmd.events import PalmMotion
from palmd.rig.dry_plant import DRY, DryPlant
from palmd.rig.friction import plant_on
from palmd.rig.plant import FrictionSurface, Hinge, PlantOptions, stable_poses
from palmd.rig.shapes import cylinder, random_body
from palmd.rig.simulate import Rock, Rocking
from tools.studies.sharp_shapes import rounded_polygon, uniform_body

STEP = 5e-4
FIXED = Hinge("fixed", base=(0.0, 0.0))
AT_REST = PalmMotion.at_rest((0.7, 1.6))
ROCKING = Rocking(Rock(0.75, 0.5, 0.5, 0.3), Rock(1.65, 0.25, 0.8, 1.0))


def lump(seed):
    return random_body("friction", np.random.default_rng(seed))


def driven(plant, palms_at, seconds):
    """The plant after each step."""
    for k in range(round(seconds / STEP)):
        plant.advance(palms_at((k + 0.5) * STEP), palms_at((k + 1) * STEP), STEP)
        yield plant


def test_the_sticking_contact_rolls_along_the_outline_while_the_other_slips():
    plant = DryPlant(lump(3), FIXED, DRY)
    plant.place(ROCKING.at(0.0), stable_poses(plant.body, ROCKING.at(0.0))[0])
    stuck, gone, slipped = 0, np.zeros(2), 0.0
    for _ in driven(plant, ROCKING.at, 1.0):
        if plant.sticking() != (True, False):
            continue
        stuck += 1
        palm, q = plant._frame.palms[0], plant.state
        h, _, bend = plant.body.support.at(palm.out - q.psi)
        gone += plant.contact_rates()[0] * STEP, (h + bend) * (palm.turn - q.omega0) * STEP
        slipped += abs(plant.slips()[1]) * STEP
        one, two = (contact.force for contact in plant.contacts())
        assert plant._ratios[1] == math.copysign(DRY.mu, plant.slips()[1])
        assert min(one, two) > 0.0
    assert stuck > 500
    assert gone[0] == pytest.approx(gone[1], abs=1e-6)
    assert slipped > 5e-4


def test_off_balance_the_body_stays_and_does_not_creep():
    plant = DryPlant(lump(1), FIXED, DRY)
    start = stable_poses(plant.body, AT_REST)[0] + 0.05
    plant.place(AT_REST, start)
    for _ in driven(plant, lambda _t: AT_REST, 1.0):
        assert plant.sticking() == (True, True)
    assert plant.state.psi == pytest.approx(start, abs=1e-12)


@pytest.mark.parametrize(("steeper_deg", "slides"), [(-1.0, False), (1.0, True)])
def test_a_block_slides_from_the_angle_of_static_friction_on(steeper_deg, slides):
    slope = -math.atan(DRY.static) - math.radians(steeper_deg)
    ring = [(7e-3, -7e-3), (7e-3, 7e-3), (-7e-3, 7e-3), (-7e-3, -7e-3)]
    plant = DryPlant(uniform_body("block", rounded_polygon(ring, 1e-3), 0.1), FIXED, DRY)
    palms = PalmMotion.at_rest((slope, 2.0))

    def spun(psi):
        plant.place(palms, psi)
        plant._on[1] = False
        return abs(plant._accelerations()[2])

    spun(min(np.linspace(slope - 1e-3, slope + 1e-3, 201), key=spun))  # at rest on its side, not rocking on it
    x, seconds = plant.state.x, 0.1
    for _ in driven(plant, lambda _t: palms, seconds):
        assert plant.touching[0]
    way = (plant.state.x - x) / math.cos(slope)
    free = 0.5 * 9.81 * (math.sin(-slope) - DRY.mu * math.cos(slope)) * seconds**2  # with kinetic friction
    assert way == pytest.approx(free if slides else 0.0, abs=1e-4)


def test_curved_palms_refuse_dry_friction():
    with pytest.raises(ValueError, match="flat palms only"):
        plant_on(lump(1), FIXED, DRY, (1.0, 0.0), options=PlantOptions(friction_law="coulomb"))


def test_on_palms_at_rest_no_step_adds_energy():
    plant = DryPlant(lump(5), FIXED, FrictionSurface(mu=0.1, static=0.15))
    plant.place(AT_REST, 1.0, omega0=3.0)
    before = plant.energy()
    for _ in driven(plant, lambda _t: AT_REST, 1.0):
        assert plant.energy() <= before + 1e-9
        before = plant.energy()
    assert plant.sticking() == (True, True)


def test_a_cylinder_sticks_to_the_palm_it_is_rolled_along():
    """Between opening palms it slips along one; a μ large enough to stick to both does not change that."""
    plant = DryPlant(cylinder(0.02, 0.1), FIXED, FrictionSurface(mu=0.5, static=0.5))
    opening = Rocking(Rock(0.8, 0.0, 1.0, 0.0), Rock(1.6, 0.2, 0.5, 0.0))
    plant.place(opening.at(0.0), 0.0)
    seen = {plant.sticking() for _ in driven(plant, opening.at, 0.8)}
    assert {(True, False), (False, True)} & seen
    assert (False, False) not in seen
