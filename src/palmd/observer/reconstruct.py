"""Reconstruct an object's outline and motion from a whole record, from a blind start; or reject, with the reason.

A result counts as converged only when the iteration has converged, the readings are explained to their noise, no rival
is left, and the outline is certain enough.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palmd.blas import one_thread
from palmd.events import Event, FloatArray
from palmd.model import shape
from palmd.model.smoothing import CONSTANTS, ORDER, RIG, C
from palmd.observer.backward_extension import with_zero_orientation
from palmd.observer.chain import Chain
from palmd.observer.coverage import marks_of
from palmd.observer.criticism import MOST_REVISIONS, RigBelief
from palmd.observer.data_segment import SUSPICIOUS_GAP_S, DataSegment, data_segments
from palmd.observer.dry_reconstruct import dry_reconstruction
from palmd.observer.factor import Prior, conditional_covariance
from palmd.observer.initialiser import attempts_for
from palmd.observer.marginal import Marginal, marginalised
from palmd.observer.mass import MassEstimator
from palmd.observer.matching import ObjectInformation, matched
from palmd.observer.noise import MAP_READINGS, map_as_noise, with_scatter, without_map
from palmd.observer.normal_equations import Guess, ProcessNoise
from palmd.observer.numerical import NUMERICAL_FAILURES
from palmd.observer.outline import contact_normals, directions, made_convex, outline_of, rms_sd
from palmd.observer.pad_map import has_map, with_map
from palmd.observer.reconstruction import Reconstruction
from palmd.observer.record import LEAST_FORCE_N, Record, lay_out, total_duration
from palmd.observer.relations import mixture, with_each_relation
from palmd.observer.search import (
    AMBIGUOUS,
    DOUBT,
    NOTHING_MOVES,
    OVERFITTED,
    SECOND_OPINION_SIGMAS,
    Attempt,
    Minima,
    Search,
    beyond_question,
    consistent,
    different,
    explained,
    minima,
    misfit_reason,
    nothing_moves,
    overfits,
    rivals_of,
)
from palmd.observer.shape_classification import UNCLASSIFIED, root_of, shape_class
from palmd.observer.sharp_reconstruct import explained_smoothly, sharp_reconstruction
from palmd.observer.smoother import Fit, Smoother
from palmd.observer.validity import SHARP_M
from palmd.observer.visits import visits_of
from palmd.system.arcs import MOST_LYING
from palmd.system.description import RigDescription
from palmd.system.reasons import NO_REASON, Code, Reason

SPACING_S = 0.005  # of the nodes of the final fit
LEAST_S = 1.0  # of a segment
RETRY = Attempt(2.0, 3, work=6e4)  # half of these searches take less than 1e4
LATER_ATTEMPTS = tuple(RETRY._replace(later_s=seconds) for seconds in (0.5, 4.0, 1.0, 2.0))
SMOOTH_FIRST = 1 + len(LATER_ATTEMPTS)  # blind searches before other models of the object are tried
WHOLE_SHARE = 0.95  # of a segment
FRICTION_SIGMAS = 3.0  # σ of the coefficient of friction from which there is friction
MOST_PARTS = 20  # segments of one log that are searched
MOST_SEARCHES = 40
"""Blind searches in all segments besides the longest, together (budget: 0.3 to 2.2 s of processor time each, measured
2026-11-29, so about 40 s; counted rather than timed, so that every machine has the same result)."""
MOST_SEGMENTS_S = 60.0  # duration of all segments together that are searched for contact-mode segments
HIGH_PRIOR_COST = 18.0  # prior cost above which an object (one in seven of the right ones) is searched again,
SKIPPED_S = (0.5, 1.0)  # without these first seconds
SAME_DISTANCE2 = 100.0  # squared Mahalanobis distance, in some 45 constants
ROUNDS = (slice(0, 2), slice(2, SMOOTH_FIRST), slice(SMOOTH_FIRST, None))
"""Of the searches in several segments: each segment has its first two, a result and its second opinion, before any has
more."""
Numbered = Sequence[tuple[int, Attempt]]
_OUTLINE = slice(C.SHAPE, CONSTANTS)
NO_SUCH_RIG = Reason(
    Code.RIG_CONTRADICTED,
    "the readings are explained only by a rig that differs widely from its description: calibrate it first",
)
STICKS = Reason(
    Code.STICKS,
    "sticks: the palms do not vibrate, and no sequence of sticking and slipping explains the readings; vibrate the"
    " palms, or turn them slowly and by more",
)
STICKS_THOUGH_VIBRATED = Reason(
    Code.STICKS,
    "the object sticks and slips as on palms that do not vibrate: switch the shakers on, or describe the rig by"
    " vibration: {relation: none}",
)
NO_ANSWER = Reason(
    Code.UNEXPLAINED,
    "no motion of an object was found that explains the readings; check sign, zero and order of the pads and the rig's"
    " lengths, then record it again while the palms turn more slowly",
)
NO_NUMBERS = "the readings lead beyond the range of numbers: check the log's units, and record the run again"


@one_thread()
def reconstruct(
    events: Sequence[Event], rig: RigDescription, seed: int = 0, say: Callable[[str], None] | None = None
) -> Reconstruction:
    """Smooth the longest segment of `events` in which both palms touch the object, and others of the same object.

    Deterministic for a given seed. Takes about a second for ten seconds of readings; where no smooth outline explains
    them one with flat sides and corners is searched, in other segments too, which takes some ten to forty seconds more,
    and then smooth ones in the other segments, up to `MOST_SEARCHES`. Never raises because of the readings: a record
    that determines too little, or contradicts the model, is returned with `converged` False and the reason. `say` is
    called with the progress of a long search.
    """
    started = time.perf_counter()
    rigs = with_each_relation(rig)
    if len(rigs) > 1:
        mixed = mixture([_reconstructed(events, each, seed, started, None, non_smooth=False) for each in rigs], rigs)
        if mixed is not None:
            return replace(mixed, seconds=time.perf_counter() - started)
    return _reconstructed(events, rigs[0], seed, started, say)


def _reconstructed(
    events: Sequence[Event], rig: RigDescription, seed: int, started: float, say: Callable[[str], None] | None,
    *, non_smooth: bool = True,
) -> Reconstruction:  # fmt: skip
    """As `reconstruct`, for palms whose vibration is described; `non_smooth`: search non-smooth models, too."""
    try:
        return _of_segments(events, rig, seed, started, say, non_smooth)
    except NUMERICAL_FAILURES as error:
        return _rejected(Reason(Code.NOT_FINITE, f"{NO_NUMBERS} ({error})"), started)


def _of_segments(
    events: Sequence[Event], rig: RigDescription, seed: int, started: float, say: Callable[[str], None] | None,
    non_smooth: bool,
) -> Reconstruction:  # fmt: skip
    segments = _by_length(data_segments(events), rig)
    if not segments:
        reason = Reason(Code.TOO_SHORT, "no second of the record has reports of both pads and the arm")
        return _rejected(reason, started)
    search = _search(segments[0], rig)
    attempts = attempts_on(search)
    elsewhere: list[_Part] = []
    main = _part(search, seed, attempts[:SMOOTH_FIRST])
    if (
        not rig.vibration.vibrates
        and not nothing_moves(search.record)
        and (main is None or main.reason or _needs_friction(main))
    ):
        stick_slip = dry_reconstruction(search, seed, started)
        return _rejected(STICKS, started) if stick_slip is None else stick_slip
    if main is None or main.reason:
        shorter = _by_length(data_segments(events, SUSPICIOUS_GAP_S), rig)
        # the object may have been swapped in a gap
        swapped = shorter if shorter and shorter[0].lasts < segments[0].lasts else []
        until_swap = _search(swapped[0], rig) if swapped else None
        alternatives = _NonSmooth(search, segments, rig, seed, started, say, non_smooth)
        result = _in_doubt(search, main, attempts[SMOOTH_FIRST:], until_swap, alternatives, seed)
        if result is None or (result.reason and result.reason != AMBIGUOUS):
            elsewhere = _parts_of(segments[1:MOST_PARTS], rig, seed, say)
            result = elsewhere[0] if elsewhere else result
        if isinstance(result, Reconstruction):
            return result
        main = result
        if main is not None and until_swap is not None and main.segment is until_swap.segment:
            segments = swapped
    if main is None:
        return _without_smooth_answer(search, seed, started)
    main = _checked_without_start(main, seed)
    if main.reason:
        return _result(main, (), rig, started)
    others = elsewhere[1:] if elsewhere else _parts_of(segments[1:MOST_PARTS], rig, seed, say)
    main, joined = _longest_together([main, *others])
    return _result(main, joined, rig, started)


def _without_smooth_answer(search: Search, seed: int, started: float) -> Reconstruction:
    """The rejection where no motion was found; with a stick-slip one on palms that are described as vibrating."""
    if nothing_moves(search.record):
        return _rejected(NOTHING_MOVES, started)
    stick_slip = dry_reconstruction(search, seed, started) if search.rig.vibration.vibrates else None
    if stick_slip is not None:
        return replace(stick_slip, converged=False, reason=STICKS_THOUGH_VIBRATED)
    return _rejected(_if_concave(NO_ANSWER, search.rig), started)


def _parts_of(
    segments: Sequence[DataSegment], rig: RigDescription, seed: int, say: Callable[[str], None] | None
) -> list[_Part]:
    """The explained ones of these segments, the longest first; up to `MOST_SEARCHES` searches."""
    searches_left, found = MOST_SEARCHES, list[_Part]()
    searches = [(search, attempts_on(search)) for search in (_search(segment, rig) for segment in segments)]
    waiting: list[tuple[Search, Numbered, _Part | None]] = [(*each, None) for each in searches]
    for round_slice in ROUNDS:
        rejected = []
        for search, attempts, best in waiting:
            if say is not None:
                say(f"looking in {len(segments)} other segments, {len(found)} explained")
            allowed = attempts[round_slice][:searches_left]
            untried = iter(allowed)
            part = _part(search, seed, untried, best)
            searches_left -= len(allowed) - sum(1 for _ in untried)
            if part is not None and not part.reason:
                found.append(part)
            else:
                rejected.append((search, attempts, part))
        waiting = rejected
    return sorted(found, key=lambda part: part.segment.lasts, reverse=True)


def _needs_friction(part: _Part) -> bool:
    """Whether the fit needs friction, although the model assumes that vibration hides it."""
    try:
        marginal = marginalised(part.search.library, part.record, part.known, part.fit)
    except np.linalg.LinAlgError:
        return True
    return marginal.mu > FRICTION_SIGMAS * marginal.mu_sd


def _in_doubt(
    search: Search,
    first: _Part | None,
    attempts: Numbered,
    until_swap: Search | None,
    alternatives: _NonSmooth,
    seed: int,
) -> _Part | Reconstruction | None:
    """What explains the longest segment, where the `first` searches gave no certain result; None if nothing does.

    attempts: that are left for a smooth outline. until_swap: the segment up to a gap in which the object may have been
    swapped, if there is one.
    """
    if first is None and until_swap is None and alternatives.enough:
        return alternatives.result
    main = _part(search, seed, attempts, first)
    if until_swap is not None and (main is None or main.reason):
        other = _part_of(until_swap, seed)
        if other is not None and not other.reason:
            return other
    unexplained = main is None or main.reason not in (NO_REASON, AMBIGUOUS)
    return alternatives.result if unexplained and alternatives.result is not None else main


class _NonSmooth:
    """Search for non-smooth contact models, done once, when first needed.

    segments: all segments, that of `search` first: contact-mode segments may be found in the others as well.
    """

    def __init__(
        self, search: Search, segments: Sequence[DataSegment], rig: RigDescription, seed: int, started: float,
        say: Callable[[str], None] | None, enabled: bool,
    ):  # fmt: skip
        self._enabled = enabled
        self._search, self._segments, self._rig = search, segments, rig
        self._seed, self._started, self._say = seed, started, say

    @cached_property
    def _others(self) -> list[Search]:
        return _other_searches(self._segments, self._rig)

    @cached_property
    def result(self) -> Reconstruction | None:
        """A result with flat sides; None if there is none, on curved palms, or if disabled."""
        if self._search.rig.curved or not self._enabled:
            return None
        return sharp_reconstruction(self._search, self._seed, self._started, self._say, self._others)

    @property
    def enough(self) -> bool:
        """Whether no smooth outline need be searched: all is explained, or no smooth outline explains it."""
        return self.result is not None and (self._explains_whole(self.result) or self._excludes_smooth(self.result))

    def _explains_whole(self, result: Reconstruction) -> bool:
        segment = self._search.segment
        explained_s = total_duration([span for span in result.spans if segment.start <= span[0] <= segment.end])
        return explained_s > WHOLE_SHARE * segment.lasts and consistent(
            result.chi2, len(segment.pads), SECOND_OPINION_SIGMAS
        )

    def _excludes_smooth(self, result: Reconstruction) -> bool:
        return len(result.sides) > 0 and not explained_smoothly(self._search, result, self._others)


@dataclass(frozen=True, slots=True)
class _Mapped:
    """A fit with the pads' maps among its constants."""

    record: Record
    known: Prior
    fit: Fit

    @property
    def tested_fit(self) -> Fit:
        """The fit without the cost of its maps, which is unrelated to the object."""
        maps = self.fit.guess.p[CONSTANTS:]
        return replace(self.fit, prior_cost=self.fit.prior_cost - float(maps @ maps))


