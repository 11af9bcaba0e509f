"""Pads with a smooth error of place: their maps among the constants of the final fit."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palmd.events import PadSample
from palmd.observer.reconstruct import reconstruct
from palmd.observer.reconstruction import Reconstruction
from palmd.record.eventlog import EventLog, header_line, read_log
from palmd.rig.simulate import simulate_log
from palmd.system.description import AS_CALIBRATED
from tools.studies.scoring import Truth, outline_errors, truth_of

A_M = 7e-5
WAVES_M = (12e-3, 32e-3)


def read(path: Path, lines: list[dict[str, object]]) -> EventLog:
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return read_log(path)


def error_of_place(rng: np.random.Generator) -> Callable[[float], float]:
    """Two waves, `A_M` in the mean square."""
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
    """Root mean square error of what was touched, in one-sigmas."""
    found = outline_errors(answer, truth)
    assert found is not None
    at = found.touched
    return float(np.sqrt(np.mean((found.error[at] / found.h_sd[at]) ** 2)))


def test_an_error_that_repeats_with_the_place_is_in_the_band(coloured: tuple[EventLog, Truth]) -> None:
    log, truth = coloured
    unaware = reconstruct(log.events, log.rig.with_pads(map_sd=0.0))
    aware = reconstruct(log.events, log.rig.with_pads(map_sd=A_M))
    assert sigmas(unaware, truth) > 3.0
    assert aware.converged
    assert sigmas(aware, truth) < 2.0


def test_a_map_that_pads_do_not_have_costs_little(tmp_path: Path) -> None:
    lines, told = simulate_log("nominal", 9001, 10.0, calibration_sd=AS_CALIBRATED)
    log, truth = read(tmp_path / "run.jsonl", lines), truth_of(told)
    plain, mapped = (reconstruct(log.events, log.rig.with_pads(map_sd=a)) for a in (0.0, A_M))
    assert mapped.converged
    assert sigmas(mapped, truth) < 2.0
    bands = [float(np.sqrt(np.mean(each.h_sd[each.touched] ** 2))) for each in (plain, mapped)]
    assert bands[0] < bands[1] < 1.25 * bands[0]


def test_a_log_says_what_is_left_of_the_error_of_place(tmp_path: Path) -> None:
    lines, _ = simulate_log("nominal", 9001, 0.2)
    log = read(tmp_path / "run.jsonl", lines)
    rig = log.rig.with_pads(map_sd=A_M, map_length=4e-3)
    again = read(tmp_path / "again.jsonl", [header_line(rig), *lines[1:]])
    assert [(pad.map_sd, pad.map_length) for pad in again.rig.pads] == [(A_M, 4e-3)] * 2
    differing = replace(rig, pads=(rig.pads[0], replace(rig.pads[1], map_sd=2 * A_M)))
    again = read(tmp_path / "own.jsonl", [header_line(differing), *lines[1:]])
    assert [pad.map_sd for pad in again.rig.pads] == [A_M, 2 * A_M]
