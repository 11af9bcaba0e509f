"""Priors of a body before any reading, and the assumptions with which blind starts are tried."""

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

RADIUS_SD = 0.12  # relative 1σ of the radius estimated from contacts
CENTRE_SD = 0.07  # radii; 1σ of the centre of mass from the middle, per axis
ELLIPSE_SD = 0.08  # radii; RMS over the sphere of all harmonics of degree 2
SPECTRUM_EXPONENT = 2.2  # exponent with which the RMS decreases with the degree
ABOVE_DEGREE_8_RMS = 2.5e-3  # radii; RMS of all degrees above 8, which is less for a smooth body
COMMON_HEIGHT_SHARE = 0.75
"""Share of the truncated harmonics that shifts all heights together while little was touched: the centre of mass is
estimated at a wrong height."""
EXPLAINED_CHI2, UNEXPLAINED_CHI2 = 1.15, 1.35
"""χ² per number read up to which readings are explained to their noise, and from which on they do not constrain the
truncated harmonics at all."""
CORRELATED_NUMBERS = 30.0
"""Numbers read in a row whose errors are alike where truncated harmonics cause them."""
LAMBDA_SD = 0.12
DAMPING_SD = 3e-4  # m²/s
MU, MU_SD = 0.1, 0.1
DITHER_M_S, LN_DITHER_SD = 0.01, 0.4
SPIN_SD = 3.0  # rad/s, 1σ of the initial spin of a moving body
REST_SPIN_SD = 0.02  # rad/s, of a body at rest
GYRATION = 0.62  # radii; radius of gyration
FRICTIONLESS = 1e-3  # friction coefficient of frictionless start assumptions


def shape_variance(radius: float, order: int) -> FloatArray:
    """Prior variance of each coefficient of the outline (m²)."""
    degree = degrees(order)
    rms = radius * ELLIPSE_SD * (2.0 / np.maximum(degree, 2.0)) ** SPECTRUM_EXPONENT
    variance: FloatArray = 4 * np.pi * rms**2 / (2 * degree + 1)
    variance[0] = (RADIUS_SD * radius / Y00) ** 2
    variance[1:4] = 4 * np.pi * (CENTRE_SD * radius) ** 2 / 3
    return variance


def truncation_sd(radius: float, order: int, touched: Bools, chi2: float = 1.0) -> FloatArray:
    """(D,) 1σ of the outline's height from harmonics above `order` (m); `touched` (D,) marks touched directions.

    Readings along a contact curve determine the sum of all degrees there. The less was touched, the better the lower
    degrees can represent that sum: the error left is the truncated part times the root of the touched share, and more
    if the readings are not explained (`chi2` per number read). Truncation also shifts the centre of mass, from which
    heights are measured, like the mean of as many values as lobes of the next degree lie on the touched surface.
    """
    untouched_sd = ABOVE_DEGREE_8_RMS * radius * (8.0 / order) ** (SPECTRUM_EXPONENT + 0.5)
    unexplained = min(max((chi2 - EXPLAINED_CHI2) / (UNEXPLAINED_CHI2 - EXPLAINED_CHI2), 0.0), 1.0)
    share = float(touched.mean())
    remaining = unexplained + (1.0 - unexplained) * math.sqrt(share)
    lobes = max(share * (order + 2) ** 2, 1.0)
    sd: FloatArray = np.where(
        touched, math.hypot(remaining, COMMON_HEIGHT_SHARE / math.sqrt(lobes)) * untouched_sd, untouched_sd
    )
    return sd


def unexplained_sd(reading_sd: float, unexplained: float) -> float:
    """1σ of the readings' errors beyond their noise, caused by truncated harmonics (m).

    `reading_sd` (m) times the root of the cost per number read in excess of 1. It is also the 1σ of each coordinate of
    the centre of mass in the body: that is determined by balance, so that errors of the contacts shift it equally. It
    does not average out, as contacts on the same sharp places have the same errors.
    """
    return reading_sd * math.sqrt(unexplained)


