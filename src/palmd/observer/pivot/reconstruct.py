"""Reconstruct outline and motion from a whole run of the pivoting grasp, or reject it with a reason."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from palmd.blas import one_thread
from palmd.events import FloatArray, PadSample
from palmd.model import shape
from palmd.model.pivot import ORDER, P, U, library
from palmd.observer.factor import conditional_covariance
from palmd.observer.noise import LEAST_READINGS, scattered
from palmd.observer.outline import directions, gauge_free_sd, touched_by
from palmd.observer.pivot.fit import (
    MAX_ITERATIONS,
    UNSOFTENED,
    ConstantsPrior,
    PivotFit,
    Problem,
    Softening,
    rig_error_modes,
    with_model_forces,
)  # fmt: skip
from palmd.observer.pivot.record import PivotRecord, TooLittleError, arm_motion, lay_out
from palmd.observer.pivot.starts import float_starts, prior_of, rigid_starts, side_of
from palmd.system.pivot import PivotEvent, PivotRig, normal_of
from palmd.system.reasons import NO_REASON, Code, Reason
from palmd.system.vibration import AVERAGED, INDEPENDENT

STAGES = {
    "rigid": (Softening(heights=1e3), Softening(heights=30.0), UNSOFTENED),
    "float": (Softening(2.0, 8.0, 2.0, 20.0), Softening(1.0, 2.0, 1.0, 3.0), UNSOFTENED),
}
EARLY_ITERATIONS = 25
HOPELESS_START, HOPELESS = 10.0, 1.5  # cost relative to the best, above which a start or an early fit is dropped
# least range of a rigid gripper's height, or of a slide's path over the pad, for which the outline is observable
LEAST_LIFT_M, LEAST_PATH_M = 5e-4, 3e-3
FRICTION_FACTORS = (1.3, 1.8)  # factors on μ and V of the best fit, for further starts of a rolling body
AMBIGUOUS_COST = 9.0  # cost margin below which another fit makes the result ambiguous
SAME_RAD = 3e-3  # largest difference of orientation between duplicate fits
SAME_M = 3e-5  # largest RMS difference between outlines of one body
# largest RMS 1σ of the touched outline on an exactly known rig
MOST_SD_M = 1.5e-4
MOST_OUTLIERS = 0.2
CHI2_SIGMAS, CHI2_TOLERANCE = 4.0, 0.03
FORCE_CHI2_TOLERANCE = 0.15  # relative uncertainty of the forces' noise variance
HEIGHT_CHI2 = {"rigid": 9.0, "float": 1.3}
TORQUE_CHI2 = 4.0
HOLLOW_M = 1e-3  # largest negative radius of curvature
OUTSIDE_SIGMAS = 3.0  # standard deviations
ONE_SIDE = Reason(
    Code.ONE_SIDE, "only one side of the dead centre was touched: touch both sides, so that the force relates them"
)
NO_MOTION = Code.UNEXPLAINED, "no motion of a body explains the readings"


def _none() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True, slots=True)
class PivotReconstruction:
    """Estimate from a run; SI units, NaN or None for no value.

    theta, h, h_sd, touched: 360 normals, support function about the pivot, its 1σ, whether it was touched there. com:
    centre of mass from the pivot, in the body's frame at ψ = 0; inertia: about the pivot per mass; both only if the
    mass is observable. moment, inertia_kg: the same times the mass, observable from force alone. t, psi, omega0: the
    trajectory during contact. reason: why it was rejected; none if `converged`. p, covariance: the constants of
    `model.pivot`, None without a fit. outline_sd_m: RMS 1σ of the touched outline on an exactly known rig (m).
    """

    converged: bool
    reason: Reason
    chi2: float = math.nan
    theta: FloatArray = field(default_factory=directions)
    h: FloatArray | None = None
    h_sd: FloatArray | None = None
    touched: npt.NDArray[np.bool_] | None = None
    mu: float = math.nan
    mu_sd: float = math.nan
    com: FloatArray | None = None
    com_sd: FloatArray | None = None
    inertia: float = math.nan
    inertia_sd: float = math.nan
    mass: float = math.nan
    mass_sd: float = math.nan
    moment: FloatArray | None = None
    moment_sd: FloatArray | None = None
    inertia_kg: float = math.nan
    inertia_kg_sd: float = math.nan
    t: FloatArray = field(default_factory=_none)
    psi: FloatArray = field(default_factory=_none)
    omega0: FloatArray = field(default_factory=_none)
    seconds: float = 0.0
    p: FloatArray | None = None
    covariance: FloatArray | None = None
    outline_sd_m: float = math.nan


@one_thread()
def reconstruct(events: Sequence[PivotEvent], rig: PivotRig) -> PivotReconstruction:
    """Fit the whole run. Deterministic; takes a few seconds. Never raises for bad readings.

    If the pad's vibration is not known, both laws of friction are hypotheses, weighted by their evidence.
    """
    started = time.perf_counter()
    laws = (rig, replace(rig, vibration=AVERAGED)) if rig.vibration == INDEPENDENT else (rig,)
    answer = _most_likely([_by_one_law(events, each) for each in laws])
    return replace(answer, seconds=time.perf_counter() - started)


def _by_one_law(events: Sequence[PivotEvent], rig: PivotRig) -> tuple[PivotReconstruction, float]:
    """Estimate with the rig's law of friction, and its cost (−2 log evidence up to a constant; inf without a fit)."""
    try:
        rig_with_noise = _with_scatter(rig, events)
        arm = arm_motion(events, rig_with_noise)
        record = lay_out(events, arm, rig_with_noise)
        _check_observable(record)
        fits, problem = _minima(record)
        return _answer(problem, fits), fits[0].cost
    except TooLittleError as error:
        return PivotReconstruction(False, error.reason), math.inf
    except np.linalg.LinAlgError:
        return PivotReconstruction(False, Reason(*NO_MOTION)), math.inf


