"""Reconstruct an object that sticks and slips, as palms without vibration move it: fit, bands and tests."""

from __future__ import annotations

import math
import time

import numpy as np

from palmd.events import FloatArray
from palmd.model import shape
from palmd.model.rolling import Lying
from palmd.model.smoothing import ORDER, C
from palmd.observer.dry_fit import ASYMMETRY, LN_MASS, LN_RHO, MU, RIG, SHAPE, DryFit, DryModel, phases_of
from palmd.observer.factor import conditional_covariance
from palmd.observer.outline import contact_normals, made_convex, outline_of, rms_sd
from palmd.observer.reconstruction import Reconstruction
from palmd.observer.record import Record, lay_out
from palmd.observer.search import DIFFERENT_M, DOUBT, SPACING_S, Search, consistent, nothing_moves
from palmd.observer.shape_classification import root_of, shape_class
from palmd.observer.stuck_palms import (
    CHANGE_COST,
    HOPELESS_S,
    FilterStart,
    blind,
    dithered,
    stuck_guess,
    without_dithered_forces,
)
from palmd.observer.validity import SHARP_M
from palmd.observer.visits import visits_of
from palmd.system.mechanism import PALMS

LEAST_S = 5.0  # of a segment
# before an object is lost, in which filters are wrong already; after that, until it lies as before
BEFORE_LOST_S, AFTER_LOST_S = 0.3, 1.0
# of searching the sequence of stuck palms again from the fit; decrease of the cost needed for another round
ROUNDS, WORTH = 3, 10.0
HOPELESS = 4.0  # χ² of the first fit, beyond which no other sequence of stuck palms helps
MOST_OUTLIERS = 0.02
# limit of the cost of the prior; and more for each change of the stuck palm
MOST_PRIOR_COST, MOST_TURN_COST = 60.0, 2.0
MOST_FRICTION_RATIO = 1.0  # friction over normal force: nothing that lies on a pad sticks better
LEAST_SLIDING = 0.1  # friction of a palm with sliding, relative to the mean of both (convention: none is zero)
LEAST_FRICTION = 3.0  # σ of the friction; an object without friction is handled by another model
DITHERED_LN_RHO = 0.06
"""1σ of ln ρ on palms with a plan's dither (derivation: ρ² follows from the dither's accelerations, of which reports of
the arm at 60 Hz miss 9 % at 10 Hz, and differences over 10 ms another 3 %)."""
RIVAL_RADIUS, RIVAL_SHAPE = 1.05, 0.5  # of a second start: factor on the radius; deviation of the outline, in prior 1σ


def dry_reconstruction(search: Search, seed: int, started: float) -> Reconstruction | None:
    """Outline of an object that sticks to one palm and slips along the other, if it explains the segment of `search`.

    Or a part of the segment: where an object falls over, no sequence of stuck palms goes on. None where the estimate is
    in doubt. Flat palms only. started: when the reconstruction was started (`time.perf_counter`).
    """
    if search.rig.curved or search.segment.lasts < LEAST_S or nothing_moves(search.record):
        return None
    try:
        found = _found(search, seed)
        if isinstance(found, float):
            return _of_parts(search, found, seed, started)
        return None if found is None else _result(search, *found, started)
    except np.linalg.LinAlgError:
        return None


def _of_parts(search: Search, lost: float, seed: int, started: float) -> Reconstruction | None:
    """Result of the longer explained part, before the object was `lost` (s) or, if it stuck until then, after that."""
    segment = search.segment
    parts = [segment.until(lost - BEFORE_LOST_S)]
    if lost > segment.start + HOPELESS_S:
        parts.append(segment.since(lost + AFTER_LOST_S))
    for part in sorted(parts, key=lambda part: part.lasts, reverse=True):
        if part.lasts >= LEAST_S:
            result = dry_reconstruction(Search(part, search.rig, belief=search.belief), seed, started)
            if result is not None:
                return result
    return None


def _found(search: Search, seed: int) -> tuple[DryModel, DryFit] | float | None:
    """The accepted fit; or a time (s) if only the readings before it may be explained; None if nothing is."""
    record, prior = without_dithered_forces(_with_forces(search)), search.prior
    gain_stds = [pad.force_gain_std for pad in search.rig.pads]
    if not all((record.force_pad == palm).any() for palm in PALMS):
        return None
    start = blind(record, prior, search.rig.friction_sd, gain_stds)
    guess = stuck_guess(record, start)
    if isinstance(guess, float):
        return guess
    model = DryModel(record, search.path, prior, phases_of(guess.palms, record.t, dithered(record)), gain_stds)
    fit = model.fit(model.initial_constants(guess.outline, guess.mass, guess.mu, guess.asymmetry))
    model, fit = _with_phases_refined(model, fit, start)
    if guess.explained_until < search.segment.end - BEFORE_LOST_S and _is_doubtful(model, fit):
        return guess.explained_until
    return None if _is_doubtful(model, fit) or _has_rival(model, fit, search, seed) else (model, fit)


def _with_phases_refined(model: DryModel, fit: DryFit, start: FilterStart) -> tuple[DryModel, DryFit]:
    """Search the sequence of stuck palms again, with filters that know the object, while that explains more."""
    for _ in range(ROUNDS if max(fit.chi2, fit.force_chi2) < HOPELESS else 0):
        guess = stuck_guess(model.record, model.filter_start(fit, start))
        if isinstance(guess, float):
            break
        other = model.with_phases(phases_of(guess.palms, model.record.t, dithered(model.record)))
        other_fit = other.fit(other.initial_constants_from(fit))
        gain = fit.cost - other_fit.cost + CHANGE_COST * (len(model.phases) - len(other.phases))
        if gain > 0.0:
            model, fit = other, other_fit
        if gain < WORTH:
            break
    return model, fit