@dataclass(frozen=True, slots=True)
class _Part:
    """A segment, the prior, and the best fit; `reason`: why the fit is in doubt.

    as_described: whether the rig's constants were held as described; otherwise they may have been fitted to a wrong
    minimum. mapped: the fit with the pads' maps, where they have any.
    """

    search: Search
    known: Prior
    fit: Fit
    record: Record
    belief: RigBelief
    as_described: bool
    reason: Reason
    mapped: _Mapped | None = None

    @property
    def segment(self) -> DataSegment:
        """The data segment."""
        return self.search.segment

    @property
    def tested_fit(self) -> Fit:
        """The fit for the tests of residuals and prior cost."""
        return self.fit if self.mapped is None else self.mapped.tested_fit

    @property
    def deviance(self) -> float:
        """−2 log-likelihood up to a constant; comparable between fits with different noise of the forces."""
        fit = self.fit if self.mapped is None else self.mapped.fit
        return fit.cost + float(np.log(self.record.total_force_variance).sum())

    @property
    def blind(self) -> Prior:
        """The prior of any object, on the rig as the segment determines it."""
        return replace(self.known, information=None)

    def information(self) -> ObjectInformation:
        """Information of its readings about the object, and that of the segments joined to it."""
        chain = Chain(self.search.library, self.fit.noise, self.blind)
        if self.known.information is not None:
            chain.learn(self.known.information)
        chain.append(self.record, self.fit.guess)
        p = self.fit.guess.p
        return ObjectInformation(
            chain.information(p), marks_of(contact_normals(self.record, self.fit.guess.x[:, 0], p[C.SHAPE :]))
        )


