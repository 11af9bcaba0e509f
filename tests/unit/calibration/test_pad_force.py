"""Newtons per count of both pads from a cylinder's weight, for any friction and with invalid readings."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from off_pads import CONFIGURED, LIMITS, gain_errors, share
from off_pads import TRUE as REAL
from turned_cylinder import turned

from palmd.calibration.cylinder import CylinderError, normal_forces, tipping_plan
from palmd.calibration.pad_force import pad_forces
from palmd.config.two_palms import LimitsConfig
from palmd.events import PadSample, PalmSample
from palmd.motion.limits import MotionLimits
from palmd.rig.pads import PadOptions

RADIUS_M, MASS_KG = 0.02, 0.1
WEIGHT_N = 9.81 * MASS_KG
FINE = tuple(pad.model_copy(update={"newtons_per_count": 1e-4}) for pad in CONFIGURED)
TRUE = tuple(pad.model_copy(update={"newtons_per_count": gain}) for pad, gain in zip(FINE, (8e-5, 1.2e-4), strict=True))


def arc_limits(curvatures):
    limits = LimitsConfig(phi1_deg=(-10.0, 110.0), phi2_deg=(88.0, 165.0))
    return MotionLimits.from_config(limits, pad_length=0.0555, curvatures=curvatures)


def poses(rounds, limits=LIMITS):
    plan, rests = tipping_plan(RADIUS_M, limits, rounds)
    segments = plan["segments"]
    found = [before["move"] for before, rest in itertools.pairwise(segments) if "hold_s" in rest]
    assert len(found) == rests
    return [(pose["phi1_deg"], pose["phi2_deg"]) for pose in found], rests


def balanced(phi1_deg, phi2_deg, held):
    """N1, N2 from the balance of both forces and the weight, with a friction of `held` along each palm."""
    phi1, phi12 = math.radians(phi1_deg), math.radians(phi1_deg + phi2_deg)
    n = np.array([[-math.sin(phi1), math.sin(phi12)], [math.cos(phi1), -math.cos(phi12)]])
    along = np.array([math.cos(phi1) + math.cos(phi12), math.sin(phi1) + math.sin(phi12)])
    return np.linalg.solve(n, np.array([0.0, WEIGHT_N]) - held * along)


def on_arcs(phi1_deg, phi2_deg, radii):
    """N1, N2 on cradles of these radii (m): both push the cylinder's axis towards their arcs' centres."""
    phi1, phi12 = math.radians(phi1_deg), math.radians(phi1_deg + phi2_deg)
    centres = (
        np.array([[-math.sin(phi1), math.cos(phi1)], [math.sin(phi12), -math.cos(phi12)]]) * np.array(radii)[:, None]
    )
    away, between = np.array(radii) - RADIUS_M, centres[1] - centres[0]
    apart = np.linalg.norm(between)
    along = (apart**2 + away[0] ** 2 - away[1] ** 2) / (2.0 * apart)
    across = math.sqrt(away[0] ** 2 - along**2)
    axis = centres[0] + (along * between + across * np.array([between[1], -between[0]])) / apart
    assert np.linalg.norm(axis) < min(radii), "the contacts lie on the pads"
    pushed = (centres - axis) / away[:, None]
    return np.linalg.solve(pushed.T, [0.0, WEIGHT_N])


def rested(
    rounds=2,
    *,
    held=lambda _: 0.0,
    offset_n=(0.0, 0.0),
    creep=0.0,
    change=lambda events: events,
    radii=None,
    believed=(0.0, 0.0),
    every_s=0.01,
):
    """Events of one-second rests, `every_s`; `held` draws the friction of each as a share of the smaller force.

    On cradles of these `radii` (m); limits and evaluation use the `believed` curvatures (1/m).
    """
    rng = np.random.default_rng(3)
    events, t = [], 100.0
    pose_list, rests = poses(rounds, LIMITS if radii is None else arc_limits(believed))
    for number in range(rounds * rests):
        phi1_deg, phi2_deg = pose_list[number % rests]
        if number % rests == 0:
            gains = 1.0 + creep * rng.standard_normal(2)
        if radii is None:
            forces = balanced(phi1_deg, phi2_deg, held(rng) * WEIGHT_N * min(share(phi1_deg, phi2_deg)))
        else:
            forces = on_arcs(phi1_deg, phi2_deg, radii)
        angles = (math.radians(phi1_deg), math.radians(phi2_deg))
        for k in range(round(1.0 / every_s)):
            events.append(PalmSample(t + every_s * k, angles, (0.0, 0.0), (0.0, 0.0)))
            for pad, true in enumerate(TRUE, 1):
                pressed = max(forces[pad - 1] - offset_n[pad - 1], 0.0)
                counts = round(gains[pad - 1] * pressed / true.newtons_per_count)
                events.append(PadSample(t + every_s * k, pad, 0.028, counts * FINE[0].newtons_per_count))
        for k in range(10):  # during the motion to the next rest
            events.append(PalmSample(t + 1.0 + 0.01 * k, angles, (0.3, 0.0), (0.0, 0.0)))
            events += [PadSample(t + 1.0 + 0.01 * k, pad, 0.028, FINE[0].newtons_per_count) for pad in (1, 2)]
        t += 1.5
    return pad_forces(change(events), FINE, WEIGHT_N, rests, radius_m=RADIUS_M, curvatures=believed)


def refused(**made):
    with pytest.raises(CylinderError) as caught:
        rested(**made)
    return str(caught.value)


def test_the_frictionless_forces_balance_the_weight():
    for pose in ((20.0, 70.0), (45.0, 90.0), (60.0, 110.0)):
        assert normal_forces(1.0, *np.radians(pose)) == pytest.approx(tuple(share(*pose)), abs=1e-12)


def test_without_friction_the_gains_are_exact():
    found = rested()
    assert np.abs(gain_errors(found, TRUE)).max() < 2e-4
    assert (found.friction, found.pads[0].share_left, found.pads[1].share_left) == pytest.approx((0, 0, 0), abs=1e-3)
    assert (found.pads[0].offset_n, found.pads[1].offset_n) == pytest.approx((0, 0), abs=1e-3)
    assert (found.rests, found.rounds) == (64, 2)


@pytest.mark.parametrize(
    "held", [lambda rng: rng.uniform(-0.3, 0.3), lambda _: 0.2, lambda _: -0.2], ids=["any", "up", "down"]
)
def test_unknown_friction_does_not_bias_the_gains(held):
    found = rested(held=held)
    assert np.abs(gain_errors(found, TRUE)).max() < 5e-4
    assert found.friction > 0.1
    assert min(found.pads[0].share_left, found.pads[1].share_left) > 0.1


@pytest.mark.parametrize("radii", [(0.075, 0.075), (0.09, 0.065)])
def test_curved_palms_are_evaluated_by_their_tangents(radii):
    found = rested(radii=radii, believed=tuple(1.0 / radius for radius in radii))
    assert [pad.newtons_per_count for pad in found.pads] == pytest.approx([8e-5, 1.2e-4], rel=2e-4)
    assert found.friction < 2e-3


def test_the_sd_reflects_the_creep_between_rounds():
    found = rested(rounds=40, creep=0.03, every_s=0.03)
    for pad, error in zip(found.pads, gain_errors(found, TRUE), strict=True):
        share_sd = pad.newtons_per_count_sd / pad.newtons_per_count
        assert share_sd == pytest.approx(1.25 * 0.03 / math.sqrt(40), rel=0.3)
        assert abs(error) < 4.0 * share_sd


def test_a_pads_force_offset_is_found():
    found = rested(offset_n=(0.15, 0.0))
    assert found.pads[0].offset_n == pytest.approx(0.15, abs=2e-3)
    assert found.pads[1].offset_n == pytest.approx(0.0, abs=2e-3)


def test_gains_are_found_despite_the_plants_friction_and_hysteresis():
    plan, rests = tipping_plan(RADIUS_M, LIMITS, 2)
    errors = []
    for seed in (6, 7):
        steady = PadOptions(force_drift=0.0)
        events = turned(plan, LIMITS, REAL, CONFIGURED, RADIUS_M, MASS_KG, seed, pad_options=steady)
        found = pad_forces(events, CONFIGURED, WEIGHT_N, rests, radius_m=RADIUS_M)
        assert found.pads[0].saturated == found.pads[1].saturated == 0
        errors += gain_errors(found)
    assert np.abs(errors).max() < 0.005
    assert abs(np.mean(errors)) < 0.0025, "a hysteresis of 2 % averages out"


def test_swapped_pads_are_refused():
    def swap(events):
        return [
            PadSample(each.t_sample, 3 - each.pad, each.s, each.force) if isinstance(each, PadSample) else each
            for each in events
        ]

    assert "check for swapped pads" in refused(change=swap)


def test_a_rest_at_full_scale_is_excluded():
    def saturate(events):
        heavy = max(each.force for each in events if isinstance(each, PadSample) and each.pad == 2)
        return [
            PadSample(each.t_sample, 2, each.s, None)
            if isinstance(each, PadSample) and each.pad == 2 and each.force == heavy
            else each
            for each in events
        ]

    found = rested(rounds=3, change=saturate)
    assert found.pads[1].saturated == 600
    assert found.rests == 90
    assert np.abs(gain_errors(found, TRUE)).max() < 1e-3


def test_too_few_rests_are_refused():
    assert "rested on both pads 0 times, at least 64 are needed" in refused(change=lambda _: [])
    assert "rested on both pads 32 times" in refused(change=lambda events: events[: len(events) // 2])
    one = refused(change=lambda events: [each for each in events if getattr(each, "pad", 1) == 1])
    assert "rested on both pads 0 times" in one


def test_palms_that_did_not_tip_are_refused():
    def upright(events):
        return [
            replace(each, angles=(math.radians(45.0), math.radians(90.0))) if isinstance(each, PalmSample) else each
            for each in events
        ]

    assert "hardly tipped" in refused(change=upright)
