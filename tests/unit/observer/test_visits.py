"""How often each direction was touched, and what the two pruning rules keep."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from simulated import simulated

from palmd.observer.outline import directions, normal_angles, touched_by
from palmd.observer.reconstruct import reconstruct
from palmd.observer.visits import HYSTERESIS_RAD, kept_by_band, kept_by_visits, visits_of
from tools import pruning_figure
from tools.studies.scoring import outline_errors


def path(*degrees, steps=200):
    """One palm's normals on straight paths through `degrees`."""
    legs = [np.linspace(a, b, steps) for a, b in itertools.pairwise(degrees)]
    return np.radians(np.concatenate(legs))[:, None]


def test_a_sweep_is_one_visit():
    visits = visits_of(path(10, 50))
    assert np.flatnonzero(visits).tolist() == list(range(10, 51))
    assert visits.max() == 1


def test_a_return_sweep_is_two_visits_except_at_its_end():
    visits = visits_of(path(10, 50, 10))
    assert (visits[10:48] == 2).all()
    assert (visits[49:51] == 1).all()
    assert visits.sum() == 38 * 2 + visits[48] + 2


def test_jitter_adds_no_visits():
    random = np.random.default_rng(0)
    sweep = path(10, 50, steps=4000)
    visits = visits_of(sweep + np.radians(random.uniform(-0.7, 0.7, sweep.shape)))
    assert (visits[10:51] == 1).all()
    assert visits.max() == 1
    assert visits_of(np.radians(random.uniform(-0.7, 0.7, (4000, 1)))).max() == 1


def test_visited_normals_are_the_touched_ones():
    random = np.random.default_rng(0)
    normals = np.cumsum(np.cumsum(random.normal(0.0, 2e-3, (800, 2)), axis=0), axis=0)
    np.testing.assert_array_equal(visits_of(normals) > 0, touched_by(normals))


def test_each_rule_keeps_its_normals():
    visits = np.array([0, 1, 2, 3])
    h_sd = np.array([1e-5, 1e-5, 2e-4, 2e-5])
    assert kept_by_visits(visits).tolist() == [False, False, True, True]
    assert kept_by_band(h_sd, visits > 0).tolist() == [False, True, False, True]


def test_a_reconstruction_has_its_visits():
    run = simulated("nominal", 1, 3.0)
    answer = reconstruct(run.events, run.rig)
    np.testing.assert_array_equal(answer.visits > 0, answer.touched)
    psi = np.interp(answer.t, run.truth.t, run.truth.psi)
    palms = np.stack([np.interp(answer.t, run.truth.t, column) for column in run.palms.T], axis=1)
    truth = visits_of(normal_angles(palms, psi + np.mean(answer.psi - psi)))
    nearby = np.stack([np.roll(truth, shift) for shift in range(-2, 3)])  # up to its gauge, ψ is known to a degree
    assert ((nearby.min(axis=0) <= answer.visits) & (answer.visits <= nearby.max(axis=0))).all()
    assert len(answer.visits) == len(directions())
    assert answer.visits.max() > 1


def test_both_rules_are_drawn_and_the_same_run_gives_the_same_file(tmp_path):
    run = simulated("nominal", 1, 3.0)
    answer = reconstruct(run.events, run.rig)
    errors = outline_errors(answer, run.truth)
    for name in ("one.svg", "other.svg"):
        pruning_figure.save(answer, errors, run.truth.h, tmp_path / name)
    drawn = (tmp_path / "one.svg").read_bytes()
    assert (tmp_path / "other.svg").read_bytes() == drawn
    assert len(drawn) < 400_000
    with pytest.raises(ValueError, match="no outline"):
        pruning_figure.save(replace(answer, h_sd=None), errors, run.truth.h, tmp_path / "none.svg")


def counted_node_by_node(theta, centre, half_width):
    """How often a curve comes within `half_width` of a direction, node by node."""
    away = theta - centre
    away = away - math.tau * np.round(away / math.tau)
    there = np.abs(away) <= half_width
    across = (away[:-1] * away[1:] < 0.0) & (np.abs(away[:-1] - away[1:]) < math.pi)
    there[:-1] |= across
    count, arrived = 0, False
    for is_there, is_near in zip(there, there | (np.abs(away) <= HYSTERESIS_RAD), strict=True):
        count += is_there and not arrived
        arrived = is_near and (arrived or is_there)
    return count


@pytest.mark.parametrize(("nodes", "stride", "among"), [(800, 0.01, 36), (300, 0.2, 72), (60, 1.5, 12), (1, 1.0, 12)])
def test_counts_equal_those_of_each_direction_alone(nodes, stride, among):
    normals = np.cumsum(stride * np.random.default_rng(nodes).standard_normal((nodes, 2)), axis=0)
    centres = np.arange(among) * (math.tau / among)
    wanted = [sum(counted_node_by_node(theta, at, math.pi / among) for theta in normals.T) for at in centres]
    assert visits_of(normals, among).tolist() == wanted
