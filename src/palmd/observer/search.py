"""Search for the trajectory and the outline of a segment of readings: blind, or from an earlier result.

A bank of filters reads the first seconds and provides starts; the smoother refines them, and its window then grows over
the segment. Rivals are kept as long as they explain the readings nearly as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model import shape, smoothing
from palmd.model.smoothing import NODE, ORDER, C
from palmd.observer.backward_extension import extended_backwards, knowledge_of_constants
from palmd.observer.criticism import RigBelief
from palmd.observer.data_segment import STILL_RAD, DataSegment
from palmd.observer.factor import Knowledge, Prior
from palmd.observer.first_guess import blind_starts, prior_of
from palmd.observer.normal_equations import Guess, ProcessNoise
from palmd.observer.object_memory import likely_orientations
from palmd.observer.pad_map import with_shared_errors
from palmd.observer.palm_path import smoothed_path
from palmd.observer.palms import RESTING_RAD_S, motion_of
from palmd.observer.record import NO_FORCES, Record, lay_out
from palmd.observer.smoother import MAX_ITERATIONS, Budget, Fit, Smoother, contradicts_knowledge, evidence_of
from palmd.system.arcs import circle_radius
from palmd.system.description import RigDescription
from palmd.system.mechanism import OPENING, PALMS
from palmd.system.reasons import NO_REASON, Code, Reason

SPACING_S = 0.01  # of the nodes during the search
FIRST_LOOK_S = 0.3  # readings that determine the object's size
PLACED_S = 0.4  # readings by which orientations are first judged
FIRST_READINGS, ORIENTATIONS = 5, 10
PLACED_SD_M = 1e-4  # 1σ of the outline's coefficients while its orientation is searched
NOISE = ProcessNoise(1e-8, 1e-5)
GRADUATED_NOISE = (1e5, 1e3, 10.0)
"""Factors on the process noise of successive fits (derivation: at first the spin may differ by 0.1 rad/s from node to
node, more than friction can change it there; ten times less in each further fit)."""
GRADUATED_ITERATIONS = 6
"""Of each of these fits, which need not converge, since they only initialise the next one (study 2026-11-30: with 6 as
with 60 iterations, 12 of 16 logged windows converged, in a third of the time)."""

GROWTH, LEAST_GROWTH_S, SHORT_GROWTH_S = 1.6, 0.1, 0.15
PATIENCE = 12  # windows that may fail in one search
LIVE_BUDGET = 80_000.0
"""Iterations times nodes of one live answer: 1.3 s of processor time (study 2026-11-30: 16 µs each; with 120,000,
answers were up to 6 s late)."""
DISCREPANCY_ROUNDS = 3
"""Evaluations of the friction law's uncertainty along the motion found with it (study 2026-11-30: five of six logged
searches converged, after 1, 2, 2, 3 and 5)."""
HASTY = 5  # rejected steps in a row, where a shorter window can be tried instead
# with palm 1 (φ1), with palm 2 (φ1 + φ2), not at all
TURNS: FloatArray = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
MOTIONS = (0, 1, 2)  # rows of `TURNS`
MOTION_ITERATIONS = 30  # of a fit with one of these motions
# residual, and number of readings in a row with it, by which a prediction has diverged
DIVERGED_SIGMAS, DIVERGED_READINGS = 8.0, 5
RIVALS, RIVAL_ITERATIONS = 4, 20
"""Filters from which fits of all readings start, and iterations of each (study 2026-12-01, 16 starts from each of six
banks: most starts near the right motion converge within 20, and depend more on the bank than on their rank in it)."""
RIVAL = 25.0  # twice the log-likelihood by which a rival may be worse and is kept
DOUBT = 9.0  # and by which it makes the answer ambiguous
LIKELIER = 5.0  # log evidence by which one minimum is preferred to another
DIFFERENT_M = 1e-4  # RMS difference of the outlines from which two fits are rivals rather than the same
CHI2_SIGMAS, CHI2_ALLOWANCE = 3.0, 0.02
SECOND_OPINION_SIGMAS = 0.5
MOST_FORCE_CHI2 = 4.0  # of forces that are noisier than described; beyond twice the noise another cause is assumed
MOST_OUTLIERS = 0.2
MOST_PROCESS_COST = 0.25  # process cost per contact reading; with more, the motion is not one of the model's
# process cost per contact reading, and prior cost; smooth outlines do not have more of both
HIGH_PROCESS_COST, HIGH_PRIOR_COST = 0.004, 30.0
# lower limit: where the noise is less than described, a likely object has it too; smooth objects have 0.9 and more
LEAST_CHI2 = 0.75
MOST_PRIOR_COST = 60.0  # prior cost, of some thirty constants
AMBIGUOUS = Reason(Code.AMBIGUOUS, "another outline explains the readings as well")
OVERFITTED = Reason(
    Code.UNEXPLAINED, "only an unlikely object explains the readings, and it fits better than their noise allows"
)
NOTHING_MOVES = Reason(Code.UNDETERMINED, "nothing moves: readings at rest do not determine the outline")


@dataclass(frozen=True, slots=True)
class Minima:
    """The distinct minima found on `record`, best first, at least one; `work`: iterations times nodes of all fits."""

    record: Record
    fits: tuple[Fit, ...]
    work: int = 0

    @property
    def readings(self) -> int:
        """Number of readings of contacts and forces."""
        return len(self.record.contact_value) + len(self.record.force_value)

    def jumps_from(self, before: Minima) -> bool:
        """Whether the readings added to those of `before` cost more than is likely, or are not explained to their end.

        Likely is what readings cost with the noise of the earlier ones. The described noise may be far above it, since
        it includes smooth errors of place.
        """
        added = self.readings - before.readings
        if added < 0:
            return True
        likely = before.fits[0].cost / before.readings * (added + CHI2_SIGMAS * math.sqrt(2.0 * added))
        return self.fits[0].cost - before.fits[0].cost > likely

    def until(self, t: float) -> Minima | None:
        """The best minimum on the part up to `t` (s); None when hardly anything is left."""
        record = self.record.until(t)
        if len(record.dt) < 2 or record.t[-1] > t:
            return None
        best = self.fits[0]
        cut = replace(best, guess=Guess(best.guess.x[: len(record.t)], best.guess.p))
        return Minima(record, (cut,))


class Attempt(NamedTuple):
    """A blind search: how long the bank reads (s), and the number of filters from which fits start.

    asymmetry: of the palms' friction, assumed by the bank. free: all constants of the rig are opened. later_s: seconds
    at the record's beginning that are fitted last, from the result of the rest. work: limit of iterations times nodes
    of the windows after the first; beyond it the search is abandoned. exact: pads' smooth position errors are ignored.
    """

    seconds: float
    starts: int
    asymmetry: float = 0.0
    free: bool = False
    later_s: float = 0.0
    work: float = math.inf
    exact: bool = False


class Likeliest(NamedTuple):
    """The likeliest finding, whether the readings decide, and which of the motions tried explain them."""

    finding: Minima
    decided: bool
    motions: tuple[int, ...]


class Search:
    """One segment: its layout and what is known beforehand. Not for use inside the loop."""

    def __init__(
        self,
        segment: DataSegment,
        rig: RigDescription,
        patience: int = PATIENCE,
        known: Knowledge | None = None,
        start: float | None = None,
        resting_since: float = math.inf,
        belief: RigBelief | None = None,
        most_forces: Sequence[float] = NO_FORCES,
        budget: Budget | None = None,
    ):
        """Lay out the segment's readings from `start` (s) on; compiles the smoother the first time.

        known: knowledge of the constants and the first node, by default the blind prior. patience: how many windows in
        all may fail and be tried again shorter. resting_since, most_forces: as in `lay_out`. belief: in the rig, by
        default its description. budget: shared by all fits; by default unlimited.
        """
        self.rig = rig
        self._patience = patience
        self.segment = segment
        start = segment.start if start is None else start
        self.path = smoothed_path(segment.palms, rig.palm_angle_noise)
        self.record = lay_out(segment.pads, self.path, rig, start, segment.end, SPACING_S, resting_since, most_forces)
        self.library = smoothing.library(rig.curved)
        self._known = known
        self._resting_since = resting_since
        self.belief = belief or RigBelief.of(rig)
        self.noise = noise_on(rig)
        self._budget = budget or Budget()

    def with_belief(self, belief: RigBelief) -> Search:
        """The same segment, to be searched under another belief in the rig."""
        other = copy(self)
        other.__dict__.pop("prior", None)
        other.belief = belief
        return other

    def with_knowledge(self, known: Knowledge) -> Search:
        """The same segment, to be searched with other knowledge of the constants and the first node."""
        other = copy(self)
        other._known = known
        return other

    def with_budget(self, budget: Budget) -> Search:
        """The same search with a budget of its own."""
        other = copy(self)
        other._budget = budget
        return other

    @property
    def known(self) -> Knowledge:
        """The knowledge used: what was given, else the blind prior."""
        return self._known or self.prior

    @cached_property
    def prior(self) -> Prior:
        """Prior of the object, from its first readings only."""
        segment = self.segment
        first_samples = [sample for sample in segment.pads if sample.t_sample < segment.start + FIRST_LOOK_S]
        opening = self.path.at(np.array([sample.t_sample for sample in first_samples]))[:, OPENING]
        if not self.rig.curved:
            radius = float(np.mean([sample.s for sample in first_samples] * np.tan(opening / 2)))
            return prior_of(radius, self.belief.sd, self.rig.vibration)
        mean = [float(np.mean([sample.s for sample in first_samples if sample.pad == palm])) for palm in PALMS]
        joints = self.path.at(np.array([segment.start + FIRST_LOOK_S / 2]))[0, : len(PALMS)]
        radius = circle_radius(joints.tolist(), mean, self.rig.curvatures)
        return prior_of(radius, self.belief.sd, self.rig.vibration)

    def rest_duration(self, t: float) -> float:
        """For how long (s) the palms have rested at `t` (s)."""
        return float(self.path.resting(np.array([t]), RESTING_RAD_S, self._resting_since)[0])

    def blind(self, attempt: Attempt, seed: int) -> Minima | None:
        """Start from the likeliest filters of a bank that has read the first seconds; None if no start succeeds."""
        if attempt.later_s > 0.0:
            return self._extended_backwards(attempt, seed)
        begin = self.record.t[0]
        record = self.record.until(begin + attempt.seconds)
        starts = blind_starts(
            self.segment.events(), self.rig, begin, attempt.seconds, seed, attempt.starts, attempt.asymmetry
        )
        guesses = [start.guess(record.t) for start in starts]
        return self.deepened(self._grown_from(record, guesses, attempt.work)) if starts else None

    def rival(self, asymmetry: float, seed: int) -> Minima | None:
        """Fits of all readings at once, from filters of a bank that has read all of them; None if none is explained.

        asymmetry: of the palms' friction, assumed by the bank.
        """
        begin, events = float(self.record.t[0]), self.segment.events()
        starts = blind_starts(events, self.rig, begin, self.segment.lasts, seed, RIVALS, asymmetry)
        smoother = self.smoother(self.record)
        fits = [smoother.fit(start.guess(self.record.t), self.noise, RIVAL_ITERATIONS) for start in starts]
        fits = [fit for fit in fits if explained(fit, self.record)]
        return self.deepened(Minima(self.record, _distinct(fits))) if fits else None

    def _extended_backwards(self, attempt: Attempt, seed: int) -> Minima | None:
        """As `blind` without the first seconds, to which the result is extended backwards."""
        begin, end = float(self.record.t[0]), float(self.record.t[-1])
        if end - begin < attempt.later_s + attempt.seconds:
            return None
        later = self._since(int(np.searchsorted(self.record.t, begin + attempt.later_s)))
        found = later.blind(attempt._replace(later_s=0.0), seed)
        if found is None:
            return None
        fit = found.fits[0]
        posterior = Smoother(self.library, found.record, later.known).posterior_if_any(fit)
        if posterior is None:
            return None
        known = knowledge_of_constants(fit.guess.p, posterior.covariance, self.prior.scale)
        whole = replace(self.record, force_variance=_scatter(found.record, later.record) * self.record.force_variance)
        guess = extended_backwards(self.library, whole, fit, known, explained)
        return None if guess is None else self._at_once([guess])

    def _since(self, first: int) -> Search:
        """The same search from node `first` on."""
        later = copy(self)
        later.__dict__.pop("prior", None)
        later.segment = self.segment.since(float(self.record.t[first]))
        later.record = self.record.between(first, len(self.record.dt))
        return later

    def resumed(self, guesses: Sequence[Guess], predict_forces: bool = False, strict: bool = True) -> Minima | None:
        """Continue fits of a shorter part of the segment, as far as readings are explained; None without any progress.

        First in one window to the end of the record. Where that does not converge, the process noise includes the
        discrepancy of the friction law along the predicted motion; included in every fit it would bias ρ towards heavy
        objects (`Smoother.with_discrepancy`). Then in one window again, at last in growing ones, each of them tried
        twice.
        predict_forces: contact forces are those that the model predicts. strict: whether to begin without that
        discrepancy, which is useful where nothing else is known of ρ.
        """
        as_described = self.record
        at_once = self._at_once(guesses, predict_forces) if strict else None
        if at_once is None or not at_once.fits[0].settled:
            smoother = self.smoother(self.record)
            self.record = smoother.with_discrepancy(smoother.completed(guesses[0]))
            if not strict or self.record.discrepancy.any():
                at_once = self._at_once(guesses, predict_forces)
        if at_once is not None and at_once.fits[0].settled:
            return at_once
        found = self._grown_from(self.record.steps(len(guesses[0].x) - 1), guesses, loosens=True) or at_once
        if found is None:
            self.record = as_described
        return found

    def deepened(self, found: Minima | None) -> Minima | None:
        """`found` with each minimum followed down its valley, where it explains the record to its end.

        Friction makes the cost a narrow, curved valley in which an iteration may stop early. With more process noise at
        first the valley is wide and nearly straight. A minimum found so may be another one, with a lower cost but so
        narrow that it is less likely.
        """
        if found is None or not self.covers(found):
            return found
        smoother, fits = self.smoother(found.record), list[Fit]()
        for fit in found.fits:
            deeper = smoother.fit(self._loosely_fitted(smoother, fit.guess), self.noise)
            better = deeper.settled and deeper.cost < fit.cost
            known = smoother.posterior_if_any(fit) if better and fit.settled else None
            likelier = better and evidence_of(smoother.posterior_if_any(deeper)) > evidence_of(known)
            fits.append(deeper if likelier else fit)
        return replace(found, fits=_distinct(fits))

    def with_friction_discrepancy(self, found: Minima) -> Minima:
        """`found`, which has not converged, with the friction law's discrepancy along its own motion as process noise.

        Where contacts stick and slip, the corners of the friction law keep an iteration from converging. `found` itself
        where that does not converge either.
        """
        guess, smoother = found.fits[0].guess, self.smoother(found.record)
        for _ in range(DISCREPANCY_ROUNDS):
            record = smoother.with_discrepancy(guess)
            if not record.discrepancy.any():
                break
            smoother = self.smoother(record)
            fit = smoother.fit(guess, self.noise)
            if not explained(fit, record):
                break  # the friction law is not the cause
            if fit.settled:
                return Minima(record, (fit,), found.work)
            guess = fit.guess
        return found

    def _at_once(self, guesses: Sequence[Guess], predict_forces: bool = False) -> Minima | None:
        """Fit of the whole record from guesses of which the first predicts it; None where it is not explained."""
        smoother = self.smoother(self.record)
        starts = [smoother.completed(guess) for guess in guesses]
        if diverged(smoother.residuals(starts[0])).any():
            return None
        if predict_forces:
            self.record = smoother.with_predicted_forces(starts[0])
        found = self.minima(self.record, starts, HASTY)
        return found if explained(found.fits[0], found.record) else None

    def from_constants(self, p: FloatArray) -> Minima | None:
        """Start from the constants `p`, at rest at the likeliest orientations; None where none of them is explained.

        ψ is gauge: the outline is rotated.
        """
        record = self.record.until(self.record.t[0] + PLACED_S)
        guesses = []
        for psi in self.orientations(p[C.SHAPE :]):
            turned = p.copy()
            turned[C.SHAPE :] = shape.turned(-psi, ORDER) @ p[C.SHAPE :]
            guesses.append(Guess(np.zeros((len(record.t), NODE)), turned))
        return self._grown_from(record, guesses)

    def orientations(self, outline: FloatArray) -> FloatArray:
        """The likeliest ψ (rad) of an outline (m) that has just been put down, from the first readings of both pads."""
        first = [[sample for sample in self.segment.pads if sample.pad == pad][:FIRST_READINGS] for pad in PALMS]
        contacts = [float(np.mean([sample.s for sample in samples])) for samples in first]
        palms = motion_of(self.path.at(np.array([first[0][0].t_sample]))[0])
        covariance = PLACED_SD_M**2 * np.eye(len(outline))
        return likely_orientations(outline, covariance, contacts, palms, self.rig, ORIENTATIONS)

    def _grown_from(
        self, record: Record, guesses: Sequence[Guess], most_work: float = math.inf, loosens: bool = False
    ) -> Minima | None:
        """Fit windows that grow to the end of the record; None where one is rejected.

        loosens: a rejected window is tried again with more process noise at first, and the progress so far is returned.
        """
        found = self.minima(record, guesses)
        if len(record.t) < len(self.record.t) and not explained(found.fits[0], found.record):
            return None
        failures = work = 0
        while len(found.record.t) < len(self.record.t):
            now, known = float(found.record.t[-1]), [fit.guess for fit in found.fits]
            longer = self._window(self._longer(found.record, found.fits[0]), now, known, loosens)
            work += longer.work
            # near an unstable equilibrium a long window may end on the wrong side
            while not (self._settled(longer) if loosens else explained(longer.fits[0], longer.record)):
                step, failures = float(longer.record.t[-1]) - now, failures + 1
                if step < SHORT_GROWTH_S or failures > self._patience or work > most_work:
                    if len(longer.record.t) == len(self.record.t):
                        return longer
                    return found if loosens and len(found.record.t) > len(record.t) else None
                longer = self._window(self.record.until(now + max(step / 2, LEAST_GROWTH_S)), now, known, loosens)
                work += longer.work
            found = longer
            if work > most_work and len(found.record.t) < len(self.record.t):
                return None
        return found

    def _window(self, record: Record, now: float, known: Sequence[Guess], loosens: bool) -> Minima:
        """The minima of `record`, from the guesses `known` until `now`; stops early if a shorter window is left."""
        last = float(record.t[-1]) - now < SHORT_GROWTH_S
        found = self.minima(record, known, MAX_ITERATIONS if last else HASTY)
        if not loosens or self._settled(found):
            return found
        loosened = self._loosened(record, known)
        return loosened if self._settled(loosened) else found

    def _loosened(self, record: Record, known: Sequence[Guess]) -> Minima:
        """As `minima`, with more process noise at first.

        Where contacts slip faster than the palms vibrate, the path depends so sharply on its start and the constants
        that the iteration hardly proceeds; with noise, the readings lead it.
        """
        smoother = self.smoother(record)
        return self.minima(record, [self._loosely_fitted(smoother, guess) for guess in known])

    def _loosely_fitted(self, smoother: Smoother, guess: Guess) -> Guess:
        """The guess after fits with `GRADUATED_NOISE`."""
        for times in GRADUATED_NOISE:
            guess = smoother.fit(guess, self.noise.noisier(times), GRADUATED_ITERATIONS).guess
        return guess

    def _longer(self, record: Record, fit: Fit) -> Record:
        """A longer window, as far as the fit predicts the next readings; beyond that the iteration would diverge."""
        begin, now = record.t[0], record.t[-1]
        longer = self.record.until(begin + GROWTH * (now - begin))
        smoother = self.smoother(longer)
        diverging = diverged(smoother.residuals(smoother.completed(fit.guess)))
        if not diverging.any():
            return longer
        step = longer.contact_step[int(np.argmax(diverging))]
        return self.record.until(max(longer.t[step], now + LEAST_GROWTH_S))

    def covers(self, finding: Minima) -> bool:
        """Whether a finding explains the readings to their end; `resumed` may return a shorter part."""
        return len(finding.record.t) == len(self.record.t)

    def _settled(self, found: Minima) -> bool:
        best = found.fits[0]
        return best.settled and explained(best, found.record)

    def smoother(self, record: Record) -> Smoother:
        """Smoother of a part of the segment, with this search's knowledge."""
        return Smoother(self.library, record, self.known, self._budget)

    def minima(self, record: Record, guesses: Sequence[Guess], rejections: int = MAX_ITERATIONS) -> Minima:
        """As `minima`, of this search."""
        return minima(self.smoother, record, guesses, self.noise, rejections)

    def with_correlated_errors(self, record: Record, fit: Fit, alone: bool = False) -> tuple[Record, Fit]:
        """The record with long-correlated errors in the noise model, as covariances need them, and its fit from `fit`.

        Errors of the friction law and the pads' position errors are the same for many readings in a row. The fit that
        decides whether the readings are explained must not include them: nearly every fit would pass. It may be drawn
        so far by errors of place that no minimum is near, and the fit begins with more process noise, then. `alone` as
        in `with_shared_errors`. Not limited by the budget.
        """
        record = with_shared_errors(self.smoother(record).with_discrepancy(fit.guess), self.rig, alone)
        smoother = Smoother(self.library, record, self.known)
        nearby = smoother.fit(fit.guess, fit.noise, GRADUATED_ITERATIONS)
        if explained(nearby, record):
            return record, nearby
        deeper = smoother.fit(self._loosely_fitted(smoother, fit.guess), fit.noise)
        return record, min(nearby, deeper, key=lambda each: each.cost)

    def likeliest(self, finding: Minima, motions: Sequence[int] = MOTIONS) -> Likeliest:
        """`finding`, or a motion with a palm or at rest where that is likelier; and whether the readings decide.

        motions: those of `MOTIONS` that are tried. A motion that has not explained a part of the readings need not be
        tried on more of them.

        Readings that hardly determine how an object turns are fitted a little better by one of many wrong motions with
        sharp minima than by the right one with a wide minimum. So the evidence is compared: the cost, and the width of
        each minimum.
        """
        smoother, best = self.smoother(finding.record), finding.fits[0]
        posterior = smoother.posterior_if_any(best)
        if posterior is None:
            return Likeliest(finding, False, tuple(motions))
        best_evidence, rival, explaining = -math.inf, best, list[int]()
        for motion in motions:
            fit = smoother.fit(self._turning_circle(best.guess.p, motion), self.noise, MOTION_ITERATIONS)
            if not explained(fit, finding.record):
                continue
            explaining.append(motion)
            posterior_of_rival = None if _difference(fit, best) <= DIFFERENT_M else smoother.posterior_if_any(fit)
            if posterior_of_rival is not None and posterior_of_rival.evidence > best_evidence:
                best_evidence, rival = posterior_of_rival.evidence, fit
        decided = best_evidence < posterior.evidence - LIKELIER
        if best_evidence > posterior.evidence + LIKELIER:
            finding = Minima(finding.record, (rival,))
        return Likeliest(finding, decided, tuple(explaining))

    def _turning_circle(self, p: FloatArray, motion: int) -> Guess:
        """A circle that turns with palm 1 or with palm 2, as an object on a flat side does, or not at all."""
        start = p.copy()
        start[C.SHAPE :] = self.prior.mean[C.SHAPE :]
        angles, rates, _ = np.split(self.record.palms, 3, axis=1)
        turns = np.stack([angles - angles[0], rates], axis=1)
        return Guess(turns @ TURNS[motion], start)

    def merged(self, one: Minima | None, other: Minima | None) -> Minima | None:
        """The minima of two searches of the whole segment."""
        if one is None or other is None:
            return one or other
        if np.array_equal(one.record.force_variance, other.record.force_variance):
            return Minima(one.record, _distinct([*one.fits, *other.fits]))
        return self.minima(self.record, [fit.guess for fit in (*one.fits, *other.fits)])