def _most_likely(hypotheses: Sequence[tuple[PivotReconstruction, float]]) -> PivotReconstruction:
    """The most likely hypothesis; the others' differences, weighted by their probabilities, increase its variances.

    A converged hypothesis is not returned if a rejected one explains the readings better by `AMBIGUOUS_COST`.
    """
    ranked = sorted(hypotheses, key=lambda each: (not each[0].converged, each[1]))
    (answer, cost), rivals = ranked[0], ranked[1:]
    better = [rival for rival, its_cost in rivals if its_cost < cost - AMBIGUOUS_COST]
    if better or not answer.converged:
        return better[0] if better else answer
    for rival, its_cost in rivals:
        share = 1.0 / (1.0 + math.exp(min((its_cost - cost) / 2.0, 700.0)))
        if rival.converged:
            answer = _widened(answer, rival, share)
    return answer


def _widened(answer: PivotReconstruction, rival: PivotReconstruction, share: float) -> PivotReconstruction:
    """Widen the answer's 1σ by the difference to a rival hypothesis with probability `share`."""
    assert answer.h is not None
    assert answer.h_sd is not None
    assert answer.touched is not None
    assert rival.h is not None
    difference = _outline_difference(answer.theta, answer.h, rival.h, answer.touched)
    root = math.sqrt(share)

    def widened(sd: float, own: float, other: float) -> float:
        return math.hypot(sd, root * (other - own)) if math.isfinite(other) else sd

    com_sd = answer.com_sd
    if answer.com is not None and com_sd is not None and rival.com is not None:
        com_sd = np.hypot(com_sd, root * (rival.com - answer.com))
    return replace(
        answer,
        h_sd=np.hypot(answer.h_sd, root * difference),
        mu_sd=widened(answer.mu_sd, answer.mu, rival.mu),
        inertia_sd=widened(answer.inertia_sd, answer.inertia, rival.inertia),
        mass_sd=widened(answer.mass_sd, answer.mass, rival.mass),
        com_sd=com_sd,
    )