@dataclass(frozen=True, slots=True)
class _Joined:
    """Motion of a joined segment, with ψ in the gauge of the main one."""

    record: Record
    psi: FloatArray
    omega0: FloatArray


def _by_length(segments: Sequence[DataSegment], rig: RigDescription) -> list[DataSegment]:
    """The segments that are long enough without their rests, the longest first."""
    noise = max(math.hypot(pad.noise, pad.resolution) for pad in rig.pads)
    long_enough = (segment for segment in (each.trimmed(noise) for each in segments) if segment.lasts >= LEAST_S)
    return sorted(long_enough, key=lambda segment: segment.lasts, reverse=True)


def _search(segment: DataSegment, rig: RigDescription) -> Search:
    return Search(segment, map_as_noise(with_scatter(rig, segment.pads), MAP_READINGS))


def _other_searches(segments: Sequence[DataSegment], rig: RigDescription) -> list[Search]:
    """Segments besides the longest, up to `MOST_SEGMENTS_S` together with it."""
    durations = np.cumsum([segment.lasts for segment in segments[:MOST_PARTS]])
    count = int(np.searchsorted(durations, MOST_SEGMENTS_S, side="right"))
    return [_search(segment, rig) for segment in segments[1:count]]


def attempts_on(search: Search) -> Numbered:
    """Attempts for a record; some start later, as a search may be hard from the beginning and easy from later on."""
    live, lasts = attempts_for(search.rig), float(search.record.t[-1] - search.record.t[0])
    # a shorter one would be no second opinion
    later = [each for each in LATER_ATTEMPTS if each.later_s + each.seconds <= lasts]
    exact = [live[0]._replace(exact=True)] if has_map(search.rig) else []
    return tuple(enumerate((*exact, live[0], *later, *live[1:])))