def minima(
    smoother_of: Callable[[Record], Smoother],
    record: Record,
    guesses: Sequence[Guess],
    noise: ProcessNoise,
    rejections: int = MAX_ITERATIONS,
) -> Minima:
    """The distinct minima found from the guesses, best first, without those that are too unlikely to be kept.

    The forces' noise is their scatter about the best fit. rejections: as in `Smoother.fit`.
    """
    smoother = smoother_of(record)
    found = [smoother.fit(guess, noise, rejections=rejections) for guess in guesses]
    fits, iterations = _distinct(found), sum(fit.iterations for fit in found)
    noisier = _with_scatter_of_forces(record, fits[0])
    if noisier is not record:
        smoother = smoother_of(noisier)
        found = [smoother.fit(fit.guess, noise) for fit in fits]
        fits, iterations = _distinct(found), iterations + sum(fit.iterations for fit in found)
    return Minima(noisier, fits, iterations * len(record.t))


def noise_on(rig: RigDescription) -> ProcessNoise:
    """Process noise, uneven rotation of this rig's palms included."""
    return replace(NOISE, omega0=NOISE.omega0 + rig.rounding_spin_density)


def diverged(residuals: FloatArray) -> npt.NDArray[np.bool_]:
    """Where `DIVERGED_READINGS` readings in a row have normalised residuals above `DIVERGED_SIGMAS`."""
    is_outlier = np.abs(residuals) > DIVERGED_SIGMAS
    diverging: npt.NDArray[np.bool_] = np.convolve(is_outlier, np.ones(DIVERGED_READINGS), "valid") == DIVERGED_READINGS
    return diverging