def widen_centre(covariance: FloatArray, first: int, sd: float) -> FloatArray:
    """Add an error of the centre of mass, 1σ `sd` (m), to a covariance whose outline begins in row `first`."""
    wider = covariance.copy()
    at = first + np.arange(1, 4)
    wider[at, at] += 4.0 * np.pi / 3.0 * sd**2
    return wider


def prior(radius: float, order: int, spin_sd: float) -> BodyPrior:
    """Prior of a body with this radius estimated from contacts (m) and this 1σ of its initial spin (rad/s)."""
    mean = np.zeros(count(order) + BODY)
    mean[0] = radius / Y00
    mean[-2:] = MU, math.log(DITHER_M_S)
    body_sd = np.array([LAMBDA_SD] * 6 + [DAMPING_SD, MU_SD, LN_DITHER_SD])
    variance = np.concatenate([shape_variance(radius, order), body_sd**2])
    return BodyPrior.independent(mean, np.diag(1.0 / variance), np.zeros(3), spin_sd)


def with_inertia(prior: BodyPrior, sd: float) -> BodyPrior:
    """The same prior with a 1σ of `sd` for the inertia's λ."""
    information = prior.information.copy()
    first = len(information) - BODY
    index = np.arange(first, first + 6)
    information[index, index] = sd**-2
    return replace(prior, information=information)


def with_order(p: FloatArray, order: int) -> FloatArray:
    """Extend the outline of parameters p to degree `order` with zeros; `order` must not be lower than theirs."""
    n = len(p) - BODY
    return np.concatenate([p[:n], np.zeros(count(order) - n), p[n:]])


def belief_with_order(prior: BodyPrior, order: int) -> BodyPrior:
    """Extend a belief to an outline of degree `order`, not lower than its own; added harmonics get their prior."""
    mean = with_order(prior.mean, order)
    old, new = len(prior.mean) - BODY, len(mean) - BODY
    added = STATES + np.arange(old, new)
    kept = np.setdiff1d(np.arange(STATES + len(mean)), added)
    information = np.zeros((STATES + len(mean),) * 2)
    information[np.ix_(kept, kept)] = prior.information
    information[added, added] = 1.0 / shape_variance(Y00 * float(mean[0]), order)[old:]
    return BodyPrior(prior.R, prior.spin, mean, information)


@dataclass(frozen=True, slots=True)
class StartAssumption:
    """Assumptions of a blind start.

    oversize: relative excess of the body's radius over that of a ball through the contacts. mu: friction coefficient.
    drift: noise density of ω̇ as computed from smoothed contacts ((rad/s)²/s).
    """

    oversize: float
    mu: float
    drift: float

    def belief(self, radius: float, centre: FloatArray, spin_sd: float, rest_nodes: int) -> BallBelief:
        """Prior for a ball of this radius (m) through its contacts with this centre (m), at rest for `rest_nodes`."""
        assumed_radius = radius * (1.0 + self.oversize)
        return BallBelief(
            np.array(
                [math.log(GYRATION * assumed_radius), 1e-4, math.log(self.mu), math.log(DITHER_M_S), assumed_radius]
            ),
            np.array([0.12, 2e-4, 0.5, LN_DITHER_SD, 0.03 * assumed_radius]),
            np.concatenate([centre, np.zeros(3)]),
            np.array([5e-3] * 3 + [spin_sd] * 3),
            max(rest_nodes, 1),
            self.drift,
        )


def start_assumptions() -> Iterator[StartAssumption]:
    """All assumptions that are tried, in their order; the frictionless ones come last."""
    for oversize, drift in (
        (0.0, 1.0),
        (0.16, 10.0),
        (0.0, 10.0),
        (0.16, 1.0),
        (0.0, 100.0),
        (-0.12, 1.0),
        (0.3, 10.0),
    ):
        yield StartAssumption(oversize, 0.1, drift)
    for oversize, drift in ((0.0, 1.0), (0.16, 10.0), (0.0, 100.0), (-0.12, 1.0)):
        yield StartAssumption(oversize, FRICTIONLESS, drift)