def _part_of(search: Search, seed: int) -> _Part | None:
    return _part(search, seed, attempts_on(search))


def _part(
    search_as_described: Search, seed: int, attempts: Iterable[tuple[int, Attempt]], best: _Part | None = None
) -> _Part | None:
    """The best fit of a segment by any attempt or by `best`; None when nothing is found, or nothing moves."""
    if (best is not None and not best.reason) or nothing_moves(search_as_described.record):
        return best
    search_suspended = search_as_described.with_belief(search_as_described.belief.suspended())
    for number, attempt in attempts:
        search = search_suspended if attempt.free else search_as_described
        try:
            finding = (_without_maps(search) if attempt.exact else search).blind(attempt, seed)
            part = None if finding is None else _refined(search, finding)
        except NUMERICAL_FAILURES:  # the other attempts go on
            continue
        if part is not None and (best is None or part.deviance < best.deviance):
            best = part
        if best is None or best.reason:
            continue
        if number > 0 or (best.as_described and beyond_question(best.fit, best.record)):
            break  # one second opinion is enough, whatever its result
    return best


def _without_maps(search: Search) -> Search:
    """The same segment, searched as if its pads had no smooth position error."""
    return Search(search.segment, without_map(search.rig), belief=search.belief)


def _checked_without_start(part: _Part, seed: int) -> _Part:
    """`part`, unless it is an unlikely object and the rest of its readings, without the first, determines another one.

    The initial motion cannot be predicted: where an object is released in haste the search may start in a wrong minimum
    next to the right one, with an unlikely object and rig. Then the object from the rest of the readings is returned.
    """
    if part.reason or part.tested_fit.prior_cost <= HIGH_PRIOR_COST:
        return part
    for later_s in SKIPPED_S:
        segment = part.segment.since(part.segment.start + later_s)
        if segment.lasts < LEAST_S:
            break
        other = _part(_search(segment, without_map(part.search.rig)), seed + 1, [(0, RETRY)])
        if other is None or other.reason:
            continue
        start = with_zero_orientation(part.fit.guess.on(part.record.t, other.record.t))
        smoother = Smoother(other.search.library, other.record, other.known)
        own_fit = smoother.fit(start, other.fit.noise)
        posterior = smoother.posterior_if_any(min(own_fit, other.fit, key=lambda fit: fit.cost))
        if posterior is not None and posterior.distance2(start.p) < SAME_DISTANCE2:
            return part
        return other if other.fit.cost < own_fit.cost + DOUBT else replace(part, reason=AMBIGUOUS)
    return part


