"""The noise of readings is measured where it exceeds what is described, and only there."""

import math
from dataclasses import replace

import numpy as np
import pytest
from simulated import simulated

from palmd.events import PadSample
from palmd.observer.noise import with_scatter
from palmd.observer.reconstruct import reconstruct
from palmd.rig.imperfections import Imperfections
from palmd.score import score_outline
from palmd.system.description import RigDescription

RIG = RigDescription()
DESCRIBED = math.sqrt(RIG.pads[0].reading_variance)


def samples(seed, noise, seconds=8.0, pad=1, force_noise=0.05, outliers=0.0, jitter=0.0):
    """A contact that wanders by centimetres, read at irregular times."""
    random = np.random.default_rng(seed)
    t = np.cumsum(random.uniform(0.006, 0.014, int(seconds * 100)))
    stamped = t + jitter * random.standard_normal(len(t))
    s = 0.03 + 0.015 * np.sin(2.0 * t) + 0.004 * np.sin(7.0 * t + 1.0) + noise * random.standard_normal(len(t))
    s = np.where(random.random(len(t)) < outliers, random.uniform(0.0, 0.05, len(t)), s)
    force = (1.0 + 0.5 * np.sin(3.0 * t)) * (1.0 + force_noise * random.standard_normal(len(t)))
    return [PadSample(float(a), pad, float(b), float(c)) for a, b, c in zip(stamped, s, force, strict=True)]


@pytest.mark.parametrize("seed", range(5))
def test_readings_as_noisy_as_described_leave_the_description_as_it_is(seed):
    assert with_scatter(RIG, [*samples(seed, DESCRIBED), *samples(seed + 9, 0.3 * DESCRIBED, pad=2)]) == RIG


@pytest.mark.parametrize("times", [1.5, 3.0, 8.0])
@pytest.mark.parametrize("outliers", [0.0, 0.03])
def test_what_scatters_more_is_noisier_by_that_and_the_other_pad_is_not(times, outliers):
    rig = with_scatter(RIG, [*samples(1, times * DESCRIBED, outliers=outliers), *samples(2, DESCRIBED, pad=2)])
    assert rig.pads[1] == RIG.pads[1]
    assert math.sqrt(rig.pads[0].reading_variance) / DESCRIBED == pytest.approx(times, rel=0.2)


def test_stamps_that_jitter_are_noise_where_the_contact_moves():
    noisy = with_scatter(RIG, samples(3, DESCRIBED, jitter=3e-3)).pads[0]
    assert noisy.noise > 1.2 * RIG.pads[0].noise


def test_forces_that_shake_are_less_certain():
    shaken = with_scatter(RIG, samples(4, DESCRIBED, force_noise=0.2)).pads[0]
    assert shaken.force_scale_std == pytest.approx(0.2, rel=0.25)
    assert shaken == replace(RIG.pads[0], force_scale_std=shaken.force_scale_std)


def test_a_few_readings_tell_no_noise():
    assert with_scatter(RIG, samples(5, 5 * DESCRIBED, seconds=0.3)) == RIG


def test_a_run_with_heavy_tailed_noise_is_claimed_and_right():
    """Three times as noisy as described, in the mean, with tails of Student's t: such a run was refused."""
    run, random = simulated("friction", 42, 10.0), np.random.default_rng(6)
    events = [
        replace(event, s=event.s + 1e-4 * float(random.standard_t(3))) if isinstance(event, PadSample) else event
        for event in run.events
    ]
    answer = reconstruct(events, run.rig)
    assert answer.converged, answer.reason
    assert not answer.contradicted.any()
    band = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    assert score_outline(answer.theta, answer.h, answer.touched, run.truth.h).e_h < 3 * band < 3e-4


@pytest.mark.parametrize("vibration", [0.3, 0.6])
def test_a_table_that_shakes_is_no_reason_to_refuse_what_the_contacts_tell(vibration):
    """Forces scatter by a fifth more than described, or twice as much; contacts move by some micrometres."""
    run = simulated("friction", 42, 10.0, imperfections=Imperfections(vibration=vibration))
    answer = reconstruct(run.events, run.rig)
    assert answer.converged, answer.reason
    assert not answer.contradicted.any()
    band = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    assert score_outline(answer.theta, answer.h, answer.touched, run.truth.h).e_h < 3 * band < 1e-4
