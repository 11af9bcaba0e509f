"""A surface is scored after the best rotation, which never scores worse than no rotation."""

from types import SimpleNamespace

import numpy as np
import pytest

from palmd.model import rotation
from palmd.model.icosphere import icosphere
from palmd.model.spherical import Y00, count, evaluator
from tools.studies.space import errors

ORDER = 8


def body(random):
    """Coefficients of an outline near a ball of 20 mm."""
    c = random.normal(0.0, 1e-4, count(ORDER))
    c[0] = 0.02 / Y00
    return c


def scored(c, estimate, turn, degrees):
    """Errors of `estimate` for the rotated body c, touched within so many degrees of one direction."""
    directions, _ = icosphere()
    touched = directions[directions[:, 2] > np.cos(np.radians(degrees))]
    true = evaluator(ORDER)(directions @ turn.T)[0] @ c
    truth = {
        "t": [0.0, 1.0], "rotation": [turn, turn], "directions": directions, "h_m": true,
        "normals_body": np.stack([touched, touched])[:, :, None].repeat(3, axis=2),
    }  # fmt: skip
    answer = SimpleNamespace(
        coefficients=estimate, h_sd=np.full(len(directions), 1e-5), directions=directions, t=[0.0, 1.0]
    )
    return errors(answer, truth)


def test_a_rotated_frame_is_no_error():
    random = np.random.default_rng(1)
    c, turn = body(random), rotation.exp(np.array([0.3, -0.2, 0.1]))
    error, ratio = scored(c, c, turn, 40.0)
    assert error < 1e-9
    assert ratio < 1e-6


@pytest.mark.parametrize("seed", range(12))
def test_with_little_coverage_the_best_rotation_is_no_worse_than_none(seed):
    """Undamped steps would diverge to 0.2 rad, since a common height error looks like a rotation."""
    random = np.random.default_rng(seed)
    c = body(random)
    estimate = c.copy()
    estimate[1:9] += random.normal(0.0, 3e-4, 8)
    directions, _ = icosphere()
    near = directions[:, 2] >= np.cos(np.radians(8.0 + 4.0))
    unturned = np.sqrt(np.mean((evaluator(ORDER)(directions[near])[0] @ (estimate - c)) ** 2))
    error, _ = scored(c, estimate, np.eye(3), 8.0)
    assert error <= unturned + 1e-6