def _refined(search: Search, finding: Minima) -> _Part:
    """The best fit of `finding`, refined; where pads have maps, the best of it and its rivals.

    Outlines that are equally likely with the wider noise of a search without maps may differ in likelihood with maps.
    """
    best, rivals = _refitted(search, finding, finding.fits[0]), rivals_of(finding)
    if best.reason not in (NO_REASON, NO_SUCH_RIG) or not rivals:
        return best
    if best.mapped is None:
        return replace(best, reason=AMBIGUOUS)
    parts = [best]
    for rival in rivals:
        try:
            part = _refitted(search, finding, rival)
        except NUMERICAL_FAILURES:  # it is no rival, then
            continue
        if all(different(part.fit, other.fit) for other in parts):
            parts.append(part)
    first, *others = sorted(parts, key=lambda part: part.deviance)
    ambiguous = any(other.deviance < first.deviance + DOUBT for other in others)
    return replace(first, reason=AMBIGUOUS if ambiguous else first.reason)


def _refitted(search: Search, finding: Minima, found: Fit) -> _Part:
    """Refit a fit of `finding` on finer nodes, with contact forces and the forces' noise from the model.

    Constants of the rig that the readings contradict are opened. At last, steps in which contacts hop are made
    uncertain: earlier that would favour objects that hop.
    """
    prior, belief = search.prior, search.belief
    segment, rig = search.segment, search.rig
    record = lay_out(segment.pads, search.path, rig, segment.start, segment.end, SPACING_S)
    guess = found.guess.on(finding.record.t, record.t)
    smoother = Smoother(search.library, record, prior)
    level = np.maximum(smoother.forces(guess), LEAST_FORCE_N)
    record = replace(smoother.with_predicted_forces(guess), force_variance=rig.force_variances(level, record.force_pad))
    finer = minima(lambda each: Smoother(search.library, each, prior), record, [guess], found.noise)
    record, fit = finer.record, finer.fits[0]
    smoother = Smoother(search.library, record, prior)
    for _ in range(MOST_REVISIONS):
        criticised = search.with_knowledge(prior)
        honest_record, honest_fit = criticised.with_correlated_errors(record, fit)
        before, belief = belief, belief.after(criticised.smoother(honest_record).posterior_if_any(honest_fit))
        if np.array_equal(before.sd, belief.sd):
            break
        prior = replace(prior, sd=np.concatenate([prior.sd[: C.RIG], belief.sd, prior.sd[C.SHAPE :]]))
        smoother = Smoother(search.library, record, prior)
        fit = smoother.fit(belief.within(fit.guess), fit.noise)
    record = smoother.with_discrepancy(fit.guess, hopping_only=True)
    if record.discrepancy.any():
        fit = _fitted_twice(Smoother(search.library, record, prior), fit.guess, fit.noise)
    mapped = _mapped(search, record, prior, fit) if has_map(rig) else None
    as_described = np.array_equal(belief.sd, search.belief.sd)
    part = _Part(search, prior, fit, record, belief, as_described, NO_REASON, mapped)
    reason = OVERFITTED if overfits(part.tested_fit) else misfit_reason(part.tested_fit, finding.record)
    return replace(part, reason=reason or (NO_SUCH_RIG if belief.contradicts_description(fit.guess) else NO_REASON))


