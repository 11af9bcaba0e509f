"""How rough a body is beside what is believed of any, by those of its harmonics that the readings tell.

One factor on the one-sigma of all degrees from `FROM` on, by the fixed point of the evidence (MacKay 1992): the square
sum of what was found, over how many of them the readings determine.
"""

from __future__ import annotations

import numpy as np

from palmd.model.three_palms import BODY
from palmd.observer.three_palms.arrow import STATES
from palmd.observer.three_palms.smoother import BodyFit, BodyPrior

FROM = 2  # degree
BELIEVED = 6.0  # harmonics' worth of belief in a factor of 1
ITERATIONS = 12


def roughness(prior: BodyPrior, fit: BodyFit) -> float:
    """The factor; `prior`: what the fit believed."""
    information, gradient = fit.arrow.marginal()
    told = information @ fit.motion.p - gradient
    index = np.arange(FROM**2, len(fit.motion.p) - BODY)
    believed = np.diagonal(prior.information)[STATES + index]
    square = 1.0
    for _ in range(ITERATIONS):
        scaled = information.copy()
        scaled[index, index] += believed * (1.0 / square - 1.0)
        covariance = np.linalg.inv(scaled)
        found = (covariance @ told)[index]
        determined = len(index) - float((np.diagonal(covariance)[index] * believed).sum()) / square
        square = (float((found**2 * believed).sum()) + BELIEVED) / (determined + BELIEVED)
    return float(np.sqrt(square))


def as_rough(prior: BodyPrior, share: float) -> BodyPrior:
    """The same belief of a body `share` times as rough."""
    information = prior.information.copy()
    index = np.arange(STATES + FROM**2, len(information) - BODY)
    information[index, index] /= share**2
    return BodyPrior(prior.R, prior.spin, prior.mean, information)
