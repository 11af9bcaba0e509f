"""Outline and standard deviations from coefficients and their covariance."""

import math

import numpy as np
import pytest

from palmd.model import shape
from palmd.model.shape import basis, coefficients_of, tangential_basis
from palmd.observer import outline
from palmd.observer.outline import DIRECTIONS, directions, gauge_free_sd, normal_angles, outline_of, touched_by

ORDER = 4
RANDOM = np.random.default_rng(3)
COEFFICIENTS = np.array([0.02, *(5e-4 * RANDOM.standard_normal(2 * ORDER))])
ROOT = 1e-5 * RANDOM.standard_normal((2 * ORDER + 1, 2 * ORDER + 1))
COVARIANCE = ROOT @ ROOT.T


def degrees(*values):
    return np.radians(values)


def test_coefficients_of_a_sampled_outline():
    theta = np.arange(50) * (math.tau / 50)
    assert coefficients_of(basis(theta, ORDER) @ COEFFICIENTS, ORDER) == pytest.approx(COEFFICIENTS, abs=1e-15)
    assert coefficients_of(np.cos(3 * theta), ORDER) == pytest.approx([0, 0, 0, 0, 0, 1, 0, 0, 0], abs=1e-15)


def test_normals_at_the_contacts():
    """Equation (3.1)."""
    (normals,) = normal_angles(np.array([[0.7, 1.6]]), np.array([0.2]))
    assert normals == pytest.approx([0.7 - 0.2 - math.pi / 2, 0.7 + 1.6 - 0.2 - 3 * math.pi / 2])


def test_all_normals_passed_by_a_contact_are_touched():
    touched = touched_by(np.column_stack([degrees(350, 362, 355), degrees(100, 100.2, 100.4)]))
    assert np.flatnonzero(touched).tolist() == [0, 1, 2, 100, *range(350, 360)]


def test_the_sd_is_that_after_the_best_rotation():
    """Against samples of the error, each rotated by least squares over the touched normals."""
    normals = np.column_stack([degrees(0, 40), degrees(150, 220)])
    outline = outline_of(COEFFICIENTS, COVARIANCE, [normals])
    samples = ROOT @ np.random.default_rng(0).standard_normal((2 * ORDER + 1, 4000))
    errors = basis(directions(), ORDER) @ samples
    slope = -tangential_basis(directions(), ORDER) @ COEFFICIENTS
    on = outline.touched
    turns, *_ = np.linalg.lstsq(slope[on][:, None], errors[on], rcond=None)
    assert outline.h_sd == pytest.approx((errors - slope[:, None] * turns).std(axis=1), rel=0.06)


def test_an_error_of_orientation_alone_gives_no_sd():
    """The first-order change of h(θ + ε) is along h′: no sd, however large its variance."""
    k = np.arange(1, ORDER + 1)
    turned = np.zeros_like(COEFFICIENTS)
    turned[1::2], turned[2::2] = k * COEFFICIENTS[2::2], -k * COEFFICIENTS[1::2]
    theta, touched = directions(), degrees(10, 11, 12, 200)
    plain = np.sqrt(((basis(theta, ORDER) @ turned) ** 2).max())
    assert plain > 1e-4
    assert gauge_free_sd(theta, touched, COEFFICIENTS, np.outer(turned, turned)).max() < 1e-9


def test_without_an_orientation_the_sd_is_the_plain_one():
    circle = np.zeros(2 * ORDER + 1)
    circle[0] = 0.02
    plain = np.sqrt(((basis(directions(), ORDER) @ ROOT) ** 2).sum(axis=1))
    assert gauge_free_sd(directions(), degrees(10, 20), circle, COVARIANCE) == pytest.approx(plain)
    assert gauge_free_sd(directions(), degrees(), COEFFICIENTS, COVARIANCE) == pytest.approx(plain)
    assert len(plain) == DIRECTIONS


def _hollow(depth: float) -> tuple[np.ndarray, slice]:
    """A belief of two other states and an outline whose smallest v is −depth (m)."""
    coefficients = np.zeros(25)
    coefficients[0] = 0.02
    coefficients[3] = (0.02 + depth) / 3.0  # v = a0 + (1 − 2²) a2 cos 2θ
    return np.concatenate([[1.0, 2.0], coefficients]), slice(2, None)


def _least_curvature(x: np.ndarray, at: slice) -> float:
    order = (len(x[at]) - 1) // 2
    rows = shape.basis(np.linspace(0.0, 2 * np.pi, 1440), order) * (1.0 - shape.harmonic_of_coefficient(order) ** 2)
    return float((rows @ x[at]).min())


def test_a_concave_outline_is_made_convex_within_its_uncertainty() -> None:
    x, at = _hollow(1e-3)
    P = np.diag(np.concatenate([[1.0, 1.0], np.full(25, 3e-4) ** 2]))
    before = np.diagonal(P).copy()
    assert _least_curvature(x, at) < -0.9e-3
    assert outline.made_convex(x, P, at)
    assert _least_curvature(x, at) > -2e-5  # between the constrained directions
    assert x[0] == 1.0
    assert np.all(np.diagonal(P) <= before)
    assert np.linalg.eigvalsh(P).min() > -1e-18


def test_a_convex_outline_is_unchanged() -> None:
    x, at = _hollow(-5e-3)
    P = np.eye(27) * 1e-8
    assert outline.made_convex(x, P, at)
    np.testing.assert_array_equal(x, _hollow(-5e-3)[0])
    np.testing.assert_array_equal(P, np.eye(27) * 1e-8)


def test_an_exactly_known_concave_outline_cannot_be_made_convex() -> None:
    x, at = _hollow(1e-3)
    assert not outline.made_convex(x, np.zeros((27, 27)), at)
