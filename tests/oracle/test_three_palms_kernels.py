"""The kernels of three palms against the emulated rig's constraint forces, which are an independent implementation."""

import math

import numpy as np
import pytest
from plain_body_equations import acceleration_kernel
from plain_body_on_palms import BodyStates, PalmState, accelerations

from palmd.model.spherical import count, evaluator
from palmd.observer.three_palms import kernels
from palmd.observer.three_palms.arrow import STATES, Arrow
from palmd.observer.three_palms.body import centres_of, inertia
from palmd.observer.three_palms.equations import BodyMotion, Noise
from palmd.observer.three_palms.kernels import by_columns, palm_inputs, reading_geometry
from palmd.observer.three_palms.path import joint_path
from palmd.observer.three_palms.record import PadReadings, lay_out
from palmd.observer.three_palms.smoother import BodyPrior, BodySmoother
from palmd.rig.three_palms.bodies import Bodies, spread_directions
from palmd.rig.three_palms.plant import FrictionParameters
from palmd.system.three_palms import ThreePalmsRig, palms_at, readings_of

ORDER, GRAVITY = 8, 9.81
LAMBDA = np.array([-0.1, 0.05, 0.02, -0.04, 0.06, 0.1])
DAMPING, MU, DITHER = 2e-4, 0.15, 0.011
PHASES = np.random.default_rng(0).uniform(0.0, 2.0 * math.pi, (1, 3)) + 2.0 * math.pi * np.outer(
    np.arange(4099), (0.8191725134, 0.6710436067, 0.5497004779)
)
"""Vibration phases, evenly distributed over all combinations."""


@pytest.fixture(scope="module")
def parameters():
    """A smooth body, a ball with a mild ellipsoid off its middle, that few harmonics represent."""
    form = np.diag([0.009, 0.0095, 0.0105]) ** 2
    body = Bodies(
        np.array([0.009]), np.array([[form]]), np.array([[[1e-9, 0, 0], [-1e-9, 0, 0], [0, 1e-9, 0], [0, -1e-9, 0],
        [0, 0, 1e-9], [0, 0, -1e-9]]]), np.array([4.0]), np.array([[3e-4, -5e-4, 4e-4]]), np.zeros((1, 3, 3)),
    )  # fmt: skip
    u = spread_directions(2000)
    c = np.linalg.lstsq(evaluator(ORDER)(u)[0], body.support(u[None])[0][0], rcond=None)[0]
    p = np.concatenate([c, LAMBDA, [DAMPING, MU, math.log(DITHER)]])
    return p, Bodies(body.ball, body.forms, body.vertices, body.sharpness, body.offset, inertia(p)[None])


@pytest.fixture(scope="module")
def moment():
    """Palms, rotation and spin of a body at some instants."""
    random = np.random.default_rng(5)
    T = 6
    angle = np.array([0.9, 0.8, 0.8]) + random.uniform(-0.3, 0.3, (T, 3))
    palms = palms_at(angle, random.normal(0, 0.5, (T, 3)), random.normal(0, 1.0, (T, 3)))
    R = np.linalg.qr(random.normal(size=(T, 3, 3)))[0]
    R *= np.linalg.det(R)[:, None, None]
    return palms, R, random.normal(0, 2.0, (T, 3))


# The model is exact to order μ²; the error falls as μ³ down to that of the directions' rounded kink.
@pytest.mark.parametrize(("mu", "within"), [(0.2, 0.02), (0.05, 3e-3)])
def test_accelerations_and_forces_are_those_of_free_bodies_with_constraints(parameters, moment, mu, within):
    p, body = parameters
    p = p.copy()
    p[-2:] = mu, math.log(0.4)  # some slips are slower than that, some faster
    palms, R, omega = moment
    alpha, force = acceleration_kernel(ORDER)((by_columns(R), omega, palm_inputs(palms)), (p, (GRAVITY, 1.0)))[:2]
    T = len(R)
    bodies = Bodies(*(np.repeat(getattr(body, name), T, axis=0) for name in body.__dataclass_fields__))
    rubbing = FrictionParameters(*(np.full(T, each) for each in (mu, 0.4, DAMPING)))
    centre = centres_of(R, palm_inputs(palms), p)
    _, x, _ = bodies.support(-np.einsum("bji,bnj->bni", R, palms.normal))
    r = np.einsum("bij,bnj->bni", R, x)
    turning = palms.normal_rate - np.cross(omega[:, None], palms.normal)
    moved = -(palms.normal_rate * centre[:, None]).sum(-1) - (r * turning).sum(-1)
    velocity = np.linalg.solve(palms.normal, moved[..., None])[..., 0]
    at = PalmState(palms.normal, palms.normal_rate, palms.normal_acceleration, palms.spin)
    _, spin_rate, touch = accelerations(bodies, rubbing, at, BodyStates(centre, velocity, R, omega), GRAVITY, PHASES)
    np.testing.assert_allclose(force, touch.force, rtol=within)
    np.testing.assert_allclose(alpha, spin_rate, atol=within * np.abs(spin_rate).max())
    read = readings_of(palms, centre[:, None] + r)
    for pad in range(3):
        geometry = reading_geometry(palms, np.full(T, pad))
        y = kernels.reading(ORDER)((by_columns(R), geometry), (p[: count(ORDER)],))[0]
        np.testing.assert_allclose(y, read[:, pad], atol=5e-8)  # degrees above 8 of the ellipsoid


