"""A Gaussian belief with an inequality constraint, against the truncated normal distribution."""

import numpy as np
import pytest
from scipy.stats import truncnorm

from palmd.observer.cutoff import cut_off

P0 = np.array([[4.0, 1.2, 0.3], [1.2, 2.0, -0.5], [0.3, -0.5, 1.0]])


@pytest.mark.parametrize("depth", [0.0, 0.7, 5.0, 19.9, 20.1, 35.0])
def test_the_constrained_belief_has_the_moments_of_the_truncated_distribution(depth):
    row = np.array([1.0, -0.4, 0.7])
    sd = np.sqrt(row @ P0 @ row)
    x, P = np.array([0.0, 0.2, -1.0]), P0.copy()
    x -= row * (row @ x + depth * sd) / (row @ row)
    assert cut_off(x, P, row)
    truncated = truncnorm(depth, np.inf, loc=-depth * sd, scale=sd)
    assert row @ x == pytest.approx(truncated.mean(), rel=1e-4)  # a series beyond 20 sd
    assert row @ P @ row == pytest.approx(truncated.var(), rel=1e-6 if depth < 6.0 else 0.03)  # rounding


def test_correlated_components_move_and_independent_ones_stay():
    row, x, P = np.array([1.0, 0.0, 0.0]), np.array([-1.0, 2.0, 3.0]), P0.copy()
    P[2, :2] = P[:2, 2] = 0.0
    free = P[2, 2]
    assert cut_off(x, P, row)
    rise = x[0] + 1.0
    assert x[1] - 2.0 == pytest.approx(rise * P0[1, 0] / P0[0, 0])
    assert (x[2], P[2, 2]) == (3.0, free)
    assert np.allclose(P, P.T)
    assert np.linalg.eigvalsh(P).min() > 0.0


def test_an_exactly_known_component_is_unchanged():
    row, x, P = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0]), P0.copy()
    P[2] = P[:, 2] = 0.0
    before = P.copy()
    assert not cut_off(x, P, row)
    assert np.array_equal(P, before)
    assert x.tolist() == [0.0, 0.0, -1.0]
