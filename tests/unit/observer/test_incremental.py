"""The incremental smoother beside a live observer: information accumulates over rests and losses, in bounded time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulated import Run, pads_changed, simulated

from palmd.events import Event, FloatArray, Improvement, PadSample
from palmd.model import shape, shape_map
from palmd.model.smoothing import CONSTANTS, ORDER, RIG, C
from palmd.observer import fixed_lag_smoother
from palmd.observer.chain import Chain
from palmd.observer.coverage import NORMAL_BINS
from palmd.observer.data_segment import longest_segment
from palmd.observer.incremental import _FROM, IncrementalSmoother, _as_shape_map, given_the_rig
from palmd.observer.initialiser import SUFFICIENT_S
from palmd.observer.normal_equations import Guess
from palmd.observer.outline import gauge_free_sd
from palmd.observer.record import Record
from palmd.observer.reidentification import reidentified
from palmd.observer.search import Minima, Search
from palmd.observer.smoother import Budget
from palmd.observer.smoothing import Session, period
from palmd.rig.imperfections import drawn_error
from palmd.score import score_outline
from palmd.system.description import AS_CALIBRATED
from palmd.system.mechanism import PALMS
from palmd.system.vibration import INDEPENDENT

THETA: FloatArray = (np.arange(NORMAL_BINS) + 0.5) * (2 * np.pi / NORMAL_BINS)
OUTLINE = slice(shape_map.Z.SHAPE, None)


def scored(answer: Improvement, run: Run) -> tuple[float, float, float]:
    """RMS error of the touched outline (µm), RMS of its one-sigma there (µm), and the touched share."""
    coefficients, touched = answer.x[OUTLINE], answer.touched
    score = score_outline(THETA, shape.basis(THETA, ORDER) @ coefficients, touched, run.truth.h)
    sd = gauge_free_sd(THETA, THETA[touched], coefficients, answer.P[OUTLINE, OUTLINE])[touched]
    return score.e_h * 1e6, math.sqrt(float(np.mean(sd**2))) * 1e6, score.touched


class Beside:
    """A smoother that is fed a run as the loop does, and called at intervals of `every` (s)."""

    def __init__(self, run: Run, every: float = 1.0):
        self.run, self.smoother, self.t, self.every = run, IncrementalSmoother(run.rig), 0.0, every
        self.answers: list[Improvement] = []
        self.kept: dict[float, int] = {}  # number of retained events by time of the call

    def until(self, t: float, session: Session) -> Improvement | None:
        """Continue to `t` (s); the last answer on the way."""
        last = None
        while self.t < t:
            before, self.t = self.t, min(self.t + self.every, t)
            self.smoother.add(session, [e for e in self.run.events if before < e.t_sample <= self.t])
            answer = self.smoother.answer()
            self.kept[self.t] = len(self.smoother._events)
            if answer is not None:
                last = answer
                self.answers.append(answer)
        return last


def test_a_failed_factorisation_gives_no_answer(monkeypatch):
    """Fits of sticking objects can fail so; the observer must continue."""

    def not_positive_definite(*_):
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    run = simulated("friction", 700, 3.0)
    smoother = IncrementalSmoother(run.rig)
    smoother.add(Session(1, 0.0), run.events)
    monkeypatch.setattr("palmd.observer.incremental.given_the_rig", not_positive_definite)
    assert smoother.answer() is None


@pytest.fixture(scope="module")
def rested() -> tuple[Beside, list[Improvement | None]]:
    """An object that rests for a long time; the answers before, at the end of, and after the rest."""
    beside, session = Beside(simulated("friction", 700, 36.0, rests=((12.0, 31.0),))), Session(1, 0.0)
    return beside, [beside.until(t, session) for t in (13.0, 30.0, 36.0)]


@pytest.fixture(scope="module")
def pushed() -> tuple[Beside, Improvement | None]:
    """Somebody turns the object by hand for a second without loss of contact; the last answer before."""
    run = simulated("rig", 4, 24.0)

    def push(event: Event) -> Event:
        inside = isinstance(event, PadSample) and 10.0 < event.t_sample < 11.0
        return PadSample(event.t_sample, event.pad, event.s + 4e-3, event.force) if inside else event

    beside = Beside(Run(tuple(map(push, run.events)), run.rig, run.truth, run.palms))
    return beside, beside.until(10.0, Session(1, 0.0))


Rested = tuple[Beside, list[Improvement | None]]


def test_a_rest_does_not_reduce_the_information(rested: Rested) -> None:
    beside, (moved, still, again) = rested
    assert moved is not None
    assert still is not None
    assert again is not None
    errors, sds, _ = zip(*(scored(answer, beside.run) for answer in (moved, still, again)), strict=True)
    assert sds[1] < 1.01 * sds[0]
    assert sds[2] < 1.01 * sds[1]
    assert all(error < 2.5 * sd for error, sd in zip(errors, sds, strict=True))
    assert all(answer.established and answer.frame == moved.frame for answer in (moved, still, again))


def test_the_number_of_retained_events_is_bounded(rested: Rested) -> None:
    kept = rested[0].kept
    assert kept[36.0] < 1.2 * kept[16.0]
    assert kept[16.0] < 6 * 300


def test_an_object_that_is_searched_for_is_searched_for_without_pause(rested: Rested) -> None:
    """The interval between answers grows with the known object's readings, not with a search in vain."""
    searching, followed = IncrementalSmoother(rested[0].run.rig), rested[0].smoother
    resting = [replace(e, s=0.03) if isinstance(e, PadSample) else e for e in rested[0].run.events]
    searching.add(Session(1, 0.0), [event for event in resting if event.t_sample < 12.0])
    assert searching.answer() is None
    assert period(searching.elapsed_s) == period(0.0) < period(followed.elapsed_s)


