"""Kinematics of the three-palm mechanism, forward and inverse."""

import numpy as np
import pytest

from palmd.system.three_palms import contact_points, palms_at, readings_of


@pytest.fixture
def random():
    return np.random.default_rng(1)


def angles_of(normal):
    """(T, 3) joint angles β, γ2, γ3 (rad) whose palms have these unit normals (T, 3 palms, 3); β in (−π/2, π/2)."""
    n1, n2, n3 = normal[:, 0], normal[:, 1], normal[:, 2]
    beta = np.arctan2(-n1[:, 1], n1[:, 2])
    up = np.stack([np.zeros_like(beta), np.cos(beta), np.sin(beta)], axis=-1)
    along2, along3 = (n2 * up).sum(-1), (n3 * up).sum(-1)
    return np.stack([beta, np.arctan2(along2, n2[:, 0]), np.arctan2(along3, -n3[:, 0])], axis=-1)


def moving(t, a, b, c):
    """Angles, rates and accelerations (T, 3) of a smooth motion."""
    t = t[:, None]
    return a + b * np.sin(c * t), b * c * np.cos(c * t), -b * c**2 * np.sin(c * t)


def test_normals_and_their_rates_follow_from_the_joints(random):
    constants = np.array([0.9, 0.8, 0.7]), random.uniform(0.2, 0.5, 3), random.uniform(1.0, 3.0, 3)
    t, step = np.linspace(0.0, 2.0, 9), 1e-5
    now, ahead, behind = (palms_at(*moving(t + shift, *constants)) for shift in (0.0, step, -step))
    np.testing.assert_allclose(np.linalg.norm(now.normal, axis=-1), 1.0, atol=1e-14)
    np.testing.assert_allclose((ahead.normal - behind.normal) / (2 * step), now.normal_rate, atol=1e-8)
    np.testing.assert_allclose(
        (ahead.normal_rate - behind.normal_rate) / (2 * step), now.normal_acceleration, atol=1e-8
    )
    for name in ("axis_a", "axis_b"):  # each palm turns as a whole
        axis, rate = getattr(now, name), (getattr(ahead, name) - getattr(behind, name)) / (2 * step)
        np.testing.assert_allclose(np.cross(now.spin, axis), rate, atol=1e-8)
        np.testing.assert_allclose((axis * now.normal).sum(-1), 0.0, atol=1e-14)


def test_joints_are_recovered_from_the_normals(random):
    angle = np.array([0.9, 0.8, 0.8]) + random.uniform(-0.5, 0.5, (20, 3))
    still = np.zeros_like(angle)
    np.testing.assert_allclose(angles_of(palms_at(angle, still, still).normal), angle, atol=1e-12)


def test_a_reading_maps_to_a_point_on_its_palm(random):
    angle = np.array([[0.9, 0.8, 0.7]])
    palms = palms_at(angle, 0 * angle, 0 * angle)
    read = random.uniform(-0.03, 0.03, (1, 3, 2))
    points = contact_points(palms, read[..., 0], read[..., 1])
    np.testing.assert_allclose((points * palms.normal).sum(-1), 0.0, atol=1e-16)
    np.testing.assert_allclose(readings_of(palms, points), read, atol=1e-16)
