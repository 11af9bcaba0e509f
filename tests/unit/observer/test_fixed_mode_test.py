"""What only turns with a palm is told from what rolls by the other palm's readings alone."""

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


def told(
    readings: dict[int, np.ndarray], openings: np.ndarray, rig: RigDescription = EXACT, force: np.ndarray = NO_FORCE
) -> FixedModeTest:
    """After these readings (m) of each pad, with noise."""
    random, riding = np.random.default_rng(1), FixedModeTest(rig)
    rates = np.gradient(openings, DT_S)
    for k, (opening, rate) in enumerate(zip(openings.tolist(), rates.tolist(), strict=True)):
        palms = PalmMotion((0.7, opening), (0.0, rate), (0.0, 0.0))
        for pad in PALMS:
            s = float(readings[pad][k] + random.normal(0.0, NOISE_M))
            riding.read(PadSample(DT_S * k, pad, s, float(force[k])), palms)
    return riding


OPENINGS = 1.6 + 0.3 * np.sin(np.linspace(0.0, 4.0, 200))
RIDDEN = (15e-3 + 1e-3 * np.cos(OPENINGS)) / np.sin(OPENINGS)  # a corner of 1 mm, 15 mm over the other palm
ROLLING = (18e-3 + 18e-3 * np.cos(OPENINGS)) / np.sin(OPENINGS) + 1e-3 * np.sin(np.linspace(0.0, 9.0, 200))


@pytest.mark.parametrize(("one", "two", "excluded"), [
    (RIDDEN, ROLLING, False), (ROLLING, RIDDEN, False), (ROLLING, ROLLING, True), (RIDDEN, RIDDEN, False),
])  # fmt: skip
def test_a_ride_is_excluded_where_both_palms_contradict_it(one, two, excluded):
    assert told({1: one, 2: two}, OPENINGS).excluded is excluded


def test_a_corner_is_felt_and_not_forgotten():
    riding = told({1: RIDDEN, 2: ROLLING}, OPENINGS)
    assert riding.cornered
    for s in (10e-3, 20e-3) * 100:
        riding.read(PadSample(3.0, 1, s), PalmMotion((0.7, 1.6), (0.1, 0.0), (0.0, 0.0)))
    assert riding.excluded
    assert riding.cornered
    round_one = (15e-3 + 10e-3 * np.cos(OPENINGS)) / np.sin(OPENINGS)
    assert not told({1: round_one, 2: ROLLING}, OPENINGS).cornered


def test_nothing_that_rests_excludes_a_ride_or_allows_for_one():
    still = np.full(200, 15e-3)
    assert not told({1: still, 2: still}, np.full(200, 1.6)).excluded
    assert not FixedModeTest(EXACT).excluded
    rolled = told({1: ROLLING, 2: ROLLING}, OPENINGS)
    for k in range(100_000):
        rolled.read(PadSample(3.0, 1 + k % 2, 20e-3), PalmMotion.at_rest((0.7, 1.6)))
    assert rolled.excluded


def test_a_disc_may_be_anything_that_has_an_arc_for_all_that_its_readings_tell():
    disc = 18e-3 * (1 + np.cos(OPENINGS)) / np.sin(OPENINGS)
    riding = told({1: disc, 2: disc}, OPENINGS)
    assert not riding.excluded
    assert not riding.cornered
    assert riding.disc
    assert not told({1: RIDDEN, 2: ROLLING}, OPENINGS).disc


def test_arcs_about_one_centre_are_as_a_disc_and_others_are_not_by_both_palms_together():
    def about(over_other, radius):
        return (over_other + radius * np.cos(OPENINGS)) / np.sin(OPENINGS)

    assert FixedModeTest(EXACT).concentric
    assert told({1: about(18e-3, 18e-3), 2: about(18e-3, 18e-3)}, OPENINGS).concentric
    assert told({1: about(12e-3, 18e-3), 2: about(18e-3, 12e-3)}, OPENINGS).concentric
    other = told({1: about(18e-3, 18e-3), 2: about(18e-3, 16e-3)}, OPENINGS)
    assert other.disc
    assert not other.concentric


def test_what_is_told_sharply_and_is_no_disc_need_not_be_felt_to_roll():
    """It hardly rolls: neither palm by itself contradicts a ride for 3.4 s."""
    run = simulated("friction", 16302, 6.0)
    watcher = observer.make("shape", run.rig, smoothing=Simulated(run.rig))
    tick = next(islice(replay(run, watcher), 210, None))
    assert watcher._session.track.flat_side_test.disc
    assert not watcher._session.track.flat_side_test.concentric
    assert tick.estimate.valid


@pytest.mark.parametrize("off", ["zero", "scale", "turn", "lag", "force", "standoff"])
def test_a_ride_is_not_excluded_by_what_a_rig_may_be_off_by(off):
    openings = 1.6 + 0.3 * np.sin(np.linspace(0.0, 40.0, 2000))
    ridden = (15e-3 + 10e-3 * np.cos(openings)) / np.sin(openings)
    rolling = ridden + 1e-3 * np.sin(np.linspace(0.0, 90.0, 2000))
    pad, force = CALIBRATED.pads[0], 1.0 + 0.8 * np.sin(np.linspace(0.0, 60.0, 2000))
    wrong = {
        "zero": 3 * pad.zero_sd,
        "scale": 3 * pad.scale_sd * ridden,
        "lag": -3 * pad.lag_sd * np.gradient(ridden, DT_S),
        "force": 3 * pad.force_sd * force,
        "standoff": 3 * pad.standoff_sd / np.sin(openings),
    }
    reported = openings - 3 * CALIBRATED.angle_sd * (off == "turn")
    assert not told({1: ridden + wrong.get(off, 0.0), 2: rolling}, reported, CALIBRATED, force).excluded


def test_what_rolls_on_a_calibrated_rig_excludes_a_ride_too():
    assert told({1: ROLLING, 2: ROLLING}, OPENINGS, CALIBRATED).excluded


def valid_ticks(run, smoother_takes_s: float) -> int:
    """In how many ticks an observer is valid."""
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
def test_only_what_is_known_to_roll_is_vouched_for(monkeypatch, smoother_takes_s, excluded, disc, sharp, ticks):
    """By both pads, or by one and a smoother that has weighed its answer against a ride."""
    monkeypatch.setattr(FixedModeTest, "excluded", excluded)
    monkeypatch.setattr(FixedModeTest, "disc", disc)
    monkeypatch.setattr(FixedModeTest, "concentric", disc)
    monkeypatch.setattr(FixedModeTest, "_touches_corner", lambda *_: sharp)
    monkeypatch.setattr("palmd.observer.fixed_mode_test.LEAST_RANGE_RAD", 0.0)
    valid = valid_ticks(simulated("nominal", 9500, 2.0), smoother_takes_s)
    assert (valid > ticks) if ticks else (valid == 0)


def test_what_rolls_is_vouched_for_before_the_smoother_has_told_of_it():
    assert valid_ticks(simulated("nominal", 9500, 1.2), NEVER) > 20
