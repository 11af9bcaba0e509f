"""What a record tells of an outline with flat sides and corners: fit, bands and doubts, as `reconstruct` gives them."""

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
from palmd.observer.cornered_reconstruct import cornered_reconstruction
from palmd.observer.factor import friction_of, given
from palmd.observer.normal_equations import Guess
from palmd.observer.outline import directions, normal_angles, sd_of, touched_within
from palmd.observer.reconstruction import Reconstruction
from palmd.observer.record import joined
from palmd.observer.search import Search, explained, still
from palmd.observer.shape_classification import root_of, shape_class
from palmd.observer.sided import SidedSearch, in_order
from palmd.observer.sided_fits import LEAST_S, Candidate
from palmd.observer.validity import SHARP_M
from palmd.observer.visits import visits_of

LEAST_SIDE_M = 1e-3  # a shorter side is none
MOST_CHI2, MOST_OUTLIERS = 1.15, 0.05  # of the readings, while contacts jump
MOST_STRAIN_TOLD = 40.0  # of the cost, by the prior: outlines that are right have 5 to 30
DIFFERENT_M, DOUBT = 1e-4, 25.0
MOST_SLACK = 0.02  # of the cost, for each contact reading: more, and blows explain what the outline does not
MOST_STRETCHES = 2  # of a segment that are looked at, longest first
# What simulated outlines are off by besides: neither contacts that jump nor the width of a side is noise.
MODEL_SD_M, OVERCONFIDENCE = 6e-6, 1.5
# Of what nodes twice as far apart tell otherwise: about a quarter of the error is left (docs/theory/sides.md).
LEFT = 1 / 3


def sharp_reconstruction(
    search: Search,
    seed: int,
    begun: float,
    say: Callable[[str], None] | None = None,
    others: Sequence[Search] = (),
) -> Reconstruction | None:
    """The outline with flat sides that explains the longest part of the segment of `search` that one explains.

    Where the object rides as well in the segments of `others`, of these too. None where none does beyond doubt. `say`
    is told how far the search has come.
    """
    if still(search.record) or search.segment.lasts < LEAST_S:
        return None
    sided = SidedSearch(search, seed, others)
    segment = search.segment

    def followed(so_far: Candidate) -> None:
        until = so_far.record.t[-1] - segment.start
        if say is not None:
            say(f"looking for flat sides: {until:.1f} of {segment.lasts:.1f} s")

    told = cornered_reconstruction(search, sided.record, sided.rides, begun)
    if told is not None:
        return told

    def longest() -> Iterator[tuple[Candidate, ...]]:
        yield from sided.ridden()
        for stretch in sided.stretches(followed)[:MOST_STRETCHES]:
            yield stretch
            yield from sided.halved(stretch)

    for found in longest():
        other: Candidate | None = found[0]  # on nodes farther apart than those of what comes first
        for best in sided.refined(found[0]):
            if not _doubtful(best, found):
                told = _told(best, other, sided, search, begun)
                if told is not None:
                    return told
            other = best if best.explains else None  # and may not be told: the next has nodes farther apart
    return None


def explained_smoothly(search: Search, told: Reconstruction, others: Sequence[Search] = ()) -> bool:
    """Whether a smooth outline explains what `told` does as well, begun from that motion and outline.

    On a rig as it is taken for, or on any. told: of the segments of `search` and `others`.
    """
    assert told.h is not None  # of what is claimed
    record = joined([each.record for each in in_order(search, others)]).within(told.spans)
    psi, omega0 = (np.interp(record.t, told.t, each) for each in (told.psi, told.omega0))
    p = search.prior.mean.copy()
    dither = math.exp(p[C.SATURATION])
    p[C.LN_RHO], p[C.DRAG], p[C.SATURATION] = math.log(told.rho), told.mu / dither, dither**-2.0
    if math.isfinite(told.mass):
        p[C.LN_MASS] = math.log(told.mass)
    p[RIG], p[C.SHAPE :] = told.rig, coefficients_of(told.h, ORDER)
    guess = Guess(np.stack([psi - psi[0], omega0], axis=1), p)
    for belief in (search.belief, search.belief.suspended()):
        found = search.believing(belief).minima(record, [guess])
        if explained(found.fits[0], found.record):
            return True
    return False


