"""Model criticism: which of the rig's constants are not what the rig is taken for, and what is believed instead. Pure.

A constant with prior N(0, σ²) that readings tell as v with variance P pulls at its prior by v/σ². Were the prior true
that would have variance (σ² − P)/σ⁴, so z = v/√(σ² − P) is standard normal: of all tests the sharpest against a shift
of this constant alone (the score test; Rao 1948). The one with the largest z is given free, then the next, as long as
one is contradicted: a shift shows in the z of all constants that are told together with it. Where as many others, given
free together, explain the readings nearly as well by their marginal likelihood, it may be these, and they are free too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from palmd.events import FloatArray
from palmd.model.smoothing import RIG, RIG_CONSTANTS
from palmd.observer.normal_equations import Guess
from palmd.observer.smoother import Posterior
from palmd.system.description import AS_CALIBRATED, RigDescription
from palmd.system.rig_constants import prior_sds

CONTRADICTED = 4.0  # z: 1 of 1,000 clean rigs has one of 15 constants beyond it
STILL = 3.0  # and what has been contradicted is still
KNOWN = 1e-7  # one-sigma, in SI units, of what is exactly as described: small, and a number to divide by
RIVAL_NATS, MOST_TOGETHER = 5.0, 3  # of explanations as likely, and of constants that are off at a time
MOST_REVISIONS = 4  # of what is believed of the rig, in one answer
NOISE = 1e-14  # of a precision against the prior's: what is left when one is taken from the other
NOTHING: FloatArray = np.zeros(RIG_CONSTANTS)
FREE_SD: FloatArray = 10.0 * prior_sds(RigDescription().known_to(AS_CALIBRATED))
"""One-sigma of constants that are not what they were taken for."""


@dataclass(frozen=True, slots=True)
class RigBelief:
    """How well the rig's constants are taken to be known, in the order of `model.smoothing.R`; SI units.

    told: their one-sigmas by the rig's description. contradicted: by how many sigmas each is not what it was taken for,
    0 where nothing speaks against that. sd: their one-sigmas to go by.
    """

    told: FloatArray
    contradicted: FloatArray
    sd: FloatArray

    @classmethod
    def of(cls, rig: RigDescription) -> RigBelief:
        """What its description says."""
        told = np.maximum(prior_sds(rig), KNOWN)
        return cls(told, np.zeros(RIG_CONSTANTS), told)

    def suspended(self) -> RigBelief:
        """For the moment nothing is taken at its word."""
        return replace(self, sd=np.maximum(self.told, FREE_SD))

    def after(self, p: FloatArray, posterior: Posterior | None) -> RigBelief:
        """What constants `p` found under this belief leave of it; the same where they are no minimum.

        What they contradict is free, what they no longer contradict is as told.
        """
        if posterior is None:
            return self
        try:
            found = contradicted(p[RIG], posterior.covariance[RIG, RIG], self.sd, self.told, self.contradicted)
        except np.linalg.LinAlgError:
            return self
        return replace(self, contradicted=found, sd=freed(self.told, found))

    def within(self, guess: Guess) -> Guess:
        """A guess with no constant of the rig beyond its one-sigma, to go on from under this belief."""
        p = guess.p.copy()
        p[RIG] = np.clip(p[RIG], -self.sd, self.sd)
        return replace(guess, p=p)


def contradicted(
    values: FloatArray, covariance: FloatArray, sd: FloatArray, believed: FloatArray, before: FloatArray = NOTHING
) -> FloatArray:
    """The z of each constant of the rig that contradicts what is `believed` of it, 0 of the others.

    `values` and `covariance` are the posterior of the rig's constants under a prior of mean 0 and one-sigma `sd`;
    `believed`, from `FREE_SD` on, cannot be contradicted. What did so `before` does down to `STILL`. Raises LinAlgError
    for a covariance that is none.
    """
    scale = 1.0 / np.sqrt(np.diagonal(covariance))
    precision = np.linalg.inv(covariance * np.outer(scale, scale)) * np.outer(scale, scale)
    told, pull = precision - np.diag(sd**-2.0), precision @ values
    limit, found = np.where(before != 0.0, STILL, CONTRADICTED), np.zeros(RIG_CONSTANTS)
    while (fixed := freed(believed, found) < FREE_SD).any():
        z = np.where(fixed, _scores(told, pull, freed(believed, found) ** -2.0), 0.0)
        worst = int(np.argmax(np.abs(z) / limit))
        if abs(z[worst]) < limit[worst]:
            break
        found[worst] = z[worst]
    if found.any():
        return _with_rivals(found, _scores(told, pull, believed**-2.0), told, pull, believed)
    return found


def _with_rivals(
    found: FloatArray, z: FloatArray, told: FloatArray, pull: FloatArray, believed: FloatArray
) -> FloatArray:
    """`found` with those constants that may be off in the place of some of these; their `z` as `believed`."""
    open_to_doubt = np.flatnonzero(believed < FREE_SD)
    size = np.count_nonzero(found)
    if size > MOST_TOGETHER:
        return np.where(believed < FREE_SD, np.where(found != 0.0, found, z), 0.0)
    sets: list[tuple[int, ...]] = list(combinations(open_to_doubt.tolist(), int(size)))
    likely = [_log_likelihood(told, pull, freed(believed, _marked(each)) ** -2.0) for each in sets]
    together, likeliest = found.copy(), max(likely)
    for each, value in zip(sets, likely, strict=True):
        if value > likeliest - RIVAL_NATS:
            for k in each:
                together[k] = found[k] or z[k]
    return together


def _marked(chosen: Iterable[int]) -> FloatArray:
    marks = np.zeros(RIG_CONSTANTS)
    marks[list(chosen)] = 1.0
    return marks


def _log_likelihood(told: FloatArray, pull: FloatArray, prior: FloatArray) -> float:
    """Marginal likelihood of the readings under a prior of these precisions, up to a constant of the readings."""
    scale = 1.0 / np.sqrt(np.diagonal(told) + prior)
    root = np.linalg.cholesky((told + np.diag(prior)) * np.outer(scale, scale))
    solved = np.linalg.solve(root, scale * pull)
    log_determinant = 2.0 * float(np.log(np.diagonal(root)).sum() - np.log(scale).sum())
    return 0.5 * (float(solved @ solved) + float(np.log(prior).sum()) - log_determinant)


def freed(sd: FloatArray, found: FloatArray) -> FloatArray:
    """One-sigmas `sd` of the rig's constants, where those free that were `found` to contradict theirs."""
    return np.where(found != 0.0, np.maximum(sd, FREE_SD), sd)


def _scores(told: FloatArray, pull: FloatArray, prior: FloatArray) -> FloatArray:
    """z of each constant: the readings' information matrix is `told`, their information vector `pull`."""
    scale = 1.0 / np.sqrt(np.diagonal(told) + prior)
    both = (told + np.diag(prior)) * np.outer(scale, scale)
    score = prior * scale * np.linalg.solve(both, scale * pull)
    # prior − prior P prior, written so that nothing cancels where the prior is all but certain
    own = told * scale
    variance = np.diagonal(told) - (own * np.linalg.solve(both, own.T).T).sum(axis=1)
    z: FloatArray = score / np.sqrt(np.where(variance > NOISE * prior, variance, math.inf))
    return z
