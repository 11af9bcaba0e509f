"""The search for the trajectory and the outline behind a segment of readings: blind or from an earlier answer.

A bank of filters reads the first seconds and says where a solution may lie; the smoother goes there, and its window
then grows over the segment, with rivals kept as long as they explain the readings nearly as well.
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
from palmd.observer.beginning import known_of, with_beginning
from palmd.observer.criticism import RigBelief
from palmd.observer.data_segment import STILL_RAD, DataSegment
from palmd.observer.factor import Knowledge, Prior
from palmd.observer.first_guess import blind_starts, prior_of
from palmd.observer.normal_equations import Guess, ProcessNoise
from palmd.observer.object_memory import likely_orientations
from palmd.observer.palm_path import smoothed_path
from palmd.observer.palms import RESTING_RAD_S, motion_of
from palmd.observer.record import NO_FORCES, Record, lay_out
from palmd.observer.smoother import MAX_ITERATIONS, Budget, Fit, Smoother
from palmd.system.arcs import circle_radius
from palmd.system.description import RigDescription
from palmd.system.mechanism import OPENING, PALMS

SPACING_S = 0.01  # of the nodes while looking for the answer
FIRST_LOOK_S = 0.3  # readings that tell the object's size
PLACED_S = 0.4  # readings that orientations are first judged by
FIRST_READINGS, ORIENTATIONS = 5, 10
PLACED_SD_M = 1e-4  # of the outline's coefficients, where its orientation is sought
NOISE = ProcessNoise(1e-8, 1e-5)
LED_BY_READINGS = (1e5, 1e3, 10.0)
"""Times the process noise, one fit after the other (derivation: at first the spin may differ by 0.1 rad/s from node to
node, more than any friction changes it there, then by ten times less each)."""
LED_ITERATIONS = 6
"""Of each of these fits, which need not converge, since they only initialise the next one (study 2026-11-30: with 6 as
with 60 iterations, 12 of 16 logged windows converged, in a third of the time)."""

GROWTH, LEAST_GROWTH_S, SHORT_GROWTH_S = 1.6, 0.1, 0.15
PATIENCE = 12
LIVE_BUDGET = 80_000.0
"""Iterations times nodes of one live answer: 1.3 s of processor time (study 2026-11-30: 16 µs each; with 120,000
answers came up to 6 s late)."""
JUDGED = 3
"""Times that the law's uncertainty is evaluated along the motion that it led to (study 2026-11-30: of six logged
searches five settled, after 1, 2, 2, 3 and 5)."""
HASTY = 5  # steps in a row that may be rejected, where a shorter window can be tried instead
TURNS: FloatArray = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 0.0]])  # with φ1, with φ1 + φ2, not at all
MOTIONS = (0, 1, 2)  # of these
RIDE_ITERATIONS = 30  # that one of these motions is worth
ASTRAY_SIGMAS, ASTRAY_READINGS = 8.0, 5  # a prediction that misses so many readings in a row by so much is lost
RIVAL = 25.0  # twice the difference in log-likelihood up to which a rival is carried along
DOUBT = 9.0  # and up to which it makes the answer ambiguous
LIKELIER = 5.0  # in log evidence, from which on one minimum is taken for right and not another
DIFFERENT_M = 1e-4  # RMS of the outlines' difference from which two fits are rivals rather than the same
CHI2_SIGMAS, CHI2_SLACK = 3.0, 0.02
SECOND_OPINION_SIGMAS = 0.5
MOST_FORCE_CHI2 = 4.0  # of forces that are noisier than described: by twice, and something else is wrong
MOST_OUTLIERS = 0.2
MOST_SLACK = 0.25  # of the cost, for each contact reading: more, and the motion is not one of the model's
TREMBLING, UNLIKELY = 0.004, 30.0  # of the same two, where there is more of both than smooth outlines have
LEAST_CHI2 = 0.75  # where noise is less than described, a likely object has it too; smooth bodies have 0.9 and more
MOST_STRAIN = 60.0  # of the cost, from some thirty constants and their prior
AMBIGUOUS = "another outline explains the readings as well"
OVERFITTED = "only an unlikely object explains the readings, and better than their noise allows"
NOTHING_MOVES = "nothing moves: readings at rest tell nothing of the outline"


@dataclass(frozen=True, slots=True)
class Minima:
    """The distinct minima found on `record`, best first, at least one; `work`: iterations times nodes, of all fits."""

    record: Record
    fits: tuple[Fit, ...]
    work: int = 0

    def until(self, t: float) -> Minima | None:
        """The best one's part up to `t` (s); None when hardly anything is left."""
        record = self.record.until(t)
        if len(record.dt) < 2 or record.t[-1] > t:
            return None
        best = self.fits[0]
        cut = replace(best, guess=Guess(best.guess.x[: len(record.t)], best.guess.p))
        return Minima(record, (cut,))


