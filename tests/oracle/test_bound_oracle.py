"""The Cramér–Rao bound against single shooting without nodes, process noise, Jacobians or other parts of the smoother.

Plain NumPy integrates many perturbed bodies over the whole record; differences of their readings give J, and (JᵀJ/σ² +
prior⁻¹)⁻¹ the covariance.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import CONSTANTS, DRAG, LN_MASS, LN_RHO, ORDER, RIG, SATURATION, SHAPE, Bodies
from scipy.interpolate import CubicHermiteSpline

from palmd.model.shape import basis, coefficients_of, tangential_basis
from palmd.observer.data_segment import DataSegment, longest_segment
from palmd.observer.factor import Prior
from palmd.observer.search import Search
from palmd.record.eventlog import EventLog, read_log
from palmd.rig.plant import PlantOptions
from palmd.rig.simulate import simulate_log
from palmd.system.vibration import Vibration
from tools.studies.bound import Truth, cramer_rao

STEP_S = 1e-3  # friction is stiff where a slip crosses the vibration's speed
SECONDS = 2.0
TOLERANCE = 0.02  # relative: the smoother has a little process noise and drops readings after its last node
FAST_HZ = 1e6  # too fast for a body to follow
SPIN = CONSTANTS  # index after the constants: ω0 at the start


def _simulated(kind: str, seed: int, folder: Path) -> tuple[EventLog, Truth]:
    options, vibration = PlantOptions(friction_law="sign_pairs"), Vibration(frequency=FAST_HZ)
    lines, truth = simulate_log(kind, seed, SECONDS, options, vibration=vibration)
    path = folder / "run.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    columns = (np.array(truth[name]) for name in ("theta_rad", "h_m", "t", "psi_rad", "omega0_rad_s"))
    constants = (truth[name] for name in ("rho_m", "mu", "mass_kg", "dither_m_s", "damping_m2_s"))
    return read_log(path), Truth(*constants, *columns)


def _shot(
    bodies: Bodies, stretch: DataSegment, search: Search, psi0: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(times, ψ, ω0) of every body from the start of the segment."""
    count = math.ceil((stretch.end - stretch.start) / STEP_S)
    times = stretch.start + STEP_S / 2 * np.arange(2 * count + 1)
    palms = search.path.at(times)
    rows = [(np.full(bodies.p.shape[1], psi0), bodies.p[SPIN])]
    for k in range(count):
        rows.append(bodies.moved(*rows[-1], (palms[2 * k], palms[2 * k + 1], palms[2 * k + 2]), STEP_S))
    trajectory = np.array(rows)
    return times[::2], trajectory[:, 0], trajectory[:, 1]


def _believed(p: np.ndarray, prior: Prior) -> np.ndarray:
    """Prior quantities in units of their 1σ: ln(ρ/h0), μ, ln u_d, the other constants, and the first spin."""
    dither = p[SATURATION] ** -0.5
    about = p.copy()
    about[LN_RHO] -= math.log(p[SHAPE])
    about[DRAG], about[SATURATION] = p[DRAG] * dither, math.log(dither)
    return about / np.append(prior.sd, prior.omega0_sd)


