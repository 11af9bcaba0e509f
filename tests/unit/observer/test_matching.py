"""Whether two records are of the same object: joined only if they overlap and agree."""

import math

import numpy as np
import pytest

from palmd.model import shape
from palmd.model.smoothing import CONSTANTS, ORDER, RIG_CONSTANTS, C
from palmd.observer.coverage import NORMAL_BINS
from palmd.observer.factor import Factor
from palmd.observer.matching import ObjectInformation, _weight, _weights, matched, with_turn_marginalised

RANDOM = np.random.default_rng(3)
RADIUS = 0.02
SD = 5e-6
NOWHERE = np.zeros(NORMAL_BINS, dtype=np.bool_)


def a_prior():
    sd = np.concatenate([[0.12, 0.1, 0.35, 3e-4, 1.5], np.full(RIG_CONSTANTS, 1e-4), shape.prior_sd(RADIUS, ORDER)])
    sd[C.SHAPE] = 0.1 * RADIUS
    mean = np.zeros(CONSTANTS)
    mean[C.SHAPE] = RADIUS
    return Factor(mean, 0.0, np.diag(sd**-2.0), np.zeros(CONSTANTS), sd)


def an_object():
    prior = a_prior()
    return prior.about + 0.7 * prior.scale * RANDOM.standard_normal(CONSTANTS)


def known_object(p, middle, width, sd=SD):
    """Information from readings of h with this `sd` at normals within `width` (rad) of `middle`, and of ρ, μ, m."""
    theta = middle + np.linspace(-width, width, 60)
    rows = np.zeros((60, CONSTANTS))
    rows[:, C.SHAPE :] = shape.basis(theta, ORDER) / sd
    rows = np.vstack([rows, np.diag([20.0, 100.0, 10.0, 1e3, 300.0] + [0.0] * (CONSTANTS - 5))[:5]])
    values = rows @ p + RANDOM.standard_normal(len(rows))
    matrix = rows.T @ rows
    about = p + 1e-6 * RANDOM.standard_normal(CONSTANTS)
    miss = values - rows @ about
    marks = NOWHERE.copy()
    marks[np.floor(theta / (2 * np.pi) * NORMAL_BINS).astype(int) % NORMAL_BINS] = True
    return ObjectInformation(Factor(about, float(miss @ miss), matrix, rows.T @ miss, np.ones(CONSTANTS)), marks)


def turned(p, by):
    other = p.copy()
    other[C.SHAPE :] = shape.turned(by, ORDER) @ p[C.SHAPE :]
    return other


@pytest.mark.parametrize("by", [0.0, 0.7, 3.0, -2.0])
def test_overlapping_records_of_one_object_are_joined_at_the_right_rotation(by):
    p = an_object()
    known, now = known_object(p, 1.0, 1.5), known_object(turned(p, by), 1.5 - by, 1.2)
    found = matched(known, now, a_prior())
    assert found is not None
    assert math.remainder(found.turn - by, math.tau) == pytest.approx(0.0, abs=1e-3)
    joined = found.aligned.information.plus(now.information).plus(a_prior())
    best = joined.about + joined.solved(joined.side)
    theta = 1.0 - by + np.linspace(-1.5, 1.5, 50)
    assert shape.basis(theta, ORDER) @ (best - turned(p, by))[C.SHAPE :] == pytest.approx(0.0, abs=6 * SD)
    assert found.aligned.touched.sum() == known.touched.sum()
    assert found.aligned.touched[int((1.0 - by) % math.tau / math.tau * NORMAL_BINS)]


def test_the_earlier_record_gives_no_information_about_the_rotation():
    """The gauge is free: the joined record's orientation is determined by the overlap alone."""
    known = known_object(an_object(), 1.0, 3.0)
    free, turn_information = with_turn_marginalised(known.information)
    along, h = np.zeros(CONSTANTS), 1e-6
    along[C.SHAPE :] = (shape.turned(h, ORDER) - shape.turned(-h, ORDER)) @ known.information.about[C.SHAPE :] / (2 * h)
    assert turn_information > 1.0
    assert along @ free.matrix @ along < 1.1 * (math.tau / 240) ** -2


def test_records_without_overlap_are_not_joined():
    p = an_object()
    assert matched(known_object(p, 0.0, 0.4), known_object(turned(p, 0.3), 2.5, 0.4), a_prior()) is None


def test_another_object_is_not_joined():
    for _ in range(5):
        assert matched(known_object(an_object(), 1.0, 2.0), known_object(an_object(), 1.2, 2.0), a_prior()) is None


def test_records_of_a_circle_are_not_joined():
    p = a_prior().about.copy()
    assert matched(known_object(p, 1.0, 3.0), known_object(p, 1.5, 3.0), a_prior()) is None


def test_weights_of_all_rotations_equal_single_evaluations():
    p = an_object()
    known, rest = known_object(p, 1.0, 1.5), known_object(p, 1.5, 1.2).information.plus(a_prior())
    weights = _weights(known.information, rest)
    for number in (0, 17, 120):
        free, turn_information = with_turn_marginalised(known.turned(number * math.tau / 240).information)
        wanted = _weight(free.plus(rest)) - 0.5 * math.log1p(turn_information) - math.log(240)
        assert weights[number] == pytest.approx(wanted, rel=1e-9)


def test_weights_are_gaussian_integrals():
    """Against numerical integration in two dimensions."""
    root = np.array([[3.0, 1.0], [0.5, 2.0]])
    factor = Factor(np.array([0.1, -0.2]), 1.3, root @ root.T, np.array([0.4, -0.3]), np.ones(2))
    grid = np.linspace(-4.0, 4.0, 801)
    a, b = np.meshgrid(grid, grid, indexing="ij")
    y = np.stack([a.ravel(), b.ravel()], axis=1)
    by = y - factor.about
    cost = factor.cost - 2 * by @ factor.side + ((by @ factor.matrix) * by).sum(axis=1)
    integral = np.exp(-cost / 2).sum() * (grid[1] - grid[0]) ** 2
    assert _weight(factor) + math.log(2 * math.pi) == pytest.approx(math.log(integral), rel=1e-6)