def _mapped(search: Search, record: Record, prior: Prior, fit: Fit) -> _Mapped:
    """Refit with the pads' smooth position errors estimated."""
    contacts = Smoother(search.library, record, prior).predicted_contacts(fit.guess)
    record, prior, guess = with_map(record, contacts, prior, fit.guess, search.rig)
    return _Mapped(record, prior, _fitted_twice(Smoother(search.library, record, prior), guess, fit.noise))


def _fitted_twice(smoother: Smoother, guess: Guess, noise: ProcessNoise) -> Fit:
    """Fit of a problem with more freedom than that of `guess`; repeated once if it has not converged."""
    fit = smoother.fit(guess, noise)
    return fit if fit.settled else smoother.fit(fit.guess, noise)


def _longest_together(parts: Sequence[_Part]) -> tuple[_Part, list[_Joined]]:
    """The parts that are certainly of the same object: of all such sets the one of longest duration."""
    remaining, best, longest = list(parts), (parts[0], list[_Joined]()), 0.0
    while remaining:
        main, others = remaining.pop(0), list[_Joined]()
        lasts = main.segment.lasts
        waiting = list(remaining)
        while waiting:
            part = waiting.pop(0)
            joined = _joined(main, part)
            if joined is not None:
                main, other = joined
                others.append(other)
                remaining = [each for each in remaining if each is not part]
                lasts += part.segment.lasts
                waiting = list(remaining)  # more of the outline is known now, with which they may overlap
        if lasts > longest:
            best, longest = (main, others), lasts
    return best


