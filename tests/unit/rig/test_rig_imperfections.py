"""Imperfections of the emulated rig: geometry by another formula, signs by reconstruction, and random draws."""

import json
import math
from dataclasses import fields, replace

import numpy as np
import pytest
from simulated import simulated

from palmd.config.two_palms import Config, ImperfectionsConfig, rig_description
from palmd.events import PalmMotion
from palmd.observer.reconstruct import reconstruct
from palmd.rig.imperfections import NO_ERROR, PERFECT, Imperfections, PadImperfection, configured, drawn
from palmd.rig.plant import PAD_LENGTH, FrictionSurface, Hinge, Plant, palm_frame, stable_poses
from palmd.rig.shapes import cylinder, random_body
from palmd.rig.simulate import PERFECTLY_KNOWN, Rock, Rocking, main, simulate_log
from palmd.rig.world import default_config
from palmd.score import score_outline
from palmd.system.description import AS_CALIBRATED, RigDescription
from palmd.system.rig_constants import RIG_NAMES

RADIUS = 0.02
STEP = 5e-4
CALIBRATED = RigDescription().known_to(AS_CALIBRATED)


def of_pad(number, **off):
    return Imperfections(tuple(PadImperfection(**(off if palm == number else {})) for palm in (1, 2)))


# --------------------------------------------------------------------------------------------------- the plant


def nearest(plant, palms, pads, number):
    """From a palm's surface to the body's centre: the distance (m) and its place (m), by exhaustive search."""
    frame = palm_frame(plant.hinge, palms)
    ox, oy = frame.ox, frame.oy
    angle = palms.angles[0] if number == 1 else sum(palms.angles)
    s = np.linspace(0.0, PAD_LENGTH, 200_001)
    pad = pads[number - 1]
    height = (1.0 if number == 1 else -1.0) * (pad.standoff + 4.0 * pad.sagitta * s * (PAD_LENGTH - s) / PAD_LENGTH**2)
    x = ox + s * math.cos(angle) - height * math.sin(angle)
    y = oy + s * math.sin(angle) + height * math.cos(angle)
    distance = np.hypot(plant.state.x - x, plant.state.y - y)
    return distance.min(), s[distance.argmin()]


@pytest.mark.parametrize(
    "pads",
    [
        (PadImperfection(standoff=1e-3), PadImperfection()),
        (PadImperfection(sagitta=5e-4), PadImperfection(sagitta=-3e-4)),
        (PadImperfection(), PadImperfection(standoff=-5e-4, sagitta=5e-4)),
    ],
    ids=["standoff", "both bowed", "both of palm 2"],
)
def test_a_cylinder_stays_on_curved_surfaces_off_the_hinge_line(pads):
    rocking = Rocking(Rock(0.7, 0.4, 0.7, 0.3), Rock(1.6, 0.25, 0.8, 1.0))
    plant = Plant(cylinder(RADIUS, 0.1), Hinge(), FrictionSurface(mu=0.2), imperfections=Imperfections(pads))
    plant.place(rocking.at(0.0), 0.0)
    for k in range(3001):
        palms = rocking.at(k * STEP)
        if k % 300 == 0:
            for number, contact in enumerate(plant.contacts(), 1):
                distance, where = nearest(plant, palms, pads, number)
                assert contact.touching
                assert distance == pytest.approx(RADIUS, abs=2e-7)
                assert contact.s == pytest.approx(where, abs=3e-5)  # of s·slope², and the finest step of the search
        plant.advance(rocking.at((k + 0.5) * STEP), rocking.at((k + 1) * STEP), STEP)


def test_contacts_move_at_the_prescribed_rate():
    rocking = Rocking(Rock(0.7, 0.4, 0.7, 0.3), Rock(1.6, 0.25, 0.8, 1.0))
    plant = Plant(random_body("rig", np.random.default_rng(2)), Hinge(), FrictionSurface(mu=0.2))
    plant.place(rocking.at(0.0), stable_poses(plant.body, rocking.at(0.0))[0])
    s, rates = [], []
    for k in range(1500):
        s.append([contact.s for contact in plant.contacts()])
        rates.append(plant.contact_rates())
        plant.advance(rocking.at((k + 0.5) * STEP), rocking.at((k + 1) * STEP), STEP)
    np.testing.assert_allclose(np.gradient(np.array(s), STEP, axis=0)[5:-5], np.array(rates)[5:-5], atol=2e-4)
    assert np.abs(rates).max() > 0.02


def test_contact_forces_follow_a_vibrating_table():
    plant = Plant(cylinder(RADIUS, 0.1), Hinge(), FrictionSurface(mu=0.2), imperfections=Imperfections(vibration=0.3))
    palms = PalmMotion.at_rest((math.pi / 4, math.pi / 2))
    plant.place(palms, 0.0)
    presses = []
    for _ in range(6000):
        plant.advance(palms, palms, STEP)
        presses.append([contact.force for contact in plant.contacts()])
    measured = np.sum(presses, axis=1) / math.sqrt(2.0) / 0.1  # m/s², both palms at 45°
    assert measured.mean() == pytest.approx(9.81, abs=0.02)
    assert measured.std() == pytest.approx(0.3, rel=0.05)