def test_readings_beyond_the_friction_law_are_fitted_with_its_discrepancy(monkeypatch) -> None:
    run = simulated("friction", 700, 12.0, vibration=INDEPENDENT)
    session, asked = Session(1, 0.0), list[bool]()
    beside, minima = Beside(run), Search.minima
    assert beside.until(4.0, session) is not None

    def only_doubting(search: Search, record: Record, *rest: Any) -> Minima:
        found, doubting = minima(search, record, *rest), bool(record.discrepancy.any())
        asked.append(doubting)
        return found if doubting else replace(found, fits=(replace(found.fits[0], settled=False),))

    monkeypatch.setattr(Search, "minima", only_doubting)
    answer = beside.until(5.0, session)
    assert answer is not None
    assert asked[:2] == [False, True]
    error, sd, _ = scored(answer, run)
    assert error < 3.0 * sd


def test_marginalised_segments_include_the_friction_discrepancy(monkeypatch) -> None:
    left_open, append = list[FloatArray](), Chain.append

    def seen(chain: Chain, record: Record, guess: Guess) -> None:
        left_open.append(record.discrepancy)
        append(chain, record, guess)

    monkeypatch.setattr(Chain, "append", seen)
    Beside(simulated("friction", 700, 12.0, vibration=INDEPENDENT)).until(12.0, Session(1, 0.0))
    assert len(left_open) > 1
    assert all((each > 0.0).mean() > 0.5 for each in left_open)


def test_bands_hold_on_pads_with_correlated_errors_of_place() -> None:
    sd_m, length_m = 7e-5, 3e-3
    run = simulated("rig", 710, 16.0)
    errors = [
        drawn_error(sd_m, length_m, pad.length, np.random.default_rng(2 + palm))
        for palm, pad in zip(PALMS, run.rig.pads, strict=True)
    ]

    def off(sample: PadSample) -> PadSample:
        return replace(sample, s=sample.s + errors[sample.pad - 1].at(sample.s))

    rig = run.rig.with_pads(map_sd=sd_m, map_length=length_m)
    answer = Beside(Run(tuple(pads_changed(run.events, off)), rig, run.truth, run.palms)).until(16.0, Session(1, 0.0))
    assert answer is not None
    assert answer.established
    error, sd, _ = scored(answer, run)
    assert error < 3.0 * sd