def _joined(main: _Part, part: _Part) -> tuple[_Part, _Joined] | None:
    """`main` with the information of `part` added; None unless both are certainly of the same object."""
    p = main.fit.guess.p
    prior = Chain(main.search.library, main.fit.noise, main.blind).prior(p)
    match = matched(part.information(), main.information(), prior)
    if match is None:
        return None
    before, added = main.known.information, match.aligned.information
    known = replace(main.known, information=added if before is None else before.plus(added))
    fit = Smoother(main.search.library, main.record, known).fit(main.fit.guess, main.fit.noise)
    if not fit.settled:
        return None
    nodes = part.fit.guess.x
    return replace(main, known=known, fit=fit, mapped=None), _Joined(part.record, nodes[:, 0] + match.turn, nodes[:, 1])


def _result(main: _Part, others: Sequence[_Joined], rig: RigDescription, started: float) -> Reconstruction:
    fit, record, library, reason = main.fit, main.record, main.search.library, main.reason
    prior = main.known
    if has_map(rig):
        mapped = main.mapped or _mapped(main.search, record, prior, fit)
        record, prior, fit = mapped.record, mapped.known, mapped.fit
        reason = reason or misfit_reason(mapped.tested_fit, record)
    if reason and not explained(fit, record):
        reason = _if_concave(reason, rig)
    try:
        marginal = marginalised(library, record, prior, fit)
    except np.linalg.LinAlgError:
        return _rejected(reason or Reason(Code.NOT_CONVERGED, "the fit is not a minimum"), started, fit.chi2)
    x, without_considered = marginal.mean.x, (marginal.mean.p[RIG], marginal.covariance[RIG, RIG])
    mean, covariance = np.concatenate([marginal.mean.p, x[-1]]), main.belief.considering(marginal.covariance)
    convex = made_convex(mean, covariance, _OUTLINE)
    p = mean[:CONSTANTS]
    parts = sorted([_Joined(record, x[:, 0], x[:, 1]), *others], key=lambda part: float(part.record.t[0]))
    normals = [contact_normals(part.record, part.psi, p[C.SHAPE :]) for part in parts]
    outline = outline_of(p[C.SHAPE :], covariance[_OUTLINE, _OUTLINE], normals)
    conditional_outline = outline_of(p[C.SHAPE :], conditional_covariance(covariance, RIG, _OUTLINE), normals)
    if not reason and rms_sd(conditional_outline.h_sd, outline.touched) > SHARP_M:
        reason = Reason(Code.UNDETERMINED, "the readings determine too little of the outline")
    if not reason and (concavity := most_lying(p[C.SHAPE :], normals, rig.curvatures)) >= MOST_LYING:
        text = f"the palms are too concave for the object: kappa v reaches {concavity:.2f} at a contact"
        reason = Reason(Code.TOO_CONCAVE, text)
    if not reason and not convex:
        reason = Reason(Code.IMPOSSIBLE, "only a hollow outline explains the readings")
    root = root_of(shape.basis(outline.theta, ORDER), covariance[_OUTLINE, _OUTLINE])
    sd = np.sqrt(np.diagonal(covariance))
    rho = math.exp(p[C.LN_RHO])
    mass, mass_sd = _mass_of(main, rig, marginal)
    all_normals = np.concatenate(normals)
    radii = [shape.basis(all_normals[:, i], ORDER) @ p[C.SHAPE :] for i in range(all_normals.shape[1])]
    t, psi, omega0 = (
        np.concatenate(columns)
        for columns in zip(*((part.record.t, part.psi, part.omega0) for part in parts), strict=True)
    )
    return Reconstruction(
        converged=not reason, chi2=fit.chi2,
        theta=outline.theta, h=outline.h, h_sd=outline.h_sd, touched=outline.touched,
        visits=np.sum([visits_of(each) for each in normals], axis=0),
        rho=rho, rho_sd=rho * float(sd[C.LN_RHO]), mu=marginal.mu, mu_sd=marginal.mu_sd,
        mass=mass, mass_sd=mass_sd, rig=p[RIG], rig_covariance=covariance[RIG, RIG],
        contradicted=main.belief.contradicted, rig_prior_sd=main.belief.sd,
        t=t, psi=psi, omega0=omega0, radii=np.stack(radii),
        reason=reason, seconds=time.perf_counter() - started,
        turned_sd=math.nan if others else float(sd[CONSTANTS]),  # ψ is 0 at the first node: gauge
        rig_by_prior=without_considered,
        evidence=marginal.evidence - main.belief.opening_nats,
        shape_class=UNCLASSIFIED if reason else shape_class(outline.theta, outline.h, root, outline.touched),
    )  # fmt: skip


