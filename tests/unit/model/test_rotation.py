"""Rotations and rotation vectors, against SciPy and against finite differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmd.model import rotation

VECTORS = np.concatenate(
    [
        np.zeros((1, 3)),
        np.random.default_rng(1).normal(0.0, 1.0, (40, 3)),
        [[1e-9, 0.0, 0.0], [0.0, 3.1, 0.0], [1.8, -1.8, 1.8]],  # almost none, and almost half a turn
    ]
)


def test_exp_and_log_agree_with_scipy():
    assert np.allclose(rotation.exp(VECTORS), Rotation.from_rotvec(VECTORS).as_matrix(), atol=1e-14)
    near = VECTORS[np.linalg.norm(VECTORS, axis=1) < np.pi - 1e-3]
    assert len(near) > 35
    assert np.allclose(rotation.log(rotation.exp(near)), near, atol=1e-11)
    assert np.allclose(rotation.skew(VECTORS[3]) @ VECTORS[4], np.cross(VECTORS[3], VECTORS[4]))


def test_the_left_inverse_jacobian_is_accurate_to_third_order():
    """Halving v reduces the error to a sixteenth."""
    v = np.array([0.3, -0.2, 0.4])

    def error_at(v):
        step = 1e-6
        columns = [
            rotation.log(rotation.exp(d) @ rotation.exp(v)) - rotation.log(rotation.exp(-d) @ rotation.exp(v))
            for d in step * np.eye(3)
        ]
        return np.abs(np.array(columns).T / (2 * step) - rotation.left_inverse(v)).max()

    whole, half = error_at(v), error_at(v / 2)
    assert whole < 1e-3
    assert half / whole == pytest.approx(1 / 16, rel=0.1)


def test_quaternions_are_continuous_and_represent_the_same_rotations():
    turns = np.linspace(0.0, 4 * np.pi, 50)[:, None] * np.array([0.0, 0.6, 0.8])
    R = rotation.exp(turns)
    q = rotation.quaternions(R)
    assert np.abs(np.diff(q, axis=0)).max() < 0.2
    assert np.allclose(Rotation.from_quat(q).as_matrix(), R)