def _with_scatter_of_forces(record: Record, fit: Fit) -> Record:
    """The record with the forces' noise increased to their scatter about a fit that explains the contacts.

    What shakes the table disturbs the forces long before it moves a contact.
    """
    forces = len(record.force_value)
    described = not forces or consistent(fit.force_chi2, forces)
    if described or not consistent(fit.chi2, len(record.contact_value)):
        return record
    return replace(record, force_variance=min(fit.force_chi2, MOST_FORCE_CHI2) * record.force_variance)


def _scatter(found: Record, described: Record) -> float:
    """Factor of the forces' variance found over the described one."""
    n = len(found.force_value)
    return float(found.force_variance[0] / described.force_variance[0]) if n else 1.0


def _distinct(fits: Sequence[Fit]) -> tuple[Fit, ...]:
    ordered = sorted(fits, key=lambda fit: fit.cost)
    distinct: list[Fit] = []
    for fit in ordered:
        near = fit.cost < ordered[0].cost + RIVAL or not distinct
        if near and all(different(fit, other) for other in distinct):
            distinct.append(fit)
    return tuple(distinct)


def explained(fit: Fit, record: Record) -> bool:
    """Whether contacts and forces are explained to their noise, by a motion of the model and a likely object."""
    forces = len(record.force_value)
    process_cost_high, prior_cost_high = (
        fit.process_cost > MOST_PROCESS_COST * len(record.contact_value),
        fit.prior_cost > MOST_PRIOR_COST,
    )
    if process_cost_high or prior_cost_high or fit.outlier_run > DIVERGED_READINGS:
        return False
    contacts_and_forces = consistent(fit.chi2, len(record.contact_value)) and (
        not forces or consistent(fit.force_chi2, forces)
    )
    return contacts_and_forces and not contradicts_knowledge(fit)  # last: it costs most


