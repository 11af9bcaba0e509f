"""The paper's quasistatic equations against objects in exact balance, from another formulation (stable poses)."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from palmd.events import PalmMotion
from palmd.model import quasistatic as qs
from palmd.model.adams import AdamsBashforthMoulton
from palmd.rig.plant import stable_poses
from palmd.rig.shapes import random_body
from tools.studies.paper_poses import balanced_run

LUMP = np.array([0.040, 0.003, -0.002, 0.008, 0.0, 0.0008, 0.001])


def slow_run(n: int = 2000, seconds: float = 10.0):
    t = np.linspace(0.0, seconds, n)
    phi1 = 0.75 + 0.22 * np.sin(0.8 * t)
    phi2 = 1.65 + 0.22 * np.sin(1.3 * t + 0.5)
    return balanced_run(LUMP, 2.6, t, phi1, phi2)


def test_the_balance_error_is_zero_in_every_stable_pose_of_the_emulated_rig():
    rng = np.random.default_rng(3)
    for phi1, phi2 in ((0.5, 1.4), (0.8, 1.7), (1.1, 1.2)):
        body = random_body("friction", rng)
        for psi in stable_poses(body, PalmMotion.at_rest((phi1, phi2))):
            (h1, g1, _), (h2, g2, _) = (
                body.support.at(phi1 - psi - math.pi / 2),
                body.support.at(phi1 + phi2 - psi - 3 * math.pi / 2),
            )
            s1 = (h1 * math.cos(phi2) + h2) / math.sin(phi2) + g1
            s2 = (h2 * math.cos(phi2) + h1) / math.sin(phi2) - g2
            reading = qs.QuasistaticReadings(s1, s2, phi1, phi2, 0.0, 0.0, 0.0, 0.0)
            assert qs.offsets(reading, h1, h2) == pytest.approx((-g1, -g2), abs=1e-12)
            assert abs(qs.balance_error(reading, h1, h2)) < 1e-9
            assert abs(qs.balance_error(reading, h1 + 1e-4, h2)) > 1e-6


def test_the_rotation_rate_is_that_of_the_balanced_object_wherever_it_is_defined():
    run = slow_run()
    assert run.jumps == 0
    psi_dot = CubicSpline(run.t, run.psi)(run.t, 1)
    pairs = zip(run.readings, run.contacts.r1, run.contacts.r2, strict=True)
    computed = np.array([(qs.turning_rate(f, r1, r2), qs.balance_lever(f, r1, r2)) for f, r1, r2 in pairs])
    defined = np.abs(computed[:, 1]) > 2e-3
    assert defined[5:-5].mean() > 0.5
    worst = np.abs(computed[:, 0] - psi_dot)[5:-5][defined[5:-5]].max()
    assert worst < 1e-5 * np.abs(psi_dot).max()


def test_rates_of_radii_and_offsets_are_those_of_the_true_contacts():
    run = slow_run()
    c = run.contacts
    state = np.stack([c.r1, c.r2, run.psi, c.d1, c.d2])
    true = CubicSpline(run.t, state, axis=1)(run.t, 1)
    reading = run.readings[700]
    assert abs(qs.balance_lever(reading, c.r1[700], c.r2[700])) > 1e-3
    computed = qs.rates(reading, state[:, 700])
    np.testing.assert_allclose(computed, true[:, 700], atol=1e-6 * np.abs(true).max())
    run1, run2 = qs.contact_rates(reading, computed[2])
    assert run1 == pytest.approx(c.v1[700] * (reading.omega1 - computed[2]), rel=1e-5)  # (3.27)
    assert run2 == pytest.approx(c.v2[700] * (reading.omega12 - computed[2]), rel=1e-5)  # (3.28)


def integrated(run, r1: float, r2: float, softening: float) -> np.ndarray:
    adams = AdamsBashforthMoulton(run.t[1] - run.t[0])
    d1, d2 = qs.offsets(run.readings[0], r1, r2)
    states = [np.array([r1, r2, run.psi[0], d1, d2])]
    for here, there in pairwise(run.readings):
        states.append(
            adams.step(
                states[-1],
                lambda y, reading=here: qs.rates(reading, y, softening),
                lambda y, reading=there: qs.rates(reading, y, softening),
            )
        )
    return np.array(states).T


def test_integration_from_the_true_initial_state_returns_shape_and_motion():
    run = slow_run()
    state = integrated(run, run.contacts.r1[0], run.contacts.r2[0], 0.0)
    reach = np.ptp(run.contacts.r1)
    assert np.abs(state[0] - run.contacts.r1).max() < 0.02 * reach
    assert np.abs(state[2] - run.psi).max() < 0.05


@pytest.mark.parametrize("off", [(3e-3, 3e-3), (-2e-3, 1e-3)])
def test_the_papers_two_errors_do_not_determine_the_mean_radius(off):
    """Along any solution e_f keeps its first value and e_c stays zero, whatever the initial error."""
    run = slow_run()
    r1, r2 = run.contacts.r1[0] + off[0], run.contacts.r2[0] + off[1]
    state = integrated(run, r1, r2, 0.0)
    e_f = np.array([qs.balance_error(reading, *state[:2, k]) for k, reading in enumerate(run.readings)])
    e_c = np.array([np.hypot(*qs.closure_error(reading, state[:, k])) for k, reading in enumerate(run.readings)])
    assert np.abs(e_f - e_f[0]).max() < 2e-5
    assert e_c.max() < 2e-5
    wrong = np.abs(state[0] - run.contacts.r1).max()
    assert wrong > 1e-3
    balanced = qs.radii_of(run.readings[0], run.contacts.r1[0], 0.0)
    assert abs(qs.balance_error(run.readings[0], *balanced)) < 1e-12


def test_radii_of_is_the_inverse_of_mean_and_balance():
    reading = qs.QuasistaticReadings(0.021, 0.019, 0.7, 1.6, 0.0, 0.0, 0.0, 0.0)
    r1, r2 = qs.radii_of(reading, np.array([0.018, 0.022]), np.array([1e-3, -5e-4]))
    np.testing.assert_allclose((r1 + r2) / 2, [0.018, 0.022])
    np.testing.assert_allclose(qs.balance_error(reading, r1, r2), [1e-3, -5e-4], atol=1e-15)


def test_a_circle_has_no_lever_and_softening_bounds_the_rate():
    phi1, phi2, r = 0.7, 1.5, 0.02
    s = r / math.tan(phi2 / 2)
    reading = qs.QuasistaticReadings(s, s, phi1, phi2, 0.003, -0.002, 0.1, 0.05)
    assert abs(qs.balance_lever(reading, r, r)) < 1e-15
    assert abs(qs.turning_rate(reading, r, r, 1e-3)) < 1e-9


def test_the_integrator_is_of_fourth_order():
    def error(steps: int) -> float:
        h = 2.0 / steps
        adams, y = AdamsBashforthMoulton(h), np.array([1.0, 0.0])
        for _ in range(steps):
            turn = lambda y: np.array([-y[1], y[0]])  # noqa: E731
            y = adams.step(y, turn, turn)
        return float(np.hypot(y[0] - math.cos(2.0), y[1] - math.sin(2.0)))

    # the first steps are of lower order: their error, h² · h, dominates
    assert 7.0 < error(40) / error(80) < 20.0
    assert error(640) < 1e-7


def test_rates_accept_many_initial_states_at_once():
    reading = qs.QuasistaticReadings(0.021, 0.019, 0.7, 1.6, 0.003, -0.002, 0.1, 0.05)
    states = np.array([[0.018, 0.02], [0.019, 0.021], [0.0, 0.1], [0.001, 0.0], [0.0, 0.002]])
    together = qs.rates(reading, states, 1e-3)
    for k in range(2):
        np.testing.assert_allclose(together[:, k], qs.rates(reading, states[:, k], 1e-3))
