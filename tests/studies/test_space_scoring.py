"""How a surface is scored: after the best rotation, and no worse than without one."""

from types import SimpleNamespace

import numpy as np
import pytest

from palmd.model import rotation
from palmd.model.icosphere import icosphere
from palmd.model.spherical import Y00, count, evaluator
from tools.studies.space import errors

ORDER = 8


def body(random):
    """Coefficients of an outline about a ball of 20 mm."""
    c = random.normal(0.0, 1e-4, count(ORDER))
    c[0] = 0.02 / Y00
    return c


def scored(c, told, turn, degrees):
    """The errors of `told` where the body c, which lies turned, was touched within so many degrees of one place."""
    directions, _ = icosphere()
    felt = directions[directions[:, 2] > np.cos(np.radians(degrees))]
    true = evaluator(ORDER)(directions @ turn.T)[0] @ c
    truth = {
        "t": [0.0, 1.0], "rotation": [turn, turn], "directions": directions, "h_m": true,
        "normals_body": np.stack([felt, felt])[:, :, None].repeat(3, axis=2),
    }  # fmt: skip
    answer = SimpleNamespace(
        coefficients=told, h_sd=np.full(len(directions), 1e-5), directions=directions, t=[0.0, 1.0]
    )
    return errors(answer, truth)


def test_a_turned_frame_is_no_error():
    random = np.random.default_rng(1)
    c, turn = body(random), rotation.exp(np.array([0.3, -0.2, 0.1]))
    error, ratio = scored(c, c, turn, 40.0)
    assert error < 1e-9
    assert ratio < 1e-6


@pytest.mark.parametrize("seed", range(12))
def test_of_little_that_was_touched_the_best_rotation_is_no_worse_than_none(seed):
    """Steps to it that are not damped led 0.2 rad away, where heights are off together by more than turns explain."""
    random = np.random.default_rng(seed)
    c = body(random)
    told = c.copy()
    told[1:9] += random.normal(0.0, 3e-4, 8)
    directions, _ = icosphere()
    near = directions[:, 2] >= np.cos(np.radians(8.0 + 4.0))
    unturned = np.sqrt(np.mean((evaluator(ORDER)(directions[near])[0] @ (told - c)) ** 2))
    error, _ = scored(c, told, np.eye(3), 8.0)
    assert error <= unturned + 1e-6
