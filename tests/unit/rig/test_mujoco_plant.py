"""MuJoCo as the emulated rig's plant: against palmd's own, in closed loop with the daemon, and only on request."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from palmd.config.two_palms import rig_description
from palmd.config.vibration import VibrationConfig
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import require
from palmd.console.shipped import shipped
from palmd.daemon.exploration_requests import Decider
from palmd.events import PalmMotion
from palmd.observer import Simulated
from palmd.rig.dry_plant import DryPlant
from palmd.rig.ellipses import ellipse_of
from palmd.rig.imperfections import PERFECT
from palmd.rig.plant import AS_ASSUMED, FrictionSurface, Hinge, PlantOptions, stable_poses
from palmd.rig.shaker import drawn_shaking
from palmd.rig.shapes import ellipse, random_body, uniform_body_of, with_slug
from palmd.rig.vibrating_plant import VibratingPlant
from palmd.rig.world import World, default_config
from palmd.score import WRONG_M
from palmd.system.mechanism import PALMS
from palmd.system.vibration import Vibration
from palmd.yamlfile import load_config, load_plan
from tools.closed_loop import InlineExplorer, TwoPalmsLoop

STEP_S = 5e-4
MOST_PENETRATION_M = 2e-6
IN_MUJOCO = PlantOptions(physics="mujoco")


@pytest.fixture(scope="module")
def mujoco_plant():
    pytest.importorskip("mujoco", reason="mujoco is not installed: the extra `mujoco` has it")
    from palmd.rig.mujoco_plant import MujocoPlant

    return MujocoPlant


def rocking(t):
    """Both palms, from rest at 45° and 90°."""
    swing = [
        (middle, amplitude, math.tau * f)
        for middle, amplitude, f in ((0.25 * math.pi, 0.2, 1.1), (0.5 * math.pi, 0.1, 0.8))
    ]
    return PalmMotion(
        tuple(middle + a * (1.0 - math.cos(k * t)) for middle, a, k in swing),
        tuple(a * k * math.sin(k * t) for _, a, k in swing),
        tuple(a * k * k * math.cos(k * t) for _, a, k in swing),
    )


def rocked(plant, psi):
    """Rows of ψ, both contacts' distances and forces, of a body placed on the palms and rocked for 0.6 s."""
    plant.place(rocking(0.0), psi)
    rows = []
    for k in range(1200):
        plant.advance(rocking((k + 0.5) * STEP_S), rocking((k + 1) * STEP_S), STEP_S)
        contacts = plant.contacts()
        rows.append((plant.state.psi, *(each.s for each in contacts), *(each.force for each in contacts)))
        assert plant.touching == (True, True)
    return np.array(rows)


def rms(error):
    return math.sqrt(np.mean(error**2))


@pytest.mark.parametrize(
    ("seed", "hinge", "transmission"),
    [(1, Hinge("arc"), None), (2, Hinge("fixed"), None), (3, Hinge("arc"), 0.5), (4, Hinge("fixed"), 1.0)],
)
def test_the_body_moves_as_in_palmds_own_plant(mujoco_plant, seed, hinge, transmission):
    """On curved pads off the hinge line, with unequal friction, and on compliant mounts."""
    random = np.random.default_rng(seed)
    body = random_body("ellipse", random)
    one, two = PERFECT.pads
    off = replace(
        PERFECT,
        pads=(replace(one, sagitta=2e-4, standoff=-3e-4), replace(two, sagitta=-1e-4, standoff=2e-4)),
        friction=0.2,
    )
    known = Vibration("independent", frequency=250.0, transmission=transmission)
    shaking = drawn_shaking(known, random, speed=0.012, body_mass=body.mass)
    psi = stable_poses(body, rocking(0.0))[0]
    here, there = (
        plant_of(body, hinge, FrictionSurface(mu=0.15), shaking, options=AS_ASSUMED, imperfections=off)
        for plant_of in (VibratingPlant, mujoco_plant)
    )
    run = rocked(here, psi)
    error = rocked(there, psi) - run
    assert np.ptp(np.degrees(run[:, 0])) > 5.0
    assert rms(np.degrees(error[:, 0])) < 0.1
    assert np.abs(error[:, 1:3]).max() < 3e-5
    assert rms(error[100:, 3:]) < 0.02 * body.mass * 9.81
    assert 0.0 < there.penetration_m < MOST_PENETRATION_M


