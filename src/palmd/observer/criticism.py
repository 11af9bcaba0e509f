"""Model criticism: which of the rig's constants the readings contradict, and which prior is used instead. Pure.

The readings determine the rig's constants as a Gaussian. Besides the description, explanations by one, two or three
causes are considered. A cause is a deviation by N(0, D²), D a few times what calibration leaves, of one constant, or of
both pads' constants that have a common origin: both zeros depend on where the hinge is, both time stamps on one clock.
The other constants are as described. With q the score of the readings under the description, K its covariance and C the
causes' directions (scaled to what calibration leaves), the log Bayes factor of an explanation by causes D times as
large is ½ D² qᵀC (1 + D² CᵀKC)⁻¹ Cᵀq − ½ ln|1 + D² CᵀKC| (Rao 1948 for the score, Kass and Raftery 1995 for the
factor). This penalises explanations with more causes, or with causes that the readings hardly determine; explanations
that the readings cannot distinguish share the probability.

A contradicted constant is opened: it is estimated, and its prior 1σ is the root of its expected square over all
explanations. Until then the constants are considered (Schmidt 1966): estimates use the description, and the expected
square of the shifts by the explanations is added to their covariance. To be named, a cause has prior odds of 1 in 100.
For bands, the odds are higher (`PRIOR_DOUBTED`) where a rig is declared better known than calibration leaves it, since
half of the deviations that bias an outline show up at only two or three σ.
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

# log odds (nats) of all explanations against the description above which it is contradicted; reached by 1 in 100 clean
# rigs
CONTRADICTED = -0.5
STILL_CONTRADICTED = -2.0  # log odds (nats) down to which it stays contradicted
# least share of the explanations that include a constant for it to be named, where no explanation has most of the
# probability
NAMED = 0.25
LN_PRIOR_NAMED = math.log(0.01)  # log prior odds of a cause to be named
# prior odds of a cause for bands, of what is declared better than calibrated; divided by the cause's size
PRIOR_DOUBTED = 0.05
CAUSE_SIZES = (1.0, 3.0, 10.0)  # sizes of a cause, relative to what calibration leaves
MOST_CAUSES = 3  # causes in one explanation
# limit of a constant, relative to the prior 1σ of an opened one; beyond it the description does not fit the rig
MOST_DEVIATION = 2.0
MOST_SIGMAS_LEFT = 5.0  # σ by which the best explanation may miss any constant; beyond it all constants are opened
LEAST_SD = 1e-7  # 1σ, in SI units, of what is exactly as described: small, but a number to divide by
SAME_RATIO = 1.5  # ratio of two 1σ below which no new fit is needed,
SMALL_SHARE = 0.1  # and the 1σ, relative to what calibration leaves, below which differences do not matter
MOST_REVISIONS = 4  # of the belief in the rig, in one answer
ZEROS: FloatArray = np.zeros(RIG_CONSTANTS)
CALIBRATION_SD: FloatArray = prior_sds(RigDescription().known_to(AS_CALIBRATED))
"""1σ of the constants of a calibrated rig; 0 for the vibration's, which that calibration does not determine."""
CALIBRATION_SD[R.KAPPA :] = 0.0
_COMMON_ORIGIN = (R.ZERO, R.LAG)
CAUSES: FloatArray = np.vstack(
    [
        np.diag(CALIBRATION_SD)[CALIBRATION_SD > 0.0],
        *(np.diag(CALIBRATION_SD)[of : of + len(PALMS)].sum(axis=0) for of in _COMMON_ORIGIN),
    ]
)
"""Size of the deviation of each constant by each cause (n, all): one by one, then both pads' with a common origin."""
FREE_SD: FloatArray = CAUSE_SIZES[-1] * CALIBRATION_SD
"""Prior 1σ of opened constants, when the readings do not determine it."""


NONE_CONSIDERED: FloatArray = np.zeros((RIG_CONSTANTS, RIG_CONSTANTS))


