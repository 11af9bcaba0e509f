"""The predictive belief of a body's outline from its touched part, for bodies with infinitely many harmonics."""

import math

import numpy as np
import pytest

from palmd.model.icosphere import icosphere
from palmd.model.spherical import Y00, count, evaluator
from palmd.model.three_palms import BODY
from palmd.observer.three_palms.beliefs import shape_variance, truncation_sd
from palmd.observer.three_palms.body import ORDER, inertia
from palmd.observer.three_palms.smoother import BodyPrior
from palmd.observer.three_palms.touched_outline import directions_near, predictive_belief, touched_outline

RADIUS, TRUE_ORDER = 0.028, 20
N = count(ORDER)
DIRECTIONS = icosphere()[0]
TOUCHED = DIRECTIONS[:, 2] > math.cos(math.radians(60.0))
UNTOUCHED = DIRECTIONS[:, 2] < math.cos(math.radians(75.0))


def fitted(seed):
    """True heights of a body, and the fit of degree `ORDER` to very many readings of a part of it."""
    random = np.random.default_rng(seed)
    coefficients = random.normal(0.0, np.sqrt(shape_variance(RADIUS, TRUE_ORDER)))
    coefficients[0] = RADIUS / Y00
    heights = evaluator(TRUE_ORDER)(DIRECTIONS)[0] @ coefficients
    rows, weight = evaluator(ORDER)(DIRECTIONS[TOUCHED])[0], 1e-5**-2
    mean = np.zeros(N)
    mean[0] = RADIUS / Y00
    covariance = np.linalg.inv(weight * rows.T @ rows + np.diag(1.0 / shape_variance(RADIUS, ORDER)))
    c = mean + covariance @ (weight * rows.T @ (heights[TOUCHED] - rows @ mean))
    lam = random.normal(0.0, 0.1, 6)
    whole = 1e-4 * np.eye(6 + N + BODY)
    whole[6 : 6 + N, 6 : 6 + N] = covariance
    return heights, np.concatenate([c, lam, [0.0, 0.1, -4.6]]), whole


def heights_of(p):
    return evaluator(ORDER)(DIRECTIONS)[0] @ p[:N]


def bands(covariance):
    rows = evaluator(ORDER)(DIRECTIONS)[0]
    return np.sqrt(((rows @ covariance[6 : 6 + N, 6 : 6 + N]) * rows).sum(axis=1))


def rms(x):
    return math.sqrt(np.mean(np.square(x)))


def test_the_untouched_outline_is_more_accurate_and_within_its_bands():
    before, after, sigmas, kept = [], [], [], []
    for seed in range(8):
        heights, p, covariance = fitted(seed)
        q, known = touched_outline(p, covariance, TOUCHED)
        before.append(rms((heights_of(p) - heights)[UNTOUCHED]))
        after.append(rms((heights_of(q) - heights)[UNTOUCHED]))
        sigmas.append(rms(((heights_of(q) - heights) / bands(known))[UNTOUCHED]))
        kept.append(rms((heights_of(q) - heights_of(p))[TOUCHED]) / truncation_sd(RADIUS, ORDER, TOUCHED).min())
    assert np.median(after) < 0.7 * np.median(before)
    assert rms(sigmas) < 1.5
    assert rms(((heights_of(p) - heights) / bands(covariance))[UNTOUCHED]) > 2.0  # of the plain fit
    assert max(kept) < 2.0


def test_a_common_error_of_all_heights_is_kept():
    """For example with a poorly known centre of mass, from which all heights are measured."""
    _, p, covariance = fitted(4)
    covariance[7:10, 7:10] += 4.0 * np.pi / 3.0 * (2e-4) ** 2 * np.eye(3)
    _, known = touched_outline(p, covariance, TOUCHED)
    before, after = (np.median(bands(each)[TOUCHED]) for each in (covariance, known))
    assert before > 1e-4
    assert 0.9 * before < after < 1.1 * before


