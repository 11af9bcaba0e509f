"""The blind start between three palms: motion from given contacts, without rotation or shape."""

import math

import numpy as np
from scipy.interpolate import make_smoothing_spline
from system_logs import log_of

from palmd.observer.three_palms import kernels
from palmd.observer.three_palms.driven import ContactCurves, nearest_balls, smoothing_spline
from palmd.observer.three_palms.kernels import palm_inputs
from palmd.observer.three_palms.reconstruct import longest_stretch
from palmd.observer.three_palms.search import Task, start_candidates
from palmd.record.systems.three_palms import SYSTEM, path_and_readings
from palmd.system.three_palms import palms_at
from tools.studies.space_logs import simulate

SECONDS, SPACING = 1.2, 0.02


def test_a_ball_is_found_from_its_contacts():
    angle = np.array([[0.9, 0.8, 0.7]])
    normal = palms_at(angle, 0 * angle, 0 * angle).normal
    centre, radius = np.array([0.001, 0.02, 0.03]), 0.02
    found, radii = nearest_balls(centre - radius * normal, normal)
    np.testing.assert_allclose(found, [centre], atol=1e-15)
    np.testing.assert_allclose(radii, radius, atol=1e-15)


def test_the_smoothing_spline_agrees_with_scipy():
    random = np.random.default_rng(0)
    t = np.cumsum(random.uniform(5e-3, 15e-3, 300))
    y = np.sin(3 * t) + 0.1 * random.normal(size=len(t))
    between = np.linspace(t[0] - 0.01, t[-1] + 0.01, 500)
    for lam in (1e-8, 1e-5, 1e-2):
        mine, scipys = smoothing_spline(t, y, lam), make_smoothing_spline(t, y, lam=lam)
        np.testing.assert_allclose(mine(between), scipys(between), atol=1e-9)
        np.testing.assert_allclose(mine.derivative()(between), scipys.derivative()(between), atol=1e-8)


def test_given_contacts_determine_the_derivatives_of_centre_and_spin():
    (run,) = simulate("friction", 1, SECONDS + 0.1, seed=2)
    truth, log = run.truth, log_of(SYSTEM, run.lines)
    path, readings = path_and_readings(log)
    t = np.array(truth["t"])[: round(SECONDS / SPACING)]
    state = np.concatenate([truth["com_m"], truth["omega_rad_s"]], axis=1)[: len(t)]
    gyration = math.sqrt(np.trace(truth["inertia_m2"]) / 3)
    constants = np.array([math.log(gyration), 0.0, math.log(truth["mu"]), math.log(truth["dither_m_s"])])
    given = (state, palm_inputs(path.palms(t)), ContactCurves.smoothed(readings).at(path, t))
    rates = kernels.driven()(given, (constants, log.rig.kernel_constants))[0]
    off = (rates - np.gradient(state, t, axis=0))[5:-5]
    assert np.sqrt(np.mean(off[:, :3] ** 2)) < 1e-4  # m/s
    assert np.sqrt(np.mean(off[:, 3:] ** 2)) < 5.0  # rad/s²: a contact error of 40 µm gives 4


def test_a_frictionless_body_is_found_from_a_blind_start():
    run = simulate("drag", 1, 1.6, seed=9541)[0]
    log = log_of(SYSTEM, run.lines)
    path, readings = path_and_readings(log)
    start, end = longest_stretch(path, readings)
    first, *_ = start_candidates(Task(path, readings, ContactCurves.smoothed(readings), log.rig, start, end), 1.5)
    nodes = np.searchsorted(run.truth["t"], first.record.t - 0.5 * SPACING)
    off = np.sqrt(np.mean((first.fit.motion.omega - np.array(run.truth["omega_rad_s"])[nodes]) ** 2))
    assert first.cost_per_number < 1.05
    assert off < 0.15  # rad/s
