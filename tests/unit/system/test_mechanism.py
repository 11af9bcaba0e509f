"""From joint angles to palm directions and to the normals that the palms touch."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from palmd.system.mechanism import JOINTS, PALMS, directions, hinge_position, joints_at, normal_directions


def test_names_of_joints_and_numbers_of_palms():
    assert PALMS == (1, 2)
    assert JOINTS == ("phi1", "phi2")


def test_palm_2s_direction_is_the_sum_of_both_joints_and_so_is_its_rate():
    assert directions((0.7, 1.6)) == (0.7, 0.7 + 1.6)
    one, two = directions(np.array([[0.7, 0.8], [1.6, 1.5]]))
    assert one.tolist() == [0.7, 0.8]
    assert two == pytest.approx([2.3, 2.3])


def test_outward_normals_point_into_the_palms():
    """Palm 1 has the object on its left, palm 2 on its right: n1 = t turned by 90°, n2 by −90°, and θ = −n."""
    joints, psi = (0.7, 1.6), 0.3
    for theta, angle, side in zip(normal_directions(joints, psi), directions(joints), (1, -1), strict=True):
        into = (side * math.sin(angle), -side * math.cos(angle))
        assert (math.cos(theta + psi), math.sin(theta + psi)) == pytest.approx(into)


def test_joints_at_inverts_normal_directions():
    assert joints_at(normal_directions((0.7, 1.6), 0.3), 0.3) == pytest.approx((0.7, 1.6))


def test_floats_arrays_and_symbols_give_identical_results():
    rows = np.random.default_rng(0).uniform(0.1, 2.0, (50, 3))
    arrays = np.stack(normal_directions(rows[:, :2].T, rows[:, 2]), axis=1)
    floats = [normal_directions(row[:2].tolist(), float(row[2])) for row in rows]
    x = ca.SX.sym("x", 3)
    symbols = ca.Function("theta", [x], [ca.vertcat(*normal_directions((x[0], x[1]), x[2]))])
    assert arrays.tolist() == [list(each) for each in floats]
    assert [np.array(symbols(row)).ravel().tolist() for row in rows] == arrays.tolist()


def test_the_hinge_moves_on_an_arc_of_palm_1s_length():
    assert hinge_position((0.12, 0.0), 0.12, 0.0) == (0.0, 0.0)
    assert hinge_position((0.12, 0.01), 0.1, math.pi / 2) == pytest.approx((0.12, -0.09))
    assert hinge_position((0.0, 0.0), 0.0, 1.0) == (0.0, 0.0)
