"""Model criticism: which of the rig's constants are not what the rig is taken for, and what is believed instead. Pure.

Readings tell the rig's constants as a Gaussian. Beside what is believed beforehand stand explanations, each of one, two
or three causes. A cause is that one constant is off by N(0, D²), D a few times what calibration leaves, or that both
pads' are which hang on one thing, alike: zeros on where the hinge is, time stamps on one clock. The rest is as
believed. With q the score of the readings under what is believed, K its covariance and C the causes' directions (as
long as what calibration leaves), an explanation by causes D times as large is likelier by
½ D² qᵀC (1 + D² CᵀKC)⁻¹ Cᵀq − ½ ln|1 + D² CᵀKC| (Rao 1948 for the score, Kass and Raftery 1995 for the factor). So one
that needs more causes, or that readings would tell worse, pays for it, and explanations that readings cannot tell apart
share what is believed. Contradicted, a constant is open to the root of its expected square over all of them and
estimated; until then it is considered (Schmidt 1966): estimates go by what is believed, and the expected square of what
the explanations would move them by is added to their covariance. To be named a cause has to be likelier than one in a
hundred. To be in a band not nearly as much, where it is a rig that is declared better than calibration leaves one: half
of what leads an outline astray is told by two or three sigmas.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.smoothing import RIG, RIG_CONSTANTS, R
from palmd.observer.normal_equations import Guess
from palmd.observer.smoother import Posterior
from palmd.system.description import AS_CALIBRATED, RigDescription
from palmd.system.mechanism import PALMS
from palmd.system.rig_constants import prior_sds

CONTRADICTED = -0.5  # nats, of all explanations together against what is believed: of clean rigs 1 in 100 comes there
STILL = -2.0  # and what has been contradicted is still
NAMED = 0.25  # share of the explanations that a constant must be in, where no one of them has most of it
SELDOM = math.log(0.01)  # that there is one cause, beforehand, to be named
OFTEN = 0.05  # the same, to be doubted, of what is declared better than calibrated; less by as much as it is more off
TIMES = (1.0, 3.0, 10.0)  # what calibration leaves
MOST_TOGETHER = 3  # causes at a time
NO_SUCH_RIG = 2.0  # of what is left free, beyond which a constant is no rig's that answers to its description
BEYOND_ALL = 5.0  # sigmas that the best explanation may leave of any constant, before nothing is taken at its word
KNOWN = 1e-7  # one-sigma, in SI units, of what is exactly as described: small, and a number to divide by
SAME = 1.5  # one-sigmas that differ by less are no reason to fit anew,
LITTLE = 0.1  # nor those that are less of what calibration leaves
MOST_REVISIONS = 4  # of what is believed of the rig, in one answer
NOTHING: FloatArray = np.zeros(RIG_CONSTANTS)
LEFT: FloatArray = prior_sds(RigDescription().known_to(AS_CALIBRATED))
"""One-sigma of the constants of a calibrated rig; 0 of the vibration's, which no calibration of the geometry leaves."""
LEFT[R.KAPPA :] = 0.0
_SHARED = (R.ZERO, R.LAG)
CAUSES: FloatArray = np.vstack(
    [np.diag(LEFT)[LEFT > 0.0], *(np.diag(LEFT)[of : of + len(PALMS)].sum(axis=0) for of in _SHARED)]
)
"""How far each cause moves each constant (n, all), about: one by one, then both pads' that hang on one thing."""
FREE_SD: FloatArray = TIMES[-1] * LEFT
"""One-sigma of constants that are not what they were taken for, nobody knows by how much."""


NO_DOUBT: FloatArray = np.zeros((RIG_CONSTANTS, RIG_CONSTANTS))


