"""The generated C of the shape map's filter against its NumPy version: prediction and fusion of a reading."""

import math

import numpy as np
import plain_shape_map
import pytest

from palmd.model import shape, shape_map
from palmd.model.compiled import load
from palmd.model.kernels import single
from palmd.system.mechanism import PALMS as NUMBERS

SAME_FORMULA = 1e-9
"""Relative: the generated C and NumPy evaluate the same expressions in different order."""
PALMS = np.array([0.7, 1.5, 0.4, -0.3, 1.0, -2.0])
JERK = [3.0, -4.0]
VIBRATION = [0.3, 0.8, 0.0, 2e-3, 0.1, -0.05, 0.1, 0.02]
IN_PHASE = [-1.0, 1.0, 0.0, 2e-3, *[0.0] * 4]
AVERAGED = [0.0, 1.0, 1.0, 0.0, *[0.0] * 4]
"""κ, λ, whether the averaged law holds, half a period (s); errors of κ, λ, that flag and friction's arm."""
RIG = [9.81, 0.12, 0.12, 0.0, 0.0, 0.0, 0.0, *VIBRATION]


@pytest.fixture(scope="module")
def kernels():
    updates = [shape_map.update_function(name, pad) for name, pad in zip(shape_map.UPDATES, NUMBERS, strict=True)]
    return load("shape_map_single", lambda: map(single, (shape_map.predict_function(), *updates)))


def a_state(random, mu):
    Z = shape_map.Z
    x = np.zeros(shape_map.N)
    x[Z.PSI], x[Z.OMEGA0], x[Z.LN_RHO] = random.uniform(-3, 3), random.uniform(-2, 2), math.log(0.014)
    x[Z.MU], x[Z.LN_DITHER], x[Z.DAMPING] = mu, math.log(0.008), 3e-4
    x[Z.SHAPE :] = 0.5 * shape.prior_sd(0.02) * random.standard_normal(shape.COEFFICIENTS)
    x[Z.SHAPE] = 0.02
    return x


@pytest.mark.parametrize(("mu", "law"), [(0.0, VIBRATION), (0.3, VIBRATION), (0.3, IN_PHASE), (0.3, AVERAGED)])
@pytest.mark.parametrize("seed", range(4))
def test_c_and_numpy_predict_the_same_state(kernels, seed, mu, law):
    random = np.random.default_rng(seed)
    n = shape_map.N
    x = a_state(random, mu)
    root = random.standard_normal((n, n)) * 1e-3
    P, u = root @ root.T, np.array([0.006, *PALMS, *JERK, *RIG[: -len(law)], *law])
    x_c, P_c = np.zeros(n), np.zeros((n, n))
    kernels.bind("predict", [x, P, u], [x_c, P_c])()
    x_np, F = plain_shape_map.transition(x, u)
    Q = np.zeros(n)
    Q[:2] = np.array([shape_map.Q_PSI, shape_map.Q_OMEGA0]) * u[0]
    Q[1] += plain_shape_map.left_open(x, u)
    P_np = F @ P @ F.T + np.diag(Q)
    assert abs(x_np[1] - x[1]) > 1e-3, "the spin must change for a meaningful comparison"
    assert x_c == pytest.approx(x_np, rel=SAME_FORMULA, abs=SAME_FORMULA * abs(x_np).max())
    assert np.abs(P_c - P_np).max() < SAME_FORMULA * np.abs(P_np).max()


@pytest.mark.parametrize("pad", [1, 2])
def test_c_and_numpy_agree_on_fusion_of_a_reading(kernels, pad):
    """A reading equal to its prediction has zero innovation; another one moves the state along P hᵀ."""
    x, n = a_state(np.random.default_rng(5), 0.1), shape_map.N
    s, row = plain_shape_map.reading_row(x, *PALMS[:2], pad)
    x_c, P_c, score = np.zeros(n), np.zeros((n, n)), np.zeros(2)
    for off in (0.0, 1e-3):
        z = np.array([s + off, 1e-8, math.inf, 1.0, *PALMS[:2]])
        kernels.bind(f"update_s{pad}", [x, np.eye(n), z], [x_c, P_c, score])()
        assert x_c - x == pytest.approx(row * off / (row @ row + 1e-8), rel=SAME_FORMULA, abs=1e-14)
    keep = np.eye(n) - np.outer(row, row) / (row @ row + 1e-8)
    assert np.abs(P_c - keep).max() < 1e-6