def is_implausible(fit: Fit, record: Record) -> bool:
    """Whether the readings are not explained, or only by an unlikely object with a trembling motion.

    A smooth outline explains an object on a flat side like this: with such a large radius of curvature that ψ need
    tremble by tens of microradians only to reach each contact reading.
    """
    trembles = fit.process_cost > HIGH_PROCESS_COST * len(record.contact_value)
    return (fit.settled and not explained(fit, record)) or (trembles and fit.prior_cost > HIGH_PRIOR_COST)


def overfits(fit: Fit) -> bool:
    """Whether the readings are explained far better than their noise allows, by an unlikely object.

    As in `is_implausible`, this is caused by a flat side: ψ follows each reading.
    """
    return fit.chi2 < LEAST_CHI2 and fit.prior_cost > HIGH_PRIOR_COST


def beyond_question(fit: Fit, record: Record) -> bool:
    """Whether the contacts are explained so well that no second search is needed."""
    return consistent(fit.chi2, len(record.contact_value), SECOND_OPINION_SIGMAS)


def rejection_reason(fit: Fit, finding: Minima) -> Reason:
    """Reason to reject `fit`, the best of `finding` or a refinement of it; none when it is accepted."""
    return misfit_reason(fit, finding.record) or (AMBIGUOUS if rivals_of(finding) else NO_REASON)