@dataclass(frozen=True, slots=True)
class RigBelief:
    """How well the rig's constants are taken to be known, in the order of `model.smoothing.R`; SI units.

    told: their one-sigmas by the rig's description. contradicted: by how many sigmas each is not what it was taken for,
    0 where nothing speaks against that. sd: their one-sigmas to go by. doubt: mean products (all, all) of what they may
    be off by beyond those, while nothing is contradicted.
    """

    told: FloatArray
    contradicted: FloatArray
    sd: FloatArray
    doubt: FloatArray = field(default_factory=lambda: NO_DOUBT)

    @classmethod
    def of(cls, rig: RigDescription) -> RigBelief:
        """What its description says."""
        told = np.maximum(prior_sds(rig), KNOWN)
        return cls(told, np.zeros(RIG_CONSTANTS), told)

    @property
    def opened_nats(self) -> float:
        """What a log evidence under this belief lacks: a prior opened from `told` to `sd` is as much less dense."""
        return float(np.log(self.sd / self.told).sum())

    def suspended(self) -> RigBelief:
        """For the moment nothing is taken at its word."""
        return replace(self, sd=np.maximum(self.told, FREE_SD), doubt=NO_DOUBT)

    def after(self, posterior: Posterior | None) -> RigBelief:
        """What is left of it by a `posterior` under this belief; the same where there is none.

        What they contradict is open, what they no longer contradict is as told, but for doubt. `sd` is the same object
        where that hardly changes it.
        """
        if posterior is None:
            return self
        try:
            of_rig = posterior.constants[RIG], posterior.covariance[RIG, RIG]
            found = criticised(*of_rig, self.sd, self.told, self.contradicted)
        except np.linalg.LinAlgError:
            return self
        one, other = (np.maximum(sd, LITTLE * LEFT) for sd in (found.sd, self.sd))
        hardly = bool((np.abs(np.log(one / other)) < math.log(SAME)).all())
        return replace(self, contradicted=found.contradicted, sd=self.sd if hardly else found.sd, doubt=found.doubt)

    def considering(self, covariance: FloatArray) -> FloatArray:
        """The covariance of an estimate y, which begins with the constants, what is in `doubt` allowed for.

        To have its prior's mean elsewhere by m moves an estimate by cov(y, rig) sd⁻² m.
        """
        pull = covariance[:, RIG] / self.sd**2
        return covariance + pull @ self.doubt @ pull.T

    def beyond_all(self, guess: Guess) -> bool:
        """Whether a guess has a constant further off than the widest explanation foresees: something else is wrong."""
        return bool((np.abs(guess.p[RIG]) > NO_SUCH_RIG * np.maximum(self.told, FREE_SD))[LEFT > 0.0].any())

    def within(self, guess: Guess) -> Guess:
        """A guess with no constant of the rig beyond its one-sigma, to go on from under this belief."""
        p = guess.p.copy()
        p[RIG] = np.clip(p[RIG], -self.sd, self.sd)
        return replace(guess, p=p)


@dataclass(frozen=True, slots=True)
class Criticism:
    """What readings leave of a belief: as in `RigBelief`; odds: of its being wrong in something, natural logarithm."""

    contradicted: FloatArray
    sd: FloatArray
    doubt: FloatArray
    odds: float


def criticised(
    values: FloatArray, covariance: FloatArray, sd: FloatArray, believed: FloatArray, before: FloatArray = NOTHING
) -> Criticism:
    """What is left of one-sigmas `believed` of the rig's constants.

    `values` and `covariance` are the posterior of the rig's constants under a prior of mean 0 and one-sigma `sd`. What
    was contradicted `before` is down to `STILL`. Raises LinAlgError for a covariance that is none.
    """
    K, q = _score(values, covariance, sd, believed)
    among, log_weight, log_doubt, squares = _explanations(K, q, believed)
    odds = float(np.logaddexp.reduce(log_weight, initial=-math.inf))
    if not len(among):
        return Criticism(NOTHING, believed, NO_DOUBT, odds)
    if odds < (STILL if before.any() else CONTRADICTED):
        return Criticism(NOTHING, believed, _expected(log_doubt, squares), odds)
    share, square = np.exp(log_weight - odds), _expected(log_weight, squares)
    opened = np.sqrt(believed**2 + np.diagonal(square))
    best = among[int(np.argmax(log_weight))]
    left = _sigmas(*_score(values, covariance, sd, np.where(best, FREE_SD, believed)))
    if np.abs(left[believed < FREE_SD]).max() > BEYOND_ALL:
        opened = np.maximum(believed, FREE_SD)
    likeliest = share[(among == best).all(axis=1)].sum() > 0.5
    found = np.zeros(RIG_CONSTANTS)
    for k in np.flatnonzero(best if likeliest else share @ among >= NAMED):
        together = np.flatnonzero(among[int(np.argmax(np.where(among[:, k], log_weight, -math.inf)))])
        found[k] = _sigmas_together(K, q, together)[together == k][0]
    return Criticism(found, opened, NO_DOUBT, odds)


def _expected(log_weights: FloatArray, squares: FloatArray) -> FloatArray:
    """Mean of `squares` (n, constants, constants), by how likely each is; of no cause, whose weight is 1, it is 0."""
    odds = float(np.logaddexp.reduce(log_weights))
    mean: FloatArray = np.tensordot(np.exp(log_weights - np.logaddexp(odds, 0.0)), squares, 1)
    return mean


