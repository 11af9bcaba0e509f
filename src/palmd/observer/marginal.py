"""The smoother's answer averaged over the dither speed, along which the posterior is bent like a banana.

Friction under dither is told well as μ/u_d, badly as μ and u_d apart, so a Gaussian about the likeliest point is too
sure of both. Here ln u_d is stepped through instead, everything else is fitted at each step (there it is nearly
Gaussian), and the steps are weighed by their marginal likelihood (Rue, Martino and Chopin 2009, INLA).
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

PINNED_SD = 1e-4
STEP_RANGE = (0.03, 0.35)  # of ln u_d
MOST_STEPS = 7  # to each side
NEGLIGIBLE_NATS = 4.0  # below the best step: e⁻⁴
NEAR = 0.3  # of the cost: what promises to fall by less is where its linearisation foretells it


@dataclass(frozen=True, slots=True)
class Marginal:
    """Means of nodes and constants, the covariance of (constants, last node), and μ with its one-sigma.

    evidence: log marginal likelihood of the record, up to a constant of its contact readings.
    """

    mean: Guess
    covariance: FloatArray
    mu: float
    mu_sd: float
    evidence: float


@dataclass(frozen=True, slots=True)
class _Step:
    """The fit at one ln u_d. `bent`: by how much that lies off where it was foreseen."""

    value: float
    fit: Fit
    posterior: Posterior
    log_weight: float
    bent: Guess


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
        last, bent = steps[0], steps[-1].bent  # much the same on both sides, and from one step to the next
        for number in range(1, MOST_STEPS + 1):
            try:
                found = _step(smoother, prior, last.fit, middle + direction * number * stride, bent)
            except np.linalg.LinAlgError:
                break
            if not math.isfinite(found.log_weight):
                break  # there is no minimum there, so nothing to weigh; what lies nearer counts
            last = found
            steps.append(last)
            bent = last.bent
            if last.log_weight < max(step.log_weight for step in steps) - NEGLIGIBLE_NATS:
                break
    most = max(step.log_weight for step in steps)
    weights = np.exp([step.log_weight - most for step in steps])
    evidence = most + math.log(weights.sum() * stride) - 0.5 * float(np.log(record.force_variance).sum())
    weights /= weights.sum()
    x = sum(weight * step.posterior.beyond.x for weight, step in zip(weights, steps, strict=True))
    p = sum(weight * step.posterior.beyond.p for weight, step in zip(weights, steps, strict=True))
    mean = np.concatenate([p, x[-1]])
    covariance = np.zeros((len(mean), len(mean)))
    for weight, step in zip(weights, steps, strict=True):
        miss = np.concatenate([step.posterior.beyond.p, step.posterior.beyond.x[-1]]) - mean
        covariance += weight * (step.posterior.covariance + np.outer(miss, miss))
    between = max(stride**2 - sd**2, 0.0) / 12  # sums over steps no longer than the one-sigma are exact
    covariance[C.SATURATION, C.SATURATION] += (2.0 * p[C.SATURATION]) ** 2 * between
    mu, mu_sd = _friction(steps, weights, between)
    kept = np.append(np.arange(CONSTANTS), len(p) + np.arange(NODE))  # the pads' maps are marginalised
    return Marginal(Guess(x, p[:CONSTANTS]), covariance[np.ix_(kept, kept)], mu, mu_sd, evidence)


def _friction(steps: Sequence[_Step], weights: FloatArray, between: float) -> tuple[float, float]:
    """μ and its one-sigma over all steps: as a function of (B, w) it is too curved for their covariance.

    between: variance of ln u_d that the steps do not resolve.
    """
    each = np.array([friction_of(step.posterior.beyond.p, step.posterior.covariance) for step in steps])
    mean = float(weights @ each[:, 0])
    spread = float(weights @ (each[:, 1] ** 2 + (each[:, 0] - mean) ** 2))
    return mean, math.sqrt(spread + mean**2 * between)


def _step(smoother: Smoother, prior: Prior, start: Fit, value: float, bent: Guess) -> _Step:
    """The fit at ln u_d = `value`, from where the linearisation at `start` foretells it, `bent` besides."""
    pinned = smoother.knowing(_pinned(prior, value))
    foreseen = _foreseen(prior, start, value)
    guess = _at(Guess(foreseen.x + bent.x, foreseen.p + bent.p), value)
    if not pinned.sane(guess):
        foreseen, guess = start.guess, _at(start.guess, value)
    fit = pinned.fit(guess, start.noise, worth=NEAR)
    posterior = pinned.posterior(fit)
    belief = (value - prior.mean[C.SATURATION]) / prior.sd[C.SATURATION]
    bent = Guess(posterior.beyond.x - foreseen.x, posterior.beyond.p - foreseen.p)
    # the evidence is an integral over B and w: in B = μ/u_d what is believed of μ is as dense as u_d, and in
    # w = exp(−2 ln u_d) the pin is as wide as w
    log_weight = posterior.evidence + posterior.promise / 2 - belief**2 / 2 + (1.0 + 2.0) * value
    return _Step(value, fit, posterior, log_weight, bent)


def _at(guess: Guess, value: float) -> Guess:
    """With ln u_d = `value`."""
    p = guess.p.copy()
    p[C.SATURATION] = math.exp(-2.0 * value)
    return Guess(guess.x, p)


def _pinned(prior: Prior, value: float) -> Prior:
    """What is believed where ln u_d is `value`."""
    mean, sd = prior.mean.copy(), prior.sd.copy()
    mean[C.SATURATION], sd[C.SATURATION] = value, PINNED_SD
    return replace(prior, mean=mean, sd=sd)


def _foreseen(prior: Prior, start: Fit, value: float) -> Guess:
    """The minimum at ln u_d = `value` as the linearisation at `start` has it, along which w is straight."""
    known, here = start.linearised, start.guess
    if known is None:
        return here
    now, wanted = float(here.p[C.SATURATION]), math.exp(-2.0 * value)
    straight = -0.5 * (math.log(now) + wanted / now - 1.0)  # the tangent of ln u_d in w
    before, then = (each.terms(here.p, here.x[0]) for each in (known.known, _pinned(prior, straight)))
    step = known.equations.knowing_instead(then, before).solved(0.0, prior.scale)
    return Guess(here.x + step.x, here.p + step.p)