def _outline_difference(
    theta: FloatArray, h: FloatArray, other: FloatArray, touched: npt.NDArray[np.bool_]
) -> FloatArray:
    """Difference of two outlines (m), up to a small rotation: both have ψ = 0 at the first reading."""
    difference = h - other
    slope = np.gradient(other, theta)
    return difference - slope * float(slope[touched] @ difference[touched]) / max(
        float(slope[touched] @ slope[touched]), 1e-30
    )


def _with_scatter(rig: PivotRig, events: Sequence[PivotEvent]) -> PivotRig:
    at = {each.t_sample: each for each in events if isinstance(each, PadSample)}
    samples = [at[t] for t in sorted(at)]
    return replace(rig, pad=scattered(rig.pad, samples)) if len(samples) >= LEAST_READINGS else rig


def _check_observable(record: PivotRecord) -> None:
    """Raise TooLittleError for runs that obviously do not determine an outline."""
    z = record.heights.value
    if z.min() <= 0.0:
        text = f"the pivot would be {-z.min() * 1e3:.1f} mm below the pad's surface: check z"
        raise TooLittleError(Code.PIVOT_MISPLACED, text)
    lift, path = (
        float(np.percentile(each, 98) - np.percentile(each, 2)) for each in (z, record.heights.inputs[:, U.X])
    )
    if record.rig.vertical == "float" and path < LEAST_PATH_M:
        text = f"the arm hardly moves ({path * 1e3:.2f} mm): without rolling the outline is not observable"
        raise TooLittleError(Code.UNDETERMINED, text)
    if record.rig.vertical == "rigid" and lift < LEAST_LIFT_M:
        text = f"the pivot's height hardly changes ({lift * 1e3:.2f} mm): dragging alone does not determine the outline"
        raise TooLittleError(Code.UNDETERMINED, text)


def _minima(record: PivotRecord) -> tuple[list[PivotFit], Problem]:
    """Minima from all starts, the best first, and the least-squares problem."""
    kernels, prior = library(record.rig.vibration.law), prior_of(record)
    problem = Problem(kernels, record, prior)
    rigid = record.rig.vertical == "rigid"
    if rigid:
        sides = [side_of(record, touch) for touch in record.touches]
        starts = rigid_starts(record, prior, sides)
    else:
        starts = float_starts(record, prior)
    starts = [start for start in starts if start.cost < HOPELESS_START * starts[0].cost]
    fits = _distinct([_refined(problem, start.c, start.p, STAGES[record.rig.vertical][:-1]) for start in starts])
    fits = [fit for fit in fits if fit.cost < HOPELESS * fits[0].cost]
    fits = _distinct([_refined(problem, fit.c, fit.p, (UNSOFTENED,)) for fit in fits])
    if not fits:
        raise TooLittleError(*NO_MOTION)
    problem = with_model_forces(problem, kernels, fits[0])
    refined = [problem.fit(fit.c, fit.p) for fit in fits]
    if not rigid and record.rig.vibration.law == "sign_pairs":
        best = min(refined, key=lambda fit: fit.cost)
        refined += [problem.fit(best.c, _with_more_friction(best.p, prior, more)) for more in FRICTION_FACTORS]
    return _distinct(refined), problem


def _with_more_friction(p: FloatArray, prior: ConstantsPrior, factor: float) -> FloatArray:
    """Start with μ and V larger by a factor, which slow slip does not distinguish, and λ from the prior."""
    p = p.copy()
    p[P.SATURATION] /= factor**2
    p[P.TRANSMISSION] = prior.mean[P.TRANSMISSION]
    return p


