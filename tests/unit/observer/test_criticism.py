"""Criticism of the rig: contradicted constants are named and estimated, and others are not."""

import math
from dataclasses import replace

import numpy as np
import pytest
from campaign import nightly
from scipy.stats import multivariate_normal
from simulated import Run, palms_changed, simulated

from palmd.events import PadSample, PalmSample
from palmd.model.smoothing import RIG, RIG_CONSTANTS, C, R
from palmd.observer.criticism import (
    CALIBRATION_SD,
    CAUSE_SIZES,
    FREE_SD,
    LEAST_SD,
    LN_PRIOR_NAMED,
    PRIOR_DOUBTED,
    RigBelief,
    criticised,
)
from palmd.observer.data_segment import data_segments
from palmd.observer.incremental import IncrementalSmoother
from palmd.observer.reconstruct import reconstruct
from palmd.observer.search import Attempt, Search
from palmd.observer.smoother import Smoother
from palmd.observer.smoothing import Session
from palmd.score import score_outline
from palmd.system.description import AS_CALIBRATED
from palmd.system.rig_constants import RIG_NAMES

CALIBRATED = np.where(CALIBRATION_SD > 0.0, CALIBRATION_SD, LEAST_SD)  # the vibration is as described
EXACT = np.full(RIG_CONSTANTS, 1e-7)


