"""A whole record of three palms: the body's shape and motion from a blind start, or an honest refusal."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.blas import one_thread
from palmd.events import FloatArray
from palmd.model.icosphere import icosphere
from palmd.model.spherical import Y00, evaluator, order_of
from palmd.model.three_palms import BODY
from palmd.observer.three_palms import beliefs
from palmd.observer.three_palms.body import FINER, centres_of, inertia
from palmd.observer.three_palms.driven import ContactCurves
from palmd.observer.three_palms.path import JointPath
from palmd.observer.three_palms.propagation import HOLLOW_CHI2, MOST_COST, MOST_LAMBDA, Grown, best
from palmd.observer.three_palms.record import PadReadings
from palmd.observer.three_palms.search import Task
from palmd.observer.three_palms.touched_outline import everywhere, near
from palmd.system.three_palms import GAP_S, PALMS, ThreePalmsRig

LEAST_S = 2.5
MOST_CHI2 = beliefs.EXPLAINED_CHI2
SHARP_M = 7e-5
PROVEN, PROVEN_M = 2.0, 1e-4
"""Cost per number read, and one-sigma of what was touched, that a live body may have which has foretold for long."""
ALONE = "no second start has come to the same motion yet"


@dataclass(frozen=True, slots=True)
class BodyReconstruction:
    """What a record tells; SI units, NaN or None where there is no value. See `docs/theory/three-palms.md`.

    directions (D, 3), triangles (F, 3) between them, h, h_sd, touched (D,); points: (D, 3) of the surface with these
    outward normals, made convex where it was not felt; coefficients: of h, as in `model.spherical`; inertia (3, 3) per
    unit mass; the trajectory t (K,), R (K, 3, 3), omega (K, 3), centre (K, 3), contacts (K, 3 palms, 3) on the body, in
    its own frame. That frame has its origin at the centre of mass, and R = 1 at the first node. `reason`: why not, when
    not `converged`.
    """

    converged: bool
    reason: str
    chi2: float
    directions: FloatArray
    triangles: npt.NDArray[np.int64]
    h: FloatArray | None
    h_sd: FloatArray | None
    touched: npt.NDArray[np.bool_] | None
    points: FloatArray | None
    coefficients: FloatArray | None
    inertia: FloatArray | None
    inertia_sd: FloatArray | None
    mu: float
    mu_sd: float
    mass: float
    mass_sd: float
    t: FloatArray
    R: FloatArray
    omega: FloatArray
    centre: FloatArray
    contacts: FloatArray
    seconds: float


@one_thread()
def reconstruct(path: JointPath, readings: PadReadings, rig: ThreePalmsRig) -> BodyReconstruction:
    """Smooth the longest stretch in which all three palms feel the body. Never raises for what the readings say."""
    begun = time.perf_counter()
    start, end = longest_stretch(path, readings)
    if end - start < LEAST_S:
        return _nothing(f"there are no {LEAST_S:g} s in which all three pads and the joints report", begun)
    inside = readings.within(start, end)
    task = Task(path, inside, ContactCurves.smoothed(inside), rig, start, end, FINER)
    ended = best(task)
    if not ended:
        return _nothing("no motion of a body was found that explains the first readings", begun)
    return answer(task, ended, begun)


def longest_stretch(path: JointPath, readings: PadReadings) -> tuple[float, float]:
    """(start, end) (s) of the longest time in which no pad is silent for long."""
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


def answer(task: Task, ended: Sequence[Grown], begun: float) -> BodyReconstruction:
    """What the best of the rivals says, and whether it may be believed."""
    first = ended[0]
    fit, record, p = first.whole, first.record, first.motion.p
    n = len(p) - BODY
    order = order_of(n)
    directions, triangles = icosphere()
    point_rows = everywhere(order)[1]
    try:
        covariance: FloatArray = np.asarray(np.linalg.inv(fit.arrow.information()), np.float64)
    except np.linalg.LinAlgError:
        return _nothing("the fit is not a minimum", begun, fit.chi2)
    p, hollow = first.made_convex(p, covariance)
    R, felt = fit.motion.R, first.felt
    touched = near(felt)
    h, sd = surface(p, covariance, touched, fit.chi2, beliefs.missed_sd(task.noise.reading, first.unexplained()))
    mass, mass_sd = mass_of(task.rig, first)
    own, own_sd = inertia(p), inertia_sd(p, covariance)
    return BodyReconstruction(
        converged=not (reason := doubt(task, ended, sd[touched], hollow)),
        reason=reason, chi2=fit.chi2, directions=directions, triangles=triangles,
        h=h, h_sd=sd, touched=touched, coefficients=p[:n],
        points=within(point_rows @ p[:n], directions, h),
        inertia=own, inertia_sd=own_sd, mu=float(p[-2]), mu_sd=float(np.sqrt(covariance[-2, -2])),
        mass=mass, mass_sd=mass_sd, t=record.t, R=R, omega=fit.motion.omega,
        centre=centres_of(R, record.node_palms, p), contacts=(evaluator(order)(felt)[1] @ p[:n]).reshape(-1, 3, 3),
        seconds=time.perf_counter() - begun,
    )  # fmt: skip


def surface(
    p: FloatArray, covariance: FloatArray, touched: npt.NDArray[np.bool_], chi2: float, centre_sd: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """(D,) h in all directions and its one-sigma (m), turns of the body's frame left out of it.

    covariance: (m, m) of the parameters p; chi2: per number read, by which it is widened where above 1. What is above
    is no noise of each number but what harmonics leave out, alike in many in a row: those tell as much as one.
    centre_sd: of the centre of mass besides (m), from which all heights count.
    """
    directions, _ = icosphere()
    n = len(p) - BODY
    order = order_of(n)
    rows, point_rows = everywhere(order)
    form = without_turns(rows, np.cross(directions, point_rows @ p[:n]), touched)
    sd = np.sqrt(np.maximum(((form @ covariance[:n, :n]) * form).sum(axis=1), 0.0))
    beyond = beliefs.beyond_sd(Y00 * p[0], order, touched, chi2)
    alike = 1.0 + beliefs.NUMBERS_ALIKE * max(chi2 - 1.0, 0.0)
    return rows @ p[:n], np.asarray(np.sqrt(alike * sd**2 + beyond**2 + centre_sd**2), np.float64)


def within(points: FloatArray, directions: FloatArray, h: FloatArray) -> FloatArray:
    """Points (D, 3) drawn in towards the centre of mass as far as the planes n·x ≤ h of all `directions` ask.

    Nothing is drawn in where the body is convex; where nothing was felt, ∇H of a support function that is a mere belief
    may fold over.
    """
    out = np.ones(len(points))
    for part in np.array_split(np.arange(len(points)), 8):
        out[part] = np.maximum((points[part] @ directions.T / h).max(axis=1), 1.0)
    return np.asarray(points / out[:, None], np.float64)


def without_turns(rows: FloatArray, turns: FloatArray, touched: npt.NDArray[np.bool_]) -> FloatArray:
    """Rows (D, n) of h after the turn of the body's frame, (D, 3) by its vector, that changes it least where touched.

    The frame is gauge: by how much the body as a whole is turned in it is no error of its form.
    """
    undone = np.linalg.lstsq(turns[touched], rows[touched], rcond=None)[0]
    return np.asarray(rows - turns @ undone, np.float64)


def doubt(task: Task, ended: Sequence[Grown], sd: FloatArray, hollow: float, *, proven: bool = False) -> str:
    """Why the first of the rivals is not to be believed; empty if it is.

    sd: (T,) one-sigma of what was touched (m). hollow: χ² of what makes it convex there. proven: it has foretold for
    long what came: what more it costs is truncation.
    """
    first = ended[0]
    most_chi2, most_cost, most_sd = (PROVEN, PROVEN, PROVEN_M) if proven else (MOST_CHI2, MOST_COST, SHARP_M)
    if first.record.t[-1] < task.end - 0.1:
        return f"what explains the first readings fails after {first.record.t[-1] - task.start:.1f} s"
    if first.whole.chi2 > most_chi2:
        return "the readings are not explained to their noise"
    if first.per_number > most_cost:
        return "no motion by the equations explains the readings"
    if any(each.contradicts(first) for each in ended[1:]):
        return "another motion explains the readings as well"
    if first.alone and not proven:
        return ALONE
    if first.largest_lambda > MOST_LAMBDA:
        return "only an inertia that no such body has explains the readings"
    if hollow > HOLLOW_CHI2:
        return "only a hollow body explains the readings"
    if float(np.sqrt(np.mean(sd**2))) > most_sd:
        return "the readings tell too little of the shape"
    return ""


def mass_of(rig: ThreePalmsRig, rival: Grown) -> tuple[float, float]:
    """Mass and its one-sigma (kg) by the forces read, NaN without them."""
    record, readings = rival.record, rival.record.readings
    told = np.isfinite(readings.force)
    if not told.any():
        return math.nan, math.nan
    k, share, pad = record.interval[told], record.share[told], readings.pad[told]
    force = rival.whole.force
    per_mass = (1 - share) * force[k, pad] + share * force[k + 1, pad]
    good = per_mass > 0.1
    ratio = readings.force[told][good] / per_mass[good]
    mass, scatter = float(np.mean(ratio)), rig.pad.force_scale_std
    return mass, mass * scatter / math.sqrt(len(ratio))


def inertia_sd(p: FloatArray, covariance: FloatArray) -> FloatArray:
    """(3, 3) one-sigma of the inertia's entries (m²)."""
    index = np.array([0, *range(len(p) - BODY, len(p) - BODY + 6)])
    slopes = []
    for i in index:
        step = 1e-4 * (abs(p[i]) if i == 0 else 1.0)
        moved = [inertia(p + sign * step * (np.arange(len(p)) == i)) for sign in (1.0, -1.0)]
        slopes.append((moved[0] - moved[1]) / (2 * step))
    J = np.stack(slopes)
    return np.asarray(np.sqrt(np.einsum("aij,ab,bij->ij", J, covariance[np.ix_(index, index)], J)))


def _nothing(reason: str, begun: float, chi2: float = math.nan) -> BodyReconstruction:
    none, nan = np.zeros((0, 3)), math.nan
    return BodyReconstruction(
        False, reason, chi2, *icosphere(), None, None, None, None, None, None, None, nan, nan, nan, nan,
        np.zeros(0), np.zeros((0, 3, 3)), none, none, np.zeros((0, 3, 3)), time.perf_counter() - begun,
    )  # fmt: skip
