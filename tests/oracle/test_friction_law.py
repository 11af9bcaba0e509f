"""The friction law of vibrating palms against values of an independent program (docs/theory/vibration.md)."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from palmd.model import friction
from palmd.model.contact import Contact
from palmd.model.dynamics import BodyConstants, Palms, newton_euler

# φ1 φ2 ω1 ω2 α1 α2 ψ ω0; μ, V (mm/s), c (1e-4 m²/s); α0 f1 f2 of each law, α0 of antiphase
REFERENCE = """
0.75 1.65 0 0 0 0 0.883 0; 0.2 15 0|0.000260272 6.64713 6.70791|-1.16991 6.61298 6.68176|3.85923 6.87928 6.9478|-6.19905
0.6 1.5 0 0 0 0 0.4 0.2; 0.1 15 0|71.1679 8.1935 5.70377|69.0958 8.20415 5.73018|73.0883 8.24836 5.76169|63.6262
0.9 1.9 0.3 -0.2 1 0.5 0.7 0.1; 0.3 20 0|-45.979 4.01424 7.71861|-35.2996 4.10143 7.77431|-50.4351 4.23355 8.00471|-18.9054
0.5 1.9 -0.4 0.3 0.5 -1 2.0 -0.3; 0.15 12 0|88.968 7.17599 4.47659|90.6359 7.13965 4.41212|96.6726 7.31962 4.43177|84.7455
0.9 1.2 0.2 0.1 0 0 1.2 0.5; 0.25 10 0|-8.3811 8.32789 8.22364|-21.5337 8.30709 8.39943|-7.29974 8.85317 8.81421|-39.3582
0.75 1.65 0.5 0.2 0 0 0.9 -0.6; 0.2 10 0|190.553 7.81603 5.16397|230.533 7.99445 4.76398|230.533 7.99445 4.76398|230.533
1.1 1.4 0 0.8 0 -2 4.0 0.3; 0.3 18 0|-33.3738 5.07484 8.13714|-30.4634 5.08947 8.1389|-23.4656 5.55002 8.68276|-33.5212
0.6 2.1 0.1 0.1 0.2 0.3 5.2 -0.15; 0.05 10 2|117.493 5.63396 5.33831|118.197 5.63871 5.3153|118.226 5.64564 5.32021|118.147
"""  # noqa: E501
NO_RIPPLE = 0.0  # s: the reference has vibrations so fast that the body's own slip does not alternate
LAWS = {
    "averaged": (0.0, 1.0, 1.0),
    "independent": (0.0, 1.0, 0.0),
    "in_phase": (-1.0, 1.0, 0.0),
    "antiphase": (1.0, 1.0, 0.0),
}


def _ellipse(theta: float) -> tuple[float, float, float]:
    """r, d, v of an ellipse of half axes 22 and 17 mm, its centre at (0.6, −0.4) mm from the centre of mass."""
    a, b, x, y = 0.022, 0.017, 0.0006, -0.0004
    c, s = math.cos(theta), math.sin(theta)
    q = math.sqrt(a * a * c * c + b * b * s * s)
    return q + x * c + y * s, -((b * b - a * a) * s * c / q - x * s + y * c), a * a * b * b / q**3


def _motion(
    palms: list[float], psi: float, omega0: float, body: list[float], law: tuple[float, float, float]
) -> np.ndarray:
    inputs = ca.SX.sym("x", 11)
    thetas = palms[0] - psi - math.pi / 2, palms[0] + palms[1] - psi - 3 * math.pi / 2
    one, two = (Contact(*map(ca.SX, _ellipse(theta))) for theta in thetas)
    motion = newton_euler(
        Palms(*ca.vertsplit(inputs[:6])), inputs[6], one, two, BodyConstants(*ca.vertsplit(inputs[7:])),
        ca.SX([9.81, 0, 0, 0, 0, 0, 0, *law, NO_RIPPLE, 0, 0, 0, 0]),
    )  # fmt: skip
    found = ca.Function("motion", [inputs], [ca.vertcat(motion.alpha0, motion.f1, motion.f2)])
    return np.asarray(found([*palms, omega0, *body])).ravel()


def _exact(ratio: ca.SX, xp: object = ca) -> ca.SX:
    return 2 / math.pi * ca.asin(ca.fmin(ca.fmax(ratio, -1), 1))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("row", REFERENCE.strip().splitlines())
def test_the_law_gives_the_reference_values_to_six_digits(row: str, law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(friction, "mean_direction", _exact)
    state, *values = row.split("|")
    motion, constants = (list(map(float, part.split())) for part in state.split(";"))
    expected = list(map(float, dict(zip(LAWS, values, strict=True))[law].split()))
    mu, speed, damping = constants[0], constants[1] * 1e-3, constants[2] * 1e-4
    rho = math.sqrt((0.022**2 + 0.017**2) / 4 + 0.52e-6)
    found = _motion(motion[:6], motion[6], motion[7], [rho, mu, math.pi * speed / 2, damping], LAWS[law])
    assert found[: len(expected)] == pytest.approx(expected, rel=1e-5, abs=5e-6)


def test_the_smooth_kink_approximates_the_arcsine_as_documented() -> None:
    x = np.linspace(-4, 4, 2001)
    off = friction.mean_direction(x, np) - 2 / math.pi * np.arcsin(np.clip(x, -1, 1))
    assert np.abs(off).max() == pytest.approx(0.09, abs=0.005)
    assert math.sqrt(np.mean(off[np.abs(x) < 0.8] ** 2)) < 2e-4
    beyond = np.abs(x) > 1.2
    assert np.abs(off[beyond]) == pytest.approx(2 / math.pi * 0.02 / np.sqrt(x[beyond] ** 2 - 1), rel=0.02)


@pytest.mark.parametrize("kappa", [-1.0, -0.4, 0.0, 0.7, 1.0])
def test_sign_shares_sum_to_one_and_keep_each_palms_own_share(kappa: float) -> None:
    sigma = np.random.default_rng(1).uniform(-1, 1, (2, 100))
    shares = np.array(friction.sign_shares(sigma, kappa, xp=np))
    assert shares.sum(axis=0) == pytest.approx(1.0)
    assert shares.min() > -1e-12
    assert shares[0] + shares[1] == pytest.approx((1 + sigma[0]) / 2)
    assert shares[0] + shares[2] == pytest.approx((1 + sigma[1]) / 2)
    at_rest = np.array(friction.sign_shares((0.0, 0.0), kappa, xp=np))
    assert at_rest @ [1, -1, -1, 1] == pytest.approx(kappa)
