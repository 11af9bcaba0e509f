"""The smoother's posterior averaged over the dither speed, along which it is strongly curved.

Under dither the readings determine friction as μ/u_d well, but μ and u_d separately badly, so a Gaussian about the
likeliest point underestimates the 1σ of both. Here ln u_d is stepped through instead, everything else is fitted at each
step (there it is nearly Gaussian), and the steps are weighted by their marginal likelihood (Rue, Martino and Chopin
2009, INLA).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import Library
from palmd.model.smoothing import CONSTANTS, NODE, C
from palmd.observer.factor import Prior, friction_of
from palmd.observer.normal_equations import Guess
from palmd.observer.record import Record
from palmd.observer.smoother import Fit, Posterior, Smoother

PINNED_SD = 1e-4  # 1σ of ln u_d at each step
STEP_RANGE = (0.03, 0.35)  # least and largest step of ln u_d
MOST_STEPS = 7  # to each side
NEGLIGIBLE_NATS = 4.0  # below the best step: weight e⁻⁴
SMALL_DECREASE = 0.3  # predicted decrease of the cost below which the linearisation is accurate enough


@dataclass(frozen=True, slots=True)
class Marginal:
    """Means of nodes and constants, covariance of (constants, last node), and μ with its 1σ.

    evidence: log marginal likelihood of the record, up to a constant of its contact readings.
    """

    mean: Guess
    covariance: FloatArray
    mu: float
    mu_sd: float
    evidence: float


@dataclass(frozen=True, slots=True)
class _Step:
    """The fit at one ln u_d; `deviation`: of its mean from the linear prediction."""

    value: float
    fit: Fit
    posterior: Posterior
    log_weight: float
    deviation: Guess


def marginalised(library: Library, record: Record, prior: Prior, fit: Fit) -> Marginal:
    """Average about the minimum `fit` of `record`; raises LinAlgError where it is no minimum."""
    saturation = float(fit.guess.p[C.SATURATION])
    middle = -0.5 * math.log(saturation)
    smoother = Smoother(library, record, prior)
    covariance = smoother.posterior(fit).covariance
    sd = math.sqrt(covariance[C.SATURATION, C.SATURATION]) / (2.0 * saturation)
    stride = min(max(sd, STEP_RANGE[0]), STEP_RANGE[1])
    straight = Guess(np.zeros_like(fit.guess.x), np.zeros_like(fit.guess.p))
    steps = [_step(smoother, prior, fit, middle, straight)]
    for direction in (-1, 1):
        last, deviation = steps[0], steps[-1].deviation  # about the same on both sides, and from one step to the next
        for number in range(1, MOST_STEPS + 1):
            try:
                found = _step(smoother, prior, last.fit, middle + direction * number * stride, deviation)
            except np.linalg.LinAlgError:
                break
            if not math.isfinite(found.log_weight):
                break  # there is no minimum to be weighted here; the steps so far count
            last = found
            steps.append(last)
            deviation = last.deviation
            if last.log_weight < max(step.log_weight for step in steps) - NEGLIGIBLE_NATS:
                break
    largest = max(step.log_weight for step in steps)
    weights = np.exp([step.log_weight - largest for step in steps])
    evidence = largest + math.log(weights.sum() * stride) - 0.5 * float(np.log(record.total_force_variance).sum())
    weights /= weights.sum()
    x = sum(weight * step.posterior.beyond.x for weight, step in zip(weights, steps, strict=True))
    p = sum(weight * step.posterior.beyond.p for weight, step in zip(weights, steps, strict=True))
    mean = np.concatenate([p, x[-1]])
    covariance = np.zeros((len(mean), len(mean)))
    for weight, step in zip(weights, steps, strict=True):
        difference = np.concatenate([step.posterior.beyond.p, step.posterior.beyond.x[-1]]) - mean
        covariance += weight * (step.posterior.covariance + np.outer(difference, difference))
    between = max(stride**2 - sd**2, 0.0) / 12  # sums over steps no longer than 1σ are exact
    covariance[C.SATURATION, C.SATURATION] += (2.0 * p[C.SATURATION]) ** 2 * between
    mu, mu_sd = _friction(steps, weights, between)
    kept = np.append(np.arange(CONSTANTS), len(p) + np.arange(NODE))  # the pads' maps are marginalised
    return Marginal(Guess(x, p[:CONSTANTS]), covariance[np.ix_(kept, kept)], mu, mu_sd, evidence)


def _friction(steps: Sequence[_Step], weights: FloatArray, between: float) -> tuple[float, float]:
    """μ and its 1σ over all steps: as a function of (B, w) it is too curved for their covariance.

    between: variance of ln u_d that the steps do not resolve.
    """
    each = np.array([friction_of(step.posterior.beyond.p, step.posterior.covariance) for step in steps])
    mean = float(weights @ each[:, 0])
    spread = float(weights @ (each[:, 1] ** 2 + (each[:, 0] - mean) ** 2))
    return mean, math.sqrt(spread + mean**2 * between)


def _step(smoother: Smoother, prior: Prior, start: Fit, value: float, deviation: Guess) -> _Step:
    """The fit at ln u_d = `value`, from the linear prediction at `start`, corrected by `deviation`."""
    pinned = smoother.with_knowledge(_pinned(prior, value))
    predicted = _predicted(prior, start, value)
    guess = _at(Guess(predicted.x + deviation.x, predicted.p + deviation.p), value)
    if not pinned.sane(guess):
        predicted, guess = start.guess, _at(start.guess, value)
    fit = pinned.fit(guess, start.noise, worth=SMALL_DECREASE)
    posterior = pinned.posterior(fit)
    prior_residual = (value - prior.mean[C.SATURATION]) / prior.sd[C.SATURATION]
    deviation = Guess(posterior.beyond.x - predicted.x, posterior.beyond.p - predicted.p)
    # the evidence is an integral over B and w: the density of the prior of μ in B = μ/u_d is proportional to u_d, and
    # the width of the pin in w = exp(−2 ln u_d) to w
    log_weight = posterior.evidence + posterior.predicted_decrease / 2 - prior_residual**2 / 2 + (1.0 + 2.0) * value
    return _Step(value, fit, posterior, log_weight, deviation)


def _at(guess: Guess, value: float) -> Guess:
    """The guess with ln u_d = `value`."""
    p = guess.p.copy()
    p[C.SATURATION] = math.exp(-2.0 * value)
    return Guess(guess.x, p)


def _pinned(prior: Prior, value: float) -> Prior:
    """The prior with ln u_d fixed at `value`."""
    mean, sd = prior.mean.copy(), prior.sd.copy()
    mean[C.SATURATION], sd[C.SATURATION] = value, PINNED_SD
    return replace(prior, mean=mean, sd=sd)


def _predicted(prior: Prior, start: Fit, value: float) -> Guess:
    """Minimum at ln u_d = `value` by the linearisation at `start`, in which w is linear."""
    linearised, guess = start.linearised, start.guess
    if linearised is None:
        return guess
    w, w_wanted = float(guess.p[C.SATURATION]), math.exp(-2.0 * value)
    tangent = -0.5 * (math.log(w) + w_wanted / w - 1.0)  # the tangent of ln u_d in w
    prior_before, prior_then = (each.terms(guess.p, guess.x[0]) for each in (linearised.known, _pinned(prior, tangent)))
    step = linearised.equations.with_knowledge_replaced(prior_then, prior_before).solved(0.0, prior.scale)
    return Guess(guess.x + step.x, guess.p + step.p)
