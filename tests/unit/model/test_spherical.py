"""Support functions in spherical harmonics: gradients and curvatures against finite differences."""

import casadi as ca
import numpy as np
import pytest

from palmd.model.spherical import (
    Y00,
    SphericalSurface,
    count,
    curvature,
    degrees,
    derivatives,
    evaluator,
    point,
    solid_harmonics,
)

ORDER = 5


@pytest.fixture
def body():
    """Coefficients of a body of about 20 mm."""
    random = np.random.default_rng(3)
    c = random.normal(size=count(ORDER)) * 1e-3 / (1.0 + degrees(ORDER)) ** 2
    c[0] = 0.02 / Y00
    return c


def height(c, x):
    """H(x) = |x| h(x/|x|)."""
    size = np.linalg.norm(x)
    return size * float((evaluator(ORDER)(x[None] / size)[0] @ c)[0])


def numeric_gradient(c, x, step=1e-5):
    return np.array([(height(c, x + step * e) - height(c, x - step * e)) / (2 * step) for e in np.eye(3)])


def test_harmonics_are_orthonormal():
    count_z = 24
    z, weight = np.polynomial.legendre.leggauss(count_z)
    turn = 2 * np.pi * np.arange(2 * count_z) / (2 * count_z)
    zz, tt = np.meshgrid(z, turn, indexing="ij")
    across = np.sqrt(1 - zz**2)
    u = np.stack([across * np.cos(tt), across * np.sin(tt), zz], axis=-1).reshape(-1, 3)
    rows = evaluator(ORDER)(u)[0]
    areas = np.repeat(weight, len(turn)) * 2 * np.pi / len(turn)
    np.testing.assert_allclose(rows.T @ (areas[:, None] * rows), np.eye(count(ORDER)), atol=1e-12)


def test_derivatives_of_solid_harmonics_are_one_degree_lower():
    x = ca.SX.sym("x", 3)
    value = solid_harmonics(x, ORDER)
    at = ca.Function("f", [x], [value, ca.jacobian(value, x)])
    S, slope = (np.asarray(each) for each in at([0.3, -0.5, 0.9]))
    np.testing.assert_allclose(np.stack([D @ S[:, 0] for D in derivatives(ORDER)], axis=1), slope, atol=1e-12)


def test_the_contact_point_of_a_normal_is_the_gradient(body):
    u = np.array([0.48, -0.6, 0.64])
    points = evaluator(ORDER)(u[None])[1][0] @ body
    np.testing.assert_allclose(points, numeric_gradient(body, u), atol=1e-9)


def test_sensitivities_of_contact_and_curvature_match_finite_differences(body):
    u_, s_, c_ = ca.SX.sym("u", 3), ca.SX.sym("s", 3), ca.SX.sym("c", count(ORDER))
    surface = SphericalSurface(u_, c_, ORDER)
    terms = surface.terms()
    f = ca.Function("f", [u_, s_, c_], [*point(surface, terms), *curvature(surface, terms, s_)])
    u, s = np.array([0.48, -0.6, 0.64]), np.array([0.8, 0.64, 0.0])
    turn, step = np.array([0.2, -0.7, 0.4]), 1e-6

    def at(angle, spin=0.0):
        from scipy.spatial.transform import Rotation

        R = Rotation.from_rotvec(angle * turn).as_matrix()
        return [np.asarray(each) for each in f(R @ u, (1 + spin) * R @ s, body)]

    _, x_by_u, _, kappa, by_u, by_s, _ = at(0.0)
    np.testing.assert_allclose(kappa, s @ x_by_u @ s, rtol=1e-9)
    du, ds = np.cross(turn, u), np.cross(turn, s)
    ahead, behind = at(step), at(-step)
    np.testing.assert_allclose((ahead[0] - behind[0])[:, 0] / (2 * step), x_by_u @ du, atol=1e-9)
    np.testing.assert_allclose((ahead[3] - behind[3])[:, 0] / (2 * step), by_u @ du + by_s @ ds, atol=1e-9)
    longer, shorter = at(0.0, step), at(0.0, -step)
    np.testing.assert_allclose((longer[3] - shorter[3])[:, 0] / (2 * step), by_s @ s, atol=1e-9)