def misfit_reason(fit: Fit, record: Record) -> Reason:
    """Why `fit` does not explain the readings, whether or not anything else does; none when it does."""
    if nothing_moves(record):
        return NOTHING_MOVES
    if not fit.settled:
        return Reason(Code.NOT_CONVERGED, "the iteration has not converged")
    if not explained(fit, record):
        chi2 = f"chi2 {fit.chi2:.2f}, of the forces {fit.force_chi2:.2f}"
        costs = f"process noise {fit.process_cost:.0f}, prior {fit.prior_cost:.0f}, outliers in a row {fit.outlier_run}"
        text = f"no likely object and motion explain the readings to their noise: {chi2}; {costs}"
        return Reason(Code.UNEXPLAINED, text)
    if fit.outliers > MOST_OUTLIERS:
        return Reason(Code.OUTLIERS, f"{fit.outliers:.0%} of the readings are outliers")
    return NO_REASON


def rivals_of(finding: Minima) -> list[Fit]:
    """The other outlines that explain the readings as well as the best one."""
    return [rival for rival in finding.fits[1:] if rival.cost < finding.fits[0].cost + DOUBT]


def different(one: Fit, other: Fit) -> bool:
    """Whether two fits are of different outlines."""
    return _difference(one, other) > DIFFERENT_M


