"""The outline's score against shapes whose errors are known analytically."""

import math

import numpy as np
import pytest

from palmd.score import score_outline

THETA = np.arange(360) * (math.tau / 360)
ALL = np.ones(360, dtype=bool)


def outline(theta):
    """Without any symmetry; mean radius 20 mm."""
    return 0.02 + 1e-3 * np.cos(theta - 0.4) + 8e-4 * np.cos(2 * theta) + 3e-4 * np.sin(3 * theta)


@pytest.mark.parametrize("turn", [0.0, 0.3, math.pi, -2.9, 5.0, 1e-3, math.radians(0.25)])
def test_the_same_outline_is_found_in_any_rotation(turn):
    score = score_outline(THETA, outline(THETA + turn), ALL, outline(THETA))
    assert score.e_h < 1e-8
    assert math.remainder(score.rotation - turn, math.tau) == pytest.approx(0.0, abs=1e-5)
    assert score.touched == 1.0


def test_an_error_of_known_size_in_a_harmonic_that_no_rotation_changes():
    score = score_outline(THETA, outline(THETA + 1.0) + 3e-5 * np.cos(6 * THETA), ALL, outline(THETA))
    assert score.e_h == pytest.approx(3e-5 / math.sqrt(2), rel=1e-3)
    assert score.max_error == pytest.approx(3e-5, rel=1e-3)
    assert score.relative == pytest.approx(score.e_h / 0.02)


def test_the_centre_of_mass_is_no_gauge():
    """The same body about another point is a different answer: 1 mm along x gives 1 mm · cos θ of error."""
    shifted = 0.02 + 8e-4 * np.cos(2 * THETA) + 1e-3 * np.cos(THETA)
    score = score_outline(THETA, shifted, ALL, 0.02 + 8e-4 * np.cos(2 * THETA))
    assert score.e_h == pytest.approx(1e-3 / math.sqrt(2), rel=1e-6)


def test_only_touched_normals_count():
    touched = (THETA > 1.0) & (THETA < 2.5)
    h = np.where(touched, outline(THETA), 7.0)
    score = score_outline(THETA, h, touched, outline(THETA))
    assert score.e_h < 1e-8
    assert score.touched == touched.mean()


def test_the_estimates_normals_may_be_any():
    theta = np.sort(np.random.default_rng(1).uniform(0.0, math.tau, 187))
    score = score_outline(theta, outline(theta + 2.0), np.ones(187, dtype=bool), outline(THETA))
    assert score.e_h < 1e-8


def test_the_rotation_is_the_global_optimum():
    """Against brute force, on an estimate that is wrong everywhere and touched in part."""
    random = np.random.default_rng(2)
    touched = random.random(360) < 0.3
    h = outline(THETA + 4.0) + 2e-4 * np.sin(4 * THETA) + 1e-4 * random.standard_normal(360)
    score = score_outline(THETA, h, touched, outline(THETA))
    turns = np.arange(0.0, math.tau, 1e-3)
    errors = h[touched] - outline(THETA[touched] + turns[:, None])
    best = np.sqrt((errors**2).mean(axis=1)).min()
    assert score.e_h <= best * (1 + 1e-9)
    assert score.e_h == pytest.approx(best, rel=1e-4)


def test_an_outline_with_near_sevenfold_symmetry():
    def nearly(theta):
        return 0.02 + 1e-4 * np.cos(7 * theta) + 1e-6 * np.cos(theta)

    turn = math.radians(0.25)  # the worst case for a search on whole and half degrees
    score = score_outline(THETA, nearly(THETA + turn), ALL, nearly(THETA))
    assert score.e_h < 1e-9
    assert score.rotation == pytest.approx(turn, abs=1e-5)


def test_nothing_touched_gives_no_number():
    score = score_outline(THETA, outline(THETA), ~ALL, outline(THETA))
    assert math.isnan(score.e_h)
    assert score.touched == 0.0


def test_lengths_must_agree():
    with pytest.raises(ValueError, match="do not fit"):
        score_outline(THETA, outline(THETA)[:-1], ALL, outline(THETA))