def _with_forces(search: Search) -> Record:
    """The search's record with the forces of pads of uncertain gain: here the gain is estimated with the object."""
    record = search.record
    if not any(pad.force_gain_std for pad in search.rig.pads):
        return record
    trusting = search.rig.with_pads(force_gain_std=0.0)
    return lay_out(search.segment.pads, search.path, trusting, float(record.t[0]), search.segment.end, SPACING_S)


def _is_doubtful(model: DryModel, fit: DryFit) -> bool:
    """Whether the fit fails a test."""
    record = model.record
    explained = consistent(fit.chi2, len(record.contact_value)) and consistent(fit.force_chi2, len(record.force_value))
    likely = fit.prior_cost < MOST_PRIOR_COST + MOST_TURN_COST * len(model.phases) + len(fit.z[model.gains])
    return not (
        fit.settled
        and explained
        and likely
        and fit.outliers < MOST_OUTLIERS
        and fit.friction_ratio < MOST_FRICTION_RATIO
    )


def _has_rival(model: DryModel, fit: DryFit, search: Search, seed: int) -> bool:
    """Whether a fit from a very different outline ends at another outline that explains the readings as well."""
    prior = search.prior
    noise = np.random.default_rng(seed).normal(size=SHAPE.stop)
    start = prior.mean[C.SHAPE :] + RIVAL_SHAPE * prior.sd[C.SHAPE :] * noise
    start[0] = RIVAL_RADIUS * prior.mean[C.SHAPE]
    other = model.fit(model.initial_constants(start, math.exp(fit.z[LN_MASS]), fit.z[MU], fit.z[ASYMMETRY]))
    theta = contact_normals(model.record, fit.psi, fit.z[SHAPE]).ravel()
    difference = shape.basis(theta, ORDER) @ (other.z[SHAPE] - fit.z[SHAPE])
    return other.cost < fit.cost + DOUBT and float(np.sqrt(np.mean(difference**2))) > DIFFERENT_M


def friction_sd(asymmetry: float, covariance: FloatArray) -> float:
    """1σ of the mean friction of both palms, given the covariance of (mean, asymmetry a); half the 2σ band.

    Where the object slides on one palm only, readings determine μ (1 + a) or μ (1 − a): on this hyperbola the band by
    the covariance is too short towards a large friction of the other palm.
    """
    variance, mixed, asymmetry_variance = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    if asymmetry_variance <= 0.0:
        return math.sqrt(variance)
    along, sd = mixed / asymmetry_variance, math.sqrt(asymmetry_variance)
    sliding = 1.0 - math.copysign(asymmetry, along * asymmetry)  # μ of the palm with sliding, over the mean
    longer = sliding / max(sliding - 2.0 * sd, LEAST_SLIDING)
    return math.sqrt(max(variance - along * mixed, 0.0) + (along * sd * max(longer, 1.0)) ** 2)


def _result(search: Search, model: DryModel, fit: DryFit, started: float) -> Reconstruction | None:
    """The result; None where the outline is hollow or too uncertain, or there is no friction."""
    record, z = model.record, fit.z.copy()
    covariance: FloatArray = np.asarray(np.linalg.inv(fit.matrix), dtype=np.float64)
    if not made_convex(z, covariance, SHAPE):
        return None
    sd = np.sqrt(np.diagonal(covariance))
    normals = contact_normals(record, fit.psi, z[SHAPE])
    outline = outline_of(z[SHAPE], covariance[SHAPE, SHAPE], [normals])
    conditional_outline = outline_of(z[SHAPE], conditional_covariance(covariance, RIG, SHAPE), [normals])
    if not rms_sd(conditional_outline.h_sd, outline.touched) < SHARP_M or z[MU] < LEAST_FRICTION * sd[MU]:
        return None
    rho, mass = math.exp(z[LN_RHO]), math.exp(z[LN_MASS])
    ln_rho_sd = math.hypot(float(sd[LN_RHO]), DITHERED_LN_RHO if len(dithered(record)) else 0.0)
    root = root_of(shape.basis(outline.theta, ORDER), covariance[SHAPE, SHAPE])
    lying, frictions = Lying.at(record.palms, fit.psi, ORDER), [MU, ASYMMETRY]
    return Reconstruction(
        converged=True, chi2=fit.chi2,
        theta=outline.theta, h=outline.h, h_sd=outline.h_sd, touched=outline.touched, visits=visits_of(normals),
        rho=rho, rho_sd=rho * ln_rho_sd,
        mu=float(z[MU]), mu_sd=friction_sd(z[ASYMMETRY], covariance[np.ix_(frictions, frictions)]),
        mass=mass, mass_sd=mass * float(sd[LN_MASS]),
        rig=z[RIG], rig_covariance=covariance[RIG, RIG],
        contradicted=search.belief.contradicted, rig_prior_sd=search.belief.sd,
        t=record.t, psi=fit.psi, omega0=np.gradient(fit.psi, record.t),
        radii=np.stack([rows @ z[SHAPE] for rows in lying.h]),
        seconds=time.perf_counter() - started, turned_sd=model.turned_sd(fit, covariance),
        shape_class=shape_class(outline.theta, outline.h, root, outline.touched),
    )  # fmt: skip