@pytest.mark.parametrize("seed", [1, 4])
def test_without_vibration_contacts_stick_and_slip_as_in_palmds_own_plant(mujoco_plant, seed):
    body, surface = random_body("ellipse", np.random.default_rng(seed)), FrictionSurface(mu=0.15)
    psi = stable_poses(body, rocking(0.0))[0]
    here, there = DryPlant(body, Hinge("arc"), surface), mujoco_plant(body, Hinge("arc"), surface, None)
    run = rocked(here, psi)
    error = rocked(there, psi) - run
    assert np.ptp(np.degrees(run[:, 0])) > 20.0
    assert rms(np.degrees(error[:, 0])) < 0.01
    assert rms(error[100:, 3:]) < 0.02 * body.mass * 9.81


def test_the_daemon_estimates_an_ellipse_moved_by_mujoco(mujoco_plant):
    config = load_config(shipped("demo.yaml"))
    plan = load_plan(config.plan)
    rig = rig_description(config)
    loop = TwoPalmsLoop(
        config, plan, 2, kind="ellipse", options=IN_MUJOCO,
        smoothing=Simulated(rig), explorer=InlineExplorer(Decider(rig, 2)),
    )  # fmt: skip
    assert isinstance(loop.world.plant, mujoco_plant)
    loop.start()
    valid = [
        (instant.messages["palm/estimate"], instant.truth)
        for instant in loop.run(6.5)
        if instant.messages["palm/estimate"]["valid"]
    ]
    assert len(valid) > 50
    off = [abs(estimate[name] - truth[name]) for estimate, truth in valid[-50:] for name in ("r1_m", "r2_m")]
    assert max(off) < WRONG_M
    assert loop.world.status()["contact_losses"] == 0
    assert 0.0 < loop.world.status()["penetration_m"] < MOST_PENETRATION_M


def test_the_same_seed_gives_bit_identical_results(mujoco_plant):
    del mujoco_plant
    heard = []
    for _ in range(2):
        world = World(default_config("calibrated"), 5, kind="ellipse", options=IN_MUJOCO)
        heard.append((world.advance(0.4), world.truth()))
    assert heard[0] == heard[1]


def test_a_new_object_falls_and_is_placed_on_the_palms(mujoco_plant):
    del mujoco_plant
    world = World(default_config(), 3, kind="ellipse", options=IN_MUJOCO)
    world.new_object()
    world.advance(0.5)
    assert not any(contact.touching for contact in world.plant.contacts())
    world.advance(1.5)
    assert all(contact.touching for contact in world.plant.contacts())
    assert world.object_truth()["object"] == 2


@pytest.mark.parametrize(("curvature", "kind", "said"), [(4.0, "ellipse", "flat palms"), (0.0, "rig", "no ellipse")])
def test_unsupported_features_are_refused(mujoco_plant, curvature, kind, said):
    del mujoco_plant
    rig = default_config().rig.model_copy(update={f"palm{palm}_curvature_per_m": curvature for palm in PALMS})
    with pytest.raises(ValueError, match=said):
        World(default_config().model_copy(update={"rig": rig}), 1, kind=kind, options=IN_MUJOCO)


def test_dry_palms_do_not_vibrate(mujoco_plant):
    rig = default_config().rig.model_copy(update={"vibration": VibrationConfig(relation="none")})
    world = World(default_config().model_copy(update={"rig": rig}), 1, kind="ellipse", options=IN_MUJOCO)
    assert isinstance(world.plant, mujoco_plant)
    world.advance(0.5)
    assert world.plant.touching == (True, True)
    assert abs(world.plant.mean_omega0) < 1e-4


@pytest.mark.parametrize("ratio", [1.0, 0.8])
def test_an_ellipse_is_recognised_from_its_outline(ratio):
    body = with_slug(uniform_body_of("ellipse", ellipse(0.02, 0.02 * ratio), 0.1), np.random.default_rng(1)).turned(0.7)
    found = ellipse_of(body.support)
    assert found.half_axes == pytest.approx((0.02, 0.02 * ratio), abs=1e-9)
    if ratio < 1.0:
        assert math.remainder(found.tilt - 0.7, math.pi) == pytest.approx(0.0, abs=1e-6)
    assert math.hypot(*found.centre) > 2e-4


def test_mujoco_is_loaded_only_on_request():
    code = "import sys, palmd.rig.world as w; w.World(w.default_config(), 1); assert 'mujoco' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_missing_mujoco_is_a_one_line_error_that_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(CliError, match="--physics mujoco needs mujoco, which is not installed: ") as raised:
        require("--physics mujoco", "mujoco", "mujoco")
    assert raised.value.status == BAD_INPUT
    assert len(str(raised.value).splitlines()) == 1