@pytest.mark.nightly
@pytest.mark.parametrize(("kind", "seed"), [("nominal", 3), ("rig", 1)])
def test_the_bound_equals_that_of_single_shooting(kind: str, seed: int, tmp_path: Path) -> None:
    log, truth = _simulated(kind, seed, tmp_path)
    stretch = longest_segment(log.events)
    assert stretch is not None
    search = Search(stretch, log.rig)
    spline = CubicHermiteSpline(truth.t, truth.psi, truth.omega0)
    prior = search.prior

    p = np.zeros(SPIN + 1)
    dither = truth.dither or math.exp(prior.mean[SATURATION])
    p[:RIG] = math.log(truth.rho), truth.mu / dither, dither**-2.0, truth.damping, math.log(truth.mass)
    p[SHAPE:SPIN] = coefficients_of(truth.h, ORDER)
    p[SPIN] = spline(stretch.start, 1)
    step = 1e-4 * np.append(prior.scale, prior.omega0_sd)
    both = np.concatenate([p[:, None], p[:, None] + np.diag(step), p[:, None] - np.diag(step)], axis=1)
    bodies = Bodies(both, log.rig.gravity, log.rig.palm1_length if log.rig.hinge == "arc" else 0.0)
    times, psi, omega0 = _shot(bodies, stretch, search, float(spline(stretch.start)))
    inside = times < truth.t[-1]
    assert psi[inside, 0] == pytest.approx(spline(times[inside]), abs=1e-3)  # two independent integrations

    paths = CubicHermiteSpline(times, psi, omega0)
    predicted, sigma = [], []
    for sample in stretch.pads:
        pad = log.rig.pads[sample.pad - 1]
        (palms,) = search.path.at(np.array([sample.t_sample]))
        at, spin = paths(sample.t_sample), paths(sample.t_sample, 1)
        predicted.append(bodies.contacts(palms, at)[sample.pad - 1])
        sigma.append(math.hypot(pad.noise, pad.resolution / math.sqrt(12)))
        if sample.force is not None and sample.force > 0.05:
            force = np.exp(both[LN_MASS]) * bodies.forces_and_spin(palms, at, spin)[sample.pad - 1]
            predicted.append(force)
            sigma.append(math.hypot(pad.force_scale_std * force[0], pad.force_resolution / math.sqrt(12)))
    y = np.array(predicted)
    J = (y[:, 1 : SPIN + 2] - y[:, SPIN + 2 :]) / (2 * step) / np.array(sigma)[:, None]
    believed = np.array([_believed(column, prior) for column in both.T]).T
    rows = (believed[:, 1 : SPIN + 2] - believed[:, SPIN + 2 :]) / (2 * step)
    covariance = np.linalg.inv(J.T @ J + rows.T @ rows)
    sd = np.sqrt(np.diagonal(covariance))

    theta = np.arange(0.0, math.tau, math.tau / 90)
    here = replace(truth, t=times, psi=psi[:, 0], omega0=omega0[:, 0])
    bound = cramer_rao(log.events, log.rig, here, theta)
    assert bound.rho_sd == pytest.approx(truth.rho * sd[LN_RHO], rel=TOLERANCE)
    of_mu = np.array([dither, -truth.mu * dither**2 / 2]) @ covariance[np.ix_([DRAG, SATURATION], [DRAG, SATURATION])]
    assert bound.mu_sd == pytest.approx(math.sqrt(of_mu @ [dither, -truth.mu * dither**2 / 2]), rel=TOLERANCE)
    assert bound.mass_sd == pytest.approx(truth.mass * sd[LN_MASS], rel=TOLERANCE)

    # h after the best rotation where touched; each eigenvector of the error is rotated
    phi = search.path.at(times)[:, :2]
    normals = np.concatenate([phi[:, 0] - psi[:, 0] - math.pi / 2, phi.sum(axis=1) - psi[:, 0] - 3 * math.pi / 2])
    touched = np.unique(np.round(np.degrees(normals)) % 360) * (math.tau / 360)
    values, vectors = np.linalg.eigh(covariance[SHAPE:SPIN, SHAPE:SPIN])
    errors = vectors * np.sqrt(np.maximum(values, 0))
    slope_there, slope = (-tangential_basis(angles, ORDER) @ p[SHAPE:SPIN] for angles in (touched, theta))
    turns = np.linalg.lstsq(slope_there[:, None], basis(touched, ORDER) @ errors, rcond=None)[0]
    h_sd = np.linalg.norm(basis(theta, ORDER) @ errors - slope[:, None] * turns, axis=1)
    assert bound.h_sd == pytest.approx(h_sd, rel=TOLERANCE)
