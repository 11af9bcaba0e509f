"""Reconstruct an outline with flat sides and corners: fit, bands and tests."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model import sharp
from palmd.model.shape import coefficients_of
from palmd.model.sharp import LENGTHS, NORMALS, SIDES, WIDTH
from palmd.model.smoothing import ORDER, RIG, C
from palmd.observer.factor import conditional_covariance, friction_of
from palmd.observer.flat_side_fits import LEAST_S, Candidate
from palmd.observer.flat_side_search import FlatSideSearch, in_order
from palmd.observer.normal_equations import Guess
from palmd.observer.outline import directions, normal_angles, rms_sd, sd_of, touched_within
from palmd.observer.reconstruction import Reconstruction
from palmd.observer.record import concatenated_records
from palmd.observer.rounded_polygon_reconstruct import rounded_polygon_reconstruction
from palmd.observer.search import Search, explained, nothing_moves
from palmd.observer.shape_classification import root_of, shape_class
from palmd.observer.validity import SHARP_M
from palmd.observer.visits import visits_of

LEAST_SIDE_M = 1e-3  # shorter sides do not count
MOST_CHI2, MOST_OUTLIERS = 1.15, 0.05  # of the readings; outliers occur while contacts jump
MOST_PRIOR_COST = 40.0  # prior cost; right outlines have 5 to 30
# RMS difference of another outline; twice the log-likelihood by which a rival may be worse and still count
DIFFERENT_M, DOUBT = 1e-4, 25.0
MOST_PROCESS_COST = 0.02  # process cost per contact reading; with more, impacts explain what the outline does not
MOST_STRETCHES = 2  # explained parts of a segment that are used, longest first
# Model error of h and overconfidence, from simulations: jumping contacts and the width of a side are not noise.
MODEL_SD_M, OVERCONFIDENCE = 6e-6, 1.5
# Of the difference to nodes twice as far apart: about a quarter of the error remains (docs/theory/sides.md).
NODE_ERROR_LEFT = 1 / 3


def sharp_reconstruction(
    search: Search,
    seed: int,
    started: float,
    say: Callable[[str], None] | None = None,
    others: Sequence[Search] = (),
) -> Reconstruction | None:
    """The outline with flat sides that explains the longest explained part of the segment of `search`.

    With contact-mode segments of the same object in the segments of `others`. None where no result is certain.
    started: when the reconstruction was started (`time.perf_counter`). say: called with the progress.
    """
    if nothing_moves(search.record) or search.segment.lasts < LEAST_S:
        return None
    sided = FlatSideSearch(search, seed, others)
    segment = search.segment

    def report(candidate: Candidate) -> None:
        until = candidate.record.t[-1] - segment.start
        if say is not None:
            say(f"looking for flat sides: {until:.1f} of {segment.lasts:.1f} s")

    result = rounded_polygon_reconstruction(search, sided.record, sided.segments, started)
    if result is not None:
        return result

    def candidates() -> Iterator[tuple[Candidate, ...]]:
        yield from sided.segment_fits()
        for stretch in sided.stretches(report)[:MOST_STRETCHES]:
            yield stretch
            yield from sided.halved(stretch)

    for found in candidates():
        other: Candidate | None = found[0]  # the previous fit, on nodes farther apart
        for best in sided.refined(found[0]):
            if not _is_doubtful(best, found):
                result = _result(best, other, sided, search, started)
                if result is not None:
                    return result
            other = best if best.explains else None  # the next fit has nodes farther apart
    return None


def explained_smoothly(search: Search, result: Reconstruction, others: Sequence[Search] = ()) -> bool:
    """Whether a smooth outline explains the same readings as `result`, started from that motion and outline.

    With the rig as described, or with its constants opened. result: of the segments of `search` and `others`.
    """
    assert result.h is not None  # an accepted result has an outline
    record = concatenated_records([each.record for each in in_order(search, others)]).within(result.spans)
    psi, omega0 = (np.interp(record.t, result.t, each) for each in (result.psi, result.omega0))
    p = search.prior.mean.copy()
    dither = math.exp(p[C.SATURATION])
    p[C.LN_RHO], p[C.DRAG], p[C.SATURATION] = math.log(result.rho), result.mu / dither, dither**-2.0
    if math.isfinite(result.mass):
        p[C.LN_MASS] = math.log(result.mass)
    p[RIG], p[C.SHAPE :] = result.rig, coefficients_of(result.h, ORDER)
    guess = Guess(np.stack([psi - psi[0], omega0], axis=1), p)
    for belief in (search.belief, search.belief.suspended()):
        found = search.with_belief(belief).minima(record, [guess])
        if explained(found.fits[0], found.record):
            return True
    return False


def _is_doubtful(best: Candidate, found: tuple[Candidate, ...]) -> bool:
    """Whether the fit fails a test or has a rival."""
    fit = best.fit
    likely = fit.prior_cost < MOST_PRIOR_COST and fit.outliers < MOST_OUTLIERS
    explained = fit.chi2 < MOST_CHI2 and fit.force_chi2 < MOST_CHI2
    if not (best.explains and fit.settled and likely and explained):
        return True
    if (
        fit.process_cost > MOST_PROCESS_COST * len(best.record.contact_value)
        or not (fit.guess.p[LENGTHS:WIDTH] > LEAST_SIDE_M).any()
    ):
        return True
    theta = directions()
    h = sharp.support(theta, found[0].fit.guess.p)
    touched = touched_within(found[0].record, found[0].fit.guess.x[:, 0])
    return any(
        other.deviance < found[0].deviance + DOUBT
        and np.sqrt(np.mean((sharp.support(theta, other.fit.guess.p) - h)[touched] ** 2)) > DIFFERENT_M
        for other in found[1:]
    )


def _result(
    best: Candidate, other: Candidate | None, sided: FlatSideSearch, search: Search, started: float
) -> Reconstruction | None:
    """The result; None where `best` is no minimum or too uncertain. Its band includes the change from `other`."""
    try:
        covariance = OVERCONFIDENCE**2 * sided.fits.posterior(best).covariance
    except np.linalg.LinAlgError:
        return None
    fit, record = best.fit, best.record
    p, x = fit.guess.p, fit.guess.x
    normals = normal_angles(record.palms, x[:, 0])
    theta, touched = directions(), touched_within(record, x[:, 0])
    h = sharp.support(theta, p)
    rows, shape = sharp.outline_rows(theta, p), slice(C.SHAPE, len(p))
    free = _gauge_free(theta, touched, p, rows)
    node_difference = np.zeros(len(theta))
    if other is not None:
        node_difference = _gauge_free(theta, touched, p, (h - sharp.support(theta, other.fit.guess.p))[:, None])[:, 0]
        node_difference *= NODE_ERROR_LEFT if len(record.t) > len(other.record.t) else 1.0
    model_sd = np.hypot(MODEL_SD_M, node_difference)
    h_sd, conditional_sd = (
        np.hypot(sd_of(free, each), model_sd)
        for each in (covariance[shape, shape], conditional_covariance(covariance, RIG, shape))
    )
    if rms_sd(conditional_sd, touched) > SHARP_M:
        return None
    mu, mu_sd = friction_of(p, covariance)
    sd = np.sqrt(np.diagonal(covariance))
    rho = math.exp(p[C.LN_RHO])
    has_forces = len(record.force_value) > 0
    mass = math.exp(p[C.LN_MASS]) if has_forces else math.nan
    radii = [sharp.support(each, p) for each in normals.T]
    visits = np.sum([visits_of(part) for part in np.split(normals, record.gap_steps + 1)], axis=0)
    return Reconstruction(
        converged=True, chi2=fit.chi2,
        theta=theta, h=h, h_sd=h_sd, touched=touched, visits=visits,
        rho=rho, rho_sd=rho * float(sd[C.LN_RHO]), mu=mu, mu_sd=mu_sd,
        mass=mass, mass_sd=mass * float(sd[C.LN_MASS]), rig=p[RIG], rig_covariance=covariance[RIG, RIG],
        contradicted=search.belief.contradicted, rig_prior_sd=search.belief.sd,
        t=record.t, psi=x[:, 0], omega0=x[:, 1], radii=np.stack(radii),
        seconds=time.perf_counter() - started,
        turned_sd=math.nan if len(record.gap_steps) else float(sd[len(p)]),
        sides=sides_of(p, covariance),
        shape_class=shape_class(theta, h, root_of(rows, covariance[shape, shape]), touched),
    )  # fmt: skip


def _gauge_free(theta: FloatArray, touched: npt.NDArray[np.bool_], p: FloatArray, rows: FloatArray) -> FloatArray:
    """Change of h on `theta` by `rows` (n, k), after the rotation that fits the `touched` normals best."""
    step = 1e-4
    slope = (sharp.support(theta + step, p) - sharp.support(theta - step, p)) / (2 * step)
    slope_touched = slope[touched]
    turn = slope_touched @ rows[touched] / max(float(slope_touched @ slope_touched), 1e-30)
    gauge_free: FloatArray = rows - np.outer(slope, turn)
    return gauge_free


def sides_of(p: FloatArray, covariance: FloatArray) -> FloatArray:
    """Normal (rad), length and its 1σ (m) of each flat side, one a row."""
    sd = np.sqrt(np.diagonal(covariance))
    rows = [
        (math.remainder(p[NORMALS + j], math.tau), p[LENGTHS + j], sd[LENGTHS + j])
        for j in range(SIDES)
        if p[LENGTHS + j] > LEAST_SIDE_M
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 3)
