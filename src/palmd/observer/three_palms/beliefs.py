"""What is believed of a body before any reading, and what it may be tried with."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.spherical import Y00, count, degrees
from palmd.model.three_palms import BODY
from palmd.observer.three_palms.arrow import STATES
from palmd.observer.three_palms.driven import BallBelief
from palmd.observer.three_palms.smoother import BodyPrior

Bools = npt.NDArray[np.bool_]

RADIUS_SD = 0.12  # of the radius that the contacts suggest, as a share
CENTRE_SD = 0.07  # of the centre of mass from the middle, in radii
ELLIPSE_SD = 0.08  # RMS over the sphere of all harmonics of degree 2, in radii
FALL = 2.2  # with which power of the degree it falls from there
BEYOND_8 = 2.5e-3  # RMS of all degrees above 8, in radii; a smooth body has less
CENTRE_LEFT = 0.75
"""Share of what is beyond by which heights move together where little was touched: it misleads the centre's height."""
EXPLAINED_CHI2, UNEXPLAINED_CHI2 = 1.15, 1.35
"""Up to which readings are explained to their noise, and from which on they tell nothing of what is left out."""
NUMBERS_ALIKE = 30.0
"""Numbers read in a row that miss an outline by about the same, where harmonics leave something out of it."""
LAMBDA_SD = 0.12
DAMPING_SD = 3e-4  # m²/s
MU, MU_SD = 0.1, 0.1
DITHER_M_S, LN_DITHER_SD = 0.01, 0.4
SPIN_SD = 3.0  # at the beginning (rad/s)
REST_SPIN_SD = 0.02  # where it is seen to rest
GYRATION = 0.62  # a body's radius of gyration, in radii
FRICTIONLESS = 1e-3


def shape_variance(radius: float, order: int) -> FloatArray:
    """Of each coefficient of the outline (m²)."""
    degree = degrees(order)
    rms = radius * ELLIPSE_SD * (2.0 / np.maximum(degree, 2.0)) ** FALL
    variance: FloatArray = 4 * np.pi * rms**2 / (2 * degree + 1)
    variance[0] = (RADIUS_SD * radius / Y00) ** 2
    variance[1:4] = 4 * np.pi * (CENTRE_SD * radius) ** 2 / 3
    return variance


def beyond_sd(radius: float, order: int, touched: Bools, chi2: float = 1.0) -> FloatArray:
    """(D,) one-sigma of the outline's height from the degrees above `order`, by whether a palm `touched` there (m).

    Readings along a contact curve tell the sum of all degrees there, which lower ones can follow the better, the less
    was touched: they leave of what is beyond the root of the share touched, and more of it, the less the readings are
    explained (`chi2` per number read). It moves the centre of mass besides, from which heights count, as the mean of as
    many values as lobes of the next degree lie on what was touched.
    """
    everywhere = BEYOND_8 * radius * (8.0 / order) ** (FALL + 0.5)
    missed = min(max((chi2 - EXPLAINED_CHI2) / (UNEXPLAINED_CHI2 - EXPLAINED_CHI2), 0.0), 1.0)
    share = float(touched.mean())
    left = missed + (1.0 - missed) * math.sqrt(share)
    lobes = max(share * (order + 2) ** 2, 1.0)
    sd: FloatArray = np.where(touched, math.hypot(left, CENTRE_LEFT / math.sqrt(lobes)) * everywhere, everywhere)
    return sd


def missed_sd(reading_sd: float, unexplained: float) -> float:
    """By how much readings are missed besides their noise, one-sigma: what harmonics leave out (m).

    `reading_sd` (m) times the root of what a number read costs more than 1. It is one-sigma of each coordinate of the
    centre of mass in the body, too: readings do not tell it, balance does, and contacts that are off mislead it by as
    much. It stays however long that goes on, for contacts on the same sharp places are off alike.
    """
    return reading_sd * math.sqrt(unexplained)


def with_centre(covariance: FloatArray, first: int, sd: float) -> FloatArray:
    """The same covariance, the centre of mass known to no better than `sd` (m); the outline begins in row `first`."""
    wider = covariance.copy()
    at = first + np.arange(1, 4)
    wider[at, at] += 4.0 * np.pi / 3.0 * sd**2
    return wider


def prior(radius: float, order: int, spin_sd: float) -> BodyPrior:
    """Of a body whose contacts suggest this radius (m), with this one-sigma of its first spin (rad/s)."""
    mean = np.zeros(count(order) + BODY)
    mean[0] = radius / Y00
    mean[-2:] = MU, math.log(DITHER_M_S)
    body_sd = np.array([LAMBDA_SD] * 6 + [DAMPING_SD, MU_SD, LN_DITHER_SD])
    variance = np.concatenate([shape_variance(radius, order), body_sd**2])
    return BodyPrior.apart(mean, np.diag(1.0 / variance), np.zeros(3), spin_sd)


def with_inertia(prior: BodyPrior, sd: float) -> BodyPrior:
    """The same belief, the inertia's λ taken to be known to `sd`."""
    information = prior.information.copy()
    first = len(information) - BODY
    index = np.arange(first, first + 6)
    information[index, index] = sd**-2
    return replace(prior, information=information)


def raised(p: FloatArray, order: int) -> FloatArray:
    """The same parameters with an outline up to degree `order`, no lower than theirs."""
    n = len(p) - BODY
    return np.concatenate([p[:n], np.zeros(count(order) - n), p[n:]])


def raised_belief(prior: BodyPrior, order: int) -> BodyPrior:
    """The same belief of an outline up to degree `order`, no lower than its own; of what it adds as of any body."""
    mean = raised(prior.mean, order)
    old, new = len(prior.mean) - BODY, len(mean) - BODY
    added = STATES + np.arange(old, new)
    kept = np.setdiff1d(np.arange(STATES + len(mean)), added)
    information = np.zeros((STATES + len(mean),) * 2)
    information[np.ix_(kept, kept)] = prior.information
    information[added, added] = 1.0 / shape_variance(Y00 * float(mean[0]), order)[old:]
    return BodyPrior(prior.R, prior.spin, mean, information)


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """What a start begins with: how much larger than a ball through its contacts the body is, and its friction.

    drift: how little smoothed contacts are trusted to tell ω̇, a spectral density ((rad/s)²/s).
    """

    larger: float
    mu: float
    drift: float

    def belief(self, radius: float, centre: FloatArray, spin_sd: float, still: int) -> BallBelief:
        """For a ball of this radius (m) through its contacts, about this centre (m); at rest for `still` nodes."""
        own = radius * (1.0 + self.larger)
        return BallBelief(
            np.array([math.log(GYRATION * own), 1e-4, math.log(self.mu), math.log(DITHER_M_S), own]),
            np.array([0.12, 2e-4, 0.5, LN_DITHER_SD, 0.03 * own]),
            np.concatenate([centre, np.zeros(3)]),
            np.array([5e-3] * 3 + [spin_sd] * 3),
            max(still, 1),
            self.drift,
        )


def hypotheses() -> Iterator[Hypothesis]:
    """Those that are tried."""
    for larger, drift in ((0.0, 1.0), (0.16, 10.0), (0.0, 10.0), (0.16, 1.0), (0.0, 100.0), (-0.12, 1.0), (0.3, 10.0)):
        yield Hypothesis(larger, 0.1, drift)
    for larger, drift in ((0.0, 1.0), (0.16, 10.0), (0.0, 100.0), (-0.12, 1.0)):
        yield Hypothesis(larger, FRICTIONLESS, drift)