def test_the_smoothers_gradient_is_that_of_its_cost(parameters):
    p, _ = parameters
    random = np.random.default_rng(2)
    t = 0.016 * np.arange(30)
    angle = np.tile([0.9, 0.8, 0.8], (30, 1)) + 0.1 * np.sin(3 * t)[:, None]
    plan = np.stack([0.3 * np.cos(3 * t)[:, None] * np.ones(3), -0.9 * np.sin(3 * t)[:, None] * np.ones(3)], axis=1)
    times = np.sort(random.uniform(0.01, 0.2, 40))
    readings = PadReadings(times, random.integers(0, 3, 40), random.uniform(0.0, 0.02, (40, 2)), np.full(40, np.nan))
    record = lay_out(joint_path(t, angle, plan, 2e-4), readings, 0.0, 10, 0.02)
    prior = BodyPrior.independent(p, np.eye(len(p)), np.zeros(3), 1.0)
    smoother = BodySmoother(record, prior, Noise(1e-4), ThreePalmsRig())
    R = np.tile(np.eye(3), (11, 1, 1))
    motion = BodyMotion(R, np.zeros((11, 3)), p).moved(random.normal(0, 0.02, (11, 6)), 0 * p)
    nodes, step = (
        random.normal(size=(11, 6)),
        random.normal(size=len(p)) * np.r_[np.full(count(ORDER), 1e-4), np.full(9, 1e-2)],
    )
    nodes[0, :3] = 0.0  # the gauge
    arrow = smoother.evaluate(motion).arrow
    small = 1e-7
    ahead, behind = (
        smoother.evaluate(motion.moved(sign * small * nodes, sign * small * step)).cost for sign in (1, -1)
    )
    predicted = 2 * ((arrow.nodes_gradient * nodes).sum() + arrow.gradient @ step)
    # the gradient omits the noise strength's dependence on the spin, and commutators of large rotations
    assert (ahead - behind) / (2 * small) == pytest.approx(predicted, rel=2e-2)


def random_arrow(seed, K, m, q):
    """K nodes in a row, each pair linked by q residuals r with Jacobians left, right and, in m parameters, by."""
    random = np.random.default_rng(seed)
    arrow = Arrow.empty(K, m)
    left, right = random.normal(size=(2, K - 1, q, STATES))
    by, r = random.normal(size=(K - 1, q, m)), random.normal(size=(K - 1, q))
    arrow.add_residuals(r, left, right, by)
    arrow.diagonal += np.eye(STATES)
    return arrow, left, right, by, r


def test_the_arrow_solver_agrees_with_a_dense_solve():
    K, m, q = 4, 3, 8
    arrow, left, right, by, r = random_arrow(0, K, m, q)
    arrow.corner += np.eye(m)
    J = np.zeros((K - 1, q, K * STATES + m))
    for k in range(K - 1):
        J[k, :, k * STATES : (k + 1) * STATES], J[k, :, (k + 1) * STATES : (k + 2) * STATES] = left[k], right[k]
    J[:, :, K * STATES :] = by
    J = J.reshape(-1, K * STATES + m)
    whole = J.T @ J + np.eye(K * STATES + m)
    nodes, step = arrow.solve(0.0)
    np.testing.assert_allclose(
        np.concatenate([nodes.ravel(), step]), -np.linalg.solve(whole, J.T @ r.ravel()), rtol=1e-9
    )
    np.testing.assert_allclose(np.linalg.inv(arrow.information()), np.linalg.inv(whole)[-m:, -m:], rtol=1e-8)


def test_the_information_left_in_the_last_node_is_the_dense_marginal():
    m = 3
    arrow, *_ = random_arrow(1, 5, m, 9)
    arrow.add_prior(2.0 * np.eye(STATES + m), np.ones(STATES + m))
    nodes, step = arrow.solve(0.0)
    information, gradient = arrow.marginal_of_last_node()
    predicted = -np.linalg.solve(information, gradient)
    np.testing.assert_allclose(predicted, np.concatenate([nodes[-1], step]), rtol=1e-9)
    np.testing.assert_allclose(
        np.linalg.inv(information)[STATES:, STATES:], np.linalg.inv(arrow.information()), rtol=1e-8
    )
