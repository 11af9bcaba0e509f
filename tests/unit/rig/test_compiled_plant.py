"""The plant's compiled step against its twin in Python: the same bits, whatever happens to the body."""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest

from palmd.events import PalmMotion
from palmd.rig import compiled_plant, simulate
from palmd.rig.imperfections import PERFECT, Imperfections, PadImperfection
from palmd.rig.plant import Hinge, Plant, PlantOptions, random_surface, stable_poses
from palmd.rig.shapes import random_body
from palmd.rig.simulate import Rock, Rocking

STEP = 5e-4
AT_REST = PalmMotion.at_rest((0.7, 1.6))
BOWED = Imperfections((PadImperfection(sagitta=1e-4, standoff=-2e-4), PadImperfection(sagitta=-2e-4)), friction=0.2)
SHAKEN = Imperfections(vibration=0.5)

pytestmark = pytest.mark.skipif(compiled_plant.backend() != "c", reason="no C compiler")


def standing(_t):
    return AT_REST


@dataclass
class Met:
    """In how many steps of a run."""

    in_the_air: int = 0
    on_one_palm: int = 0
    fallen: int = 0


def twins(seed, hinge, options, imperfections):
    rng = np.random.default_rng(seed)
    body, surface = random_body("odd", rng), random_surface("rig", rng)
    compiled, python = (Plant(body, hinge, surface, options=options, imperfections=imperfections) for _ in range(2))
    python._compiled = None
    return compiled, python


def told(plant):
    """All there is to tell of a plant."""
    return (
        plant.state,
        plant.touching,
        plant.fallen,
        plant.contacts(),
        plant.contact_rates(),
        plant._frame,
        plant._rates,
    )


def alike(plants, palms_at, steps):
    """Drives both; they are the same after each step. What was met on the way."""
    compiled, python = plants
    met = Met()
    for k in range(steps):
        for plant in plants:
            plant.advance(palms_at((k + 0.5) * STEP), palms_at((k + 1) * STEP), STEP)
        assert told(compiled) == told(python), k
        met.in_the_air += not python.fallen and not any(python.touching)
        met.on_one_palm += sum(python.touching) == 1
        met.fallen += python.fallen
    return met


@pytest.mark.parametrize(
    ("mode", "imperfections"),
    [("arc", PERFECT), ("fixed", PERFECT), ("arc", BOWED), ("fixed", SHAKEN)],
)
def test_rolling_and_shaken_off(mode, imperfections):
    """The palms rock until the body flies, and comes down on one of them, or beside them."""
    rocking = Rocking(Rock(0.75, 0.25, 6.0, 0.3), Rock(1.6, 0.15, 5.1, 1.0))
    plants = twins(3, Hinge(mode), PlantOptions(), imperfections)
    for plant in plants:
        plant.place(rocking.at(0.0), stable_poses(plant.body, AT_REST)[0] + 0.2, omega0=0.3)
    met = alike(plants, rocking.at, 2000)
    assert met.in_the_air
    assert met.on_one_palm


@pytest.mark.parametrize("thrown", [(0.0, 0.5), (0.8, 0.5), (-0.8, 0.5)])
def test_thrown(thrown):
    plants = twins(5, Hinge("fixed"), PlantOptions(), PERFECT)
    for plant in plants:
        plant.place(AT_REST, 0.0)
        plant.state.vx, plant.state.vy = thrown
    met = alike(plants, standing, 600)
    assert met.in_the_air + met.on_one_palm
    assert bool(met.fallen) == (thrown[0] != 0.0)


def test_a_step_goes_on_from_what_was_done_to_the_plant_in_between():
    plants = twins(7, Hinge("arc"), PlantOptions(), BOWED)
    for psi in (0.0, 1.0):
        for plant in plants:
            plant.place(AT_REST, psi)
        alike(plants, standing, 5)
        for plant in plants:
            plant.take_away()
        assert alike(plants, standing, 5).fallen == 5


def test_a_copy_goes_on_alike_and_by_itself():
    plant = twins(9, Hinge("arc"), PlantOptions(), BOWED)[0]
    plant.place(AT_REST, 0.5)
    copy, other = (pickle.loads(pickle.dumps(plant)) for _ in range(2))
    alike((plant, copy), standing, 20)
    assert copy._compiled is not None
    assert told(other) != told(copy)


@pytest.mark.parametrize(
    ("kind", "seed", "rests", "imperfections", "lost"),
    [
        ("nominal", 1, (), PERFECT, False),
        ("rig", 3, ((0.6, 1.1), (2.0, 2.4)), BOWED, False),
        ("odd", 1, (), SHAKEN, False),
        ("friction", 5, (), Imperfections(angles=(0.01, -0.02), gravity=0.004), False),
        ("friction", 5, (), Imperfections(vibration=30.0), True),
    ],
)
def test_a_whole_run_has_the_same_bits(monkeypatch, kind, seed, rests, imperfections, lost):
    scene = simulate._draw(kind, np.random.default_rng(seed), None, None, rests, imperfections)
    compiled = simulate.simulate_run(scene, 3.0, PlantOptions(), ())
    monkeypatch.setattr(Plant, "simulate_rocking", lambda *_: None)
    python = simulate.simulate_run(scene, 3.0, PlantOptions(), ())
    assert (compiled is None) == (python is None) == lost
    assert lost or compiled.tobytes() == python.tobytes()


def test_without_a_compiler_python_steps_it(monkeypatch):
    monkeypatch.setattr(compiled_plant, "_library", lambda: None)
    plant = twins(0, Hinge("arc"), PlantOptions(), PERFECT)[0]
    plant.place(AT_REST, 0.0)
    plant.advance(AT_REST, AT_REST, STEP)
    assert compiled_plant.backend() == "python"
    assert plant.touching == (True, True)
