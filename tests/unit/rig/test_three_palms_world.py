"""The emulated rig of three palms: its compiled plant, its pads and its arm, byte by byte."""

import math
from pathlib import Path

import numpy as np
import pytest

from palmd.daemon.three_palms_system import TiltPoses
from palmd.devices.actuator import Pose
from palmd.devices.pad import make_pad
from palmd.events import PadSample
from palmd.messages import stamp
from palmd.rig.three_palms.bodies import random_bodies, random_rotation
from palmd.rig.three_palms.compiled import BodyOnPalms, TurningPalms, backend, palm_rows
from palmd.rig.three_palms.plant import BodyStates, FrictionParameters
from palmd.rig.three_palms.world import ThreePalmsWorld
from palmd.system.three_palms import PALMS, palms_at, readings_of
from palmd.three_palms_quantities import PALM3_BODY, PALM3_TRUTH
from palmd.yamlfile import load_any_config
from tools.published import validate

CONFIG = load_any_config(Path(__file__).parents[3] / "config/three_palms.yaml")


def palms(t):
    angle = np.array([[0.9, 0.8, 0.8]]) + 0.1 * np.sin(3 * t)
    rate, acceleration = (np.full((1, 3), each) for each in (0.3 * math.cos(3 * t), -0.9 * math.sin(3 * t)))
    each = palms_at(angle, rate, acceleration)
    kinds = (each.normal, each.normal_rate, each.normal_acceleration, each.spin)
    return np.concatenate([kind.reshape(1, 9) for kind in kinds], axis=1)


@pytest.mark.skipif(backend() != "c", reason="no C compiler")
def test_the_compiled_plant_does_what_its_twin_does():
    rng = np.random.default_rng(5)
    body, rubbing = random_bodies(1, rng), FrictionParameters(np.array([0.1]), np.array([0.01]), np.array([1e-4]))
    R, normal = random_rotation(rng, 1), palms(0.0)[0, :9].reshape(3, 3)
    h = body.support(-np.einsum("bji,nj->bni", R, normal))[0][0]
    still = np.zeros((1, 3))
    begun = BodyStates(np.linalg.solve(normal, h)[None], still, R, still + 0.5)
    pair = [BodyOnPalms(body, rubbing, 9.81, compiled=compiled) for compiled in (True, False)]
    for each in pair:
        each.begin(begun)
        for k in range(20):
            t = 2e-3 * k
            each.advance(np.concatenate([palms(t), palms(t + 1e-3), palms(t + 2e-3)]), 2e-3)
    compiled, twin = pair
    assert np.abs(compiled.state - twin.state).max() < 1e-13
    assert np.abs(compiled.force - twin.force).max() < 1e-11
    assert np.abs(compiled.point - twin.point).max() < 1e-14


@pytest.mark.skipif(backend() != "c", reason="no C compiler")
def test_the_compiled_palms_turn_and_read_as_their_twin_does():
    rng = np.random.default_rng(6)
    at = [tuple(map(tuple, rng.normal(size=(3, 3)))) for _ in range(8)]
    compiled, twin = (TurningPalms(at[0], compiled=each) for each in (True, False))
    points = rng.normal(0.0, 0.03, (3, 3))
    for joints in at:
        for each in (compiled, twin):
            each.turn(joints)
        assert np.abs(compiled.rows - twin.rows).max() < 2e-14
        planes = palms_at(*np.array(joints)[:, None])
        assert np.abs(compiled.readings(points) - readings_of(planes, points[None])[0]).max() < 1e-16
    assert np.abs(compiled.rows[0] - palm_rows(palms_at(*np.array(at[-3])[:, None]))[0]).max() < 2e-14


def test_the_plant_goes_on_under_the_palms_as_the_arm_moves_them():
    """Step by step: what the world hands to the plant is what its joints say, in their order."""
    world = ThreePalmsWorld(CONFIG, 3)
    beta, gamma2, gamma3 = world._arm._servos
    for servo, rate in ((beta, 3e-4), (gamma2, -2e-4), (gamma3, 0.2)):
        servo.follow(world.t, rate)
    told, advance = [], world._body.advance

    def advanced(palms, dt):
        told.append((palms.copy(), dt))
        advance(palms, dt)

    world._body.advance = advanced
    for k in range(1, 9):
        world.advance(1e-3 * k)
        joints = tuple(map(np.array, world._arm.joints(world.t)))
        if k % 2 == 0:
            assert told[-1][1] == 2e-3
            assert np.abs(told[-1][0][2] - palm_rows(palms_at(*(each[None] for each in joints)))[0]).max() < 1e-14
    assert len(told) == 4
    assert np.array_equal(told[2][0][2], told[3][0][0])
    assert not np.array_equal(told[3][0][0], told[3][0][1])


@pytest.fixture(scope="module")
def spoken():
    """A world that has stood for half a second, and what its pads have said, through the daemon's own drivers."""
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
def test_both_coordinates_of_a_contact_come_over_the_wire(spoken, palm):
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


def test_what_falls_off_is_put_back_by_a_hand(monkeypatch):
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


def turned(body, rubbing, begun, frequencies, compiled=True, steps=500):
    """Rotations of a body on palms that vibrate, every step, and the forces at the end."""
    plant = BodyOnPalms(body, rubbing, 9.81, frequencies=frequencies, compiled=compiled)
    plant.begin(begun)
    rows = []
    for k in range(steps):
        t = 2e-3 * k
        plant.advance(np.concatenate([palms(t), palms(t + 1e-3), palms(t + 2e-3)]), 2e-3)
        rows.append(plant.state[6:15].reshape(3, 3).copy())
    return np.array(rows), plant.force.copy()


def vibrating_scene():
    rng = np.random.default_rng(5)
    body, rubbing = random_bodies(1, rng), FrictionParameters(np.array([0.2]), np.array([0.0157]), np.array([1e-4]))
    R, normal = random_rotation(rng, 1), palms(0.0)[0, :9].reshape(3, 3)
    h = body.support(-np.einsum("bji,nj->bni", R, normal))[0][0]
    still = np.zeros((1, 3))
    return body, rubbing, BodyStates(np.linalg.solve(normal, h)[None], still, R, still)


@pytest.mark.skipif(backend() != "c", reason="no C compiler")
def test_averages_over_vibrations_are_the_limit_of_fast_ones():
    """Resolved in steps of a fortieth of a period, to some hundredths of a degree of a turn of ten and more."""
    scene = vibrating_scene()
    averaged, force = turned(*scene, None)
    resolved, felt = turned(*scene, (2500.0, 2630.0, 2810.0))
    apart = np.degrees(np.arccos(np.clip((np.einsum("kij,kij->k", averaged, resolved) - 1.0) / 2.0, -1.0, 1.0)))
    way = np.degrees(np.arccos(np.clip((np.einsum("kij,ij->k", averaged, averaged[0]) - 1.0) / 2.0, -1.0, 1.0)))
    assert way.max() > 5.0
    assert apart.max() < 0.03
    np.testing.assert_allclose(felt, force, rtol=0.03)


@pytest.mark.skipif(backend() != "c", reason="no C compiler")
def test_the_compiled_plant_vibrates_as_its_twin_does():
    scene = vibrating_scene()
    compiled, twin = (turned(*scene, (250.0, 263.0, 281.0), each, 8) for each in (True, False))
    assert np.abs(compiled[0] - twin[0]).max() < 1e-12
    assert np.abs(compiled[1] - twin[1]).max() < 1e-9
