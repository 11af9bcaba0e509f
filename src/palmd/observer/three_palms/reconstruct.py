"""Reconstruct a body's shape and motion from a whole record of three palms, or reject it with a reason."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from palmd.blas import one_thread
from palmd.events import FloatArray
from palmd.model.icosphere import icosphere
from palmd.model.spherical import Y00, evaluator, order_of
from palmd.model.three_palms import BODY
from palmd.observer.three_palms import beliefs
from palmd.observer.three_palms.body import FINER_ORDERS, centres_of, inertia
from palmd.observer.three_palms.driven import ContactCurves
from palmd.observer.three_palms.path import JointPath
from palmd.observer.three_palms.propagation import (
    HOLLOW_CHI2,
    MOST_COST,
    MOST_LAMBDA,
    BodyHypothesis,
    ranked_hypotheses,
)
from palmd.observer.three_palms.record import PadReadings
from palmd.observer.three_palms.search import Task
from palmd.observer.three_palms.touched_outline import directions_near, outline_rows
from palmd.system.reasons import NO_REASON, Code, Reason
from palmd.system.three_palms import GAP_S, PALMS, ThreePalmsRig

LEAST_S = 2.5  # of a record
MOST_CHI2 = beliefs.EXPLAINED_CHI2
MOST_SD_M = 7e-5  # largest RMS 1σ of the touched surface
PROVEN_COST, PROVEN_SD_M = 2.0, 1e-4
"""Limits of cost and χ² per number read, and of 1σ of the touched surface, for a live hypothesis that is proven: it was
confirmed, and has predicted the readings for long since."""
UNCONFIRMED = Reason(Code.UNCONFIRMED, "the motion is not yet confirmed by an independent restart")


@dataclass(frozen=True, slots=True)
class BodyReconstruction:
    """Estimate from a whole record; SI units, NaN or None for no value. See `docs/theory/three-palms.md`.

    Surface: directions (D, 3), triangles (F, 3) between them, support function h, h_sd and touched (D,); points (D, 3)
    with these outward normals, made convex where untouched; coefficients of h as in `model.spherical`. inertia (3, 3)
    per unit mass. Trajectory: t (K,), R (K, 3, 3), omega (K, 3), centre (K, 3), contacts (K, 3 palms, 3) in the body's
    frame, whose origin is the centre of mass, with R = 1 at the first node. reason: why it was rejected; none if
    `converged`.
    """

    converged: bool
    reason: Reason
    chi2: float = math.nan
    directions: FloatArray = field(default_factory=lambda: icosphere()[0])
    triangles: npt.NDArray[np.int64] = field(default_factory=lambda: icosphere()[1])
    h: FloatArray | None = None
    h_sd: FloatArray | None = None
    touched: npt.NDArray[np.bool_] | None = None
    points: FloatArray | None = None
    coefficients: FloatArray | None = None
    inertia: FloatArray | None = None
    inertia_sd: FloatArray | None = None
    mu: float = math.nan
    mu_sd: float = math.nan
    mass: float = math.nan
    mass_sd: float = math.nan
    t: FloatArray = field(default_factory=lambda: np.zeros(0))
    R: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    omega: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    centre: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    contacts: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    seconds: float = 0.0


@one_thread()
def reconstruct(path: JointPath, readings: PadReadings, rig: ThreePalmsRig) -> BodyReconstruction:
    """Reconstruct from the longest stretch in which all three pads are touched. Never raises for bad readings."""
    started = time.perf_counter()
    return replace(_reconstructed(path, readings, rig), seconds=time.perf_counter() - started)


def _reconstructed(path: JointPath, readings: PadReadings, rig: ThreePalmsRig) -> BodyReconstruction:
    start, end = longest_stretch(path, readings)
    if end - start < LEAST_S:
        text = f"no {LEAST_S:g} s without a gap in the reports of a pad or the joints"
        return BodyReconstruction(False, Reason(Code.TOO_SHORT, text))
    inside = readings.within(start, end)
    task = Task(path, inside, ContactCurves.smoothed(inside), rig, start, end, FINER_ORDERS)
    ended = ranked_hypotheses(task)
    if not ended:
        return BodyReconstruction(False, Reason(Code.UNEXPLAINED, "no motion of a body explains the first readings"))
    return reconstruction_of(task, ended)


def longest_stretch(path: JointPath, readings: PadReadings) -> tuple[float, float]:
    """(start, end) (s) of the longest stretch without a gap of `GAP_S` in any pad's readings."""
    silent: list[tuple[float, float]] = []
    for pad in range(len(PALMS)):
        t = readings.t[readings.pad == pad]
        t = np.concatenate([[path.start - 1.0], t[(t >= path.start) & (t <= path.end)], [path.end + 1.0]])
        gaps = np.flatnonzero(np.diff(t) > GAP_S)
        silent += [(float(t[k]), float(t[k + 1])) for k in gaps]
    best_start, best_end, free = path.start, path.start, path.start
    for begin, over in [*sorted(silent), (path.end, math.inf)]:
        if min(begin, path.end) - free > best_end - best_start:
            best_start, best_end = free, min(begin, path.end)
        free = max(free, over)
    return best_start, best_end


