"""The kernels of the pivoting grasp against the emulated rig's constraint forces, and gradients against differences."""

import math

import numpy as np
import pytest

from palmd.model import pivot
from palmd.model.pivot import BATCH, CONSTANTS, INPUTS, MOTION, ORDER, P, U
from palmd.model.shape import coefficients_of
from palmd.observer.pivot.fit import body_prior_residuals
from palmd.rig.pivot import GRAVITY, Grasp
from palmd.rig.shapes import random_body


@pytest.fixture(scope="module")
def grasp():
    body = random_body("friction", np.random.default_rng(5))
    return Grasp(body, (0.004, -0.005), 0.12, 0.012, 3e-5, carriage=0.1, carriage_damping=0.2)


def constants_of(grasp):
    body, p = grasp.body, np.zeros(CONSTANTS)
    b = -np.array(grasp.pivot)
    theta = np.arange(360) * (math.tau / 360)
    p[P.INERTIA] = body.mass * (body.rho**2 + b @ b)
    p[P.MOMENT : P.MOMENT + 2], p[P.MASS] = body.mass * b, body.mass
    p[P.DAMPING] = body.mass * grasp.damping
    p[P.TRANSMISSION] = 1.0
    p[P.DRAG], p[P.SATURATION] = grasp.mu / grasp.dither, 1 / grasp.dither**2
    h = body.support.sample(theta) + b[0] * np.cos(theta) + b[1] * np.sin(theta)
    p[P.SHAPE :] = coefficients_of(h, ORDER)
    return p


def called(name, motion, p, u):
    """The value of one kernel and its gradient."""
    motions, inputs = np.zeros((BATCH, MOTION)), np.zeros((BATCH, INPUTS))
    motions[0], inputs[0] = motion, u
    value, gradient = np.zeros(BATCH), np.zeros((BATCH, MOTION + CONSTANTS))
    pivot.library().bind(f"{name}_batch", [motions, p, inputs], [value, gradient])()
    return value[0], gradient[0]


def inputs_of(grasp, x, z=(0.0, 0.0, 0.0)):
    u = np.zeros(INPUTS)
    u[[U.X, U.VX, U.AX]], u[[U.Z, U.VZ, U.AZ]] = x, z
    u[U.GRAVITY], u[U.CARRIAGE], u[U.CARRIAGE_DAMPING] = GRAVITY, grasp.carriage, grasp.carriage_damping
    return u


STILL, FAST = 0.0, 8.0
"""Slips relative to V at which the rounded kink of the model's law has no or little effect; the emulated rig has none.
"""


def along(grasp, psi, omega, ratio):
    """Motion of the arm along the pad that makes the body slip at this ratio of V."""
    return 0.02, ratio * grasp.vibration - omega * grasp.height(psi), 0.4


@pytest.mark.parametrize(("ratio", "within"), [(STILL, 1e-5), (0.5, 1e-4), (FAST, 1e-3)])
@pytest.mark.parametrize("psi", [-2.5, -0.7, 0.4])
def test_normal_force_of_a_rigid_gripper_agrees_with_the_constraints(grasp, psi, ratio, within):
    """E[f] = N (e + σμz)/(e² − μ²z²): at rest more than without friction, and more than by the averaged law."""
    p, e = constants_of(grasp), grasp.offset(psi)
    omega = 0.7 * math.copysign(1.0, e)
    az = -0.3 * e
    x, vz = along(grasp, psi, omega, ratio), -omega * e
    h2 = grasp.body.support.at(-0.5 * math.pi - psi)[2] - grasp.arm(psi)[1]
    alpha = (h2 * omega**2 - az) / e
    z = (grasp.height(psi), vz, az)
    u = inputs_of(grasp, x, z)
    assert called("height", (psi, omega, alpha), p, u)[0] == pytest.approx(z[0], abs=1e-9)
    assert called("reading", (psi, omega, alpha), p, u)[0] == pytest.approx(x[0] + e, abs=1e-8)
    signs = [grasp.torque_residual(psi, omega, alpha, x, z, sign * grasp.mu)[1] for sign in (1.0, -1.0)]
    forward = 0.5 + math.asin(min(ratio, 1.0)) / math.pi
    wanted = forward * signs[0] + (1.0 - forward) * signs[1]
    assert called("rigid_force", (psi, omega, alpha), p, u)[0] == pytest.approx(wanted, rel=within)
    if min(signs) > 0.0:
        assert grasp.rigid_contact_force(psi, omega, alpha, x, z) == pytest.approx(wanted, rel=1e-12)


