from __future__ import annotations

import numpy as np
import pytest

from palmd.observer.local_fit import HALF_WIDTH_S, RecentReadings, local_cubic


def irregular(n: int, seed: int) -> np.ndarray:
    return np.sort(np.random.default_rng(seed).uniform(0.0, 1.0, n))


def test_a_cubic_is_reproduced_for_any_spacing():
    t = irregular(80, 1)
    cubic = np.polynomial.Polynomial([0.02, 0.1, -0.3, 0.7])
    values = np.stack([cubic(t), -2 * cubic(t)], axis=1)
    fit = local_cubic(t, values, 0.5)
    np.testing.assert_allclose(fit.value, [cubic(0.5), -2 * cubic(0.5)], rtol=1e-9)
    np.testing.assert_allclose(fit.rate, [cubic.deriv()(0.5), -2 * cubic.deriv()(0.5)], rtol=1e-8)


def test_noise_is_reduced_as_stated():
    t = np.arange(0.0, 1.0, 0.01)
    noise = np.random.default_rng(2).normal(0.0, 1.0, (len(t), 2000))
    fit = local_cubic(t, noise, 0.5)
    assert 0.2 < fit.value.std() < 0.3
    assert 4.0 < fit.rate.std() < 6.0
    end = local_cubic(t, noise, 0.99)
    assert end.value.std() > 2 * fit.value.std()


def test_a_jump_causes_a_misfit():
    t = np.arange(0.0, 1.0, 0.01)
    smooth, jump = 0.01 * np.sin(3 * t), 0.01 * np.sin(3 * t) + 0.01 * (t > 0.5)
    fit = local_cubic(t, np.stack([smooth, jump], axis=1), 0.52)
    assert fit.misfit[0] < 1e-5
    assert fit.misfit[1] > 2e-3


@pytest.mark.parametrize("t", [-1.0, 3.0, 0.5])
def test_too_few_readings_give_no_fit(t):
    few = np.array([0.5, 0.51, 0.52])
    assert local_cubic(few, few[:, None], t) is None
    assert RecentReadings(1.0).at(t) is None
    at_one_instant = np.full(10, 0.5)
    assert local_cubic(at_one_instant, at_one_instant[:, None], t) is None


def test_late_readings_are_sorted_in_and_old_ones_are_dropped():
    t = irregular(60, 3)
    in_order, shuffled = RecentReadings(2.0), RecentReadings(2.0)
    for each in t:
        in_order.add(each, each**2)
    for each in np.random.default_rng(4).permutation(t):
        shuffled.add(each, each**2)
        shuffled.add(each, 99.0)  # fed twice: the first one counts
    np.testing.assert_array_equal(in_order.at(0.5).value, shuffled.at(0.5).value)
    in_order.add(10.0, 0.0)
    assert in_order.at(0.5) is None
    assert HALF_WIDTH_S < 1.0