class Attempt(NamedTuple):
    """Of a blind search: what a bank of one friction asymmetry reads (s), and how many filters are started from.

    `free`: nothing that is believed of the rig's constants is taken at its word. `later_s`: seconds from the record's
    beginning that are sought last, from what the rest of it tells. `work`: iterations times nodes of the windows
    after the first, beyond which a search that has not come to the end of the record is given up. `exact`: pads' smooth
    errors of place are not thought of.
    """

    seconds: float
    starts: int
    asymmetry: float = 0.0
    free: bool = False
    later_s: float = 0.0
    work: float = math.inf
    exact: bool = False


class Likeliest(NamedTuple):
    """What is likeliest, whether the readings decide, and which motions explain them, of those that were tried."""

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
        most_strain: float = MOST_STRAIN,
    ):
        """Lays out the segment's readings from `start` (s) on; compiles the smoother the first time.

        `known` is about the constants and the first node, by default the blind prior. `patience` is how many windows in
        all a search may find unexplained, and try again with a shorter one. `resting_since` and `most_forces` as in
        `lay_out`. `belief` in the rig is by default what its description says. All fits share the `budget`, if any.
        `most_strain`: see `explained`.
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
        self._most_strain = most_strain

    def believing(self, belief: RigBelief) -> Search:
        """The same segment, searched anew under another belief in the rig."""
        other = copy(self)
        other.__dict__.pop("prior", None)
        other.belief = belief
        return other

    def knowing(self, known: Knowledge) -> Search:
        """The same segment, searched by something else that is known of the constants and the first node."""
        other = copy(self)
        other._known = known
        return other

    def spending(self, budget: Budget) -> Search:
        """The same, with a budget of its own."""
        other = copy(self)
        other._budget = budget
        return other

    @property
    def known(self) -> Knowledge:
        """What the search goes by: what was known beforehand, else the blind prior."""
        return self._known or self.prior

    @cached_property
    def prior(self) -> Prior:
        """What is believed of the object before anything but its first readings."""
        segment = self.segment
        first = [sample for sample in segment.pads if sample.t_sample < segment.start + FIRST_LOOK_S]
        opening = self.path.at(np.array([sample.t_sample for sample in first]))[:, OPENING]
        if not self.rig.curved:
            radius = float(np.mean([sample.s for sample in first] * np.tan(opening / 2)))
            return prior_of(radius, self.belief.sd, self.rig.vibration)
        mean = [float(np.mean([sample.s for sample in first if sample.pad == palm])) for palm in PALMS]
        joints = self.path.at(np.array([segment.start + FIRST_LOOK_S / 2]))[0, : len(PALMS)]
        radius = circle_radius(joints.tolist(), mean, self.rig.curvatures)
        return prior_of(radius, self.belief.sd, self.rig.vibration)

    def rested(self, t: float) -> float:
        """For how long the palms have rested at `t` (s)."""
        return float(self.path.resting(np.array([t]), RESTING_RAD_S, self._resting_since)[0])

    def blind(self, attempt: Attempt, seed: int) -> Minima | None:
        """Start from the likeliest of a bank that has read the first seconds; None if that leads nowhere."""
        if attempt.later_s > 0.0:
            return self._backwards(attempt, seed)
        begin = self.record.t[0]
        record = self.record.until(begin + attempt.seconds)
        starts = blind_starts(
            self.segment.events(), self.rig, begin, attempt.seconds, seed, attempt.starts, attempt.asymmetry
        )
        guesses = [start.guess(record.t) for start in starts]
        return self._grown_from(record, guesses, attempt.work) if starts else None

    def _backwards(self, attempt: Attempt, seed: int) -> Minima | None:
        """As `blind` without the first seconds, which are joined to what that finds."""
        begin, end = float(self.record.t[0]), float(self.record.t[-1])
        if end - begin < attempt.later_s + attempt.seconds:
            return None
        rest = self._since(int(np.searchsorted(self.record.t, begin + attempt.later_s)))
        found = rest.blind(attempt._replace(later_s=0.0), seed)
        if found is None:
            return None
        fit = found.fits[0]
        told = Smoother(self.library, found.record, rest.known).posterior_if_any(fit)
        if told is None:
            return None
        known = known_of(fit.guess.p, told.covariance, self.prior.scale)
        whole = replace(self.record, force_variance=_scatter(found.record, rest.record) * self.record.force_variance)
        guess = with_beginning(self.library, whole, fit, known, explained)
        return None if guess is None else self._at_once([guess])

    def _since(self, first: int) -> Search:
        """The same from node `first` on."""
        later = copy(self)
        later.__dict__.pop("prior", None)
        later.segment = self.segment.since(float(self.record.t[first]))
        later.record = self.record.between(first, len(self.record.dt))
        return later

    def resumed(self, guesses: Sequence[Guess], pressed: bool = False, strict: bool = True) -> Minima | None:
        """Continue fits of a shorter part of the segment, as far as readings are explained; None without any progress.

        First in one window to the end of the record. Where that does not converge, the process noise includes the
        discrepancy of the friction law along the predicted motion; included in every fit it would bias ρ towards heavy
        bodies (`Smoother.judged`). Then in one window again, at last in growing ones, each of them tried twice.
        pressed: contacts are pressed as the model predicts. strict: whether to begin without that discrepancy, which
        is of use where nothing else is known of ρ.
        """
        described = self.record
        at_once = self._at_once(guesses, pressed) if strict else None
        if at_once is None or not at_once.fits[0].settled:
            smoother = self.smoother(self.record)
            self.record = smoother.judged(smoother.completed(guesses[0]))
            if not strict or self.record.left_open.any():
                at_once = self._at_once(guesses, pressed)
        if at_once is not None and at_once.fits[0].settled:
            return at_once
        found = self._grown_from(self.record.steps(len(guesses[0].x) - 1), guesses, loosens=True) or at_once
        if found is None:
            self.record = described
        return found

    def doubted(self, found: Minima) -> Minima:
        """`found`, which has not settled, with steps as uncertain as the law of friction along its own motion.

        Where contacts stick and slip the law's own corners keep an iteration from settling. Itself where that does not
        settle either.
        """
        guess, smoother = found.fits[0].guess, self.smoother(found.record)
        for _ in range(JUDGED):
            record = smoother.judged(guess)
            if not record.left_open.any():
                break
            smoother = self.smoother(record)
            fit = smoother.fit(guess, self.noise)
            if not self.explained(fit, record):
                break  # it is not the law's corners that are in the way
            if fit.settled:
                return Minima(record, (fit,), found.work)
            guess = fit.guess
        return found

    def _at_once(self, guesses: Sequence[Guess], pressed: bool = False) -> Minima | None:
        """What explains the whole record, from guesses of which the first foretells it; None else."""
        smoother = self.smoother(self.record)
        starts = [smoother.completed(guess) for guess in guesses]
        if astray(smoother.residuals(starts[0])).any():
            return None
        if pressed:
            self.record = smoother.pressed(starts[0])
        found = self.minima(self.record, starts, HASTY)
        return found if self.explained(found.fits[0], found.record) else None

    def placed(self, p: FloatArray) -> Minima | None:
        """Start from the constants `p`, at rest at the likeliest orientations; None where none of them is explained.

        ψ is gauge: it is the outline that is turned.
        """
        record = self.record.until(self.record.t[0] + PLACED_S)
        guesses = []
        for psi in self.orientations(p[C.SHAPE :]):
            turned = p.copy()
            turned[C.SHAPE :] = shape.turned(-psi, ORDER) @ p[C.SHAPE :]
            guesses.append(Guess(np.zeros((len(record.t), NODE)), turned))
        return self._grown_from(record, guesses)

    def orientations(self, outline: FloatArray) -> FloatArray:
        """The likeliest ψ (rad) of an outline (m) that has just been put down, by the first readings of both pads."""
        first = [[sample for sample in self.segment.pads if sample.pad == pad][:FIRST_READINGS] for pad in PALMS]
        contacts = [float(np.mean([sample.s for sample in samples])) for samples in first]
        palms = motion_of(self.path.at(np.array([first[0][0].t_sample]))[0])
        covariance = PLACED_SD_M**2 * np.eye(len(outline))
        return likely_orientations(outline, covariance, contacts, palms, self.rig, ORIENTATIONS)

    def _grown_from(
        self, record: Record, guesses: Sequence[Guess], most_work: float = math.inf, loosens: bool = False
    ) -> Minima | None:
        """Fit windows that grow to the end of the record; None where one is rejected.

        loosens: a rejected window is tried again with more process noise at first, and progress so far is returned.
        """
        found = self.minima(record, guesses)
        if len(record.t) < len(self.record.t) and not self.explained(found.fits[0], found.record):
            return None
        failures = work = 0
        while len(found.record.t) < len(self.record.t):
            now, known = float(found.record.t[-1]), [fit.guess for fit in found.fits]
            longer = self._window(self._longer(found.record, found.fits[0]), now, known, loosens)
            work += longer.work
            # near an unstable equilibrium a long window ends on the wrong side of it
            while not (self._settled(longer) if loosens else self.explained(longer.fits[0], longer.record)):
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
        """The minima of `record`, from what is `known` until `now`; given up soon if a shorter one can be tried."""
        last = float(record.t[-1]) - now < SHORT_GROWTH_S
        found = self.minima(record, known, MAX_ITERATIONS if last else HASTY)
        if not loosens or self._settled(found):
            return found
        loosened = self._loosened(record, known)
        return loosened if self._settled(loosened) else found

    def _loosened(self, record: Record, known: Sequence[Guess]) -> Minima:
        """As `minima`, of a motion that is noisier at first.

        Contacts that slip faster than the palms vibrate make a path bend so sharply with its start and the constants
        that the iteration hardly gets on along it; one that may leave the model's for a moment is led by the readings.
        """
        smoother, guesses = self.smoother(record), list(known)
        for times in LED_BY_READINGS:
            noisier = self.noise.noisier(times)
            guesses = [smoother.fit(guess, noisier, LED_ITERATIONS).guess for guess in guesses]
        return self.minima(record, guesses)

    def _longer(self, record: Record, fit: Fit) -> Record:
        """A longer window, as far as the fit foretells the readings to come: beyond that it would be led astray."""
        begin, now = record.t[0], record.t[-1]
        longer = self.record.until(begin + GROWTH * (now - begin))
        smoother = self.smoother(longer)
        gone = astray(smoother.residuals(smoother.completed(fit.guess)))
        if not gone.any():
            return longer
        step = longer.contact_step[int(np.argmax(gone))]
        return self.record.until(max(longer.t[step], now + LEAST_GROWTH_S))

    def covers(self, finding: Minima) -> bool:
        """Whether a finding explains the readings to their end; `resumed` may return a shorter part."""
        return len(finding.record.t) == len(self.record.t)

    def explained(self, fit: Fit, record: Record) -> bool:
        """As the function of that name, by this search's limit of strain."""
        return explained(fit, record, self._most_strain)

    def _settled(self, found: Minima) -> bool:
        best = found.fits[0]
        return best.settled and self.explained(best, found.record)

    def smoother(self, record: Record) -> Smoother:
        """Of a part of the segment, by what the search goes by."""
        return Smoother(self.library, record, self.known, self._budget)

    def minima(self, record: Record, guesses: Sequence[Guess], rejections: int = MAX_ITERATIONS) -> Minima:
        """As `minima`, of this search."""
        return minima(self.smoother, record, guesses, self.noise, rejections)

    def likeliest(self, finding: Minima, motions: Sequence[int] = MOTIONS) -> Likeliest:
        """`finding` or, where likelier, what turns as a palm does, or not at all; and whether the readings decide.

        `motions`: those of `MOTIONS` that are tried. What has not explained a shorter part of the same readings does
        not explain more of them either.

        Readings that hardly tell how an object turns are explained a little better by one of many motions, about which
        everything looks sharp, than by the right one, about which little does. So it is the evidence that is compared:
        the cost, and how wide each minimum is.
        """
        smoother, best = self.smoother(finding.record), finding.fits[0]
        posterior = smoother.posterior_if_any(best)
        if posterior is None:
            return Likeliest(finding, False, tuple(motions))
        most, rival, able = -math.inf, best, list[int]()
        for motion in motions:
            fit = smoother.fit(self._riding(best.guess.p, motion), self.noise, RIDE_ITERATIONS)
            if not self.explained(fit, finding.record):
                continue
            able.append(motion)
            found = None if _difference(fit, best) <= DIFFERENT_M else smoother.posterior_if_any(fit)
            if found is not None and found.evidence > most:
                most, rival = found.evidence, fit
        decided = most < posterior.evidence - LIKELIER
        if most > posterior.evidence + LIKELIER:
            finding = Minima(finding.record, (rival,))
        return Likeliest(finding, decided, tuple(able))

    def _riding(self, p: FloatArray, motion: int) -> Guess:
        """A circle that turns with palm 1, with palm 2, as what lies on a flat side does, or not at all."""
        begun = p.copy()
        begun[C.SHAPE :] = self.prior.mean[C.SHAPE :]
        angles, rates, _ = np.split(self.record.palms, 3, axis=1)
        moved = np.stack([angles - angles[0], rates], axis=1)
        return Guess(moved @ TURNS[motion], begun)

    def merged(self, one: Minima | None, other: Minima | None) -> Minima | None:
        """What two searches of the whole segment have found between them."""
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
    """The distinct minima that the guesses lead to, best first, without those too unlikely to be kept.

    Forces are as noisy as they scatter about the best. `rejections` as in `Smoother.fit`.
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
    """What the model leaves out, how unevenly the palms of this rig turn included."""
    return replace(NOISE, omega0=NOISE.omega0 + rig.rounding_spin_density)


def astray(residuals: FloatArray) -> npt.NDArray[np.bool_]:
    """Where `ASTRAY_READINGS` readings in a row are missed by `ASTRAY_SIGMAS`; residuals in sigmas."""
    miss = np.abs(residuals) > ASTRAY_SIGMAS
    gone: npt.NDArray[np.bool_] = np.convolve(miss, np.ones(ASTRAY_READINGS), "valid") == ASTRAY_READINGS
    return gone


def _with_scatter_of_forces(record: Record, fit: Fit) -> Record:
    """The record, its forces as noisy as they scatter about a fit that explains the contacts, if more than described.

    Whatever shakes the table shakes the forces long before it moves a contact.
    """
    forces = len(record.force_value)
    described = not forces or consistent(fit.force_chi2, forces)
    if described or not consistent(fit.chi2, len(record.contact_value)):
        return record
    return replace(record, force_variance=min(fit.force_chi2, MOST_FORCE_CHI2) * record.force_variance)


def _scatter(found: Record, described: Record) -> float:
    """By how much the variance of forces was found to exceed the described one."""
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


def explained(fit: Fit, record: Record, most_strain: float = MOST_STRAIN) -> bool:
    """Whether contacts and forces are explained to their noise, by a motion of the model and a likely object.

    most_strain: by how much what is known beforehand may be contradicted (twice a log-likelihood).
    """
    forces = len(record.force_value)
    slack, strain = fit.slack > MOST_SLACK * len(record.contact_value), fit.strain > most_strain
    if slack or strain or fit.astray > ASTRAY_READINGS:
        return False
    return consistent(fit.chi2, len(record.contact_value)) and (not forces or consistent(fit.force_chi2, forces))


def far_fetched(fit: Fit, record: Record) -> bool:
    """Whether the readings are not explained, or only by an unlikely object that trembles besides.

    So a smooth outline explains what lies on a flat side: with a radius of curvature so large that ψ need tremble by
    tens of microradians only to be wherever the contact was read.
    """
    trembles = fit.slack > TREMBLING * len(record.contact_value)
    return (fit.settled and not explained(fit, record)) or (trembles and fit.strain > UNLIKELY)


def overfits(fit: Fit) -> bool:
    """Whether the readings are explained far better than their noise allows, and by an unlikely object at that.

    As in `far_fetched` it is a side that is passed: ψ goes wherever each reading wants it to.
    """
    return fit.chi2 < LEAST_CHI2 and fit.strain > UNLIKELY


def beyond_question(fit: Fit, record: Record) -> bool:
    """Whether the contacts are explained so well that a second search would be a waste."""
    return consistent(fit.chi2, len(record.contact_value), SECOND_OPINION_SIGMAS)


def doubt(fit: Fit, finding: Minima) -> str:
    """Why `fit`, the best of `finding` or a refinement of it, cannot be taken at its word; empty when it can."""
    return unfit(fit, finding.record) or (AMBIGUOUS if rivalled(finding) else "")


def unfit(fit: Fit, record: Record) -> str:
    """Why `fit` is no explanation of the readings, whatever else is one; empty when it is."""
    if still(record):
        return NOTHING_MOVES
    if not fit.settled:
        return "the iteration has not settled"
    if not explained(fit, record):
        chi2 = f"chi2 {fit.chi2:.2f}, of the forces {fit.force_chi2:.2f}"
        effort = f"process noise {fit.slack:.0f}, prior {fit.strain:.0f}, readings astray {fit.astray}"
        return f"no likely object and motion explain the readings to their noise: {chi2}; {effort}"
    if fit.outliers > MOST_OUTLIERS:
        return f"{fit.outliers:.0%} of the readings are outliers"
    return ""


def rivalled(finding: Minima) -> bool:
    """Whether other outlines explain the readings as well as the best: later ones will tell."""
    return bool(rivals_of(finding))


def rivals_of(finding: Minima) -> list[Fit]:
    """The other outlines that explain the readings as well as the best."""
    return [rival for rival in finding.fits[1:] if rival.cost < finding.fits[0].cost + DOUBT]


def different(one: Fit, other: Fit) -> bool:
    """Whether two fits are of different outlines."""
    return _difference(one, other) > DIFFERENT_M


def agree(one: Minima | None, other: Minima | None) -> bool:
    """Whether two searches have come to the same outline."""
    return one is not None and other is not None and _difference(one.fits[0], other.fits[0]) < DIFFERENT_M


def still(record: Record) -> bool:
    """Whether the palms stand and every reading of a pad is the same to its noise."""
    if np.ptp(record.palms[:, :2], axis=0).max() > STILL_RAD:
        return False
    for pad in PALMS:
        mine = record.contact_pad == pad
        values, variance = record.contact_value[mine], record.contact_variance[mine]
        if len(values) and not consistent(float(np.mean((values - values.mean()) ** 2 / variance)), len(values)):
            return False
    return True


def consistent(chi2: float, readings: int, sigmas: float = CHI2_SIGMAS) -> bool:
    """Whether so many readings are explained to their noise."""
    return chi2 < 1.0 + CHI2_SLACK + sigmas * math.sqrt(2.0 / max(readings, 1))


def _difference(one: Fit, other: Fit) -> float:
    """RMS difference of two outlines (m), by Parseval."""
    miss = one.guess.p[C.SHAPE :] - other.guess.p[C.SHAPE :]
    return math.sqrt(float(miss[0] ** 2 + (miss[1:] ** 2).sum() / 2))