def test_saturated_pads_without_force_do_not_lose_the_estimate() -> None:
    """A force-dependent contact shift is corrected by the force; without it, readings contradict the estimate."""
    off_m_n, heavier, beyond, end = 6e-5, 2.0, 8.0, 14.0
    run = simulated("rig", 710, end, rests=((9.0, end),))

    def pressed(sample: PadSample) -> PadSample:
        assert sample.force is not None
        force = heavier * sample.force
        measured_force = None if sample.pad == PALMS[-1] and sample.t_sample > beyond else force
        return replace(sample, s=sample.s + off_m_n * force, force=measured_force)

    rig = run.rig.with_pads(force_sd=off_m_n)
    beside = Beside(Run(tuple(pads_changed(run.events, pressed)), rig, run.truth, run.palms))
    before, after = (beside.until(t, Session(1, 0.0)) for t in (beyond, end))
    assert before is not None
    assert after is not None
    assert after.t > end - 1.0
    assert after.frame == before.frame
    error, sd, _ = scored(after, beside.run)
    assert error < 2.5 * sd


@pytest.mark.nightly
def test_a_returning_object_is_recognised_and_its_records_are_joined() -> None:
    absences = ((9.0, 10.0), (18.0, 19.0), (27.0, 28.0))
    run = simulated("rig", 710, 36.0, absences=absences)
    beside = Beside(run, 0.5)
    ends, starts = (9.0, 18.0, 27.0, 36.0), (0.0, 10.02, 19.02, 28.02)
    scores = []
    for number, (start, end) in enumerate(zip(starts, ends, strict=True)):
        beside.until(start, Session(number, math.inf))
        if number == 2:  # sooner than a blind search confirms a new object
            soon = beside.until(start + 0.75 * SUFFICIENT_S, Session(number + 1, start))
            assert soon is not None
            assert soon.established
        answer = beside.until(end, Session(number + 1, start))
        assert answer is not None
        scores.append(scored(answer, run))
    errors, sds, touched = zip(*scores, strict=True)
    assert touched[-1] > 1.5 * touched[0]
    assert sds[-1] < sds[0]
    assert errors[-1] < max(1.2 * errors[0], 2 * sds[-1])
    frames = {answer.frame for answer in beside.answers}
    assert len(frames) == len(starts)  # each time it lies in a gauge of its own


def test_an_archived_record_that_cannot_be_compared_is_skipped() -> None:
    run = simulated("rig", 710, 12.0, absences=((7.0, 8.0),))
    beside = Beside(run)
    beside.until(7.0, Session(0, 0.0))
    beside.until(8.02, Session(1, math.inf))
    (kept,) = beside.smoother._archive
    corrupted = replace(kept, information=replace(kept.information, matrix=-kept.information.matrix))
    beside.smoother._archive = [corrupted]
    answer = beside.until(12.0, Session(1, 8.02))
    assert answer is not None
    assert beside.smoother._archive == [corrupted]


def test_another_object_starts_without_knowledge() -> None:
    first, second = simulated("friction", 700, 9.0), simulated("friction", 713, 9.0)
    beside = Beside(first)
    before = beside.until(4.0, Session(1, 0.0))
    assert before is not None
    beside.run, beside.t = second, 0.0
    beside.smoother.add(Session(1, math.inf), [])
    after = beside.until(4.0, Session(2, 0.0))
    assert after is not None
    alone = Beside(second).until(4.0, Session(1, 0.0))
    assert alone is not None
    assert scored(after, second)[2] == pytest.approx(scored(alone, second)[2], abs=2.5 / NORMAL_BINS)
    assert scored(after, second)[1] == pytest.approx(scored(alone, second)[1], rel=0.05)