def reconstruction_of(task: Task, ended: Sequence[BodyHypothesis]) -> BodyReconstruction:
    """Estimate of the best hypothesis, `ended[0]`, and whether it is accepted."""
    first = ended[0]
    fit, record, p = first.whole_fit, first.record, first.motion.p
    n = len(p) - BODY
    order = order_of(n)
    try:
        covariance: FloatArray = np.asarray(np.linalg.inv(fit.arrow.information()), np.float64)
    except np.linalg.LinAlgError:
        reason = Reason(Code.NOT_CONVERGED, "the fit did not converge to a minimum")
        return BodyReconstruction(False, reason, fit.chi2)
    p, hollow = first.made_convex(p, covariance)
    R, normals = fit.motion.R, first.touched_normals
    touched = directions_near(normals)
    h, sd = surface(
        p, covariance, touched, fit.chi2, beliefs.unexplained_sd(task.noise.reading, first.excess_cost_per_number())
    )
    mass, mass_sd = mass_of(task.rig, first)
    inertia_p, inertia_p_sd = inertia(p), inertia_sd(p, covariance)
    return BodyReconstruction(
        converged=not (reason := rejection_reason(task, ended, sd[touched], hollow)),
        reason=reason, chi2=fit.chi2,
        h=h, h_sd=sd, touched=touched, coefficients=p[:n],
        points=draw_in(outline_rows(order)[1] @ p[:n], icosphere()[0], h),
        inertia=inertia_p, inertia_sd=inertia_p_sd, mu=float(p[-2]), mu_sd=float(np.sqrt(covariance[-2, -2])),
        mass=mass, mass_sd=mass_sd, t=record.t, R=R, omega=fit.motion.omega,
        centre=centres_of(R, record.node_palms, p), contacts=(evaluator(order)(normals)[1] @ p[:n]).reshape(-1, 3, 3),
    )  # fmt: skip