def most_lying(coefficients: FloatArray, normals: Sequence[FloatArray], curvatures: Sequence[float]) -> float:
    """The largest κv at a contact; from 1 on an object would touch its palm at two places. 0 on flat palms."""
    if not any(curvatures):
        return 0.0
    bent = coefficients * (1.0 - shape.harmonic_of_coefficient((len(coefficients) - 1) // 2) ** 2)
    at = np.concatenate(normals)
    v = [shape.basis(at[:, palm], (len(bent) - 1) // 2) @ bent for palm in range(len(curvatures))]
    return float(max((kappa * each).max() for kappa, each in zip(curvatures, v, strict=True)))


CLIPPED_SHARE = 0.05
"""Of saturated readings: below it, leaving them out shifts the mass by less than the uncertainty of the pads' gain."""


def _mass_of(main: _Part, rig: RigDescription, marginal: Marginal) -> tuple[float, float]:
    """Mass and its 1σ (kg): from the fit, or computed afterwards where the fit leaves the forces out.

    NaN without forces, and where too many are saturated: the remaining ones are a biased sample.
    """
    if np.mean([sample.at_least is not None for sample in main.segment.pads]) > CLIPPED_SHARE:
        return math.nan, math.nan
    if len(main.record.force_value):
        mass = math.exp(marginal.mean.p[C.LN_MASS])
        return mass, mass * math.sqrt(marginal.covariance[C.LN_MASS, C.LN_MASS])
    exact_gain, segment, search = rig.with_pads(force_gain_std=0.0), main.segment, main.search
    record = lay_out(segment.pads, search.path, exact_gain, segment.start, segment.end, SPACING_S)
    per_unit_mass = np.where(np.arange(CONSTANTS) == C.LN_MASS, 0.0, marginal.mean.p)
    forces_per_mass = Smoother(search.library, record, search.prior).forces(replace(marginal.mean, p=per_unit_mass))
    estimator = MassEstimator(rig.pads)
    for pad, force, f in zip(record.force_pad, record.force_value, forces_per_mass, strict=True):
        estimator.feed(int(pad), float(force), float(f))
    return estimator.value, estimator.sd


def _if_concave(reason: Reason, rig: RigDescription) -> Reason:
    """The reason why nothing explains the readings, with concave palms as a possible cause if there are any."""
    if max(rig.curvatures) <= 0.0:
        return reason
    curvatures = ", ".join(f"{kappa:.3g} 1/m" for kappa in rig.curvatures)
    return Reason(reason.code, f"{reason}; palms as concave as these ({curvatures}) may be too concave for it")


def _rejected(reason: Reason, started: float, chi2: float = math.nan) -> Reconstruction:
    none: FloatArray = np.zeros(0)
    nan = math.nan
    return Reconstruction(
        False, chi2, directions(), None, None, None, None, nan, nan, nan, nan, nan, nan,
        none, np.zeros((0, 0)), none, none, none, none, none, none, time.perf_counter() - started, reason,
    )  # fmt: skip
