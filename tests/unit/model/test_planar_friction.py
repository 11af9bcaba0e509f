"""Mean and covariance of the friction direction on a palm that vibrates in its plane, against averages over time."""

import math

import casadi as ca
import numpy as np
import pytest
from scipy.special import ellipk

from palmd.model.planar_friction import KINK, direction_moments

MANY = 20000
COSINES = np.cos((np.arange(MANY) + 0.5) * math.pi / MANY)
RNG = np.random.default_rng(0)
SLIPS = [*zip(RNG.normal(0.0, 1.0, 12), RNG.normal(0.0, 0.5, 12), strict=True), (0.0, 0.0), (1.0, 0.0), (30.0, -4.0)]


@pytest.mark.parametrize(("along", "across"), SLIPS)
def test_moments_equal_averages_over_the_vibration(along, across):
    there = along + COSINES
    size = np.sqrt(there**2 + across**2 + KINK**2)
    first, second = there / size, np.full(MANY, across) / size
    sigma, spread = direction_moments(np.float64(along), np.float64(across), np)
    assert sigma == pytest.approx((first.mean(), second.mean()), abs=1e-6)
    wanted = first.var(), np.mean(first * second) - first.mean() * second.mean(), second.var()
    assert spread == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("along", [-0.7, -0.3, 0.2, 0.6])
def test_slip_along_the_vibration_gives_the_mean_sign(along):
    assert direction_moments(along, 0.0, np)[0][0] == pytest.approx(2 / math.pi * math.asin(along), abs=1e-3)


@pytest.mark.parametrize("across", [0.2, 0.5, 1.0, 3.0])
def test_slip_across_the_vibration_gives_the_elliptic_integral(across):
    w2 = across**2 + 1.0
    wanted = 2 / math.pi * across / math.sqrt(w2) * ellipk(1.0 / w2)
    assert direction_moments(0.0, across, np)[0][1] == pytest.approx(wanted, abs=2e-3)


def test_friction_across_the_vibration_stays_high_at_slow_slip():
    across = 0.1
    wanted = 2 / math.pi * across * math.log(4.0 / across)
    assert direction_moments(0.0, across, np)[0][1] == pytest.approx(wanted, rel=0.02)


def test_symbols_and_arrays_give_the_same_moments():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    sigma, spread = direction_moments(x, y)
    function = ca.Function("moments", [x, y], [ca.vertcat(*sigma, *spread)])
    for along, across in SLIPS:
        (one, two), rest = direction_moments(along, across, np)
        np.testing.assert_allclose(np.array(function(along, across))[:, 0], [one, two, *rest], atol=1e-12)
