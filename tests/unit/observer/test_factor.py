"""Quadratic costs of the constants and a node: expanded, added, marginalised."""

import numpy as np
import pytest

from palmd.model.smoothing import CONSTANTS, NODE, C
from palmd.observer.factor import SIZE, Factor, Prior, conditional_covariance


@pytest.fixture
def random():
    return np.random.default_rng(7)


def a_factor(random, size=SIZE):
    # entries as different in size as those of real normal matrices
    root = random.standard_normal((size, size + 3)) * 10 ** random.uniform(-3, 6, (size, 1))
    return Factor(random.standard_normal(size), 2.5, root @ root.T, root @ random.standard_normal(size + 3), np.ones(1))


def cost(factor, y):
    by = y - factor.about
    return factor.cost - 2 * factor.side @ by + by @ factor.matrix @ by


def test_expanding_a_cost_elsewhere_does_not_change_it(random):
    factor = a_factor(random)
    moved = factor.moved(factor.about + 1e-3 * random.standard_normal(SIZE))
    for _ in range(5):
        y = factor.about + 1e-3 * random.standard_normal(SIZE)
        assert cost(moved, y) == pytest.approx(cost(factor, y), rel=1e-6)


def test_marginalising_minimises_over_the_dropped_variables(random):
    factor, dropped = a_factor(random), slice(CONSTANTS, SIZE)
    kept = factor.marginalised(dropped)
    for _ in range(5):
        p = factor.about[:CONSTANTS] + 1e-4 * random.standard_normal(CONSTANTS)
        by = p - factor.about[:CONSTANTS]
        inner = factor.side[dropped] - factor.matrix[dropped, :CONSTANTS] @ by
        x = factor.about[dropped] + np.linalg.solve(factor.matrix[dropped, dropped], inner)
        assert cost(kept, p) == pytest.approx(cost(factor, np.concatenate([p, x])), rel=1e-6)


def test_costs_are_added_and_subtracted(random):
    one, other = a_factor(random), a_factor(random)
    both = one.plus(other)
    y = one.about + 0.1 * random.standard_normal(SIZE)
    assert cost(both, y) == pytest.approx(cost(one, y) + cost(other, y), rel=1e-9)
    assert cost(both.minus(other), y) == pytest.approx(cost(one, y), rel=1e-6)


def test_excess_is_the_cost_above_its_minimum(random):
    factor = a_factor(random)
    least = factor.moved(factor.about + factor.solved(factor.side))
    assert factor.excess() == pytest.approx(factor.cost - least.cost, rel=1e-6)
    assert least.excess() == pytest.approx(0.0, abs=1e-6 * factor.excess())


def test_the_determinant_is_accurate_for_entries_of_very_different_size(random):
    factor = a_factor(random, 6)
    assert factor.log_determinant() == pytest.approx(np.linalg.slogdet(factor.matrix)[1], rel=1e-9)


def test_the_priors_expansion_has_its_slope_and_curvature():
    """The prior is in ln(ρ/h0), μ and ln u_d; the constants are ln ρ, μ/u_d and 1/u_d²."""
    mean, sd = np.zeros(CONSTANTS), np.full(CONSTANTS, 1e-3)
    mean[C.SHAPE], mean[C.LN_RHO], sd[C.LN_RHO] = 0.02, -0.35, 0.1
    mean[C.DRAG], mean[C.SATURATION] = 0.1, np.log(0.05)
    prior = Prior(mean, sd, omega0_sd=1.5)
    p, x = mean + 0.3 * sd, np.array([2e-8, 0.4])
    p[C.LN_RHO] += np.log(p[C.SHAPE])
    p[C.DRAG], p[C.SATURATION] = 0.1003 / 0.05, 0.05**-2
    here = prior.terms(p, x)
    for seed in range(10):
        step = np.concatenate([prior.scale, [1e-7, 1.5]]) * np.random.default_rng(seed).standard_normal(SIZE)
        step *= 1e-3
        there = prior.terms(p + step[:CONSTANTS], x + step[-NODE:])
        slope, curve = -2 * here.side @ step, step @ here.matrix @ step
        assert there.cost - here.cost == pytest.approx(slope + curve, abs=0.02 * curve)


def test_conditional_covariance_given_known_constants(random):
    root = random.standard_normal((7, 7)) * 10 ** random.uniform(-3, 3, (7, 1))
    covariance = root @ root.T
    information = np.linalg.inv(covariance)  # of the rest, given the others: its own block
    assert conditional_covariance(covariance, slice(4, 7), slice(0, 4)) == pytest.approx(
        np.linalg.inv(information[:4, :4]), rel=1e-4
    )
