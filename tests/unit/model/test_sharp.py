"""Outline with flat sides: contacts in the kernels against the polygon that the outline represents."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from palmd.model import sharp
from palmd.model.smoothing import C

THETA = np.linspace(-3.0, 6.0, 721)
STEP = 1e-5


def _constants(width: float = 0.002) -> np.ndarray:
    """A triangle with three sides of 20 mm, rounded by 4 mm, about its centre."""
    p = np.zeros(sharp.CONSTANTS)
    p[C.SHAPE] = 4e-3 + 3 * 20e-3 / math.tau
    for j in range(3):
        p[sharp.NORMALS + j], p[sharp.LENGTHS + j] = 0.4 + j * math.tau / 3, 20e-3
    p[sharp.WIDTH] = math.log(width)
    return p


def _contacts(theta: np.ndarray, p: np.ndarray) -> np.ndarray:
    normal, shape = ca.SX.sym("theta"), ca.SX.sym("shape", len(p) - C.SHAPE)
    at = sharp.outline_at(normal, shape)
    kernel = ca.Function("at", [normal, shape], [at.r, at.d, at.v])
    return np.array([[float(each) for each in kernel(angle, p[C.SHAPE :])] for angle in theta])


def test_r_d_and_v_belong_to_the_same_outline() -> None:
    p = _constants()
    here, low, high = (_contacts(THETA + by, p) for by in (0.0, -STEP, STEP))
    assert here[:, 1] == pytest.approx(-(high[:, 0] - low[:, 0]) / (2 * STEP), abs=2e-6)
    bend = -(high[:, 1] - low[:, 1]) / (2 * STEP)
    assert here[:, 2] == pytest.approx(here[:, 0] + bend, abs=1e-3 * here[:, 2].max())
    assert here[:, 0] == pytest.approx(sharp.support(THETA, p), abs=1e-12)


def test_three_sides_with_a_radius_are_a_rounded_triangle() -> None:
    radius = 20e-3 / math.sqrt(3.0)  # distance of the corners, half-way between the sides' normals
    corners = 0.4 + math.pi / 3 + np.arange(3) * math.tau / 3
    reach = radius * np.cos(THETA[:, None] - corners).max(axis=1) + 4e-3
    assert sharp.support(THETA, _constants(1e-4)) == pytest.approx(reach, abs=5e-6)


def test_between_two_sides_the_contact_is_at_the_corner() -> None:
    v = _contacts(np.array([0.4 + math.pi / 3]), _constants())[0, 2]
    assert v == pytest.approx(4e-3, abs=1e-5)


def test_rows_are_the_derivatives_of_the_support_function() -> None:
    p = _constants(0.05)
    rows = sharp.outline_rows(THETA, p)
    for i in range(C.SHAPE, sharp.CONSTANTS):
        up, down = p.copy(), p.copy()
        up[i], down[i] = p[i] + 1e-6, p[i] - 1e-6
        slope = (sharp.support(THETA, up) - sharp.support(THETA, down)) / 2e-6
        assert rows[:, i - C.SHAPE] == pytest.approx(slope, abs=1e-6), i
