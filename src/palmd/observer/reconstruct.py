"""A whole record, seen from its end: the object's outline and motion from a blind start, or an honest refusal.

What comes out is called converged only when the iteration has settled, the readings are explained to their noise, no
rival is left, and the outline is told sharply enough to be called one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from palmd.events import Event, FloatArray, RigDescription
from palmd.model import shape
from palmd.model.smoothing import CONSTANTS, ORDER, C
from palmd.observer.marginal import Marginal, marginalised
from palmd.observer.mass import MassEstimator
from palmd.observer.outline import directions, made_convex, normal_angles, outline_of
from palmd.observer.record import LEAST_FORCE_N, Record, lay_out
from palmd.observer.search import Finding, Search, beyond_question, doubt
from palmd.observer.smoother import Fit, Smoother
from palmd.observer.stretch import Stretch, longest_stretch
from palmd.observer.visits import Counts, visits_of

SPACING_S = 0.005  # of the nodes in the end
LEAST_S = 1.0
SHARP_M = 1.5e-4  # RMS of the outline's one-sigma where touched, above which there is no outline to speak of
# Each attempt: seconds that the bank reads, and how many of its filters the smoother starts from.
ATTEMPTS = ((2.0, 3), (3.5, 4), (1.2, 8), (5.0, 4))
NO_ANSWER = "no motion of an object was found that explains the readings"


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """What a record tells; SI units, NaN or None where there is no value.

    theta, h, h_sd, touched, visits: 360 normals (rad), support function and its one-sigma (m), whether a palm touched
    there, and how many separate times.
    t, psi, omega0, r1, r2: the trajectory at the nodes. `chi2` is per contact reading. `reason` says why not, when
    not `converged`.
    """

    converged: bool
    chi2: float
    theta: FloatArray
    h: FloatArray | None
    h_sd: FloatArray | None
    touched: npt.NDArray[np.bool_] | None
    visits: Counts | None
    rho: float
    rho_sd: float
    mu: float
    mu_sd: float
    mass: float
    mass_sd: float
    t: FloatArray
    psi: FloatArray
    omega0: FloatArray
    r1: FloatArray
    r2: FloatArray
    reason: str
    seconds: float


def reconstruct(events: Sequence[Event], rig: RigDescription, seed: int = 0) -> Reconstruction:
    """Smooth the longest stretch of `events` in which both palms feel the object; deterministic for a given seed.

    Takes about a second for ten seconds of readings. Never raises for what the readings say: a record that tells too
    little, or contradicts the model, comes back with `converged` False and the reason.
    """
    begun = time.perf_counter()
    stretch = longest_stretch(events)
    if stretch is None or stretch.end - stretch.start < LEAST_S:
        return _nothing("there is no second in which both pads and the arm report", begun)
    search = Search(stretch, rig)
    best: _Answer | None = None
    for number, (seconds, starts) in enumerate(ATTEMPTS):
        finding = search.blind(seconds, starts, seed)
        if finding is None:
            continue
        answer = _refined(search, finding, stretch, rig)
        if best is None or answer.fit.cost < best.fit.cost:
            best = answer
        if not best.reason and (number > 0 or beyond_question(best.fit, best.record)):
            break
    return _nothing(NO_ANSWER, begun) if best is None else _result(search, best, stretch, rig, begun)


@dataclass(frozen=True, slots=True)
class _Answer:
    fit: Fit
    record: Record
    reason: str


def _refined(search: Search, finding: Finding, stretch: Stretch, rig: RigDescription) -> _Answer:
    """The best fit again on finer nodes, each force's noise taken from the model's force instead of its neighbours'."""
    best = finding.fits[0]
    record = lay_out(stretch.pads, search.path, rig, stretch.start, stretch.end, SPACING_S)
    guess = best.guess.on(finding.record.t, record.t)
    level = np.maximum(Smoother(search.library, record, search.prior).forces(guess), LEAST_FORCE_N)
    record = replace(record, force_variance=rig.force_variance(level))
    fit = Smoother(search.library, record, search.prior).fit(guess, best.noise)
    return _Answer(fit, record, doubt(fit, finding))


def _result(search: Search, answer: _Answer, stretch: Stretch, rig: RigDescription, begun: float) -> Reconstruction:
    fit, record = answer.fit, answer.record
    try:
        answered = marginalised(search.library, record, search.prior, fit)
    except np.linalg.LinAlgError:
        return _nothing(answer.reason or "the fit is not a minimum", begun, fit.chi2)
    x, covariance = answered.mean.x, answered.covariance
    everything = np.concatenate([answered.mean.p, x[-1]])
    convex = made_convex(everything, covariance, slice(C.SHAPE, CONSTANTS))
    p = everything[:CONSTANTS]
    normals = normal_angles(record.palms, x[:, 0])
    outline = outline_of(p[C.SHAPE :], covariance[C.SHAPE : CONSTANTS, C.SHAPE : CONSTANTS], normals)
    reason = answer.reason
    if not reason and float(np.sqrt(np.mean(outline.h_sd[outline.touched] ** 2))) > SHARP_M:
        reason = "the readings tell too little of the outline"
    if not reason and not convex:
        reason = "only a hollow outline explains the readings"
    sd = np.sqrt(np.diagonal(covariance))
    rho = math.exp(p[C.LN_RHO])
    mass, mass_sd = _weighed(search, answer, stretch, rig, answered)
    radii = [shape.basis(normals[:, i], ORDER) @ p[C.SHAPE :] for i in range(2)]
    return Reconstruction(
        converged=not reason, chi2=fit.chi2,
        theta=outline.theta, h=outline.h, h_sd=outline.h_sd, touched=outline.touched, visits=visits_of(normals),
        rho=rho, rho_sd=rho * float(sd[C.LN_RHO]), mu=float(p[C.MU]), mu_sd=float(sd[C.MU]),
        mass=mass, mass_sd=mass_sd,
        t=record.t, psi=x[:, 0], omega0=x[:, 1], r1=radii[0], r2=radii[1],
        reason=reason, seconds=time.perf_counter() - begun,
    )  # fmt: skip


def _weighed(
    search: Search, answer: _Answer, stretch: Stretch, rig: RigDescription, answered: Marginal
) -> tuple[float, float]:
    """Mass and its one-sigma (kg), NaN without forces: from the fit, or afterwards where the forces were left out."""
    if len(answer.record.force_value):
        mass = math.exp(answered.mean.p[C.LN_MASS])
        return mass, mass * math.sqrt(answered.covariance[C.LN_MASS, C.LN_MASS])
    believed = replace(rig, force_gain_std=0.0)
    record = lay_out(stretch.pads, search.path, believed, stretch.start, stretch.end, SPACING_S)
    unit = np.where(np.arange(CONSTANTS) == C.LN_MASS, 0.0, answered.mean.p)
    per_mass = Smoother(search.library, record, search.prior).forces(replace(answered.mean, p=unit))
    scales = MassEstimator(rig.force_scale_std, rig.force_resolution, rig.force_gain_std)
    for force, f in zip(record.force_value, per_mass, strict=True):
        scales.feed(float(force), float(f))
    return scales.value, scales.sd


def _nothing(reason: str, begun: float, chi2: float = math.nan) -> Reconstruction:
    none: FloatArray = np.zeros(0)
    nan = math.nan
    return Reconstruction(
        False, chi2, directions(), None, None, None, None, nan, nan, nan, nan, nan, nan,
        none, none, none, none, none, reason, time.perf_counter() - begun,
    )  # fmt: skip