def test_the_inertia_and_its_covariance_are_unchanged():
    _, p, covariance = fitted(3)
    random = np.random.default_rng(0)
    covariance[6, 6 + N : 12 + N] = covariance[6 + N : 12 + N, 6] = (
        1e-3 * random.normal(size=6) * covariance[6, 6] ** 0.5
    )
    q, known = touched_outline(p, covariance, TOUCHED)
    assert q[0] != p[0]
    np.testing.assert_allclose(inertia(q), inertia(p), rtol=1e-12)

    def spread(p, covariance):
        slopes = []
        for k in (0, *range(N, N + 6)):
            step = np.zeros(len(p))
            step[k] = 1e-6 * max(abs(p[k]), 1e-2)
            slopes.append((inertia(p + step) - inertia(p - step)).ravel() / (2 * step[k]))
        J, at = np.stack(slopes, axis=1), np.array([6, *range(6 + N, 12 + N)])
        return J @ covariance[np.ix_(at, at)] @ J.T

    np.testing.assert_allclose(spread(q, known), spread(p, covariance), rtol=1e-4, atol=1e-22)
    np.testing.assert_allclose(known, known.T, atol=1e-16)
    assert np.linalg.eigvalsh(known)[0] > 0.0


def test_a_fit_with_a_negative_mean_radius_is_handled():
    _, p, covariance = fitted(6)
    rows = evaluator(ORDER)(DIRECTIONS)[0]
    p[:N] = np.linalg.lstsq(rows, RADIUS * (4.0 * DIRECTIONS[:, 2] - 1.0), rcond=None)[
        0
    ]  # positive in the touched part
    assert p[0] < 0.0
    q, known = touched_outline(p, covariance, TOUCHED)
    assert q[0] > 0.0
    np.testing.assert_allclose(inertia(q), inertia(p), rtol=1e-12)
    assert np.isfinite(known).all()


def test_rotation_spin_and_friction_are_unchanged():
    _, p, covariance = fitted(1)
    covariance[0, 3] = covariance[3, 0] = 5e-5
    q, known = touched_outline(p, covariance, TOUCHED)
    np.testing.assert_array_equal(q[-3:], p[-3:])
    np.testing.assert_array_equal(known[:6, :6], covariance[:6, :6])
    np.testing.assert_array_equal(known[-3:, -3:], covariance[-3:, -3:])


def test_a_finer_outline_is_projected_to_fewer_degrees():
    random = np.random.default_rng(5)
    n = count(16)
    c = random.normal(0.0, np.sqrt(shape_variance(RADIUS, 16)))
    c[0] = RADIUS / Y00
    p = np.concatenate([c, np.zeros(BODY)])
    everywhere = np.ones(len(DIRECTIONS), np.bool_)
    q, known = touched_outline(p, 1e-14 * np.eye(6 + n + BODY), everywhere, ORDER)
    assert (len(q), known.shape) == (N + BODY, (6 + N + BODY,) * 2)
    off = rms(heights_of(q) - evaluator(16)(DIRECTIONS)[0] @ c)
    assert off < 1.3 * rms(evaluator(16)(DIRECTIONS)[0][:, N:] @ c[N:])  # at most the omitted degrees


def test_the_predictive_belief_replaces_a_belief_unless_it_is_empty():
    _, p, covariance = fitted(2)
    ahead = BodyPrior(np.eye(3), np.zeros(3), p, np.linalg.inv(covariance))
    q, known = touched_outline(p, covariance, TOUCHED)
    goes_on = predictive_belief(ahead, TOUCHED)
    np.testing.assert_allclose(goes_on.mean, q, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(np.linalg.inv(goes_on.information), known, rtol=1e-3, atol=1e-12)
    nothing = BodyPrior(np.eye(3), np.zeros(3), p, np.zeros_like(covariance))
    assert predictive_belief(nothing, TOUCHED) is nothing


def test_near_is_within_four_degrees():
    touched = np.array([[0.0, 0.0, 1.0]])
    assert directions_near(touched) == pytest.approx(DIRECTIONS[:, 2] >= math.cos(math.radians(4.0)))
