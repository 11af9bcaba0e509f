"""The least-squares problem of a record: gradient, normal matrix, posterior, outliers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from simulated import simulated

from palmd.model.shape import coefficients_of
from palmd.model.smoothing import CONSTANTS, NODE, ORDER, C
from palmd.observer import marginal
from palmd.observer.data_segment import longest_segment
from palmd.observer.factor import GAUGE_SD
from palmd.observer.marginal import marginalised
from palmd.observer.normal_equations import Guess
from palmd.observer.search import NOISE, Search
from palmd.observer.smoother import Budget, Smoother, _largest_decrease

SECONDS = 0.4


def unpacked(y):
    return Guess(y[:-CONSTANTS].reshape(-1, NODE), y[-CONSTANTS:])


def packed(guess):
    return np.concatenate([guess.x.ravel(), guess.p])


class Problem:
    """A short record whose readings, prior and trajectory all agree with one guess, at which the cost is zero."""

    def __init__(self, seconds=SECONDS):
        run = simulated("rig", 1, 2.0)
        truth = run.truth
        search = Search(longest_segment(run.events), run.rig)
        self.library, self.measured = search.library, search.record.until(search.record.t[0] + seconds)
        p = np.zeros(CONSTANTS)
        p[C.LN_RHO], p[C.DRAG], p[C.SATURATION] = np.log(truth.rho), truth.mu / truth.dither, truth.dither**-2.0
        p[C.DAMPING], p[C.LN_MASS], p[C.SHAPE :] = truth.damping, np.log(truth.mass), coefficients_of(truth.h, ORDER)
        spline = CubicHermiteSpline(truth.t, truth.psi, truth.omega0)
        start = self.measured.t[0]
        first = Guess(np.array([[0.0, spline(start, 1)]]), p)
        mean = p.copy()
        mean[C.LN_RHO] -= np.log(p[C.SHAPE])
        mean[C.DRAG], mean[C.SATURATION] = truth.mu, np.log(truth.dither)
        self.prior = replace(search.prior, mean=mean)
        smoother = Smoother(self.library, self.measured, self.prior)
        self.guess = guess = smoother.completed(first)
        sd = np.sqrt(self.measured.contact_variance)
        contacts = self.measured.contact_value - smoother.residuals(guess) * sd
        self.record = replace(self.measured, contact_value=contacts, force_value=smoother.forces(guess))
        self.smoother = Smoother(self.library, self.record, self.prior)
        self.scale = np.concatenate([np.tile([1e-4, 1e-2], len(guess.x)), 1e-2 * self.prior.scale])

    def right_hand_side(self, y, smoother=None):
        now = (smoother or self.smoother).linearised(unpacked(y), NOISE)
        return np.concatenate([now.node_side, now.constant_side])

    def normal_matrix(self):
        now = self.smoother.linearised(self.guess, NOISE)
        nodes = np.diag(now.banded[0])
        for k in range(1, len(now.banded)):
            part = np.diag(now.banded[k, :-k], -k)
            nodes += part + part.T
        return np.block([[nodes, now.border], [now.border.T, now.corner]])


@pytest.fixture(scope="module")
def problem():
    return Problem()


def with_outliers(record, share, by, seed=0):
    random = np.random.default_rng(seed)
    off = by * random.choice([-1.0, 1.0], len(record.contact_value))
    return replace(record, contact_value=record.contact_value + off * (random.random(len(off)) < share))


def test_readings_and_motion_of_the_problem_are_consistent(problem):
    fit = problem.smoother.fit(problem.guess, NOISE, iterations=0)
    # only the first node's rate differs from the prior
    assert fit.cost == pytest.approx((problem.guess.x[0, 1] / problem.prior.omega0_sd) ** 2, abs=1e-12)
    assert (fit.chi2, fit.force_chi2, fit.outliers) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert problem.smoother.residuals(problem.guess) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("share", [0.0, 0.1], ids=["clean", "outliers"])
def test_the_right_hand_side_is_minus_half_the_gradient_of_the_cost(problem, share):
    smoother = Smoother(problem.library, with_outliers(problem.record, share, 5e-3), problem.prior)
    random = np.random.default_rng(2)
    y = packed(problem.guess) + 0.02 * problem.scale * random.standard_normal(len(problem.scale))
    y[0] = GAUGE_SD
    side = problem.right_hand_side(y, smoother) * problem.scale
    gradient = []
    for i, step in enumerate(problem.scale * 1e-3):
        costs = []
        for sign in (1.0, -1.0):
            moved = y.copy()
            moved[i] += sign * step
            costs.append(smoother.fit(unpacked(moved), NOISE, iterations=0).cost)
        gradient.append((costs[0] - costs[1]) / (2e-3))
    assert np.array(gradient)[1:] == pytest.approx(-2 * side[1:], rel=2e-3, abs=1e-4 * np.abs(side[1:]).max())


def test_the_normal_matrix_is_half_the_curvature_at_zero_residuals(problem):
    y = packed(problem.guess)
    columns = []
    for i, step in enumerate(problem.scale * 1e-3):
        up, down = y.copy(), y.copy()
        up[i] += step
        down[i] -= step
        columns.append((problem.right_hand_side(down) - problem.right_hand_side(up)) / 2e-3)
    wanted = np.array(columns) * problem.scale
    N = problem.normal_matrix() * np.outer(problem.scale, problem.scale)
    size = np.sqrt(np.outer(np.diagonal(N), np.diagonal(N)))
    assert wanted / size == pytest.approx(N / size, abs=3e-3)


def test_the_posterior_is_the_inverse_of_the_normal_matrix(problem):
    fit = problem.smoother.fit(problem.guess, NOISE, iterations=0)
    posterior = problem.smoother.posterior(fit)
    N = problem.normal_matrix()
    scale = 1 / np.sqrt(np.diagonal(N))
    inverse = np.linalg.inv(N * np.outer(scale, scale)) * np.outer(scale, scale)
    wanted = [*range(len(N) - CONSTANTS, len(N)), *range(len(N) - CONSTANTS - NODE, len(N) - CONSTANTS)]
    of_sd = np.sqrt(np.diagonal(inverse))[wanted]
    normalised = inverse[np.ix_(wanted, wanted)] / np.outer(of_sd, of_sd)
    assert posterior.covariance / np.outer(of_sd, of_sd) == pytest.approx(normalised, abs=1e-6)
    steps = len(problem.record.dt)
    log_det = np.linalg.slogdet(N * np.outer(scale, scale))[1] - 2 * np.log(scale).sum()
    evidence = -0.5 * (fit.cost + log_det + steps * (np.log(NOISE.psi) + np.log(NOISE.omega0)))
    assert posterior.evidence == pytest.approx(evidence, rel=1e-9)
    assert posterior.distance2(posterior.constants) == 0.0
    sd = np.sqrt(np.diagonal(posterior.covariance)[:CONSTANTS])
    off = posterior.constants + 1.0 * sd
    correlation = posterior.covariance[:CONSTANTS, :CONSTANTS] / np.outer(sd, sd)
    assert posterior.distance2(off) == pytest.approx(np.linalg.inv(correlation).sum(), rel=1e-6)


def test_a_fits_equations_are_reused_for_that_fit_only(problem):
    fit = problem.smoother.fit(problem.guess, NOISE)
    moved = replace(fit, guess=Guess(fit.guess.x, 1.001 * fit.guess.p))
    doubting = problem.smoother.with_knowledge(replace(problem.prior, sd=2.0 * problem.prior.sd))
    for smoother, each in ((problem.smoother, fit), (problem.smoother, moved), (doubting, fit)):
        got, wanted = smoother.posterior(each), smoother.posterior(replace(each, linearised=None))
        np.testing.assert_array_equal(got.covariance, wanted.covariance)
        assert got.evidence == wanted.evidence
    assert problem.smoother.posterior(moved).evidence != problem.smoother.posterior(fit).evidence
    assert doubting.posterior(fit).evidence != problem.smoother.posterior(fit).evidence


def test_steps_over_the_dither_speed_are_predicted(problem, monkeypatch):
    prior = replace(problem.prior, sd=np.where(np.arange(CONSTANTS) == C.SATURATION, 0.3, problem.prior.sd))
    fit = Smoother(problem.library, problem.measured, prior).fit(problem.guess, NOISE)
    result = marginalised(problem.library, problem.measured, prior, fit)
    ends = []

    def from_the_start(prior, start, value):
        ends.append(value)
        return start.guess

    monkeypatch.setattr(marginal, "_predicted", from_the_start)
    wanted = marginalised(problem.library, problem.measured, prior, fit)
    assert len(ends) > 4
    sd = np.sqrt(np.diagonal(wanted.covariance))
    off = np.concatenate([result.mean.p - wanted.mean.p, result.mean.x[-1] - wanted.mean.x[-1]])
    assert (np.abs(off) < 0.1 * sd).all()
    assert result.mu == pytest.approx(wanted.mu, abs=0.05 * wanted.mu_sd)
    assert result.mu_sd == pytest.approx(wanted.mu_sd, rel=0.02)


@pytest.mark.parametrize("fails", [np.linalg.LinAlgError, None], ids=["raises", "without-a-number"])
def test_a_step_over_the_dither_speed_without_a_minimum_is_left_out(problem, monkeypatch, fails):
    prior = replace(problem.prior, sd=np.where(np.arange(CONSTANTS) == C.SATURATION, 0.3, problem.prior.sd))
    fit = Smoother(problem.library, problem.measured, prior).fit(problem.guess, NOISE)
    middle, step = -0.5 * np.log(fit.guess.p[C.SATURATION]), marginal._step

    def fails_above(smoother, known, start, value, bent):
        if value < middle + 1e-9:
            return step(smoother, known, start, value, bent)
        if fails is not None:
            raise fails
        return replace(step(smoother, known, start, middle, bent), log_weight=np.nan)

    monkeypatch.setattr(marginal, "_step", fails_above)
    result = marginalised(problem.library, problem.measured, prior, fit)
    assert np.isfinite(result.covariance).all()
    assert result.mean.p[C.SATURATION] >= fit.guess.p[C.SATURATION]


def test_without_information_the_average_is_the_prior(problem):
    """Steps over the dither speed are weighted in (μ, ln u_d); the smoother uses μ/u_d and 1/u_d²."""
    spread = 0.3
    prior = replace(problem.prior, sd=np.where(np.arange(CONSTANTS) == C.SATURATION, spread, problem.prior.sd))
    of = problem.record
    vague = replace(of, contact_variance=1e8 * of.contact_variance, force_variance=1e8 * of.force_variance)
    fit = Smoother(problem.library, vague, prior).fit(problem.guess, NOISE)
    result = marginalised(problem.library, vague, prior, fit)
    mu, dither = prior.mean[C.DRAG], np.exp(prior.mean[C.SATURATION])
    assert result.mean.p[C.DRAG] == pytest.approx(mu / dither * np.exp(spread**2 / 2), rel=0.02)
    assert result.mean.p[C.SATURATION] == pytest.approx(dither**-2 * np.exp(2 * spread**2), rel=0.02)
    assert (result.mu, result.mu_sd) == pytest.approx((mu, prior.sd[C.DRAG]), rel=0.02)


def test_a_fit_converges_to_the_truth_from_nearby(problem):
    random = np.random.default_rng(2)
    y = packed(problem.guess) + 30 * problem.scale * random.standard_normal(len(problem.scale))
    start = problem.smoother.fit(unpacked(y), NOISE, iterations=0)
    fit = problem.smoother.fit(unpacked(y), NOISE)
    assert fit.settled
    assert fit.cost < 1.0 < 100.0 < start.cost
    sd = np.sqrt(np.diagonal(problem.smoother.posterior(fit).covariance))
    assert np.abs((fit.guess.p - problem.guess.p) / sd[:CONSTANTS]).max() < 1.0


@pytest.mark.parametrize(("promise", "fall"), [(0.05, -0.4), (0.3, -0.01), (0.2, 0.0), (0.1, -5.0)])
def test_the_largest_decrease_along_a_rejected_step(promise, fall):
    t = np.linspace(0.0, 1.0, 100001)
    cost = -2.0 * promise * t + (2.0 * promise - fall) * t**2  # its slope is twice what the step predicts
    assert cost[-1] == pytest.approx(-fall)
    assert _largest_decrease(promise, fall) == pytest.approx(-cost.min(), rel=1e-6)


def test_outliers_do_not_bias_the_result():
    problem = Problem(seconds=1.8)
    clean = Smoother(problem.library, problem.measured, problem.prior)
    corrupted = Smoother(problem.library, with_outliers(problem.measured, 0.03, 5e-3), problem.prior)
    wanted, fit = clean.fit(problem.guess, NOISE), corrupted.fit(problem.guess, NOISE)
    assert fit.settled
    assert 0.01 < fit.outliers < 0.06
    sd = np.sqrt(np.diagonal(clean.posterior(wanted).covariance))[:CONSTANTS]
    assert np.abs((fit.guess.p - wanted.guess.p) / sd).max() < 1.0


def test_a_shorter_guess_is_completed_by_the_model(problem):
    known = Guess(problem.guess.x[:5], problem.guess.p)
    assert problem.smoother.completed(known).x == pytest.approx(problem.guess.x, abs=1e-12)
    assert problem.smoother.completed(problem.guess) is problem.guess


def test_a_guess_is_interpolated_to_other_nodes_by_its_cubic(problem):
    t = problem.record.t
    halfway = (t[:-1] + t[1:]) / 2
    moved = problem.guess.on(t, halfway)
    assert moved.x == pytest.approx(
        np.column_stack([CubicHermiteSpline(t, *problem.guess.x.T)(halfway, order) for order in (0, 1)])
    )
    assert problem.guess.on(t, t).x == pytest.approx(problem.guess.x, abs=1e-12)


def test_fits_that_share_a_budget_end_when_it_is_spent():
    run = simulated("rig", 1, 2.0)
    search = Search(longest_segment(run.events), run.rig)
    nodes, budget = len(search.record.t), Budget()
    guess = Guess(np.zeros((nodes, NODE)), search.prior.mean.copy())
    guess.p[[C.LN_RHO, C.DRAG, C.SATURATION]] = np.log(0.7 * guess.p[C.SHAPE]), 20.0, 1e4
    free = Smoother(search.library, search.record, search.known, budget).fit(guess, NOISE)
    assert free.iterations > 3
    budget.left = 3 * nodes
    short = Smoother(search.library, search.record, search.known, budget)
    assert short.fit(guess, NOISE).iterations == 3
    again = short.fit(guess, NOISE)
    assert (again.iterations, again.settled) == (0, False)