def surface(
    p: FloatArray, covariance: FloatArray, touched: npt.NDArray[np.bool_], chi2: float, centre_sd: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """(D,) h in all directions and its 1σ (m), rotations of the body's frame excluded.

    covariance: (m, m) of the parameters p. chi2: per number read; the excess over 1 inflates the variance, because it
    comes from truncated harmonics and is correlated over many readings. centre_sd: additional 1σ of the centre of mass
    (m), from which all heights are measured.
    """
    directions, _ = icosphere()
    n = len(p) - BODY
    order = order_of(n)
    rows, point_rows = outline_rows(order)
    shape_rows = remove_rotation(rows, np.cross(directions, point_rows @ p[:n]), touched)
    sd = np.sqrt(np.maximum(((shape_rows @ covariance[:n, :n]) * shape_rows).sum(axis=1), 0.0))
    truncated = beliefs.truncation_sd(Y00 * p[0], order, touched, chi2)
    inflation = 1.0 + beliefs.CORRELATED_NUMBERS * max(chi2 - 1.0, 0.0)
    return rows @ p[:n], np.asarray(np.sqrt(inflation * sd**2 + truncated**2 + centre_sd**2), np.float64)


def draw_in(points: FloatArray, directions: FloatArray, h: FloatArray) -> FloatArray:
    """Scale points (D, 3) towards the centre of mass until they satisfy n·x ≤ h for all `directions`.

    Points of a convex body stay; where nothing was touched, ∇H of an uncertain support function may fold over.
    """
    scale = np.ones(len(points))
    for part in np.array_split(np.arange(len(points)), 8):
        scale[part] = np.maximum((points[part] @ directions.T / h).max(axis=1), 1.0)
    return np.asarray(points / scale[:, None], np.float64)


def remove_rotation(rows: FloatArray, turns: FloatArray, touched: npt.NDArray[np.bool_]) -> FloatArray:
    """Project rotations of the body's frame out of rows (D, n) of h; turns: (D, 3) derivatives of h by a rotation.

    The rotation is the one that minimises the rows where touched. The frame is gauge: a rotation of the whole body in
    it is no error of its shape.
    """
    rotation = np.linalg.lstsq(turns[touched], rows[touched], rcond=None)[0]
    return np.asarray(rows - turns @ rotation, np.float64)


def rejection_reason(
    task: Task, ended: Sequence[BodyHypothesis], sd: FloatArray, hollow: float, *, proven: bool = False
) -> Reason:
    """Why the first hypothesis is rejected; none if it is accepted.

    sd: (T,) 1σ of the touched surface (m). hollow: χ² of the move that makes it convex there. proven: it was confirmed
    and has predicted the readings for long since, so that higher costs are attributed to truncated harmonics.
    """
    first = ended[0]
    most_chi2, most_cost, most_sd = (
        (PROVEN_COST, PROVEN_COST, PROVEN_SD_M) if proven else (MOST_CHI2, MOST_COST, MOST_SD_M)
    )
    if first.record.t[-1] < task.end - 0.1:
        text = f"the motion that explains the first readings fails after {first.record.t[-1] - task.start:.1f} s"
        return Reason(Code.UNEXPLAINED, text)
    if first.whole_fit.chi2 > most_chi2:
        return Reason(Code.UNEXPLAINED, "the readings are not explained to their noise")
    if first.cost_per_number > most_cost:
        text = "no motion that satisfies the equations of motion explains the readings"
        return Reason(Code.UNEXPLAINED, text)
    if any(each.contradicts(first) for each in ended[1:]):
        return Reason(Code.AMBIGUOUS, "another motion explains the readings as well")
    if first.needs_confirmation and not proven:
        return UNCONFIRMED
    if first.largest_lambda > MOST_LAMBDA:
        return Reason(Code.IMPOSSIBLE, "only an impossible inertia explains the readings")
    if hollow > HOLLOW_CHI2:
        return Reason(Code.IMPOSSIBLE, "only a hollow body explains the readings")
    if float(np.sqrt(np.mean(sd**2))) > most_sd:
        return Reason(Code.UNDETERMINED, "the readings determine too little of the shape")
    return NO_REASON


def mass_of(rig: ThreePalmsRig, hypothesis: BodyHypothesis) -> tuple[float, float]:
    """Mass and its 1σ (kg) from force readings; NaN without any."""
    record, readings = hypothesis.record, hypothesis.record.readings
    with_force = np.isfinite(readings.force)
    if not with_force.any():
        return math.nan, math.nan
    k, share, pad = record.interval[with_force], record.share[with_force], readings.pad[with_force]
    force = hypothesis.whole_fit.force
    per_mass = (1 - share) * force[k, pad] + share * force[k + 1, pad]
    pressed = per_mass > 0.1
    ratio = readings.force[with_force][pressed] / per_mass[pressed]
    mass, scatter = float(np.mean(ratio)), rig.pad.force_scale_std
    return mass, mass * scatter / math.sqrt(len(ratio))


def inertia_sd(p: FloatArray, covariance: FloatArray) -> FloatArray:
    """(3, 3) 1σ of the inertia's entries (m²)."""
    index = np.array([0, *range(len(p) - BODY, len(p) - BODY + 6)])
    slopes = []
    for i in index:
        step = 1e-4 * (abs(p[i]) if i == 0 else 1.0)
        moved = [inertia(p + sign * step * (np.arange(len(p)) == i)) for sign in (1.0, -1.0)]
        slopes.append((moved[0] - moved[1]) / (2 * step))
    J = np.stack(slopes)
    return np.asarray(np.sqrt(np.einsum("aij,ab,bij->ij", J, covariance[np.ix_(index, index)], J)))
