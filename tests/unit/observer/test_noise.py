"""The noise of readings is measured, and replaces the described noise only where it exceeds it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from campaign import nightly
from simulated import simulated

from palmd.events import PadSample, PalmSample
from palmd.observer.noise import ADAPTER_S, batched, with_scatter
from palmd.observer.palm_path import smoothed_path
from palmd.observer.reconstruct import reconstruct
from palmd.observer.record import lay_out
from palmd.rig.imperfections import Imperfections
from palmd.score import score_outline
from palmd.system.description import RigDescription

RIG = RigDescription()
DESCRIBED = math.sqrt(RIG.pads[0].reading_variance)


def samples(seed, noise, seconds=8.0, pad=1, force_noise=0.05, outliers=0.0, jitter=0.0):
    """A contact that moves over centimetres, read at irregular times."""
    random = np.random.default_rng(seed)
    t = np.cumsum(random.uniform(0.006, 0.014, int(seconds * 100)))
    stamped = t + jitter * random.standard_normal(len(t))
    s = 0.03 + 0.015 * np.sin(2.0 * t) + 0.004 * np.sin(7.0 * t + 1.0) + noise * random.standard_normal(len(t))
    s = np.where(random.random(len(t)) < outliers, random.uniform(0.0, 0.05, len(t)), s)
    force = (1.0 + 0.5 * np.sin(3.0 * t)) * (1.0 + force_noise * random.standard_normal(len(t)))
    return [PadSample(float(a), pad, float(b), float(c)) for a, b, c in zip(stamped, s, force, strict=True)]


@pytest.mark.parametrize("seed", range(5))
def test_readings_with_the_described_noise_leave_the_description_unchanged(seed):
    assert with_scatter(RIG, [*samples(seed, DESCRIBED), *samples(seed + 9, 0.3 * DESCRIBED, pad=2)]) == RIG


@pytest.mark.parametrize("times", [1.5, 3.0, 8.0])
@pytest.mark.parametrize("outliers", [0.0, 0.03])
def test_a_noisier_pad_gets_its_measured_noise_and_the_other_pad_does_not(times, outliers):
    rig = with_scatter(RIG, [*samples(1, times * DESCRIBED, outliers=outliers), *samples(2, DESCRIBED, pad=2)])
    assert rig.pads[1] == RIG.pads[1]
    assert math.sqrt(rig.pads[0].reading_variance) / DESCRIBED == pytest.approx(times, rel=0.2)


def test_time_stamp_jitter_is_noise_while_the_contact_moves():
    noisy = with_scatter(RIG, samples(3, DESCRIBED, jitter=3e-3)).pads[0]
    assert noisy.noise > 1.2 * RIG.pads[0].noise


def in_batches(readings, phase=0.005):
    """As an FTDI adapter delivers them and the pad's driver stamps them: the last one of a batch has just ended."""
    batches = {}
    for sample in readings:
        batches.setdefault(math.ceil((sample.t_sample - phase) / ADAPTER_S), []).append(sample)
    return [
        replace(sample, t_sample=number * ADAPTER_S + phase - 0.00625 * (len(batch) - k))
        for number, batch in batches.items()
        for k, sample in enumerate(batch)
    ]


@pytest.mark.parametrize("seed", range(4))
def test_batched_time_stamps_of_an_adapter_are_detected(seed):
    readings = samples(seed, DESCRIBED)
    t, delivered = (np.array([sample.t_sample for sample in each]) for each in (readings, in_batches(readings)))
    assert not batched(t)
    assert not batched(np.arange(800) * 0.01), "a pad that is read every 10 ms"
    assert not batched(np.arange(800) * 0.008), "or 125 times a second"
    assert batched(delivered)
    pad = with_scatter(RIG, in_batches(readings)).pads[0]
    assert pad.lag_sd == pytest.approx(ADAPTER_S / 2)
    assert pad.reading_variance >= 0.999 * (DESCRIBED**2 + pad.blur**2)


def test_batched_readings_have_a_variance_that_grows_with_contact_speed():
    readings = [*in_batches(samples(1, DESCRIBED)), *samples(2, DESCRIBED, pad=2)]
    readings.sort(key=lambda sample: sample.t_sample)
    rig = with_scatter(RIG, readings)
    palms = [PalmSample(0.016 * k, (0.9, 1.7)) for k in range(600)]
    record = lay_out(readings, smoothed_path(palms, 1e-4), rig, 0.1, 7.0, 0.01)
    variance = record.contact_variance[record.contact_pad == 1] / DESCRIBED**2
    assert variance.min() == pytest.approx(1.0, abs=0.05)
    assert variance.max() > 3.0
    assert np.ptp(record.contact_variance[record.contact_pad == 2]) == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_errors_of_batched_readings_match_their_sd(seed):
    readings = samples(seed, DESCRIBED)
    delivered = in_batches(readings)
    pad = with_scatter(RIG, delivered).pads[0]
    t, s = np.array([(sample.t_sample, sample.s) for sample in delivered]).T
    at = t - np.mean(t - np.array([sample.t_sample for sample in readings]))
    place = 0.03 + 0.015 * np.sin(2.0 * at) + 0.004 * np.sin(7.0 * at + 1.0)
    rate = 0.03 * np.cos(2.0 * at) + 0.028 * np.cos(7.0 * at + 1.0)
    z = (s - place) / np.hypot(DESCRIBED, pad.stamp_sd * rate)
    assert 0.8 < math.sqrt(np.mean(z**2)) < 1.2


@pytest.mark.parametrize(("kind", "seed"), [("rig", 7201), *nightly(("nominal", 7208), ("friction", 7203))])
def test_a_run_in_batches_is_reconstructed_within_its_band(kind, seed):
    run = simulated(kind, seed, 12.0)
    pads = [[e for e in run.events if isinstance(e, PadSample) and e.pad == number] for number in (1, 2)]
    events = [*in_batches(pads[0]), *in_batches(pads[1], 0.011), *(e for e in run.events if isinstance(e, PalmSample))]
    answer = reconstruct(sorted(events, key=lambda event: event.t_sample), run.rig)
    assert answer.converged, answer.reason
    band = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    assert score_outline(answer.theta, answer.h, answer.touched, run.truth.h).e_h < 3 * band


def test_scattered_forces_get_a_larger_sd():
    shaken = with_scatter(RIG, samples(4, DESCRIBED, force_noise=0.2)).pads[0]
    assert shaken.force_scale_std == pytest.approx(0.2, rel=0.25)
    assert shaken == replace(RIG.pads[0], force_scale_std=shaken.force_scale_std)


def test_a_few_readings_do_not_determine_the_noise():
    assert with_scatter(RIG, samples(5, 5 * DESCRIBED, seconds=0.3)) == RIG


def test_a_run_with_heavy_tailed_noise_is_accepted_and_accurate():
    """The noise is on average three times the described one, with Student's t tails; such a run was once rejected."""
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


@pytest.mark.parametrize("vibration", [0.6, *nightly(0.3)])
def test_vibration_of_the_table_does_not_cause_a_rejection(vibration):
    """Forces scatter by a fifth more than described, or twice as much; contacts move by some micrometres."""
    run = simulated("friction", 42, 10.0, imperfections=Imperfections(vibration=vibration))
    answer = reconstruct(run.events, run.rig)
    assert answer.converged, answer.reason
    assert not answer.contradicted.any()
    band = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    assert score_outline(answer.theta, answer.h, answer.touched, run.truth.h).e_h < 3 * band < 1e-4