class Linear:
    """Readings of a random linear mixture of the rig's constants, and their posterior for a prior."""

    def __init__(self, seed: int, readings: int = 60) -> None:
        self.random = np.random.default_rng(seed)
        self.design = self.random.standard_normal((readings, RIG_CONSTANTS)) / CALIBRATED

    def posterior(self, true: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        heard = self.design @ true + self.random.standard_normal(len(self.design))
        covariance = np.linalg.inv(self.design.T @ self.design + np.diag(sd**-2.0))
        return covariance @ self.design.T @ heard, covariance


@pytest.mark.parametrize("sd", [CALIBRATED, EXACT], ids=["calibrated", "exact"])
def test_a_rig_drawn_from_its_prior_is_rarely_contradicted(sd):
    linear = Linear(1)
    named = 0
    for _ in range(300):
        values, covariance = linear.posterior(linear.random.standard_normal(RIG_CONSTANTS) * sd, sd)
        named += criticised(values, covariance, sd, sd).contradicted.any()
    assert named <= 3


def test_the_odds_are_the_ratio_of_the_readings_densities():
    """By the readings' densities under all sets of causes that consist of zeros."""
    linear = Linear(4, readings=20)
    sd = np.where(np.arange(RIG_CONSTANTS) < 2, EXACT, 30 * CALIBRATED)  # only zeros can be contradicted
    true = np.where(np.arange(RIG_CONSTANTS) == 0, 2.0 * CALIBRATED, 0.0)
    heard = linear.design @ true + linear.random.standard_normal(20)

    def density(prior):
        return multivariate_normal(np.zeros(20), np.eye(20) + linear.design @ prior @ linear.design.T).logpdf(heard)

    def opened(*causes):
        off = [np.where(np.isin(np.arange(RIG_CONSTANTS), each), CALIBRATION_SD, 0.0) for each in causes]
        return [
            density(np.diag(sd**2) + times**2 * sum(np.outer(each, each) for each in off)) - density(np.diag(sd**2))
            for times in CAUSE_SIZES
        ]

    one, other, alike, both = (np.array(opened(*causes)) for causes in ([0], [1], [[0, 1]], [0, 1]))
    terms = np.concatenate(
        [
            (each + LN_PRIOR_NAMED)[each > 0.0] for each in (one, other, alike)
        ] + [(both + 2 * LN_PRIOR_NAMED)[both > np.maximum(one, other)]]
    )  # fmt: skip
    covariance = np.linalg.inv(linear.design.T @ linear.design + np.diag(sd**-2.0))
    found = criticised(covariance @ linear.design.T @ heard, covariance, sd, sd)
    assert found.log_odds == pytest.approx(np.logaddexp.reduce(terms) - math.log(len(CAUSE_SIZES)), abs=1e-3)


def test_the_covariance_includes_doubt_before_a_constant_is_contradicted():
    """The readings determine each constant to a third of its calibration sd; the first is z of these from 0."""
    precision = (3.0 / CALIBRATED) ** 2 + EXACT**-2.0

    def found(z):
        values = np.where(np.arange(RIG_CONSTANTS) == 0, z * (3.0 / CALIBRATED) / precision, 0.0)
        return criticised(values, np.diag(1.0 / precision), EXACT, EXACT)

    none, some, sure = map(found, (1.0, 2.8, 6.0))
    assert not none.considered.any()
    assert (some.sd == EXACT).all()
    assert 0.1 * CALIBRATION_SD[0] < math.sqrt(some.considered[0, 0]) < CALIBRATION_SD[0]
    assert not some.contradicted.any()
    assert np.flatnonzero(sure.contradicted).tolist() == [0]
    assert not sure.considered.any()


@pytest.mark.parametrize("off", [1.4, 1.8, 2.2])
@pytest.mark.parametrize("known", [0.001, 0.5, 1.0], ids=["all but exactly", "to half", "as calibrated"])
def test_a_doubtful_answer_has_the_moments_of_the_mixture_of_explanations(known, off):
    """Against the mixture's second moments about the estimate, of a zero and of a correlated quantity."""
    sd = np.where(
        np.arange(RIG_CONSTANTS) == 0, known * CALIBRATION_SD, 30 * CALIBRATED
    )  # only the first zero can be contradicted
    scale = np.concatenate([np.ones(C.RIG), CALIBRATED, [1.0]])  # before the rig's constants, the rig's, after them
    readings = np.zeros((2, len(scale)))
    readings[:, [C.RIG, -1]] = [[2.0, 0.6], [1.0, 1.0]]
    readings /= scale
    heard = readings[:, C.RIG] * off * CALIBRATION_SD[0] + np.array([0.3, -0.4])

    def posterior(prior):
        """Mean, covariance and log evidence if the rig's constants are known to `prior`."""
        before = np.concatenate([np.ones(C.RIG), prior, [3.0]]) ** 2
        S = np.eye(2) + (readings * before) @ readings.T
        gain = (readings * before).T @ np.linalg.inv(S)
        return (gain @ heard, np.diag(before) - gain @ S @ gain.T, multivariate_normal(np.zeros(2), S).logpdf(heard))

    def opened(times):
        return np.where(np.arange(RIG_CONSTANTS) == 0, np.hypot(sd, times * CALIBRATION_SD), sd)

    y, covariance, evidence = posterior(sd)
    each = [
        (times, *other) for times in CAUSE_SIZES if times > known and (other := posterior(opened(times)))[2] > evidence
    ]
    gains = np.array([other[3] - evidence for other in each])
    found = criticised(y[RIG], covariance[RIG, RIG], sd, sd)
    assert found.log_odds == pytest.approx(
        np.logaddexp.reduce(gains) + LN_PRIOR_NAMED - math.log(len(CAUSE_SIZES)), abs=1e-6
    )
    declared = known < 1.0  # known better than by calibration, so that more is in doubt
    often = [PRIOR_DOUBTED / times if declared else math.exp(LN_PRIOR_NAMED) / len(CAUSE_SIZES) for times, *_ in each]
    weights = np.exp([0.0, *(gains + np.log(often))])
    weights /= weights.sum()
    spread = sum(
        weight * (P + np.outer(mean - y, mean - y))
        for weight, (mean, P) in zip(weights, [(y, covariance), *(other[1:3] for other in each)], strict=True)
    )
    by = RigBelief(sd, found.contradicted, found.sd, found.considered).considering(covariance)
    asked = [C.RIG, -1]
    assert (by / np.outer(scale, scale))[np.ix_(asked, asked)] == pytest.approx(
        (spread / np.outer(scale, scale))[np.ix_(asked, asked)], rel=1e-4
    )


@pytest.mark.parametrize("sd", [CALIBRATED, EXACT], ids=["calibrated", "exact"])
@pytest.mark.parametrize("wrong", range(R.KAPPA), ids=RIG_NAMES[: R.KAPPA])
def test_only_the_wrong_constant_is_contradicted(sd, wrong):
    linear = Linear(100 + wrong)
    true = linear.random.standard_normal(RIG_CONSTANTS) * sd
    true[wrong] += 9.0 * CALIBRATED[wrong]
    found = criticised(*linear.posterior(true, sd), sd, sd).contradicted
    assert np.flatnonzero(found).tolist() == [wrong]
    assert found[wrong] > 0.0


def test_equal_errors_of_both_zeros_are_one_cause():
    """Readings that determine each to a third of its calibration sd are sufficient for equal errors only."""
    precision = (3.0 / CALIBRATED) ** 2 + EXACT**-2.0

    def found(one, other):
        off = np.zeros(RIG_CONSTANTS)
        off[[R.ZERO, R.ZERO + 1]] = one, other
        return criticised(
            off * CALIBRATION_SD * (3.0 / CALIBRATED) ** 2 / precision, np.diag(1.0 / precision), EXACT, EXACT
        )

    assert np.flatnonzero(found(1.0, 1.0).contradicted).tolist() == [R.ZERO, R.ZERO + 1]
    assert not found(1.0, -1.0).contradicted.any()


def test_a_zero_without_readings_is_not_contradicted_with_the_other():
    covariance, values = np.diag(CALIBRATED**2), np.zeros(RIG_CONSTANTS)
    covariance[R.ZERO, R.ZERO] /= 10.0
    values[R.ZERO] = 5.0 * CALIBRATED[R.ZERO]
    found = criticised(values, covariance, CALIBRATED, CALIBRATED).contradicted
    assert np.flatnonzero(found).tolist() == [R.ZERO]


def test_a_clearly_likeliest_constant_is_named_alone_otherwise_all_candidates():
    """Readings determine the constants' sum and possibly the first by itself; the odds for that are then 2 to 1."""

    def found(where, by_itself):
        information = 36.0 * np.ones((len(where), len(where)))
        information[0, 0] += by_itself**2
        M, off = np.zeros((RIG_CONSTANTS, RIG_CONSTANTS)), np.zeros(RIG_CONSTANTS)
        M[np.ix_(where, where)] = information / np.outer(CALIBRATION_SD[where], CALIBRATION_SD[where])
        off[where[0]] = CALIBRATION_SD[where[0]]
        covariance = np.linalg.inv(M + np.diag(EXACT**-2.0))
        return np.flatnonzero(criticised(covariance @ M @ off, covariance, EXACT, EXACT).contradicted).tolist()

    assert found([R.STANDOFF, R.TILT, R.TURN], 0.0) == [R.STANDOFF, R.TILT, R.TURN]
    assert found([R.STANDOFF, R.TURN], 1.2) == [R.STANDOFF]


def test_free_constants_are_not_contradicted_and_both_parameterisations_agree():
    linear = Linear(3)
    true = np.zeros(RIG_CONSTANTS)
    true[[R.ZERO, R.TURN]] = 8.0 * CALIBRATED[[R.ZERO, R.TURN]]
    free = np.maximum(CALIBRATED, FREE_SD)
    values, covariance = linear.posterior(true, free)
    assert not criticised(values, covariance, free, free).contradicted.any()
    assert np.flatnonzero(criticised(values, covariance, free, CALIBRATED).contradicted).tolist() == [R.ZERO, R.TURN]


def off_by(run: Run, zero_m: float) -> list[PadSample | PalmSample]:
    """The run's events on a rig whose pad 1 has a zero error of `zero_m`."""
    return [
        replace(event, s=event.s + zero_m) if isinstance(event, PadSample) and event.pad == 1 else event
        for event in run.events
    ]


def test_a_zero_error_is_named_and_does_not_bias_the_outline():
    run = simulated("friction", 42, 20.0)
    answer = reconstruct(off_by(run, 3e-4), run.rig)
    assert answer.converged, answer.reason
    assert [RIG_NAMES[i] for i in np.flatnonzero(answer.contradicted)] == ["pad1_zero_m"]
    assert abs(answer.rig[R.ZERO] - 3e-4) < 3 * answer.rig_sd[R.ZERO] < 1.5e-4
    assert score_outline(answer.theta, answer.h, answer.touched, run.truth.h).e_h < 4e-5


def test_a_large_error_of_the_rig_is_found():
    """Nothing explains these readings with the rig as described."""
    run = simulated("friction", 41, 12.0)
    events = palms_changed(
        run.events, lambda event: replace(event, angles=(event.angles[0], event.angles[1] - math.radians(1)))
    )
    answer = reconstruct(events, run.rig)
    assert answer.converged, answer.reason
    assert [RIG_NAMES[i] for i in np.flatnonzero(answer.contradicted)] == ["phi2_rad"]
    assert abs(answer.rig[R.TURN] - math.radians(1)) < 3 * answer.rig_sd[R.TURN]


@pytest.mark.parametrize(("kind", "seed"), [("rig", 2), *nightly(("nominal", 1), ("friction", 43))])
def test_a_correctly_described_calibrated_rig_is_not_contradicted(kind, seed):
    """For exactly known rigs see `test_reconstruct`."""
    run = simulated(kind, seed, 10.0)
    assert not reconstruct(run.events, run.rig.known_to(AS_CALIBRATED)).contradicted.any()


def test_the_live_smoother_names_the_error_and_relinearises():
    """The contradiction appears after much contact; all earlier readings are then relinearised."""
    run = simulated("friction", 41, 16.0)
    smoother, events = IncrementalSmoother(run.rig), off_by(run, 3e-4)
    answers, fed = [], 0
    for t in np.arange(1.0, 16.0, 1.0):
        until = next((i for i, event in enumerate(events) if event.t_sample > t), len(events))
        smoother.add(Session(1, 0.0), events[fed:until])
        fed = until
        answers.append(smoother.answer())
    given = [answer for answer in answers if answer is not None]
    named = [answer for answer in given if answer.contradicted.any()]
    assert named, "never contradicted"
    # at first the scales may be named; at the end only the zero is possible
    assert all(answer.contradicted[R.ZERO] > 3.0 for answer in named)
    assert [RIG_NAMES[i] for i in np.flatnonzero(given[-1].contradicted)] == ["pad1_zero_m"]
    assert given[-1].established
    assert abs(given[-1].rig[R.ZERO] - 3e-4) < 3 * given[-1].rig_sd[R.ZERO] < 2e-4


def test_criticism_of_almost_exact_constants_ignores_the_iterations_residual():
    """0.1 µm is below the iteration's tolerance, but 10 sigmas for such a constant."""
    run = simulated("friction", 42, 4.0)
    (segment,) = data_segments(run.events)
    search = Search(segment, run.rig)
    found = search.blind(Attempt(2.0, 3), 0)
    assert found is not None
    fit, smoother = found.fits[0], Smoother(search.library, found.record, search.prior)
    p = fit.guess.p.copy()
    p[C.RIG + R.SAGITTA] -= LEAST_SD
    here, there = (smoother.posterior(replace(fit, guess=replace(fit.guess, p=each))) for each in (fit.guess.p, p))
    belief = RigBelief.of(run.rig)
    assert there.constants[RIG] == pytest.approx(here.constants[RIG], abs=0.1 * LEAST_SD)
    assert not belief.after(here).contradicted.any()
    assert not belief.after(there).contradicted.any()
