"""The posterior Cramér–Rao bound of a record: the best accuracy of any estimate from these readings.

The expected information of the readings at the true trajectory and constants, plus that of the blind prior; its
inverse bounds the covariance of every unbiased estimator (van Trees 1968, section 2.4). For studies, in which the truth
is known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import Event, FloatArray
from palmd.model import shape
from palmd.model.smoothing import CONSTANTS, ORDER, C
from palmd.observer.criticism import RigBelief
from palmd.observer.data_segment import longest_segment
from palmd.observer.factor import Prior, friction_of
from palmd.observer.normal_equations import Guess
from palmd.observer.outline import contact_normals, directions, gauge_free_sd, touched_by
from palmd.observer.reconstruct import SPACING_S
from palmd.observer.record import LEAST_FORCE_N, Record, lay_out
from palmd.observer.search import Search
from palmd.observer.smoother import Smoother
from palmd.system.description import RigDescription


@dataclass(frozen=True, slots=True)
class Truth:
    """The true object and motion; SI units.

    dither: None without friction, where it has no effect. h on evenly spaced normals theta from 0; psi, omega0 at
    times t, in the outline's gauge.
    """

    rho: float
    mu: float
    mass: float
    dither: float | None
    damping: float
    theta: FloatArray
    h: FloatArray
    t: FloatArray
    psi: FloatArray
    omega0: FloatArray


@dataclass(frozen=True, slots=True)
class Bound:
    """Lower bounds of 1σ: of h on the requested normals (m), ρ (m), μ, mass (kg; NaN without any force)."""

    h_sd: FloatArray
    rho_sd: float
    mu_sd: float
    mass_sd: float


def cramer_rao(events: Sequence[Event], rig: RigDescription, truth: Truth, theta: FloatArray) -> Bound:
    """The bound for reconstructions of `events`: (Σ JᵀJ/σ² + prior⁻¹)⁻¹ at the truth.

    `theta`: normals (rad) in the truth's gauge; as in every published outline, the band does not include the error of
    the orientation. Raises ValueError if both pads and the arm never report at the same time.
    """
    segment = longest_segment(events)
    if segment is None:
        raise ValueError("nothing to reconstruct: both pads and the arm never report at the same time")
    search = Search(segment, rig, belief=RigBelief.of(rig))
    record = lay_out(segment.pads, search.path, rig, segment.start, segment.end, SPACING_S)
    guess = _true_guess(truth, search.prior, record.t)
    expected = _expected(record, Smoother(search.library, record, search.prior), rig, guess)
    smoother = Smoother(search.library, expected, search.prior)
    covariance = smoother.posterior(smoother.fit(guess, search.noise, iterations=0)).covariance
    coefficients, of_shape = guess.p[C.SHAPE :], covariance[C.SHAPE : CONSTANTS, C.SHAPE : CONSTANTS]
    touched = directions()[touched_by(contact_normals(record, guess.x[:, 0], coefficients))]
    sd = np.sqrt(np.diagonal(covariance))
    return Bound(
        h_sd=gauge_free_sd(theta, touched, coefficients, of_shape),
        rho_sd=truth.rho * float(sd[C.LN_RHO]),
        mu_sd=friction_of(guess.p, covariance)[1],
        mass_sd=truth.mass * float(sd[C.LN_MASS]) if len(record.force_value) else math.nan,
    )


def _true_guess(truth: Truth, prior: Prior, t: FloatArray) -> Guess:
    p = np.zeros(CONSTANTS)
    p[C.LN_RHO], p[C.DAMPING], p[C.LN_MASS] = math.log(truth.rho), truth.damping, math.log(truth.mass)
    dither = math.exp(prior.mean[C.SATURATION]) if truth.dither is None else truth.dither
    p[C.DRAG], p[C.SATURATION] = truth.mu / dither, dither**-2.0
    p[C.SHAPE :] = shape.coefficients_of(truth.h, ORDER)
    return Guess(np.stack([truth.psi, truth.omega0], axis=1), p).on(truth.t, t)


def _expected(record: Record, smoother: Smoother, rig: RigDescription, guess: Guess) -> Record:
    """The record with every reading at its expectation, so that none is down-weighted as an outlier."""
    contacts = record.contact_value - smoother.residuals(guess) * np.sqrt(record.contact_variance)
    forces = np.maximum(smoother.forces(guess), LEAST_FORCE_N)
    return replace(
        record, contact_value=contacts, force_value=forces, force_variance=rig.force_variances(forces, record.force_pad)
    )
