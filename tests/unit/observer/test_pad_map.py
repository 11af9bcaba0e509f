"""Pads with a smooth error of place: their maps among the constants of the final fit."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palmd.events import FloatArray, PadSample, PalmSample
from palmd.model.smoothing import CONSTANTS
from palmd.observer.factor import Prior
from palmd.observer.noise import MAP_READINGS, map_as_noise
from palmd.observer.normal_equations import Guess
from palmd.observer.pad_map import with_map
from palmd.observer.palm_path import smoothed_path
from palmd.observer.reconstruct import reconstruct
from palmd.observer.reconstruction import Reconstruction
from palmd.observer.record import Record, lay_out
from palmd.record.eventlog import EventLog, header_line, read_log
from palmd.rig.simulate import simulate_log
from palmd.system.description import AS_CALIBRATED, PadSensor, RigDescription
from tools.studies.scoring import Truth, outline_errors, truth_of

A_M = 7e-5
WAVES_M = (12e-3, 32e-3)


def read(path: Path, lines: list[dict[str, object]]) -> EventLog:
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return read_log(path)


def error_of_place(rng: np.random.Generator) -> Callable[[float], float]:
    """Two waves with mean square `A_M`²."""
    waves = [(length, rng.uniform(0, math.tau), rng.standard_normal()) for length in WAVES_M]
    size = A_M / math.sqrt(sum(share**2 for *_, share in waves) / 2)
    return lambda s: size * sum(share * math.cos(math.tau * s / length + phase) for length, phase, share in waves)


@pytest.fixture(scope="module")
def coloured(tmp_path_factory: pytest.TempPathFactory) -> tuple[EventLog, Truth]:
    lines, truth = simulate_log("nominal", 9000, 10.0, calibration_sd=AS_CALIBRATED)
    log, rng = read(tmp_path_factory.mktemp("log") / "run.jsonl", lines), np.random.default_rng([9000, 7])
    maps = [error_of_place(rng) for _ in range(2)]
    events = tuple(
        replace(each, s=each.s + maps[each.pad - 1](each.s)) if isinstance(each, PadSample) else each
        for each in log.events
    )
    return replace(log, events=events), truth_of(truth)


def sigmas(answer: Reconstruction, truth: Truth) -> float:
    """Root mean square error of the touched outline in one-sigmas."""
    found = outline_errors(answer, truth)
    assert found is not None
    at = found.touched
    return float(np.sqrt(np.mean((found.error[at] / found.h_sd[at]) ** 2)))


def test_a_repeatable_error_of_place_is_in_the_band(coloured: tuple[EventLog, Truth]) -> None:
    log, truth = coloured
    unaware = reconstruct(log.events, log.rig.with_pads(map_sd=0.0))
    aware = reconstruct(log.events, log.rig.with_pads(map_sd=A_M))
    assert sigmas(unaware, truth) > 3.0
    assert aware.converged
    assert sigmas(aware, truth) < 2.0


@pytest.mark.nightly
def test_an_unnecessary_map_widens_the_bands_little(tmp_path: Path) -> None:
    lines, truth_fields = simulate_log("nominal", 9001, 10.0, calibration_sd=AS_CALIBRATED)
    log, truth = read(tmp_path / "run.jsonl", lines), truth_of(truth_fields)
    plain, mapped = (reconstruct(log.events, log.rig.with_pads(map_sd=a)) for a in (0.0, A_M))
    assert mapped.converged
    assert sigmas(mapped, truth) < 2.0
    bands = [float(np.sqrt(np.mean(each.h_sd[each.touched] ** 2))) for each in (plain, mapped)]
    assert bands[0] < bands[1] < 1.25 * bands[0]


def test_a_log_carries_the_remaining_error_of_place(tmp_path: Path) -> None:
    lines, _ = simulate_log("nominal", 9001, 0.2)
    log = read(tmp_path / "run.jsonl", lines)
    rig = log.rig.with_pads(map_sd=A_M, map_length=4e-3)
    again = read(tmp_path / "again.jsonl", [header_line(rig), *lines[1:]])
    assert [(pad.map_sd, pad.map_length) for pad in again.rig.pads] == [(A_M, 4e-3)] * 2
    differing = replace(rig, pads=(rig.pads[0], replace(rig.pads[1], map_sd=2 * A_M)))
    again = read(tmp_path / "own.jsonl", [header_line(differing), *lines[1:]])
    assert [pad.map_sd for pad in again.rig.pads] == [A_M, 2 * A_M]


def laid(rig: RigDescription, places: FloatArray) -> Record:
    """Readings of pad 1 at these places, with a few of pad 2."""
    times = 0.01 * np.arange(len(places))
    samples = [PadSample(float(t), 1, float(s), 1.0) for t, s in zip(times, places, strict=True)]
    samples += [PadSample(float(t) + 0.001, 2, 0.02, 1.0) for t in times[::5]]
    palms = [PalmSample(0.01 * k, (0.7, 1.6), (0.0, 0.0), (0.0, 0.0)) for k in range(-4, len(places) + 5)]
    ordered = sorted(samples, key=lambda sample: sample.t_sample)
    return lay_out(ordered, smoothed_path(palms, 2e-4), rig, 0.0, 0.01 * len(places), 0.01)


def problem(rig: RigDescription, places: FloatArray) -> tuple[Record, Record]:
    """The record of a search, and that of the fit with maps."""
    rig = map_as_noise(rig, MAP_READINGS)
    record = laid(rig, places)
    prior = Prior(np.zeros(CONSTANTS), np.ones(CONSTANTS), 1.0)
    guess = Guess(np.zeros((len(record.t), 2)), np.ones(CONSTANTS))
    mapped, wider, longer = with_map(record, record.contact_value, prior, guess, rig)
    assert len(wider.mean) == len(wider.sd) == len(longer.p) == CONSTANTS + mapped.contact_map.shape[1]
    return record, mapped


def test_the_map_has_the_covariance_of_the_error_of_place() -> None:
    places, length = np.linspace(0.02, 0.026, 40), 3e-3
    _, mapped = problem(RigDescription().with_pads(map_sd=A_M, map_length=length), places)
    mine = mapped.contact_pad == 1
    found = mapped.contact_map[mine] @ mapped.contact_map[mine].T
    wanted = A_M**2 * np.exp(-0.5 * np.subtract.outer(places, places) ** 2 / length**2)
    # the pad's zero and scale take part of it
    assert found == pytest.approx(wanted, abs=0.3 * A_M**2)
    picked, contrast = (np.ix_([5, 20, 35], [5, 20, 35]), np.array([1.0, -2.0, 1.0]))  # without zero and scale
    missing = contrast @ (wanted - found)[picked] @ contrast
    left = mapped.contact_variance[mine].max() - PadSensor().reading_variance
    assert 0.0 <= missing <= contrast @ contrast * left
    assert left < 0.2 * PadSensor().reading_variance


@pytest.mark.parametrize("length", [1e-7, 5e-5, 5e-4, 3e-3, 0.5])
def test_any_correlation_length_gives_a_solvable_problem(length: float) -> None:
    rig = RigDescription().with_pads(map_sd=A_M, map_length=length)
    searched, mapped = problem(rig, np.linspace(0.02, 0.03, 40))
    assert np.isfinite(mapped.contact_map).all()
    assert (mapped.contact_variance >= rig.pads[0].reading_variance * (1 - 1e-9)).all()
    if length < 1e-4:
        assert mapped.contact_map.size == 0
        assert mapped.contact_variance == pytest.approx(rig.pads[0].reading_variance + A_M**2)
    assert (searched.contact_variance > mapped.contact_variance.min()).all()
