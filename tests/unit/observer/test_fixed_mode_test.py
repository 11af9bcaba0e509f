"""An object fixed to one palm is distinguished from a rolling one by the other palm's readings alone."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from simulated import simulated, watched

from palmd import observer
from palmd.events import PadSample, PalmMotion
from palmd.observer import Simulated
from palmd.observer.fixed_mode_test import FixedModeTest
from palmd.record.replay import replay
from palmd.system.description import AS_CALIBRATED, RigDescription
from palmd.system.mechanism import PALMS

EXACT = RigDescription()
CALIBRATED = EXACT.known_to(AS_CALIBRATED)
DT_S, NO_FORCE = 0.01, np.zeros(2000)
NOISE_M, NEVER = float(np.sqrt(EXACT.reading_variances[0])), 100.0


def fixed_mode_test_of(
    readings: dict[int, np.ndarray], openings: np.ndarray, rig: RigDescription = EXACT, force: np.ndarray = NO_FORCE
) -> FixedModeTest:
    """The test after these readings (m) of each pad, with noise."""
    random, mode_test = np.random.default_rng(1), FixedModeTest(rig)
    rates = np.gradient(openings, DT_S)
    for k, (opening, rate) in enumerate(zip(openings.tolist(), rates.tolist(), strict=True)):
        palms = PalmMotion((0.7, opening), (0.0, rate), (0.0, 0.0))
        for pad in PALMS:
            s = float(readings[pad][k] + random.normal(0.0, NOISE_M))
            mode_test.read(PadSample(DT_S * k, pad, s, float(force[k])), palms)
    return mode_test


OPENINGS = 1.6 + 0.3 * np.sin(np.linspace(0.0, 4.0, 200))
FIXED = (15e-3 + 1e-3 * np.cos(OPENINGS)) / np.sin(OPENINGS)  # a corner of 1 mm, 15 mm over the other palm
ROLLING = (18e-3 + 18e-3 * np.cos(OPENINGS)) / np.sin(OPENINGS) + 1e-3 * np.sin(np.linspace(0.0, 9.0, 200))


@pytest.mark.parametrize(("one", "two", "excluded"), [
    (FIXED, ROLLING, False), (ROLLING, FIXED, False), (ROLLING, ROLLING, True), (FIXED, FIXED, False),
])  # fmt: skip
def test_the_fixed_mode_is_excluded_if_both_palms_contradict_it(one, two, excluded):
    assert fixed_mode_test_of({1: one, 2: two}, OPENINGS).excluded is excluded


def test_a_detected_corner_is_kept():
    mode_test = fixed_mode_test_of({1: FIXED, 2: ROLLING}, OPENINGS)
    assert mode_test.cornered
    for s in (10e-3, 20e-3) * 100:
        mode_test.read(PadSample(3.0, 1, s), PalmMotion((0.7, 1.6), (0.1, 0.0), (0.0, 0.0)))
    assert mode_test.excluded
    assert mode_test.cornered
    round_one = (15e-3 + 10e-3 * np.cos(OPENINGS)) / np.sin(OPENINGS)
    assert not fixed_mode_test_of({1: round_one, 2: ROLLING}, OPENINGS).cornered


def test_resting_readings_do_not_change_the_decision():
    still = np.full(200, 15e-3)
    assert not fixed_mode_test_of({1: still, 2: still}, np.full(200, 1.6)).excluded
    assert not FixedModeTest(EXACT).excluded
    rolled = fixed_mode_test_of({1: ROLLING, 2: ROLLING}, OPENINGS)
    for k in range(100_000):
        rolled.read(PadSample(3.0, 1 + k % 2, 20e-3), PalmMotion.at_rest((0.7, 1.6)))
    assert rolled.excluded


def test_readings_of_a_disc_are_ambiguous():
    disc = 18e-3 * (1 + np.cos(OPENINGS)) / np.sin(OPENINGS)
    mode_test = fixed_mode_test_of({1: disc, 2: disc}, OPENINGS)
    assert not mode_test.excluded
    assert not mode_test.cornered
    assert mode_test.disc
    assert not fixed_mode_test_of({1: FIXED, 2: ROLLING}, OPENINGS).disc


def test_arcs_are_concentric_only_if_both_palms_agree():
    def about(over_other, radius):
        return (over_other + radius * np.cos(OPENINGS)) / np.sin(OPENINGS)

    assert FixedModeTest(EXACT).concentric
    assert fixed_mode_test_of({1: about(18e-3, 18e-3), 2: about(18e-3, 18e-3)}, OPENINGS).concentric
    assert fixed_mode_test_of({1: about(12e-3, 18e-3), 2: about(18e-3, 12e-3)}, OPENINGS).concentric
    other = fixed_mode_test_of({1: about(18e-3, 18e-3), 2: about(18e-3, 16e-3)}, OPENINGS)
    assert other.disc
    assert not other.concentric


def test_a_sharp_estimate_that_is_no_disc_is_valid_without_excluding_the_fixed_mode():
    """It hardly rolls: neither palm alone contradicts the fixed mode for 3.4 s."""
    run = simulated("friction", 16302, 6.0)
    watcher = observer.make("shape", run.rig, smoothing=Simulated(run.rig))
    tick = next(islice(replay(run, watcher), 210, None))
    assert watcher._session.track.flat_side_test.disc
    assert not watcher._session.track.flat_side_test.concentric
    assert tick.estimate.valid


@pytest.mark.parametrize("off", ["zero", "scale", "turn", "lag", "force", "standoff"])
def test_calibration_errors_do_not_exclude_the_fixed_mode(off):
    openings = 1.6 + 0.3 * np.sin(np.linspace(0.0, 40.0, 2000))
    fixed_reading = (15e-3 + 10e-3 * np.cos(openings)) / np.sin(openings)
    rolling = fixed_reading + 1e-3 * np.sin(np.linspace(0.0, 90.0, 2000))
    pad, force = CALIBRATED.pads[0], 1.0 + 0.8 * np.sin(np.linspace(0.0, 60.0, 2000))
    wrong = {
        "zero": 3 * pad.zero_sd,
        "scale": 3 * pad.scale_sd * fixed_reading,
        "lag": -3 * pad.lag_sd * np.gradient(fixed_reading, DT_S),
        "force": 3 * pad.force_sd * force,
        "standoff": 3 * pad.standoff_sd / np.sin(openings),
    }
    reported = openings - 3 * CALIBRATED.angle_sd * (off == "turn")
    assert not fixed_mode_test_of(
        {1: fixed_reading + wrong.get(off, 0.0), 2: rolling}, reported, CALIBRATED, force
    ).excluded


def test_rolling_on_a_calibrated_rig_excludes_the_fixed_mode():
    assert fixed_mode_test_of({1: ROLLING, 2: ROLLING}, OPENINGS, CALIBRATED).excluded


def valid_ticks(run, smoother_takes_s: float) -> int:
    """The number of ticks in which an observer is valid."""
    watcher = observer.make("shape", run.rig, 0, Simulated(run.rig, latency_s=smoother_takes_s))
    return sum(estimate.valid for estimate in watched(watcher, run.events))


@pytest.mark.parametrize(
    ("smoother_takes_s", "excluded", "disc", "sharp", "ticks"),
    [
        (NEVER, True, False, False, 20), (NEVER, False, False, False, 0), (NEVER, True, False, True, 0),
        (0.2, True, False, False, 20), (0.2, False, False, False, 20), (0.2, False, True, False, 0),
        (0.2, True, False, True, 0),
    ],
)  # fmt: skip
def test_only_objects_known_to_roll_are_valid(monkeypatch, smoother_takes_s, excluded, disc, sharp, ticks):
    """Known by both pads, or by one and a smoother that has compared its answer with the fixed mode."""
    monkeypatch.setattr(FixedModeTest, "excluded", excluded)
    monkeypatch.setattr(FixedModeTest, "disc", disc)
    monkeypatch.setattr(FixedModeTest, "concentric", disc)
    monkeypatch.setattr(FixedModeTest, "_touches_corner", lambda *_: sharp)
    monkeypatch.setattr("palmd.observer.fixed_mode_test.LEAST_RANGE_RAD", 0.0)
    valid = valid_ticks(simulated("nominal", 9500, 2.0), smoother_takes_s)
    assert (valid > ticks) if ticks else (valid == 0)


def test_a_rolling_object_is_valid_before_the_smoother_answers():
    assert valid_ticks(simulated("nominal", 9500, 1.2), NEVER) > 20