def test_without_an_object_events_do_not_accumulate() -> None:
    run = simulated("friction", 700, 9.0)
    smoother = IncrementalSmoother(run.rig)
    for event in run.events:
        smoother.add(Session(0, math.inf), [event])
        assert smoother.answer() is None if event is run.events[-1] else True
    assert len(smoother._events) < 300


def test_a_rest_at_the_start_is_waited_through() -> None:
    """A minute of rest before the first motion costs nothing and does not spoil the search."""
    run = simulated("friction", 700, 26.0, rests=((-1.0, 18.0),))  # no first second of motion either
    beside, session = Beside(run), Session(1, 0.0)
    assert beside.until(18.0, session) is None
    answer = beside.until(25.0, session)
    assert answer is not None
    error, sd, _ = scored(answer, run)
    assert error < 3 * sd


Pushed = tuple[Beside, Improvement | None]


def test_contradicting_readings_start_a_new_search_and_earlier_information_is_kept(pushed: Pushed) -> None:
    beside, before = pushed
    assert before is not None
    after = beside.until(24.0, Session(1, 0.0))
    assert after is not None
    assert scored(after, beside.run)[1] < 1.1 * scored(before, beside.run)[1]
    assert scored(after, beside.run)[0] < 3 * scored(after, beside.run)[1]


def test_the_same_calls_give_the_same_answers(pushed: Pushed) -> None:
    first, second = pushed[0], Beside(pushed[0].run)
    second.until(12.0, Session(1, 0.0))  # beyond the time at which the readings contradict
    first.until(12.0, Session(1, 0.0))  # unless it is already beyond
    assert len(second.answers) > 5
    for one, other in zip(first.answers, second.answers, strict=False):
        assert (one.t, one.frame, one.established) == (other.t, other.frame, other.established)
        assert one.x.tobytes() == other.x.tobytes()
        assert one.P.tobytes() == other.P.tobytes()


def test_transforming_the_friction_parameters_keeps_the_belief() -> None:
    """Against transforming random draws."""
    n = shape_map.size(ORDER)
    x, sd = np.zeros(n), np.full(n, 1e-6)
    mu, dither = shape_map.Z.MU, shape_map.Z.LN_DITHER
    x[mu], x[dither] = 12.0, 7000.0  # B, w
    P = np.diag(sd**2)
    P[np.ix_([mu, dither], [mu, dither])] = [[0.04, 2.0], [2.0, 400.0]]
    mean, J = _as_shape_map(x)
    covariance = J @ P @ J.T
    drawn = np.random.default_rng(0).multivariate_normal(
        x[[mu, dither]], P[np.ix_([mu, dither], [mu, dither])], 200_000
    )
    there = np.column_stack([drawn[:, 0] / np.sqrt(drawn[:, 1]), -0.5 * np.log(drawn[:, 1])])
    assert mean[[mu, dither]] == pytest.approx(there.mean(axis=0), rel=1e-3)
    assert covariance[np.ix_([mu, dither], [mu, dither])] == pytest.approx(np.cov(there.T), rel=0.02)


def test_rig_spread_and_remaining_covariance_add_up_to_the_whole() -> None:
    """State and constants: their own covariances and the cross-covariance."""
    random = np.random.default_rng(1)
    y = np.zeros(CONSTANTS + 2)
    y[C.SATURATION], y[C.SHAPE] = 1e4, 0.02
    root = random.standard_normal((len(y), len(y)))
    covariance = root @ root.T
    x, P, spread = given_the_rig(y, covariance)
    _, J = _as_shape_map(y[_FROM])
    of_state, of_rig = spread[: len(x)], spread[len(x) :]
    assert np.allclose(P + of_state @ of_state.T, J @ covariance[np.ix_(_FROM, _FROM)] @ J.T)
    assert np.allclose(of_state @ of_rig.T, J @ covariance[_FROM, RIG])
    assert np.allclose(of_rig @ of_rig.T, covariance[RIG, RIG])


