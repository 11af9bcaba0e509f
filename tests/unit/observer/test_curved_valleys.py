"""Ellipses on vibrating palms, simulated by MuJoCo (emulated rig; seed 7, 10 s, and seed 5904, 17 s)."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stored_log import DATA, stored_log

from palmd.events import Improvement
from palmd.model.smoothing import C, R
from palmd.observer.data_segment import data_segments
from palmd.observer.incremental import IncrementalSmoother
from palmd.observer.initialiser import attempts_for
from palmd.observer.noise import MAP_READINGS, map_as_noise, with_scatter
from palmd.observer.normal_equations import Guess
from palmd.observer.reconstruct import reconstruct
from palmd.observer.search import Search, explained
from palmd.observer.smoothing import Session, period
from palmd.record.eventlog import EventLog
from palmd.score import score_outline

COST_FROM_TRUTH = 442.6
"""Of the fit that starts from the true object and motion."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> EventLog:
    return stored_log("mujoco-ellipse", tmp_path_factory.mktemp("logs"))


def test_a_search_reaches_the_bottom_of_a_curved_valley(log: EventLog) -> None:
    """The iteration alone stops at a cost 47 higher, with an outline that is off by 1.3 mm."""
    (segment,) = data_segments(log.events)
    search = Search(segment, map_as_noise(with_scatter(log.rig, segment.pads), MAP_READINGS))
    found = search.blind(attempts_for(search.rig)[0], 1)
    assert found is not None
    assert found.fits[0].cost < COST_FROM_TRUTH + 3.0


def test_a_refit_with_shared_errors_leaves_a_wrong_minimum(log: EventLog) -> None:
    """The fit with white noise may be drawn far away by errors of place: here its rig and object are."""
    (segment,) = data_segments(log.events)
    search = Search(segment, map_as_noise(with_scatter(log.rig, segment.pads)))
    found = search.blind(attempts_for(search.rig)[0], 1)
    assert found is not None
    right = found.fits[0]
    p = right.guess.p.copy()
    p[C.RIG + R.TURN] += 0.03
    p[C.DRAG] *= 0.2
    drawn = replace(right, guess=Guess(right.guess.x, p))
    record, refit = search.with_correlated_errors(found.record, drawn)
    assert explained(refit, record)
    best = search.with_correlated_errors(found.record, right)[1]
    assert refit.cost < best.cost + 30.0


def test_a_wrong_end_of_the_motion_is_found_again_from_its_beginning(tmp_path: Path) -> None:
    """Continued from the motion known so far, the last step is not explained, for three of eight times of the first."""
    log = stored_log("mujoco-exploration", tmp_path)
    smoother, start, until = IncrementalSmoother(log.rig), log.events[0].t_sample, 0.2
    smoother.add(Session(1, start), [event for event in log.events if event.t_sample - start < until])
    while until < 17.0:
        after, until = until, until + period(until)
        smoother.add(Session(1, start), [event for event in log.events if after <= event.t_sample - start < until])
        answer = smoother.result()
        assert until < 8.0 or (isinstance(answer, Improvement) and answer.established)


def test_smooth_errors_of_pads_do_not_contradict_the_rig(log: EventLog) -> None:
    """With white noise instead of errors shared by many readings, φ2 would be off by 3° at 6σ, and the log rejected."""
    result = reconstruct(log.events, log.rig)
    assert result.converged, result.reason
    assert not result.contradicted.any()
    true_h = np.array(json.loads((DATA / "mujoco-ellipse.truth.json").read_text())["h_m"])
    score = score_outline(result.theta, result.h, result.touched, true_h)
    sd = np.sqrt(np.mean(result.h_sd[result.touched] ** 2))
    assert score.e_h < 2.0 * sd < 5e-4
