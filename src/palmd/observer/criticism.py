"""Model criticism: which of the rig's constants are not what the rig is taken for, and what is believed instead. Pure.

Readings tell the rig's constants as a Gaussian. Beside what is believed beforehand stand explanations: of one, two or
three constants each is off by N(0, D²), D a few times what calibration leaves, the rest as believed. With q the score
of the readings under what is believed and K its covariance, an explanation of the constants S is likelier by
½ qᵀ(D⁻² + K)⁻¹ q − ½ ln|1 + D K D| (restricted to S; Rao 1948 for the score, Kass and Raftery 1995 for the factor). So
one that needs more constants, or that readings would tell worse, pays for it, and explanations that readings cannot
tell apart share what is believed. A constant is open to the root of its expected square over all of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.smoothing import RIG, RIG_CONSTANTS
from palmd.observer.normal_equations import Guess
from palmd.observer.smoother import Posterior
from palmd.system.description import AS_CALIBRATED, RigDescription
from palmd.system.rig_constants import prior_sds

CONTRADICTED = 0.5  # nats, of all explanations together against what is believed: of clean rigs 1 in 100 comes there
STILL = -1.0  # and what has been contradicted is still
DOUBTED = -4.0  # nats, from which on they are in the bands: 1 to 55
NAMED = 0.25  # share of the explanations that a constant must be in
SELDOM = math.log(0.01)  # that one constant is off, beforehand
TIMES = (1.0, 3.0, 10.0)  # what calibration leaves
MOST_TOGETHER = 3  # constants that are off at a time
BEYOND_ALL = 5.0  # sigmas that the best explanation may leave of any constant, before nothing is taken at its word
KNOWN = 1e-7  # one-sigma, in SI units, of what is exactly as described: small, and a number to divide by
SAME = 1.5  # one-sigmas that differ by less are no reason to fit anew,
LITTLE = 0.1  # nor those that are less of what calibration leaves
MOST_REVISIONS = 4  # of what is believed of the rig, in one answer
NOTHING: FloatArray = np.zeros(RIG_CONSTANTS)
LEFT: FloatArray = prior_sds(RigDescription().known_to(AS_CALIBRATED))
"""One-sigma of the constants of a calibrated rig."""
FREE_SD: FloatArray = TIMES[-1] * LEFT
"""One-sigma of constants that are not what they were taken for, nobody knows by how much."""


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

    def after(self, posterior: Posterior | None) -> RigBelief:
        """What is left of it by a `posterior` under this belief; the same where there is none.

        What they contradict is open, what they no longer contradict is as told. `sd` is the same object where that
        hardly changes it.
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
        return replace(self, contradicted=found.contradicted, sd=self.sd if hardly else found.sd)

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
    odds: float


def criticised(
    values: FloatArray, covariance: FloatArray, sd: FloatArray, believed: FloatArray, before: FloatArray = NOTHING
) -> Criticism:
    """What is left of one-sigmas `believed` of the rig's constants.

    `values` and `covariance` are the posterior of the rig's constants under a prior of mean 0 and one-sigma `sd`. What
    was contradicted `before` is down to `STILL`. Raises LinAlgError for a covariance that is none.
    """
    K, q = _score(values, covariance, sd, believed)
    among, log_weight, square = _explanations(K, q, believed)
    odds = float(np.logaddexp.reduce(log_weight, initial=-math.inf))
    if odds < DOUBTED:
        return Criticism(NOTHING, believed, odds)
    share = np.exp(log_weight - odds)
    wrong = 1.0 / (1.0 + math.exp(-odds))
    opened = np.sqrt(believed**2 + wrong * (share @ square))
    if odds < (STILL if before.any() else CONTRADICTED):
        return Criticism(NOTHING, opened, odds)
    best = among[int(np.argmax(log_weight))]
    left = _sigmas(*_score(values, covariance, sd, np.where(best, FREE_SD, believed)))
    if np.abs(left[believed < FREE_SD]).max() > BEYOND_ALL:
        opened = np.maximum(believed, FREE_SD)
    found = np.zeros(RIG_CONSTANTS)
    for k in np.flatnonzero(share @ among >= NAMED):
        together = np.flatnonzero(among[int(np.argmax(np.where(among[:, k], log_weight, -math.inf)))])
        found[k] = _sigmas_together(K, q, together)[together == k][0]
    return Criticism(found, opened, odds)


@cache
def _sets(size: int) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """So many constants together (n, size), and by how much each may be off, D."""
    sets = np.array(list(combinations(range(RIG_CONSTANTS), size)), np.intp)
    return np.tile(sets, (len(TIMES), 1)), np.concatenate([times * LEFT[sets] for times in TIMES])


def _explanations(
    K: FloatArray, q: FloatArray, believed: FloatArray
) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray]:
    """Which constants are in each explanation (n, 15), its log odds (n,), by how much they are off, squared (n, 15).

    None that readings would rather have with one constant less, by the ratio of densities at 0 (Dickey 1971).
    """
    found = []
    for size in range(1, MOST_TOGETHER + 1):
        sets, D = _sets(size)
        open_ = (believed[sets] < D).all(axis=1)
        sets, D = sets[open_], D[open_]
        A = np.eye(size) + D[:, :, None] * K[sets[:, :, None], sets[:, None, :]] * D[:, None, :]
        left, log_determinant = _inverses(A)  # of N(0, 1), by the readings
        variance = np.diagonal(left, axis1=1, axis2=2)
        score = D * q[sets]
        mean = (left @ score[:, :, None])[:, :, 0]
        gain = 0.5 * (score * mean).sum(axis=1) - 0.5 * log_determinant
        needed = (np.log(variance) + mean**2 / variance > 0.0).all(axis=1)
        sets, count = sets[needed], np.count_nonzero(needed)
        among, square = np.zeros((count, RIG_CONSTANTS), dtype=np.bool_), np.zeros((count, RIG_CONSTANTS))
        np.put_along_axis(among, sets, True, axis=1)
        np.put_along_axis(square, sets, (D**2 * (mean**2 + variance))[needed], axis=1)
        found.append((among, gain[needed] + size * SELDOM - math.log(len(TIMES)), square))
    among, log_weight, square = (np.concatenate(each) for each in zip(*found, strict=True))
    return among, log_weight, square


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
    """Of each of `which`, the others of these being open."""
    inverse = np.linalg.pinv(K[np.ix_(which, which)], hermitian=True)
    sigmas: FloatArray = inverse @ q[which] / np.sqrt(np.diagonal(inverse))
    return sigmas