# ------------------------------------------------------------------------------------------- reconstruction

ZERO, LAG, FORCE, SAGITTA, SCALE = 3e-4, 6e-3, 1.5e-4, 1.5e-4, 0.02
TURNED, TIPPED, ASYMMETRY = math.radians(0.4), math.radians(0.5), 0.33
OBSERVABLE = {
    "pads, friction and gravity": (
        Imperfections(
            (PadImperfection(zero=ZERO, force=-FORCE, lag=-LAG), PadImperfection(zero=ZERO, force=FORCE, lag=LAG)),
            gravity=TIPPED,
            friction=ASYMMETRY,
        ),
        {"zero_sd": ZERO, "force_sd": FORCE, "lag_sd": LAG, "gravity_sd": TIPPED, "friction_sd": ASYMMETRY},
    ),
    "bows and the second angle": (
        Imperfections((PadImperfection(sagitta=SAGITTA), PadImperfection(sagitta=-SAGITTA)), (0.0, -TURNED)),
        {"sagitta_sd": SAGITTA, "angle_sd": TURNED},
    ),
}


def answer_to(off, **known):
    """The reconstruction of a run on a rig with these errors and otherwise exactly known."""
    run = simulated("friction", 44, 12.0, imperfections=off)
    return run, reconstruct(run.events, run.rig.known_to(PERFECTLY_KNOWN | known))


def is_estimated(answer, name, true):
    """Within its error bars, which exclude the opposite sign."""
    estimated_value, sd = (float(each[RIG_NAMES.index(name)]) for each in (answer.rig, answer.rig_sd))
    return abs(estimated_value - true) < 3.0 * sd and abs(true) > 2.5 * sd


@pytest.mark.parametrize(("off", "known"), OBSERVABLE.values(), ids=OBSERVABLE)
def test_an_observable_imperfection_is_estimated(off, known):
    _, answer = answer_to(off, **known)
    assert answer.converged, answer.reason
    assert [name for name, true in off.constants().items() if true and not is_estimated(answer, name, true)] == []


