"""The emulated rig of three palms: its compiled plant, its pads and its arm, byte by byte."""

import math
from pathlib import Path

import numpy as np
import pytest
from plain_body_on_palms import BodyStates, PalmState, accelerations

from palmd.daemon.three_palms_system import TiltPoses
from palmd.devices.actuator import Pose
from palmd.devices.pad import make_pad
from palmd.events import PadSample
from palmd.messages import stamp
from palmd.rig.three_palms.bodies import random_bodies, random_rotation
from palmd.rig.three_palms.plant import PHASE_SHIFT, PHASES, BodyOnPalms, FrictionParameters, TurningPalms, palm_rows
from palmd.rig.three_palms.world import ThreePalmsWorld
from palmd.system.three_palms import PALMS, palms_at, readings_of
from palmd.three_palms_quantities import PALM3_BODY, PALM3_TRUTH
from palmd.yamlfile import load_any_config
from tools.published import validate

CONFIG = load_any_config(Path(__file__).parents[3] / "config/three_palms.yaml")


STEP_S = 2e-3


def palms(t):
    angle = np.array([[0.9, 0.8, 0.8]]) + 0.1 * np.sin(3 * t)
    rate, acceleration = (np.full((1, 3), each) for each in (0.3 * math.cos(3 * t), -0.9 * math.sin(3 * t)))
    return palm_rows(palms_at(angle, rate, acceleration))


def step_of_palms(k):
    """At the beginning of step k, midway and at its end."""
    return np.concatenate([palms((k + share) * STEP_S) for share in (0.0, 0.5, 1.0)])


def put_on_palms(mu, dither):
    """A body that touches all palms, its friction, and its state."""
    rng = np.random.default_rng(5)
    body, rubbing = random_bodies(1, rng), FrictionParameters(*(np.array([each]) for each in (mu, dither, 1e-4)))
    R, normal = random_rotation(rng, 1), palms(0.0)[0, :9].reshape(3, 3)
    h = body.support(-np.einsum("bji,nj->bni", R, normal))[0][0]
    return body, rubbing, (np.linalg.solve(normal, h), np.zeros(3), R, np.zeros(3))


def plain_rates(plant, row, x, phases):
    """Derivatives of the state x and the contacts, by the equations in NumPy."""
    state = BodyStates(x[None, :3], x[None, 3:6], x[6:15].reshape(1, 3, 3), x[None, 15:])
    at = PalmState(*(kind.reshape(1, 3, 3) for kind in row.reshape(4, 9)))
    v_rate, w_rate, touch = accelerations(plant.body, plant.friction, at, state, 9.81, phases)
    turned = np.cross(x[15:], x[6:15].reshape(3, 3).T).T
    return np.concatenate([x[3:6], v_rate[0], turned.ravel(), w_rate[0]]), touch


def test_the_plant_integrates_the_plain_equations_by_runge_kutta():
    body, rubbing, begun = put_on_palms(0.1, 0.01)
    plant = BodyOnPalms(body, rubbing, 9.81)
    plant.begin(*begun[:3], np.full(3, 0.5))
    x = plant.state.copy()
    for k in range(20):
        rows, phases = step_of_palms(k), PHASES + k * PHASE_SHIFT
        plant.advance(rows, STEP_S)
        k1, _ = plain_rates(plant, rows[0], x, phases)
        k2, _ = plain_rates(plant, rows[1], x + 0.5 * STEP_S * k1, phases)
        k3, _ = plain_rates(plant, rows[1], x + 0.5 * STEP_S * k2, phases)
        k4, _ = plain_rates(plant, rows[2], x + STEP_S * k3, phases)
        x = x + STEP_S / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        R = x[6:15].reshape(3, 3)
        x[6:15] = (R @ (1.5 * np.eye(3) - 0.5 * R.T @ R)).ravel()  # a Newton step towards the nearest rotation
    _, touch = plain_rates(plant, rows[2], x, phases)
    np.testing.assert_allclose(plant.state, x, atol=1e-11)
    np.testing.assert_allclose(plant.force, touch.force[0], atol=1e-9)
    np.testing.assert_allclose(plant.point, touch.point[0], atol=1e-12)


def test_palm_angles_and_readings_agree_with_the_systems_equations():
    rng = np.random.default_rng(6)
    at = [tuple(map(tuple, rng.normal(size=(3, 3)))) for _ in range(8)]
    compiled, points = TurningPalms(at[0]), rng.normal(0.0, 0.03, (3, 3))
    for joints in at:
        compiled.turn(joints)
        planes = palms_at(*np.array(joints)[:, None])
        assert np.abs(compiled.rows[2] - palm_rows(planes)[0]).max() < 2e-14
        assert np.abs(compiled.readings(points) - readings_of(planes, points[None])[0]).max() < 1e-16
    assert np.abs(compiled.rows[0] - palm_rows(palms_at(*np.array(at[-3])[:, None]))[0]).max() < 2e-14