def test_an_object_that_hops_is_recognised_in_its_place() -> None:
    run, away, back = simulated("rig", 710, 12.0), 9.0, 9.1
    beside = Beside(run)
    assert beside.until(away, Session(1, 0.0)) is not None
    beside.until(back, Session(1, math.inf))
    again = beside.until(back + 2.0, Session(2, back))
    assert again is not None
    assert again.established
    error, sd, _ = scored(again, run)
    assert error < 2.0 * sd


def test_another_object_is_not_reidentified() -> None:
    one, other = (simulated("rig", seed, 8.0) for seed in (710, 711))
    beside = Beside(one)
    beside.until(8.0, Session(1, 0.0))
    known = beside.smoother._fixed_lag
    assert known is not None
    segments = [longest_segment(run.events) for run in (one, other)]
    assert all(segments)
    budgets = Budget(), Budget()
    found = [
        reidentified(known.summary(), each, one.rig, budget) for each, budget in zip(segments, budgets, strict=True)
    ]
    assert found[0] is not None
    assert found[1] is None


def test_a_backlog_of_readings_is_processed_in_parts_within_the_budget(monkeypatch) -> None:
    run, session = simulated("rig", 710, 20.0), Session(1, 0.0)
    beside = Beside(run)
    assert beside.until(9.0, session) is not None
    monkeypatch.setattr(fixed_lag_smoother, "LIVE_BUDGET", 8000.0)
    beside.smoother.add(session, [event for event in run.events if event.t_sample > 9.0])
    times = []
    while not times or times[-1] < 19.9:
        answer = beside.smoother.answer()
        assert answer is not None
        assert answer.established
        assert not times or answer.t > times[-1]
        times.append(answer.t)
    assert len(times) > 1
    error, sd, _ = scored(answer, run)
    assert error < 2.5 * sd


def test_a_continuation_that_fails_strictly_is_followed_on_trial(monkeypatch):
    """It is established after it has explained enough; never on an exactly known rig."""
    run = simulated("friction", 700, 9.0)
    session, carried_on = Session(1, 0.0), Search.resumed

    def resumed(self, guesses, predict_forces=False, strict=True):
        return None if strict else carried_on(self, guesses, predict_forces, strict)

    def answers(rig):
        beside = Beside(replace(run, rig=rig), 0.5)
        beside.until(2.0, session)
        assert beside.answers
        assert not beside.answers[-1].established
        with monkeypatch.context() as patch:
            patch.setattr(Search, "resumed", resumed)
            patch.setattr(Search, "rival", lambda *_: None)
            beside.until(9.0, session)
        return beside.answers

    on_trial = answers(run.rig.known_to({**AS_CALIBRATED, "friction_sd": 0.0}))
    assert {answer.established for answer in on_trial if answer.t < SUFFICIENT_S} == {False}
    assert on_trial[-1].established
    error, sd, touched = scored(on_trial[-1], run)
    assert touched > 0.1
    assert error < 3.0 * sd
    assert not any(answer.established for answer in answers(run.rig))


def test_an_explanation_of_the_first_readings_only_is_never_established(monkeypatch):
    """However many readings follow: it does not predict those that it leaves out."""
    run, carried_on = simulated("friction", 700, 9.0), Search.resumed

    def resumed(self, guesses, predict_forces=False, strict=True):
        found = carried_on(self, guesses, predict_forces, strict)
        return found.until(SUFFICIENT_S - 1.0) or found if strict and found is not None else found

    monkeypatch.setattr(Search, "resumed", resumed)
    monkeypatch.setattr(Search, "rival", lambda *_: None)
    beside = Beside(run)
    beside.until(9.0, Session(1, 0.0))
    assert beside.answers[-1].t > SUFFICIENT_S - 1.5
    assert not any(answer.established for answer in beside.answers)
