"""Samples of a belief about a body are made convex without changing what is known of it."""

import numpy as np
import pytest
from curvature import curvatures

from palmd.model.convex_bodies import LEAST_RADIUS, least_radii, nearest_convex
from palmd.model.icosphere import icosphere
from palmd.model.spherical import Y00, count, evaluator
from palmd.model.three_palms import BODY
from palmd.motion.body_explorer import BodyDraws
from palmd.observer.three_palms.beliefs import shape_variance
from palmd.observer.three_palms.body import ORDER

RADIUS = 0.02
SHAPE = slice(0, count(ORDER))
DIRECTIONS = icosphere(3)[0]


@pytest.fixture(scope="module")
def touched_cap():
    """A cap of the body that is known to 10 µm: which directions, mean and covariance of the outline."""
    cap = DIRECTIONS[:, 2] > 0.8
    rows = evaluator(ORDER)(DIRECTIONS[cap])[0]
    prior = np.diag(shape_variance(RADIUS, ORDER))
    gain = prior @ rows.T @ np.linalg.inv(rows @ prior @ rows.T + 1e-10 * np.eye(len(rows)))
    mean = np.zeros(count(ORDER))
    mean[0] = RADIUS / Y00
    covariance = prior - gain @ rows @ prior
    return cap, rows, mean, 0.5 * (covariance + covariance.T)


def drawn(mean, covariance, seed=3):
    variance, axes = np.linalg.eigh(covariance)
    return mean + axes @ (np.sqrt(np.maximum(variance, 0.0)) * np.random.default_rng(seed).normal(size=len(mean)))


def test_least_radii_are_the_surfaces_least_radii_of_curvature(touched_cap):
    _, _, mean, covariance = touched_cap
    c = drawn(mean, covariance)
    radii, rows = least_radii(c)
    np.testing.assert_allclose(radii, curvatures(c, DIRECTIONS)[:, 0], atol=1e-7)
    np.testing.assert_allclose(rows @ c, radii, atol=1e-12)


def test_the_untouched_part_is_made_convex_and_the_touched_part_stays(touched_cap):
    cap, rows, mean, covariance = touched_cap
    c = drawn(mean, covariance)
    assert least_radii(c)[0].min() < -0.5 * RADIUS  # a sample of a Gaussian belief is not convex
    made = nearest_convex(c, covariance, SHAPE)
    assert least_radii(made)[0].min() > 0.0
    np.testing.assert_allclose(rows @ made, rows @ c, atol=2e-5)
    elsewhere = evaluator(ORDER)(DIRECTIONS[~cap])[0]
    assert np.abs(elsewhere @ (made - c)).max() > 1e-3


def test_a_convex_body_is_not_changed_at_all(touched_cap):
    _, _, mean, covariance = touched_cap
    assert least_radii(mean)[0].min() > LEAST_RADIUS * RADIUS
    assert np.array_equal(nearest_convex(mean, covariance, SHAPE), mean)


def test_bodies_drawn_from_a_belief_are_convex(touched_cap):
    _, _, mean, shape = touched_cap
    p, covariance = np.zeros(count(ORDER) + BODY), 1e-8 * np.eye(6 + count(ORDER) + BODY)
    p[SHAPE], covariance[6 : 6 + count(ORDER), 6 : 6 + count(ORDER)] = mean, shape
    draws = BodyDraws.of(p, covariance, np.random.default_rng(0))
    assert all(least_radii(each[SHAPE])[0].min() > 0.0 for each in draws.p)
    assert 0.5e-4 < draws.turn.std() < 2e-4  # independent parameters keep their spread