@dataclass(frozen=True, slots=True)
class RigBelief:
    """How well the rig's constants are taken to be known, in the order of `model.smoothing.R`; SI units.

    described_sd: 1σ by the rig's description.
    contradicted: by how many σ each constant deviates from its description, 0 where nothing contradicts that.
    sd: 1σ to use as a prior.
    considered: expected products (all, all) of deviations beyond `sd`, while nothing is contradicted.
    """

    described_sd: FloatArray
    contradicted: FloatArray
    sd: FloatArray
    considered: FloatArray = field(default_factory=lambda: NONE_CONSIDERED)

    @classmethod
    def of(cls, rig: RigDescription) -> RigBelief:
        """The belief according to the rig's description."""
        sd = np.maximum(prior_sds(rig), LEAST_SD)
        return cls(sd, np.zeros(RIG_CONSTANTS), sd)

    @property
    def opening_nats(self) -> float:
        """Sum of ln(sd / described_sd): by how much opening the prior lowers a log evidence."""
        return float(np.log(self.sd / self.described_sd).sum())

    def suspended(self) -> RigBelief:
        """The belief with all constants opened, for a search that does not rely on the description."""
        return replace(self, sd=np.maximum(self.described_sd, FREE_SD), considered=NONE_CONSIDERED)

    def after(self, posterior: Posterior | None) -> RigBelief:
        """The belief after a `posterior` under it; unchanged where there is none.

        Contradicted constants are open; those no longer contradicted are as described, but for `considered`. `sd` is
        the same object where it would hardly change.
        """
        if posterior is None:
            return self
        try:
            rig_posterior = posterior.constants[RIG], posterior.covariance[RIG, RIG]
            criticism = criticised(*rig_posterior, self.sd, self.described_sd, self.contradicted)
        except np.linalg.LinAlgError:
            return self
        new_sd, old_sd = (np.maximum(sd, SMALL_SHARE * CALIBRATION_SD) for sd in (criticism.sd, self.sd))
        nearly_same = bool((np.abs(np.log(new_sd / old_sd)) < math.log(SAME_RATIO)).all())
        return replace(
            self,
            contradicted=criticism.contradicted,
            sd=self.sd if nearly_same else criticism.sd,
            considered=criticism.considered,
        )

    def considering(self, covariance: FloatArray) -> FloatArray:
        """Covariance of an estimate y that begins with the constants, with the `considered` deviations added.

        A prior mean that is shifted by m shifts the estimate by cov(y, rig) sd⁻² m.
        """
        gain = covariance[:, RIG] / self.sd**2
        return covariance + gain @ self.considered @ gain.T

    def contradicts_description(self, guess: Guess) -> bool:
        """Whether a constant of the guess deviates by more than the widest explanation allows."""
        return bool(
            (np.abs(guess.p[RIG]) > MOST_DEVIATION * np.maximum(self.described_sd, FREE_SD))[CALIBRATION_SD > 0.0].any()
        )

    def within(self, guess: Guess) -> Guess:
        """The guess with the rig's constants clipped to ± `sd`, as a start of a fit under this belief."""
        p = guess.p.copy()
        p[RIG] = np.clip(p[RIG], -self.sd, self.sd)
        return replace(guess, p=p)


@dataclass(frozen=True, slots=True)
class Criticism:
    """Result of `criticised`: as in `RigBelief`, and the log odds that anything deviates from the description."""

    contradicted: FloatArray
    sd: FloatArray
    considered: FloatArray
    log_odds: float


def criticised(
    values: FloatArray, covariance: FloatArray, sd: FloatArray, described_sd: FloatArray, before: FloatArray = ZEROS
) -> Criticism:
    """Belief in the rig's constants that have 1σ `described_sd` by the description.

    values, covariance: posterior of the rig's constants under a prior of mean 0 and 1σ `sd`.
    before: contradictions so far; what was contradicted stays so down to `STILL_CONTRADICTED`.
    Raises LinAlgError where `covariance` is singular.
    """
    K, q = _score(values, covariance, sd, described_sd)
    included, log_weight, log_weight_band, squares = _explanations(K, q, described_sd)
    log_odds = float(np.logaddexp.reduce(log_weight, initial=-math.inf))
    if not len(included):
        return Criticism(ZEROS, described_sd, NONE_CONSIDERED, log_odds)
    if log_odds < (STILL_CONTRADICTED if before.any() else CONTRADICTED):
        return Criticism(ZEROS, described_sd, _expected(log_weight_band, squares), log_odds)
    share, square = np.exp(log_weight - log_odds), _expected(log_weight, squares)
    opened = np.sqrt(described_sd**2 + np.diagonal(square))
    best = included[int(np.argmax(log_weight))]
    residual_sigmas = _sigmas(*_score(values, covariance, sd, np.where(best, FREE_SD, described_sd)))
    if np.abs(residual_sigmas[described_sd < FREE_SD]).max() > MOST_SIGMAS_LEFT:
        opened = np.maximum(described_sd, FREE_SD)
    likeliest = share[(included == best).all(axis=1)].sum() > 0.5
    sigmas = np.zeros(RIG_CONSTANTS)
    for k in np.flatnonzero(best if likeliest else share @ included >= NAMED):
        together = np.flatnonzero(included[int(np.argmax(np.where(included[:, k], log_weight, -math.inf)))])
        sigmas[k] = _sigmas_together(K, q, together)[together == k][0]
    return Criticism(sigmas, opened, NONE_CONSIDERED, log_odds)


def _expected(log_weights: FloatArray, squares: FloatArray) -> FloatArray:
    """Mean of `squares` (n, constants, constants) by their weights; the description has weight 1 and square 0."""
    log_odds = float(np.logaddexp.reduce(log_weights))
    mean: FloatArray = np.tensordot(np.exp(log_weights - np.logaddexp(log_odds, 0.0)), squares, 1)
    return mean