def _doubtful(best: Candidate, found: tuple[Candidate, ...]) -> bool:
    fit = best.fit
    likely = fit.strain < MOST_STRAIN_TOLD and fit.outliers < MOST_OUTLIERS
    explained = fit.chi2 < MOST_CHI2 and fit.force_chi2 < MOST_CHI2
    if not (best.explains and fit.settled and likely and explained):
        return True
    if fit.slack > MOST_SLACK * len(best.record.contact_value) or not (fit.guess.p[LENGTHS:WIDTH] > LEAST_SIDE_M).any():
        return True
    theta = directions()
    h = sharp.support(theta, found[0].fit.guess.p)
    touched = touched_within(found[0].record, found[0].fit.guess.x[:, 0])
    return any(
        other.deviance < found[0].deviance + DOUBT
        and np.sqrt(np.mean((sharp.support(theta, other.fit.guess.p) - h)[touched] ** 2)) > DIFFERENT_M
        for other in found[1:]
    )


def _told(
    best: Candidate, other: Candidate | None, sided: SidedSearch, search: Search, begun: float
) -> Reconstruction | None:
    """None where `best` is no minimum, or tells too little; by how much `other` nodes tell otherwise is in the band."""
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
    left = np.zeros(len(theta))
    if other is not None:
        left = _gauge_free(theta, touched, p, (h - sharp.support(theta, other.fit.guess.p))[:, None])[:, 0]
        left *= LEFT if len(record.t) > len(other.record.t) else 1.0
    model_sd = np.hypot(MODEL_SD_M, left)
    h_sd, told_sd = (
        np.hypot(sd_of(free, each), model_sd) for each in (covariance[shape, shape], given(covariance, RIG, shape))
    )
    if float(np.sqrt(np.mean(told_sd[touched] ** 2))) > SHARP_M:
        return None
    mu, mu_sd = friction_of(p, covariance)
    sd = np.sqrt(np.diagonal(covariance))
    rho = math.exp(p[C.LN_RHO])
    weighed = len(record.force_value) > 0
    mass = math.exp(p[C.LN_MASS]) if weighed else math.nan
    radii = [sharp.support(each, p) for each in normals.T]
    visits = np.sum([visits_of(part) for part in np.split(normals, record.torn + 1)], axis=0)
    return Reconstruction(
        converged=True, chi2=fit.chi2,
        theta=theta, h=h, h_sd=h_sd, touched=touched, visits=visits,
        rho=rho, rho_sd=rho * float(sd[C.LN_RHO]), mu=mu, mu_sd=mu_sd,
        mass=mass, mass_sd=mass * float(sd[C.LN_MASS]), rig=p[RIG], rig_covariance=covariance[RIG, RIG],
        contradicted=search.belief.contradicted, rig_prior_sd=search.belief.sd,
        t=record.t, psi=x[:, 0], omega0=x[:, 1], radii=np.stack(radii),
        reason="", seconds=time.perf_counter() - begun, turned_sd=math.nan if len(record.torn) else float(sd[len(p)]),
        sides=sides_of(p, covariance),
        shape_class=shape_class(theta, h, root_of(rows, covariance[shape, shape]), touched),
    )  # fmt: skip


def _gauge_free(theta: FloatArray, touched: npt.NDArray[np.bool_], p: FloatArray, rows: FloatArray) -> FloatArray:
    """What `rows` (n, k) change of h on `theta`, after the rotation that fits the `touched` normals best."""
    step = 1e-4
    slope = (sharp.support(theta + step, p) - sharp.support(theta - step, p)) / (2 * step)
    there = slope[touched]
    turn = there @ rows[touched] / max(float(there @ there), 1e-30)
    free: FloatArray = rows - np.outer(slope, turn)
    return free


def sides_of(p: FloatArray, covariance: FloatArray) -> FloatArray:
    """Normal (rad), length and its one-sigma (m) of each flat side, one a row."""
    sd = np.sqrt(np.diagonal(covariance))
    rows = [
        (math.remainder(p[NORMALS + j], math.tau), p[LENGTHS + j], sd[LENGTHS + j])
        for j in range(SIDES)
        if p[LENGTHS + j] > LEAST_SIDE_M
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 3)