def agree(one: Minima | None, other: Minima | None) -> bool:
    """Whether two searches have found the same outline."""
    return one is not None and other is not None and _difference(one.fits[0], other.fits[0]) < DIFFERENT_M


def nothing_moves(record: Record) -> bool:
    """Whether the palms stand still and the readings of each pad are constant to their noise."""
    if np.ptp(record.palms[:, :2], axis=0).max() > STILL_RAD:
        return False
    for pad in PALMS:
        of_pad = record.contact_pad == pad
        values, variance = record.contact_value[of_pad], record.contact_variance[of_pad]
        if len(values) and not consistent(float(np.mean((values - values.mean()) ** 2 / variance)), len(values)):
            return False
    return True


def consistent(chi2: float, readings: int, sigmas: float = CHI2_SIGMAS) -> bool:
    """Whether so many readings are explained to their noise."""
    return chi2 < 1.0 + CHI2_ALLOWANCE + sigmas * math.sqrt(2.0 / max(readings, 1))


def _difference(one: Fit, other: Fit) -> float:
    """RMS difference of two outlines (m), by Parseval's theorem."""
    difference = one.guess.p[C.SHAPE :] - other.guess.p[C.SHAPE :]
    return math.sqrt(float(difference[0] ** 2 + (difference[1:] ** 2).sum() / 2))