@cache
def _sets(size: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """All sets of `size` causes without a common constant (n, size), for each of `CAUSE_SIZES` (its index: n,)."""
    sets = np.array(list(combinations(range(len(CAUSES)), size)), np.intp)
    sets = sets[((CAUSES[sets] > 0.0).sum(axis=1) <= 1).all(axis=1)]
    return np.tile(sets, (len(CAUSE_SIZES), 1)), np.repeat(np.arange(len(CAUSE_SIZES)), len(sets))


def _explanations(
    K: FloatArray, q: FloatArray, described_sd: FloatArray
) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray, FloatArray]:
    """Constants in each explanation (n, all), its log odds for naming and bands (n,), expected products (n, all, all).

    Leaves out explanations that are less likely than with one cause less, by the ratio of densities at 0 (Dickey 1971).
    """
    sets_found = []
    information, score, factors = CAUSES @ K @ CAUSES.T, CAUSES @ q, np.array(CAUSE_SIZES)
    larger = ((factors[:, None, None] * CAUSES > described_sd) | (CAUSES == 0.0)).all(axis=2)
    for size in range(1, MOST_CAUSES + 1):
        sets, which = _sets(size)
        usable = larger[which[:, None], sets].all(axis=1)
        sets, times = sets[usable], factors[which[usable], None]
        A = np.eye(size) + times[:, :, None] ** 2 * information[sets[:, :, None], sets[:, None, :]]
        covariance, log_determinant = _inverses(A)  # posterior covariance of causes with prior N(0, 1)
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        scaled_score = times * score[sets]
        mean = (covariance @ scaled_score[:, :, None])[:, :, 0]
        gain = 0.5 * (scaled_score * mean).sum(axis=1) - 0.5 * log_determinant
        useful = (np.log(variance) + mean**2 / variance > 0.0).all(axis=1)
        sets, times, covariance, mean, gain = (
            sets[useful],
            times[useful],
            covariance[useful],
            mean[useful],
            gain[useful],
        )
        directions = times[:, :, None] * CAUSES[sets]
        expected = np.swapaxes(directions, 1, 2) @ (covariance + mean[:, :, None] * mean[:, None, :]) @ directions
        log_weight = gain + size * LN_PRIOR_NAMED - math.log(len(CAUSE_SIZES))
        prior_log_odds = np.where(
            larger[0][sets], np.log(PRIOR_DOUBTED / times), LN_PRIOR_NAMED - math.log(len(CAUSE_SIZES))
        )
        log_weight_band = gain + prior_log_odds.sum(axis=1)
        sets_found.append(((directions > 0.0).any(axis=1), log_weight, log_weight_band, expected))
    included, log_weights, log_weights_band, expected_squares = (
        np.concatenate(each) for each in zip(*sets_found, strict=True)
    )
    return included, log_weights, log_weights_band, expected_squares


def _inverses(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverses of the matrices 1 + K, K positive semidefinite (n, k, k), in place; and their log-determinants (n,)."""
    log_determinant = np.zeros(len(A))
    for i in range(A.shape[1]):  # sweep operator (Goodnight 1979)
        pivot, column = A[:, i, i].copy(), A[:, :, i].copy()
        row = A[:, i, :] / pivot[:, None]
        A -= column[:, :, None] * row[:, None, :]
        A[:, i, :], A[:, :, i] = row, -column / pivot[:, None]
        A[:, i, i] = 1.0 / pivot
        log_determinant += np.log(pivot)
    return A, log_determinant


def _score(
    values: FloatArray, covariance: FloatArray, sd: FloatArray, described_sd: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(K, q): score q of the readings where all constants are 0 ± `described_sd`, and its covariance K."""
    scale = 1.0 / np.sqrt(np.diagonal(covariance))
    precision = np.linalg.inv(covariance * np.outer(scale, scale)) * np.outer(scale, scale)
    information = (precision - np.diag(sd**-2.0)) * np.outer(described_sd, described_sd)
    # in principal axes, so that nothing cancels where the description is nearly exact or nearly uninformative
    eigenvalues, axes = np.linalg.eigh((information + information.T) / 2)
    eigenvalues = np.maximum(eigenvalues, 0.0)
    K = (axes * (eigenvalues / (1.0 + eigenvalues))) @ axes.T
    q = axes @ ((axes.T @ (described_sd * (precision @ values))) / (1.0 + eigenvalues))
    return K / np.outer(described_sd, described_sd), q / described_sd


def _sigmas(K: FloatArray, q: FloatArray) -> FloatArray:
    """Normalised score of each constant alone, the others being as described: standard normal where they are."""
    variance = np.diagonal(K)
    sigmas: FloatArray = np.divide(q, np.sqrt(variance), out=np.zeros_like(q), where=variance > 0.0)
    return sigmas


def _sigmas_together(K: FloatArray, q: FloatArray, which: npt.NDArray[np.intp]) -> FloatArray:
    """Normalised deviation of each of `which`, all of these being open; 0 where the readings determine nothing."""
    inverse = np.linalg.pinv(K[np.ix_(which, which)], hermitian=True)
    variance = np.diagonal(inverse)
    sigmas: FloatArray = np.divide(
        inverse @ q[which], np.sqrt(variance), out=np.zeros(len(which)), where=variance > 0.0
    )
    return sigmas
