"""The emulated bodies: closed-form outlines, convexity, mass properties."""

import math

import numpy as np
import pytest

from palmd.rig.shapes import KINDS, Support, area_moments, random_body


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_a_circle_off_the_origin_has_the_moments_of_a_disc():
    r, x, y = 0.02, 0.003, -0.002
    area, cx, cy, rho = area_moments(Support.from_coefficients((complex(r), 0j)).moved(x, y))
    assert area == pytest.approx(math.pi * r**2)
    assert (cx, cy) == pytest.approx((x, y))
    assert rho == pytest.approx(math.sqrt(r**2 / 2 + x**2 + y**2))


def test_ellipses_have_their_textbook_moments():
    for seed in range(40):
        body = random_body("odd", rng(seed))
        if body.shape != "ellipse":
            continue
        a, b = body.support.at(0.0)[0], body.support.at(math.pi / 2)[0]
        assert area_moments(body.support)[0] == pytest.approx(math.pi * a * b, rel=1e-9)
        assert body.rho == pytest.approx(math.hypot(a, b) / 2, rel=1e-9)
        return
    pytest.fail("no ellipse among forty odd bodies")


@pytest.mark.parametrize("kind", KINDS)
def test_the_table_agrees_with_the_series(kind):
    support = random_body(kind, rng(3)).support
    theta = rng(4).uniform(-20.0, 20.0, 200)
    for order, tolerance in enumerate((1e-12, 1e-9, 1e-6)):
        exact = support.sample(theta, order)
        read = [support.at(angle)[order] for angle in theta]
        np.testing.assert_allclose(read, exact, rtol=0.0, atol=tolerance)


def test_rotated_and_shifted_outlines():
    support = random_body("rig", rng(5)).support
    theta = np.linspace(0.0, 6.0, 50)
    np.testing.assert_allclose(support.turned(0.7).sample(theta), support.sample(theta - 0.7), atol=1e-15)
    moved = support.moved(1e-3, -2e-3).sample(theta)
    np.testing.assert_allclose(moved, support.sample(theta) + 1e-3 * np.cos(theta) - 2e-3 * np.sin(theta), atol=1e-15)


@pytest.mark.parametrize("kind", KINDS)
def test_random_bodies_are_convex_and_resemble_the_real_ones(kind):
    for seed in range(15):
        body = random_body(kind, rng(seed))
        mean = body.support.coefficients[0].real
        _, cx, cy, rho = area_moments(body.support)
        offset = math.hypot(cx, cy)
        assert body.support.min_curvature_radius > (2.4e-3 if kind == "odd" else 6.4e-3)
        assert 15.5e-3 < mean < 24.5e-3
        assert 0.06 <= body.mass <= 0.25
        assert body.rho == pytest.approx(rho, rel=0.05)
        assert 0.67 < body.rho / mean < 0.76
        assert offset <= 2.0e-3 + 1e-9
        assert (offset < 1e-9) == (body.shape != "off-centre mass")


def test_the_same_seed_gives_the_same_body():
    assert random_body("odd", rng(8)) == random_body("odd", rng(8))
    assert random_body("odd", rng(8)) != random_body("odd", rng(9))


def test_random_bodies_include_all_special_cases():
    shapes = {random_body("odd", rng(seed)).shape for seed in range(30)}
    assert shapes == {"ellipse", "strongly curved", "off-centre mass"}