def _refined(problem: Problem, c: FloatArray, p: FloatArray, stages: Sequence[Softening]) -> PivotFit:
    """Fit through these stages of softening, each from the minimum of the one before."""
    fit = problem.fit(c, p, stages[0], EARLY_ITERATIONS if stages[0] is not UNSOFTENED else MAX_ITERATIONS)
    if len(stages) == 1 or not math.isfinite(fit.cost):
        return fit
    return _refined(problem, fit.c, fit.p, stages[1:])


def _distinct(fits: Sequence[PivotFit]) -> list[PivotFit]:
    """Distinct minima, the best first."""
    kept: list[PivotFit] = []
    for fit in sorted((fit for fit in fits if math.isfinite(fit.cost)), key=lambda fit: fit.cost):
        if all(float(np.abs(fit.c - other.c).max()) > SAME_RAD for other in kept):
            kept.append(fit)
    return kept


def _answer(problem: Problem, fits: Sequence[PivotFit]) -> PivotReconstruction:
    best, record = fits[0], problem.record
    theta = directions()
    rows = record.readings
    normals = [normal_of(record.motion(best.c, rows)[touch.contains(rows.t), 0])[:, None] for touch in record.touches]
    touched = np.logical_or.reduce([touched_by(each) for each in normals])
    coefficients = best.p[P.SHAPE :]
    h = shape.basis(theta, ORDER) @ coefficients
    try:
        covariance = problem.covariance(best)
        moves = rig_error_modes(problem, best)
    except np.linalg.LinAlgError:
        raise TooLittleError(Code.NOT_CONVERGED, "the fit did not converge to a minimum") from None
    sd_known_rig = gauge_free_sd(
        theta,
        theta[touched],
        coefficients,
        conditional_covariance(covariance, slice(P.ZERO, P.SHAPE), slice(P.SHAPE, None)),
    )
    covariance = covariance + moves @ moves.T
    h_sd = gauge_free_sd(theta, theta[touched], coefficients, covariance[P.SHAPE :, P.SHAPE :])
    reason = _rejection_reason(record, best, fits[1:], theta, h, h_sd, touched)
    outline_sd_m = float(np.sqrt(np.mean(sd_known_rig[touched] ** 2)))
    if not reason and outline_sd_m > MOST_SD_M:
        reason = Reason(Code.UNDETERMINED, "the readings determine too little of the outline")
    p = best.p
    sd = np.sqrt(np.diagonal(covariance))
    mu, mu_sd = _ratio_of(covariance, [P.DRAG, P.SATURATION], p, lambda q: q[0] / math.sqrt(q[1]))
    has_mass = record.rig.vertical == "float" and len(record.forces.t) > 0
    moment = slice(P.MOMENT, P.MOMENT + 2)
    com = com_sd = None
    inertia = inertia_sd = math.nan
    if has_mass:
        along = [_ratio_of(covariance, [P.MOMENT + i, P.MASS], p, lambda q: q[0] / q[1]) for i in range(2)]
        com, com_sd = np.array(along).T
        inertia, inertia_sd = _ratio_of(covariance, [P.INERTIA, P.MASS], p, lambda q: q[0] / q[1])
    motion = record.motion(_unwound(best.c, record), rows)
    accepted = not reason
    return PivotReconstruction(
        converged=accepted, chi2=best.chi2, theta=theta,
        h=h if accepted else None, h_sd=h_sd if accepted else None, touched=touched if accepted else None,
        mu=mu, mu_sd=mu_sd, com=com, com_sd=com_sd, inertia=inertia, inertia_sd=inertia_sd,
        mass=p[P.MASS] if has_mass else math.nan, mass_sd=sd[P.MASS] if has_mass else math.nan,
        moment=p[moment], moment_sd=sd[moment], inertia_kg=p[P.INERTIA], inertia_kg_sd=sd[P.INERTIA],
        t=rows.t, psi=motion[:, 0], omega0=motion[:, 1], reason=reason,
        p=p, covariance=covariance, outline_sd_m=outline_sd_m,
    )  # fmt: skip