@cache
def _sets(size: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """So many causes at a time, no constant in two of them (n, size), for each of `TIMES`: which that is (n,)."""
    sets = np.array(list(combinations(range(len(CAUSES)), size)), np.intp)
    sets = sets[((CAUSES[sets] > 0.0).sum(axis=1) <= 1).all(axis=1)]
    return np.tile(sets, (len(TIMES), 1)), np.repeat(np.arange(len(TIMES)), len(sets))


def _explanations(
    K: FloatArray, q: FloatArray, believed: FloatArray
) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray, FloatArray]:
    """Which constants are in each explanation (n, all), its log odds to be named and doubted (n,), and mean products
    of what it says they are off by (n, all, all).

    None that readings would rather have with one cause less, by the ratio of densities at 0 (Dickey 1971).
    """
    found = []
    told, pull, factors = CAUSES @ K @ CAUSES.T, CAUSES @ q, np.array(TIMES)
    open_by = ((factors[:, None, None] * CAUSES > believed) | (CAUSES == 0.0)).all(axis=2)
    for size in range(1, MOST_TOGETHER + 1):
        sets, which = _sets(size)
        open_ = open_by[which[:, None], sets].all(axis=1)
        sets, times = sets[open_], factors[which[open_], None]
        A = np.eye(size) + times[:, :, None] ** 2 * told[sets[:, :, None], sets[:, None, :]]
        left, log_determinant = _inverses(A)  # of N(0, 1), by the readings
        variance = np.diagonal(left, axis1=1, axis2=2)
        score = times * pull[sets]
        mean = (left @ score[:, :, None])[:, :, 0]
        gain = 0.5 * (score * mean).sum(axis=1) - 0.5 * log_determinant
        needed = (np.log(variance) + mean**2 / variance > 0.0).all(axis=1)
        sets, times, left, mean, gain = sets[needed], times[needed], left[needed], mean[needed], gain[needed]
        by = times[:, :, None] * CAUSES[sets]
        square = np.swapaxes(by, 1, 2) @ (left + mean[:, :, None] * mean[:, None, :]) @ by
        log_weight = gain + size * SELDOM - math.log(len(TIMES))
        beforehand = np.where(open_by[0][sets], np.log(OFTEN / times), SELDOM - math.log(len(TIMES)))
        log_doubt = gain + beforehand.sum(axis=1)
        found.append(((by > 0.0).any(axis=1), log_weight, log_doubt, square))
    among, log_weights, log_doubts, squares = (np.concatenate(each) for each in zip(*found, strict=True))
    return among, log_weights, log_doubts, squares


def _inverses(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of matrices 1 + K, K positive semidefinite (n, k, k), in their place; and their log-determinants (n,)."""
    log_determinant = np.zeros(len(A))
    for i in range(A.shape[1]):  # swept one after the other (Goodnight 1979)
        pivot, column = A[:, i, i].copy(), A[:, :, i].copy()
        row = A[:, i, :] / pivot[:, None]
        A -= column[:, :, None] * row[:, None, :]
        A[:, i, :], A[:, :, i] = row, -column / pivot[:, None]
        A[:, i, i] = 1.0 / pivot
        log_determinant += np.log(pivot)
    return A, log_determinant


def _score(
    values: FloatArray, covariance: FloatArray, sd: FloatArray, believed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(K, q): the score of the readings where all constants are 0 ± `believed`, and its covariance K."""
    scale = 1.0 / np.sqrt(np.diagonal(covariance))
    precision = np.linalg.inv(covariance * np.outer(scale, scale)) * np.outer(scale, scale)
    told = (precision - np.diag(sd**-2.0)) * np.outer(believed, believed)
    # by its principal axes, so that nothing cancels where what is believed is all but certain, or hardly anything
    size, axes = np.linalg.eigh((told + told.T) / 2)
    size = np.maximum(size, 0.0)
    K = (axes * (size / (1.0 + size))) @ axes.T
    q = axes @ ((axes.T @ (believed * (precision @ values))) / (1.0 + size))
    return K / np.outer(believed, believed), q / believed


def _sigmas(K: FloatArray, q: FloatArray) -> FloatArray:
    """Of each constant by itself, were all others as believed: standard normal where they are."""
    variance = np.diagonal(K)
    sigmas: FloatArray = np.divide(q, np.sqrt(variance), out=np.zeros_like(q), where=variance > 0.0)
    return sigmas


def _sigmas_together(K: FloatArray, q: FloatArray, which: npt.NDArray[np.intp]) -> FloatArray:
    """Of each of `which`, the others of these being open; 0 for what no reading tells."""
    inverse = np.linalg.pinv(K[np.ix_(which, which)], hermitian=True)
    variance = np.diagonal(inverse)
    sigmas: FloatArray = np.divide(
        inverse @ q[which], np.sqrt(variance), out=np.zeros(len(which)), where=variance > 0.0
    )
    return sigmas
