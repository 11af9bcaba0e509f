"""The search for the trajectory and the outline behind a stretch of readings: blind or from an earlier answer.

A bank of filters reads the first seconds and says where a solution may lie; the smoother goes there, and its window
then grows over the stretch, with rivals kept as long as they explain the readings nearly as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import RigDescription
from palmd.model import smoothing
from palmd.model.smoothing import C
from palmd.observer.first_guess import blind_starts, prior_of
from palmd.observer.palm_path import smoothed_path
from palmd.observer.record import Record, lay_out
from palmd.observer.smoother import Fit, Guess, ProcessNoise, Smoother
from palmd.observer.stretch import Stretch

SPACING_S = 0.01  # of the nodes while looking for the answer
FIRST_LOOK_S = 0.3  # readings that tell the object's size
NOISE = ProcessNoise(1e-8, 1e-5)
GROWTH, LEAST_GROWTH_S = 1.6, 0.1
PATIENCE = 12
ASTRAY_SIGMAS, ASTRAY_READINGS = 8.0, 5  # a prediction that misses so many readings in a row by so much is lost
RIVAL = 25.0  # twice the difference in log-likelihood up to which a rival is carried along
DOUBT = 9.0  # and up to which it makes the answer ambiguous
DIFFERENT_M = 1e-4  # RMS of the outlines' difference from which two fits are rivals rather than the same
CHI2_SIGMAS, CHI2_SLACK = 3.0, 0.02
SECOND_OPINION_SIGMAS = 0.5
MOST_OUTLIERS = 0.2
MOST_SLACK = 0.25  # of the cost, for each contact reading: more, and the motion is not one of the model's
MOST_STRAIN = 60.0  # of the cost, from some thirty constants and their prior
STILL_RAD = 5e-3  # palms that move by less tell nothing of what turns with them


@dataclass(frozen=True, slots=True)
class Finding:
    """The distinct minima found on `record`, best first, at least one."""

    record: Record
    fits: tuple[Fit, ...]


class Search:
    """One stretch: its layout and its prior. Not for use inside the loop."""

    def __init__(self, stretch: Stretch, rig: RigDescription, patience: int = PATIENCE):
        """Lays out the stretch's readings; compiles the smoother the first time.

        `patience` is how many windows in all a search may find unexplained, and try again with a shorter one.
        """
        self._rig = rig
        self._patience = patience
        self._events = stretch.events()
        self.path = smoothed_path(stretch.palms, rig.palm_angle_noise)
        self.record = lay_out(stretch.pads, self.path, rig, stretch.start, stretch.end, SPACING_S)
        first = [sample for sample in stretch.pads if sample.t_sample < stretch.start + FIRST_LOOK_S]
        phi2 = self.path.at(np.array([sample.t_sample for sample in first]))[:, 1]
        self.prior = prior_of(first, np.tan(phi2 / 2))
        self.library = smoothing.library()

    def blind(self, seconds: float, count: int, seed: int) -> Finding | None:
        """Start from the `count` likeliest of a bank that has read the first `seconds`; None if that leads nowhere."""
        record = self.record.until(self.record.t[0] + seconds)
        starts = blind_starts(self._events, self._rig, seconds, seed)[:count]
        return self._grown_from(record, [start.guess(record.t) for start in starts]) if starts else None

    def resumed(self, guesses: Sequence[Guess]) -> Finding | None:
        """Go on from what was found on a shorter part of the same stretch; None if that leads nowhere."""
        return self._grown_from(self.record.steps(len(guesses[0].x) - 1), guesses)

    def _grown_from(self, record: Record, guesses: Sequence[Guess]) -> Finding | None:
        fits = self._fits(record, guesses)
        if len(record.t) < len(self.record.t) and not explained(fits[0], record):
            return None
        failures = 0
        while len(record.t) < len(self.record.t):
            now, known = float(record.t[-1]), [fit.guess for fit in fits]
            longer = self._longer(record, fits[0])
            found = self._fits(longer, known)
            # near an unstable equilibrium a long window ends on the wrong side of it
            while not explained(found[0], longer):
                step, failures = float(longer.t[-1]) - now, failures + 1
                if step < 1.5 * LEAST_GROWTH_S or failures > self._patience:
                    return Finding(longer, found) if len(longer.t) == len(self.record.t) else None
                longer = self.record.until(now + max(step / 2, LEAST_GROWTH_S))
                found = self._fits(longer, known)
            record, fits = longer, found
        return Finding(record, fits)

    def _longer(self, record: Record, fit: Fit) -> Record:
        """A longer window, as far as the fit foretells the readings to come: beyond that it would be led astray."""
        begin, now = record.t[0], record.t[-1]
        longer = self.record.until(begin + GROWTH * (now - begin))
        smoother = Smoother(self.library, longer, self.prior)
        miss = np.abs(smoother.residuals(smoother.completed(fit.guess)))
        gone = np.convolve(miss > ASTRAY_SIGMAS, np.ones(ASTRAY_READINGS), "valid") == ASTRAY_READINGS
        if not gone.any():
            return longer
        step = longer.contact_step[int(np.argmax(gone))]
        return self.record.until(max(longer.t[step], now + LEAST_GROWTH_S))

    def _fits(self, record: Record, guesses: Sequence[Guess]) -> tuple[Fit, ...]:
        """The distinct minima that the guesses lead to, best first, without those that are out of the race."""
        smoother = Smoother(self.library, record, self.prior)
        return _distinct([smoother.fit(guess, NOISE) for guess in guesses])


def merged(one: Finding | None, other: Finding | None) -> Finding | None:
    """What two searches of the same stretch have found between them."""
    if one is None or other is None:
        return one or other
    return Finding(one.record, _distinct([*one.fits, *other.fits]))


def _distinct(fits: Sequence[Fit]) -> tuple[Fit, ...]:
    ordered = sorted(fits, key=lambda fit: fit.cost)
    distinct: list[Fit] = []
    for fit in ordered:
        near = fit.cost < ordered[0].cost + RIVAL or not distinct
        if near and all(_difference(fit, other) > DIFFERENT_M for other in distinct):
            distinct.append(fit)
    return tuple(distinct)


def explained(fit: Fit, record: Record) -> bool:
    """Whether contacts and forces are explained to their noise, by a motion of the model and a likely object."""
    forces = len(record.force_value)
    slack, strain = fit.slack > MOST_SLACK * len(record.contact_value), fit.strain > MOST_STRAIN
    if slack or strain or fit.astray > ASTRAY_READINGS:
        return False
    return _consistent(fit.chi2, len(record.contact_value)) and (not forces or _consistent(fit.force_chi2, forces))


def beyond_question(fit: Fit, record: Record) -> bool:
    """Whether the contacts are explained so well that a second search would be a waste."""
    return _consistent(fit.chi2, len(record.contact_value), SECOND_OPINION_SIGMAS)


def doubt(fit: Fit, finding: Finding) -> str:
    """Why `fit`, the best of `finding` or a refinement of it, cannot be taken at its word; empty when it can."""
    if still(finding.record):
        return "nothing moves: readings at rest tell nothing of the outline"
    if not fit.settled:
        return "the iteration has not settled"
    if not explained(fit, finding.record):
        chi2 = f"chi2 {fit.chi2:.2f}, of the forces {fit.force_chi2:.2f}"
        effort = f"process noise {fit.slack:.0f}, prior {fit.strain:.0f}, readings astray {fit.astray}"
        return f"no likely object and motion explain the readings to their noise: {chi2}; {effort}"
    if fit.outliers > MOST_OUTLIERS:
        return f"{fit.outliers:.0%} of the readings are outliers"
    if any(rival.cost < finding.fits[0].cost + DOUBT for rival in finding.fits[1:]):
        return "another outline explains the readings as well"
    return ""


def still(record: Record) -> bool:
    """Whether the palms stand and every reading of a pad is the same to its noise."""
    if np.ptp(record.palms[:, :2], axis=0).max() > STILL_RAD:
        return False
    for pad in (1.0, 2.0):
        mine = record.contact_pad == pad
        values, variance = record.contact_value[mine], record.contact_variance[mine]
        if len(values) and not _consistent(float(np.mean((values - values.mean()) ** 2 / variance)), len(values)):
            return False
    return True


def _consistent(chi2: float, readings: int, sigmas: float = CHI2_SIGMAS) -> bool:
    return chi2 < 1.0 + CHI2_SLACK + sigmas * math.sqrt(2.0 / max(readings, 1))


def _difference(one: Fit, other: Fit) -> float:
    """RMS difference of two outlines (m), by Parseval."""
    miss = one.guess.p[C.SHAPE :] - other.guess.p[C.SHAPE :]
    return math.sqrt(float(miss[0] ** 2 + (miss[1:] ** 2).sum() / 2))
