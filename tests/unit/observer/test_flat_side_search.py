"""Outlines with flat sides: ψ from the readings alone, the cost of impacts, and a polygon from a blind start."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from simulated import Run, is_pad, simulated

from palmd.model import sharp
from palmd.model.shape import coefficients_of, turned
from palmd.model.smoothing import NODE, ORDER, C
from palmd.observer.data_segment import data_segments, longest_segment
from palmd.observer.factor import Prior
from palmd.observer.flat_side_fits import FINE, LAST_ITERATIONS, WAYS, Candidate, FlatSideFits, Stage
from palmd.observer.flat_side_search import FlatSideSearch
from palmd.observer.mode_initialisation import explained_spans, initial_normal, narrowed, on_nodes, palm_turn
from palmd.observer.mode_segments import TRIM_S, ModeSegment, find_mode_segments, group_by_mode
from palmd.observer.normal_equations import BLOW_SD, Guess, ProcessNoise, Residuals, _step_weights
from palmd.observer.orientation_tracking import tracked_orientation
from palmd.observer.outline import directions, normal_angles, touched_by
from palmd.observer.reconstruct import reconstruct
from palmd.observer.search import Search, overfits
from palmd.observer.sharp_reconstruct import NODE_ERROR_LEFT, _result, explained_smoothly, sharp_reconstruction
from palmd.observer.smoother import Fit
from palmd.observer.validity import SHARP_M
from palmd.score import score_outline
from palmd.system.description import AS_CALIBRATED
from tools.studies.sharp_shapes import rounded_polygon, uniform_body

CORNERS = [(16.1, -4.9), (14.5, 8.0), (0.2, 16.7), (-12.5, 11.1), (-16.8, -6.8), (4.0, -17.2)]  # mm
SECONDS = 6.0


def test_readings_of_a_known_outline_determine_its_orientation():
    run = simulated("friction", 3, 3.0)
    search = Search(longest_segment(run.events), run.rig)
    p = np.zeros(sharp.CONSTANTS)
    p[C.SHAPE : sharp.NORMALS] = coefficients_of(run.truth.h, ORDER)
    p[sharp.WIDTH] = math.log(1e-3)
    record = search.record
    true = np.interp(record.t, run.truth.t, run.truth.psi)
    psi = tracked_orientation(p, record, 50, float(true[50]))
    assert len(psi) == len(record.t) - 50
    assert psi == pytest.approx(true[50:], abs=0.05)
    assert np.ptp(true[50:]) > 0.3


def test_a_step_is_either_quiet_or_an_impact():
    noise = ProcessNoise(1e-10, 1e-5, gate=4.0)
    root = np.tile(1.0 / np.sqrt(0.005 * np.array([noise.psi, noise.omega0])), (20, 1))
    defect = np.zeros((20, NODE))
    quiet = 1.0 / root[0, 1]
    defect[7, 1], defect[9, 1] = 1.9 * quiet, 1000.0 * quiet
    weighed, beyond = _step_weights(defect, root, noise)
    weighed = weighed.reshape(-1, NODE)
    assert weighed[7, 1] == pytest.approx(root[7, 1], rel=1e-6)
    pulled = (defect * weighed)[9, 1] ** 2
    assert pulled == pytest.approx(4.0 + (defect[9, 1] / BLOW_SD[1]) ** 2, rel=1e-6)
    assert beyond == pytest.approx(4.0 * math.log(1000.0**2 / 4.0))


def a_fit(**but: float) -> Fit:
    guess = Guess(np.zeros((2, NODE)), np.zeros(sharp.CONSTANTS))
    return replace(Fit(100.0, 1.0, 1.0, 0.1, 10.0, 0.0, 0, guess, ProcessNoise(1.0, 1.0), 5, True), **but)


@pytest.mark.parametrize(
    ("chi2", "prior_cost", "too_well"), [(0.51, 40.0, True), (0.51, 10.0, False), (0.95, 40.0, False)]
)
def test_overfitting_needs_a_low_chi2_and_a_high_prior_cost(chi2, prior_cost, too_well):
    assert overfits(a_fit(chi2=chi2, prior_cost=prior_cost)) is too_well


def test_a_window_that_grows_over_a_tumble_is_not_continued():
    run = simulated("friction", 3, 3.0)
    record = Search(longest_segment(run.events), run.rig).record
    prior = Prior(np.zeros(sharp.CONSTANTS), np.ones(sharp.CONSTANTS), 1.0)
    first, longer = record.until(2.0), record.until(2.2)
    before = Candidate((), prior, first, a_fit(cost=float(first.readings)), 1.0)
    after = Candidate((), prior, longer, a_fit(cost=float(longer.readings)), 1.0)
    assert after.goes_on(before)
    jumped = replace(after, fit=a_fit(cost=longer.readings + 200.0))
    assert jumped.explains  # by the whole record's figures
    assert not jumped.goes_on(before)


def test_the_search_ends_when_its_work_is_done(monkeypatch):
    monkeypatch.setattr("palmd.observer.flat_side_search.WORK", 1.0)
    run = simulated("friction", 3, 6.0)
    seen: list[Candidate] = []
    FlatSideSearch(Search(longest_segment(run.events), run.rig)).stretches(seen.append)
    assert max(float(each.record.t[-1]) for each in seen) < 1.0


class Stub(FlatSideFits):
    """Returns candidates of a given cost per reading instead of fits."""

    def __init__(self, fits: FlatSideFits, cost: float = 1.0):
        super().__init__(fits.record, fits._base)
        self.cost, self.windows, self.stages = cost, list[float](), list[tuple[Stage, ...]]()

    def fitted(self, record, sides, guess, stages=FINE, _iterations=0):
        self.windows.append(float(record.t[-1]))
        self.stages.append(tuple(stages))
        fit = a_fit(cost=self.cost * record.readings, guess=Guess(np.zeros((len(record.t), NODE)), guess.p))
        return Candidate(sides, Prior(guess.p, guess.p + 1.0, 1.0), record, fit, 1.0)


class Reluctant(Stub):
    """Explains nothing after `until` (s), and nothing in fewer than `least` iterations."""

    def __init__(self, fits: FlatSideFits, until: float = math.inf, least: int = 0):
        super().__init__(fits)
        self.until, self.least = until, least

    def fitted(self, record, sides, guess, stages=FINE, iterations=0):
        self.cost = 1.0 if record.t[-1] < self.until and iterations >= self.least else 1.6
        found = super().fitted(record, sides, guess, stages)
        return replace(found, fit=replace(found.fit, settled=iterations >= self.least))


def grown_from_three_seconds(monkeypatch, by: float, **reluctant: float) -> tuple[Reluctant, list[Candidate]]:
    run = simulated("friction", 3, SECONDS)
    search = FlatSideSearch(Search(longest_segment(run.events), run.rig))
    search.fits = fits = Reluctant(search.fits, **reluctant)
    monkeypatch.setattr(search, "_predicted_until", lambda rivals, _: float(rivals[0].record.t[-1]) + by)
    monkeypatch.setattr(search, "_led_by_readings", lambda _, guess: guess)
    record = search.record.until(search.record.t[0] + 3.0)
    before = Stub.fitted(fits, record, (), Guess(np.zeros((1, NODE)), np.zeros(sharp.CONSTANTS)))
    fits.windows.clear()
    return fits, search._grown([before], search.record)


@pytest.mark.parametrize(("until", "found"), [(math.inf, 4.6), (4.0, 3.8), (3.5, 3.4), (3.3, None)])
def test_an_unexplained_window_is_shortened(until, found, monkeypatch):
    _, grown = grown_from_three_seconds(monkeypatch, 1.6, until=until)
    assert [float(each.record.t[-1]) for each in grown[:1]] == (
        [] if found is None else [pytest.approx(found, abs=0.02)]
    )


def test_a_candidate_that_would_explain_a_window_is_iterated_to_convergence(monkeypatch):
    fits, grown = grown_from_three_seconds(monkeypatch, 1.6, least=LAST_ITERATIONS)
    assert grown[-1].fit.settled
    assert fits.windows == pytest.approx([4.6] * len(fits.windows), abs=0.02)


@pytest.mark.parametrize(("lasts", "tried"), [(12.0, [12.0, 6.0]), (8.0, [8.0])])
def test_the_first_half_of_an_undetermined_segment_is_tried(lasts, tried, monkeypatch):
    run = simulated("friction", 3, 12.5)
    search = Search(longest_segment(run.events), run.rig)
    sided = FlatSideSearch(search)
    fits, record = Stub(sided.fits), sided.record.until(sided.record.t[0] + lasts)
    whole = fits.fitted(record, (), Guess(np.zeros((len(record.t), NODE)), np.zeros(sharp.CONSTANTS)))
    seen: list[float] = []

    def doubtful(best, found):
        seen.append(best.lasts)
        assert found == (best,)
        return True

    monkeypatch.setattr(FlatSideSearch, "segment_fits", lambda _: iter(()))
    monkeypatch.setattr(FlatSideSearch, "stretches", lambda *_: [(whole,)])
    monkeypatch.setattr(FlatSideSearch, "refined", lambda _, found: iter((found,)))
    monkeypatch.setattr(FlatSideFits, "fitted", lambda _, *but: fits.fitted(*but))
    monkeypatch.setattr("palmd.observer.sharp_reconstruct._is_doubtful", doubtful)
    assert sharp_reconstruction(search, 0, time.perf_counter()) is None
    assert seen == pytest.approx(tried, abs=0.02)


def test_kernels_without_unused_sides_give_the_same_cost():
    p = np.zeros(sharp.CONSTANTS)
    p[C.SHAPE], p[C.LN_RHO], p[C.DRAG], p[C.SATURATION] = 0.018, math.log(0.012), 10.0, 1e4
    p[sharp.NORMALS : sharp.LENGTHS] = 0.7, 1.0, 2.0, 3.0
    p[sharp.LENGTHS], p[sharp.WIDTH] = 0.015, math.log(1e-3)
    run = simulated("friction", 3, 1.0)
    record = Search(longest_segment(run.events), run.rig).record
    guess = Guess(np.zeros((len(record.t), NODE)), p)
    one, all_of_them = (
        Residuals(sharp.library_for(sides), record).linearised(guess, ProcessNoise(1e-8, 1e-5)) for sides in (1, 2)
    )
    assert sharp.library_for(1) is not sharp.library_for(2)
    assert one.cost == pytest.approx(all_of_them.cost, rel=1e-12)
    known = slice(0, sharp.NORMALS + 1)
    assert one.corner[known, known] == pytest.approx(all_of_them.corner[known, known], rel=1e-9)


def test_a_smooth_outline_explains_its_own_motion():
    run = simulated("friction", 3, SECONDS)
    search = Search(longest_segment(run.events), run.rig)
    answer = reconstruct(run.events, run.rig)
    assert explained_smoothly(search, answer)
    moved = replace(answer, psi=answer.psi + 0.1 * np.sin(3.0 * (answer.t - answer.t[0])))
    assert explained_smoothly(search, moved)  # the search returns to it


@cache
def hexagon() -> Run:
    body = uniform_body("hexagon", rounded_polygon([(x * 1e-3, y * 1e-3) for x, y in CORNERS], 1e-3), 0.2)
    return simulated("friction", 2, SECONDS, body=body)


def test_segments_are_fitted_together_and_a_wider_side_changes_little():
    run = hexagon()
    search = FlatSideSearch(Search(longest_segment(run.events), run.rig))
    segment = group_by_mode(find_mode_segments(search.record))[0][0]
    fitted = search.fits.along(WAYS[0], [replace(segment, end=2.7), replace(segment, start=2.9)])
    record, guess = fitted.record, fitted.fit.guess
    assert len(record.gap_steps) == 1
    assert fitted.fit.chi2 < 1.1
    touched = touched_by(normal_angles(record.palms, guess.x[:, 0]))
    assert score_outline(directions(), sharp.support(directions(), guess.p), touched, run.truth.h).e_h < 5e-5
    residuals = Residuals(sharp.library_for(1), record)
    wider = narrowed(guess, record, segment.palm, 2.0 * math.exp(guess.p[sharp.WIDTH]))
    assert np.abs(residuals.residuals(wider) - residuals.residuals(guess)).max() < 0.5
    assert np.abs(guess.x - palm_turn(record, segment.palm))[:, 0].max() < 0.01
    assert abs(math.remainder(guess.p[sharp.NORMALS] - initial_normal(record, segment.palm), math.tau)) < 0.01


def test_differences_between_node_grids_are_in_the_band():
    run = hexagon()
    search = Search(longest_segment(run.events), run.rig)
    sided = FlatSideSearch(search)
    segment = group_by_mode(find_mode_segments(sided.record))[0][0]
    best = sided.fits.along(WAYS[0], [replace(segment, end=3.0)])
    larger, other_way_round = best.fit.guess.p.copy(), best.fit.guess.p.copy()
    larger[C.SHAPE] += 1e-6
    other_way_round[C.SHAPE : sharp.NORMALS] = turned(-4e-4, ORDER) @ larger[C.SHAPE : sharp.NORMALS]
    other_way_round[sharp.NORMALS : sharp.LENGTHS] += 4e-4
    finer, finer_too = (
        replace(best, fit=replace(best.fit, guess=Guess(best.fit.guess.x, p))) for p in (larger, other_way_round)
    )
    coarser = replace(finer, record=best.record.until(1.0))
    alone, *others = (_result(best, other, sided, search, 0.0) for other in (None, finer, finer_too, coarser))

    def distance(turn: float) -> float:
        return math.sqrt(np.mean((alone.h - sharp.support(alone.theta + turn, larger))[alone.touched] ** 2))

    off = minimize_scalar(distance, bounds=(-1e-3, 1e-3), method="bounded", options={"xatol": 1e-9}).fun
    assert off > 5e-7
    for one_of_them, share in zip(others, (1.0, 1.0, NODE_ERROR_LEFT), strict=True):
        more = np.mean((one_of_them.h_sd**2 - alone.h_sd**2)[alone.touched])
        assert math.sqrt(more) == pytest.approx(share * off, rel=0.1)


def test_rocking_is_excluded_from_a_segment():
    run = hexagon()
    search = FlatSideSearch(Search(longest_segment(run.events), run.rig))
    record = search.record
    at = record.t[record.contact_step] + record.contact_offset
    quiet = np.random.default_rng(1).normal(size=len(at))
    assert explained_spans(record, quiet) == record.spans
    rocks = np.where((record.contact_pad == 2.0) & (at > 2.0) & (at < 2.15), 6.0, quiet)
    (start, gone), (back, end) = explained_spans(record, rocks)
    assert (start, end) == record.spans[0]
    assert gone == pytest.approx(2.0 - 2.0 * TRIM_S, abs=TRIM_S)
    assert back == pytest.approx(2.15 + 2.0 * TRIM_S, abs=TRIM_S)


def test_the_rest_of_a_fit_has_the_same_outline_and_motion():
    run = hexagon()
    record = FlatSideSearch(Search(longest_segment(run.events), run.rig)).record
    p = np.zeros(sharp.CONSTANTS)
    p[C.SHAPE : sharp.NORMALS] = 0.017, *np.random.default_rng(2).normal(0.0, 2e-4, sharp.FOURIER - 1)
    p[C.LN_RHO], p[C.DRAG], p[C.SATURATION] = math.log(0.012), 10.0, 1e4
    p[sharp.NORMALS : sharp.LENGTHS] = 0.7, 1.0, 2.0, 3.0
    p[sharp.LENGTHS], p[sharp.WIDTH] = 0.015, math.log(1e-3)
    guess = Guess(np.stack([np.sin(record.t), np.cos(record.t)], axis=1), p)
    part = record.within([(1.0, 2.0), (3.0, 4.0)])
    left = on_nodes(guess, record.t, part.t)
    assert left.x[0, 0] == 0.0
    ends = np.searchsorted(record.t, np.array(part.spans) - 1e-9)
    inside = np.logical_or.reduce([(record.contact_step >= i) & (record.contact_step < j) for i, j in ends])
    whole, parts = (Residuals(sharp.library_for(1), each).residuals(g) for each, g in ((record, guess), (part, left)))
    assert parts == pytest.approx(whole[inside], abs=1e-5)


def test_a_polygon_on_a_calibrated_rig_is_reconstructed_by_side_and_corner():
    run = hexagon()
    rig = run.rig.known_to(AS_CALIBRATED)
    answer = sharp_reconstruction(Search(longest_segment(run.events), rig), 0, time.perf_counter())
    assert answer is not None
    assert answer.converged
    score = score_outline(answer.theta, answer.h, answer.touched, run.truth.h)
    assert len(answer.sides) >= 1
    assert not explained_smoothly(Search(longest_segment(run.events), rig), answer)
    band = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    assert score.e_h < min(1e-4, 3 * band)
    assert band > SHARP_M  # because of the rig; the readings would determine more


def split_run(run: Run) -> list[Search]:
    """Its two segments, the longer first, with a contact lost for half a second."""
    seen = [event for event in run.events if not (is_pad(event) and 3.2 < event.t_sample < 3.7)]
    main, other = (Search(segment, run.rig) for segment in data_segments(seen))
    assert main.segment.end < other.segment.start
    return [main, other]


def test_mode_segments_in_other_data_segments_are_used_for_the_same_side(monkeypatch):
    for module in ("flat_side_search", "sharp_reconstruct"):
        monkeypatch.setattr(f"palmd.observer.{module}.LEAST_S", 3.0)
    run = hexagon()
    main, *others = split_run(run)
    answer = sharp_reconstruction(main, 0, time.perf_counter(), None, others)
    assert answer is not None
    assert {end < 3.3 for _, end in answer.spans} == {True, False}
    assert answer.lasts > 4.5
    assert score_outline(answer.theta, answer.h, answer.touched, run.truth.h).e_h < 5e-5
    assert not explained_smoothly(main, answer, others)


@pytest.mark.parametrize(("start", "times"), [(0.1, 1), (3.8, 0)])
def test_a_mode_segment_in_another_data_segment_alone_is_not_fitted(monkeypatch, start, times):
    main, *others = split_run(hexagon())
    search = FlatSideSearch(main, 0, others)
    segment = ModeSegment(0, start, start + 5.5, np.array([0.016, 0.002]), 1e-10 * np.eye(2), True)
    monkeypatch.setattr(
        "palmd.observer.flat_side_search.find_mode_segments", lambda record: [segment] if record.t[0] < 1.0 else []
    )
    monkeypatch.setattr(search.fits, "on_one_side", lambda _: [SimpleNamespace(explains=True)])
    assert len(list(search.segment_fits())) == times