def test_a_body_jams_where_the_pivot_is_inside_the_friction_cone(grasp):
    """|e| = μz for both slip directions, because on a vibrating pad friction acts both ways."""
    angles = np.linspace(-math.pi, math.pi, 720)
    for psi in angles:
        e, z = grasp.offset(psi), (grasp.height(psi), 0.0, 0.0)
        if abs(e) < 1.3 * grasp.mu * z[0]:
            wedged = abs(e) < grasp.mu * z[0]
            assert not (wedged and grasp.rigid_contact_force(psi, 0.0, 0.0, (0.02, 0.0, 0.0), z) > 0.0)


@pytest.mark.parametrize(("ratio", "within"), [(STILL, 1e-8), (0.5, 1e-6), (FAST, 1e-5)])
@pytest.mark.parametrize(("psi", "omega"), [(-2.5, 0.4), (-0.7, -1.2), (0.4, 2.0), (1.9, 0.0)])
def test_acceleration_on_a_carriage_agrees_with_the_constraints(grasp, psi, omega, ratio, within):
    p, x = constants_of(grasp), along(grasp, psi, omega, ratio)
    alpha, force = grasp.motion(psi, omega, x)
    u = inputs_of(grasp, x)
    assert called("slide_force", (psi, omega, alpha), p, u)[0] == pytest.approx(force, rel=1e-6)
    assert called("slide_torque", (psi, omega, alpha), p, u)[0] == pytest.approx(0.0, abs=within)
    assert abs(called("slide_torque", (psi, omega, alpha + 1.0), p, u)[0]) > 1e-6


@pytest.mark.parametrize("name", ["reading", "height", "rigid_force", "slide_force", "slide_torque"])
def test_gradients_agree_with_differences(grasp, name):
    p, motion = constants_of(grasp), np.array([0.4, 0.7, -0.5])
    p[P.ZERO : P.TRANSMISSION] = 1e-3, 2e-3, 3e-3, 1e-4, 1e-3
    u = inputs_of(grasp, (0.02, 0.03, 0.4), (0.02, 0.003, -0.02))
    at = np.concatenate([motion, p])
    gradient = called(name, motion, p, u)[1]
    scale = np.abs(gradient @ np.abs(at)) + 1.0
    for i in range(len(at)):
        step = np.zeros(len(at))
        step[i] = 1e-6 * max(abs(at[i]), 1e-4)
        ahead, behind = (called(name, (at + s)[:MOTION], (at + s)[MOTION:], u)[0] for s in (step, -step))
        slope = (ahead - behind) / (2 * step[i])
        assert slope == pytest.approx(gradient[i], rel=1e-4, abs=1e-6 * scale), i


def test_the_priors_gradient_agrees_with_differences(grasp):
    p = constants_of(grasp)
    off, J = body_prior_residuals(p)
    assert np.abs(off).max() < 1.0  # a uniform body is probable
    for i in (P.INERTIA, P.MOMENT, P.MOMENT + 1, P.MASS, P.SHAPE, P.SHAPE + 1, P.SHAPE + 2):
        step = np.zeros(CONSTANTS)
        step[i] = 1e-6 * abs(p[i])
        slope = (body_prior_residuals(p + step)[0] - body_prior_residuals(p - step)[0]) / (2 * step[i])
        assert slope == pytest.approx(J[:, i], rel=1e-5, abs=1e-4)