def _unwound(c: FloatArray, record: PivotRecord) -> FloatArray:
    """Shift the splines by whole turns to be nearest to the end of the one before."""
    c = c.copy()
    for before, touch in itertools.pairwise(record.touches):
        step = c[touch.coefficients][1] - c[before.coefficients][-2]
        c[touch.coefficients] -= math.tau * round(step / math.tau)
    return c


def _rejection_reason(
    record: PivotRecord,
    best: PivotFit,
    rivals: Sequence[PivotFit],
    theta: FloatArray,
    h: FloatArray,
    h_sd: FloatArray,
    touched: npt.NDArray[np.bool_],
) -> Reason:
    """Why the best fit is rejected; none if it is accepted."""
    if (h + OUTSIDE_SIGMAS * h_sd < 0.0).any():
        return Reason(Code.PIVOT_MISPLACED, "the pivot would lie outside the body: z contradicts the readings")
    rig = record.rig
    readings, forces = len(record.readings.t), len(record.forces.t)
    tests = [
        best.chi2 < 1.0 + CHI2_TOLERANCE + CHI2_SIGMAS * math.sqrt(2.0 / readings),
        best.height_chi2 < HEIGHT_CHI2[rig.vertical],
        not forces or best.force_chi2 < 1.0 + FORCE_CHI2_TOLERANCE + CHI2_SIGMAS * math.sqrt(2.0 / forces),
        best.torque_chi2 < TORQUE_CHI2,
    ]
    if not all(tests):
        figures = f"chi2 {best.chi2:.2f}, of the heights {best.height_chi2:.2f}, of the forces {best.force_chi2:.2f}"
        text = f"z or force contradict the readings, or the body is not rigid: {figures}"
        return Reason(Code.UNEXPLAINED, text)
    if not best.converged:
        return Reason(Code.NOT_CONVERGED, "the iteration has not converged")
    if best.outliers > MOST_OUTLIERS:
        return Reason(Code.OUTLIERS, f"{best.outliers:.0%} of the readings are outliers")
    if rig.vertical == "rigid":
        t, e = record.readings.t, record.readings.value - record.readings.inputs[:, U.X]
        sides = np.sign([np.median(e[touch.contains(t)]) for touch in record.touches])
        if abs(sides.sum()) == len(sides):
            return ONE_SIDE
        if not forces:
            text = "the pad gives no force, which is needed to relate both sides of the dead centre"
            return Reason(Code.NO_FORCE, text)
    curvature = shape.basis(theta, ORDER) @ (best.p[P.SHAPE :] * (1 - shape.harmonic_of_coefficient(ORDER) ** 2))
    if curvature[touched].min() < -HOLLOW_M:
        return Reason(Code.IMPOSSIBLE, "only a hollow outline explains the readings")
    for rival in rivals:
        if rival.cost < best.cost + AMBIGUOUS_COST and _differs(theta, touched, h, rival):
            return Reason(Code.AMBIGUOUS, "another outline explains the readings as well")
    return NO_REASON


def _differs(theta: FloatArray, touched: npt.NDArray[np.bool_], h: FloatArray, rival: PivotFit) -> bool:
    """Whether a rival's outline is different."""
    difference = _outline_difference(theta, h, shape.basis(theta, ORDER) @ rival.p[P.SHAPE :], touched)[touched]
    return float(np.sqrt(np.mean(difference**2))) > SAME_M


def _ratio_of(
    covariance: FloatArray, at: list[int], p: FloatArray, ratio: Callable[[FloatArray], float]
) -> tuple[float, float]:
    """A function of the constants `at`, and its 1σ."""
    q = p[at]
    value = ratio(q)
    steps = np.diag(1e-5 * np.abs(q) + 1e-12)
    gradient = np.array([(ratio(q + d) - ratio(q - d)) / (2 * d[i]) for i, d in enumerate(steps)])
    return value, math.sqrt(max(float(gradient @ covariance[np.ix_(at, at)] @ gradient), 0.0))