def test_the_plant_gets_the_palms_of_the_arm_in_order():
    """In each step the world passes the palms computed from its joints to the plant."""
    world = ThreePalmsWorld(CONFIG, 3)
    beta, gamma2, gamma3 = world._arm._servos
    for servo, rate in ((beta, 3e-4), (gamma2, -2e-4), (gamma3, 0.2)):
        servo.follow(world.t, rate)
    steps, advance = [], world._body.advance

    def advanced(palms, dt):
        steps.append((palms.copy(), dt))
        advance(palms, dt)

    world._body.advance = advanced
    for k in range(1, 9):
        world.advance(1e-3 * k)
        joints = tuple(map(np.array, world._arm.joints(world.t)))
        if k % 2 == 0:
            assert steps[-1][1] == 2e-3
            assert np.abs(steps[-1][0][2] - palm_rows(palms_at(*(each[None] for each in joints)))[0]).max() < 1e-14
    assert len(steps) == 4
    assert np.array_equal(steps[2][0][2], steps[3][0][0])
    assert not np.array_equal(steps[3][0][0], steps[3][0][1])


@pytest.fixture(scope="module")
def spoken():
    """A world after half a second at rest, and its pads' messages through the daemon's own drivers."""
    world = ThreePalmsWorld(CONFIG, 3)
    drivers = {f"pad{n}": make_pad(n, pad) for n, pad in zip(PALMS, CONFIG.pads.each(), strict=True)}
    for driver in drivers.values():
        driver.opened(0.0)
    events = []
    for k in range(1, 1001):
        for port, data in world.advance(5e-4 * k).items():
            if data and port in drivers:
                events += drivers[port].feed(data, 5e-4 * k)
    return world, events


@pytest.mark.parametrize("palm", PALMS)
def test_both_coordinates_of_a_contact_are_sent(spoken, palm):
    world, events = spoken
    truth = world.truth()
    mine = [event for event in events if isinstance(event, PadSample) and event.pad == palm][-20:]
    assert len(mine) == 20
    assert np.mean([event.across for event in mine]) == pytest.approx(truth[f"a{palm}_m"], abs=2e-4)
    assert np.mean([event.s for event in mine]) == pytest.approx(truth[f"b{palm}_m"], abs=2e-4)
    assert np.mean([event.force for event in mine]) == pytest.approx(truth[f"f{palm}_n"], rel=0.15, abs=0.02)


def test_the_body_rests_and_its_weight_is_carried(spoken):
    world, _ = spoken
    truth, body = world.truth(), world.object_truth()
    normals = palms_at(*(np.array([[truth[f"{joint}{what}"] for joint in ("beta", "gamma2", "gamma3")]]) for what in
                         ("_rad", "_rate_rad_s", "_rate_rad_s"))).normal[0]  # fmt: skip
    carried = np.array([truth[f"f{palm}_n"] for palm in PALMS]) @ normals
    assert carried[2] == pytest.approx(9.81 * body["mass_kg"], rel=0.05)
    assert np.abs([truth[f"omega_{axis}_rad_s"] for axis in "xyz"]).max() < 0.05
    assert validate(PALM3_TRUTH, stamp(dict(truth), 1.0, 2.0, 3)) == []
    assert validate(PALM3_BODY, stamp(dict(body), 1.0, 2.0, 3)) == []


def test_a_body_that_falls_off_is_put_back(monkeypatch):
    monkeypatch.setattr("palmd.rig.three_palms.world.AWAY_S", 0.2)
    world = ThreePalmsWorld(CONFIG, 4)
    world.advance(0.1)
    assert world.truth()["touch1"]
    world.body.state[3:6] = 0.0, 0.0, 2.0  # thrown upwards
    world.advance(0.2)
    assert not world.truth()["touch1"]
    assert world.contact_losses == 1
    world.advance(0.5)
    assert world.truth()["touch1"]


def test_the_line_carries_degrees_in_place_of_micrometres():
    pose = TiltPoses().pose((0.9, 0.8, 0.7))
    assert round(pose.x_m * 1e6) == round(math.degrees(0.9) * 1e3)
    assert TiltPoses().angles(pose) == pytest.approx((0.9, 0.8, 0.7))
    assert TiltPoses().angles(Pose(0.051, 0.046, 0.8)) == pytest.approx((math.radians(51), math.radians(46), 0.8))


def turned(frequencies):
    """Rotations of a body on vibrating palms in every step, and the forces at the end."""
    body, rubbing, begun = put_on_palms(0.2, 0.0157)
    plant = BodyOnPalms(body, rubbing, 9.81, frequencies=frequencies)
    plant.begin(*begun)
    rows = []
    for k in range(500):
        plant.advance(step_of_palms(k), STEP_S)
        rows.append(plant.state[6:15].reshape(3, 3).copy())
    return np.array(rows), plant.force.copy()


def test_averages_over_vibrations_are_the_limit_of_fast_ones():
    """Resolved in steps of a fortieth of a period: within some hundredths of a degree in a rotation of over ten."""
    averaged, force = turned(None)
    resolved, resolved_force = turned((2500.0, 2630.0, 2810.0))
    apart = np.degrees(np.arccos(np.clip((np.einsum("kij,kij->k", averaged, resolved) - 1.0) / 2.0, -1.0, 1.0)))
    way = np.degrees(np.arccos(np.clip((np.einsum("kij,ij->k", averaged, averaged[0]) - 1.0) / 2.0, -1.0, 1.0)))
    assert way.max() > 5.0
    assert apart.max() < 0.03
    np.testing.assert_allclose(resolved_force, force, rtol=0.03)