@pytest.mark.parametrize("number", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_the_scale_of_one_pad_is_estimated_if_the_others_is_known(number):
    off = of_pad(number, scale=-SCALE)
    run = simulated("friction", 44, 12.0, imperfections=off)
    pads = [replace(pad, scale_sd=SCALE * (palm == number)) for palm, pad in zip((1, 2), run.rig.pads, strict=True)]
    answer = reconstruct(run.events, replace(run.rig, pads=tuple(pads)))
    assert answer.converged, answer.reason
    assert is_estimated(answer, f"pad{number}_scale", -SCALE)


@pytest.mark.parametrize(
    ("off", "known"),
    [
        (of_pad(1, standoff=4e-4), {"standoff_sd": 4e-4}),
        (Imperfections((PadImperfection(scale=0.01),) * 2), {"scale_sd": 0.01}),
    ],
    ids=["standoff", "magnification"],
)
def test_the_sd_covers_an_unobservable_imperfection(off, known):
    run, answer = answer_to(off, **known)
    assert answer.converged, answer.reason
    error = score_outline(answer.theta, answer.h, answer.touched, run.truth.h).e_h
    band = math.sqrt(np.mean(answer.h_sd[answer.touched] ** 2))
    assert 2e-5 < error < 2.0 * band


def test_constants_have_the_names_of_the_results():
    assert set(PERFECT.constants()) == set(RIG_NAMES)


# --------------------------------------------------------------------------------------------------- the draws


def test_draws_have_the_described_sd_and_are_the_same_for_the_same_seed():
    draws = [drawn(CALIBRATED, seed) for seed in range(400)]
    assert draws[3] == drawn(CALIBRATED, 3)
    for each in fields(PadImperfection):
        if each.name == "smooth_error":
            continue
        values = [getattr(pad, each.name) for off in draws for pad in off.pads]
        sd = AS_CALIBRATED[f"{each.name}_sd"]
        assert np.std(values) == pytest.approx(sd, rel=0.12)
        assert abs(np.mean(values)) < 0.15 * sd
        assert max(map(abs, values)) <= 3.0 * sd
    for name, values in {
        "angle_sd": [angle for off in draws for angle in off.angles],
        "gravity_sd": [off.gravity for off in draws],
        "friction_sd": [off.friction for off in draws],
    }.items():
        assert np.std(values) == pytest.approx(AS_CALIBRATED[name], rel=0.15)
    assert drawn(RigDescription(), 3) == PERFECT


def test_pads_have_smooth_placement_errors_of_the_described_sd_and_length():
    sd, length, pad = 7e-5, 3e-3, RigDescription().pads[0].length
    rig = RigDescription().with_pads(map_sd=sd, map_length=length)
    places = pad / 2 + np.array([0.0, length, 6.0 * length])
    found = [each.smooth_error for seed in range(400) for each in drawn(rig, seed).pads]
    values = np.array([[place.at(float(s)) for s in places] for place in found])
    assert np.std(values[:, 0]) == pytest.approx(sd, rel=0.15)  # minus the part that a line takes
    alike = np.corrcoef(values.T)[0]
    assert alike[1] == pytest.approx(math.exp(-0.5), abs=0.1)
    assert abs(alike[2]) < 0.3  # removing a line makes distant positions slightly anticorrelated
    everywhere = np.linspace(0.0, pad, 200)
    for place in found[:5]:
        line = np.polyfit(everywhere, [place.at(float(s)) for s in everywhere], 1)
        assert np.abs(np.polyval(line, everywhere)).max() < 0.05 * sd  # these are the pad's zero and scale
    off = PadImperfection(zero=1e-4, smooth_error=found[0])
    assert off.reading_error_m(0.02, 0.0) == pytest.approx(1e-4 + found[0].at(0.02))
    assert drawn(rig, 3).constants() == drawn(rig.with_pads(map_sd=0.0), 3).constants()


# ------------------------------------------------------------------------------------------ logs, configurations


# under `vibration`, without constants
OF_VIBRATION = {"friction_arm", "vibration_kappa", "vibration_transmission", "vibration_period"}


def test_a_log_has_the_rigs_sd_and_its_truth_the_errors(tmp_path):
    out = tmp_path / "run.jsonl"
    assert main(["--seed", "3", "--seconds", "0.5", "--imperfections", "calibrated", "-o", str(out)]) == 0
    header = json.loads(out.read_text().splitlines()[0])
    truth = json.loads((tmp_path / "run.truth.json").read_text())
    assert header["rig"]["calibration_sd"]["zero_m"] == AS_CALIBRATED["zero_sd"]
    assert truth["rig"] == drawn(CALIBRATED, 0, 3).constants()
    assert {name for name, value in truth["rig"].items() if not value} == OF_VIBRATION
    header, *_ = simulate_log("nominal", 3, 0.5)[0]
    assert set(header["rig"]["calibration_sd"].values()) == {0.0}


def test_the_same_seed_gives_the_same_object_whatever_the_imperfections():
    perfect, other = (
        simulate_log("rig", 4, 0.5, calibration_sd=known)[1] for known in (PERFECTLY_KNOWN, AS_CALIBRATED)
    )
    assert (perfect["mass_kg"], perfect["rho_m"], perfect["mu"]) == (other["mass_kg"], other["rho_m"], other["mu"])
    assert perfect["phi1_rad"][0] == pytest.approx(other["phi1_rad"][0] - other["rig"]["phi1_rad"], abs=1e-9)


def asking(imperfections):
    config = default_config()
    return config.model_copy(update={"rig": config.rig.model_copy(update={"imperfections": imperfections})})


def test_a_configuration_uses_units_of_the_workshop():
    block = {"palm2": {"zero_mm": 0.3, "lag_ms": -2, "force_mm_per_n": 0.1}, "phi1_deg": 1, "gravity_deg": -0.5}
    off = configured(asking(ImperfectionsConfig.model_validate(block)), 1)
    assert off == Imperfections(
        (PadImperfection(), PadImperfection(zero=3e-4, lag=-2e-3, force=1e-4)),
        (math.radians(1.0), 0.0),
        math.radians(-0.5),
    )
    actual = off.true_palms(PalmMotion.at_rest((0.5, 1.0))).angles
    assert actual == pytest.approx((0.5 + math.radians(0.5), 1.0))
    assert configured(asking("none"), 1) == PERFECT
    assert configured(asking("calibrated"), 1) == PERFECT  # this rig is declared exactly known
    known = asking("calibrated")
    loose = known.model_copy(update={"pads": type(known.pads)(palm1={"port": "a"}, palm2={"port": "b"})})
    assert configured(loose, 1) == drawn(rig_description(loose), 1)
    assert configured(loose, 1).pads[0].zero != 0.0
    straight = {"port": "a", "map_sd_mm": 0}
    straight = known.model_copy(update={"pads": type(known.pads)(palm1=straight, palm2={"port": "b"})})
    first, second = configured(straight, 1).pads
    assert first.smooth_error == NO_ERROR
    assert second.smooth_error == drawn(rig_description(straight), 1).pads[1].smooth_error != NO_ERROR


def test_the_play_of_servos_is_not_drawn_in_addition():
    """The emulated servos have it already; an observer's sd of the angles includes both."""
    config = Config.model_validate(
        {
            "rig": {"hinge": "fixed", "imperfections": "calibrated"},
            "pads": {f"palm{i}": {"port": f"{i}"} for i in (1, 2)},
            "arm": {"kind": "feetech", "port": "c"},
        }
    )
    drawn_angles = np.array([configured(config, seed).angles for seed in range(300)])
    assert np.degrees(np.sqrt(np.mean(drawn_angles**2))) == pytest.approx(0.1, rel=0.15)
    assert np.degrees(rig_description(config).angle_sd) == pytest.approx(np.hypot(0.1, 0.5))
