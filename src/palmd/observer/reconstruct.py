"""A whole record, seen from its end: the object's outline and motion from a blind start, or an honest refusal.

What comes out is called converged only when the iteration has settled, the readings are explained to their noise, no
rival is left, and the outline is told sharply enough to be called one.
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
from palmd.observer.beginning import from_zero
from palmd.observer.chain import Chain
from palmd.observer.coverage import marks_of
from palmd.observer.criticism import MOST_REVISIONS, RigBelief
from palmd.observer.data_segment import SUSPICIOUS_GAP_S, DataSegment, data_segments
from palmd.observer.dry_reconstruct import dry_reconstruction
from palmd.observer.factor import Prior, given
from palmd.observer.initialiser import attempts_for
from palmd.observer.marginal import Marginal, marginalised
from palmd.observer.mass import MassEstimator
from palmd.observer.matching import Felt, matched
from palmd.observer.noise import MAP_READINGS, map_as_noise, with_scatter, without_map
from palmd.observer.normal_equations import Guess, ProcessNoise
from palmd.observer.numerical import NUMERICAL_FAILURES
from palmd.observer.outline import contact_normals, directions, made_convex, outline_of
from palmd.observer.pad_map import has_map, with_map
from palmd.observer.reconstruction import Reconstruction
from palmd.observer.record import LEAST_FORCE_N, Record, lasting, lay_out
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
    overfits,
    rivals_of,
    still,
    unfit,
)
from palmd.observer.shape_classification import UNTOLD, root_of, shape_class
from palmd.observer.sharp_reconstruct import explained_smoothly, sharp_reconstruction
from palmd.observer.smoother import Fit, Smoother
from palmd.observer.validity import SHARP_M
from palmd.observer.visits import visits_of
from palmd.system.arcs import MOST_LYING
from palmd.system.description import RigDescription

SPACING_S = 0.005  # of the nodes in the end
LEAST_S = 1.0
AGAIN = Attempt(2.0, 3, work=6e4)  # half of these searches take less than 1e4
LATER = tuple(AGAIN._replace(later_s=seconds) for seconds in (0.5, 4.0, 1.0, 2.0))
BEFORE_OTHERS = 1 + len(LATER)  # of the blind searches, before what else an object may be is asked
WHOLE = 0.95  # of a segment
RUBS = 3.0  # sigmas of the coefficient of friction, from which there is some
MOST_PARTS = 20  # segments of one log that are looked at
MOST_SEARCHES = 40
"""Blind searches in the segments besides the longest, of all together (budget: 0.3 to 2.2 s of processor time each,
measured 2026-11-29, so about 40 s; counted rather than timed, so that every machine comes to the same answer)."""
MOST_RIDDEN_S = 60.0  # of these together, where rides of all of them are read
DEAR = 18.0  # of the cost, by the prior: dearer objects, one in seven of the right ones, are looked for again,
LATER_S = (0.5, 1.0)  # without these readings of the beginning
SAME = 100.0  # in sigmas squared, of some 45 constants
ROUNDS = (slice(0, 2), slice(2, BEFORE_OTHERS), slice(BEFORE_OTHERS, None))
"""Of the searches in several segments: each has the first two, a result and its second opinion, before any has more."""
Numbered = Sequence[tuple[int, Attempt]]
_OUTLINE = slice(C.SHAPE, CONSTANTS)
NO_SUCH_RIG = "the readings are explained only by a rig that is nothing like its description: calibrate it first"
STICKS = (
    "sticks: the palms do not vibrate, and no sequence of sticking and slipping explains the readings; vibrate the"
    " palms, or turn them slowly and by more"
)
NO_ANSWER = (
    "no motion of an object was found that explains the readings; check sign, zero and order of the pads and the rig's"
    " lengths, then record it again while the palms turn more slowly"
)
NO_NUMBERS = "the readings lead beyond the range of numbers: check the log's units, and record the run again"


@one_thread()
def reconstruct(
    events: Sequence[Event], rig: RigDescription, seed: int = 0, say: Callable[[str], None] | None = None
) -> Reconstruction:
    """Smooth the longest segment of `events` in which both palms feel the object, and others if they are of the same.

    Deterministic for a given seed. Takes about a second for ten seconds of readings; where no smooth outline explains
    them one with flat sides and corners is looked for, in other segments too, which takes some ten to forty seconds
    more, and then smooth ones in the other segments, as far as `MOST_SEARCHES` go. Never raises for what the readings
    say: a record that tells too little, or contradicts the model, comes back with `converged` False and the reason.
    `say` is told how far a long search has come.
    """
    begun = time.perf_counter()
    rigs = with_each_relation(rig)
    if len(rigs) > 1:
        told = mixture([_reconstructed(events, each, seed, begun, None, unlike=False) for each in rigs], rigs)
        if told is not None:
            return replace(told, seconds=time.perf_counter() - begun)
    return _reconstructed(events, rigs[0], seed, begun, say)


def _reconstructed(
    events: Sequence[Event], rig: RigDescription, seed: int, begun: float, say: Callable[[str], None] | None,
    *, unlike: bool = True,
) -> Reconstruction:  # fmt: skip
    """As `reconstruct`, for palms whose vibration is described; not `unlike`: smooth outlines alone are looked for."""
    try:
        return _of_segments(events, rig, seed, begun, say, unlike)
    except NUMERICAL_FAILURES as error:
        return _nothing(f"{NO_NUMBERS} ({error})", begun)


def _of_segments(
    events: Sequence[Event], rig: RigDescription, seed: int, begun: float, say: Callable[[str], None] | None,
    wanted: bool,
) -> Reconstruction:  # fmt: skip
    found = _by_length(data_segments(events), rig)
    if not found:
        return _nothing("there is no second in which both pads and the arm report", begun)
    search = _search(found[0], rig)
    attempts = attempts_on(search)
    elsewhere: list[_Part] = []
    main = _part(search, seed, attempts[:BEFORE_OTHERS])
    if not rig.vibration.vibrates and not still(search.record) and (main is None or main.reason or _rubs(main)):
        dry = dry_reconstruction(search, seed, begun)
        return _nothing(STICKS, begun) if dry is None else dry
    if main is None or main.reason:
        shorter = _by_length(data_segments(events, SUSPICIOUS_GAP_S), rig)
        swapped = shorter if shorter and shorter[0].lasts < found[0].lasts else []  # perhaps, in a gap
        apart = _search(swapped[0], rig) if swapped else None
        unlike = _Unlike(search, found, rig, seed, begun, say, wanted)
        told = _in_doubt(search, main, attempts[BEFORE_OTHERS:], apart, unlike, seed)
        if told is None or (told.reason and told.reason != AMBIGUOUS):
            elsewhere = _parts_of(found[1:MOST_PARTS], rig, seed, say)
            told = elsewhere[0] if elsewhere else told
        if isinstance(told, Reconstruction):
            return told
        main = told
        if main is not None and apart is not None and main.segment is apart.segment:
            found = swapped
    if main is None:
        return _nothing(NOTHING_MOVES if still(Search(found[0], rig).record) else NO_ANSWER + _if_concave(rig), begun)
    main = _found_again(main, seed)
    if main.reason:
        return _result(main, (), rig, begun)
    others = elsewhere[1:] if elsewhere else _parts_of(found[1:MOST_PARTS], rig, seed, say)
    main, joined = _longest_together([main, *others])
    return _result(main, joined, rig, begun)


def _parts_of(
    segments: Sequence[DataSegment], rig: RigDescription, seed: int, say: Callable[[str], None] | None
) -> list[_Part]:
    """What explains each of these segments, the longest first, as far as `MOST_SEARCHES` go."""
    left, found = MOST_SEARCHES, list[_Part]()
    searches = [(search, attempts_on(search)) for search in (_search(segment, rig) for segment in segments)]
    waiting: list[tuple[Search, Numbered, _Part | None]] = [(*each, None) for each in searches]
    for turn in ROUNDS:
        rejected = []
        for search, attempts, best in waiting:
            if say is not None:
                say(f"looking in {len(segments)} other segments, {len(found)} explained")
            allowed = attempts[turn][:left]
            untried = iter(allowed)
            part = _part(search, seed, untried, best)
            left -= len(allowed) - sum(1 for _ in untried)
            if part is not None and not part.reason:
                found.append(part)
            else:
                rejected.append((search, attempts, part))
        waiting = rejected
    return sorted(found, key=lambda part: part.segment.lasts, reverse=True)


def _rubs(part: _Part) -> bool:
    """Whether a fit needs friction, which it takes for hidden by vibration."""
    try:
        answered = marginalised(part.search.library, part.record, part.known, part.fit)
    except np.linalg.LinAlgError:
        return True
    return answered.mu > RUBS * answered.mu_sd


def _in_doubt(
    search: Search, first: _Part | None, attempts: Numbered, apart: Search | None, unlike: _Unlike, seed: int
) -> _Part | Reconstruction | None:
    """What explains the longest segment, of which the `first` searches told nothing sure; None if nothing does.

    attempts: those that are left for a smooth outline. apart: the segment without what another object may have touched,
    if one has perhaps taken the other's place.
    """
    if first is None and apart is None and unlike.enough:
        return unlike.told
    main = _part(search, seed, attempts, first)
    if apart is not None and (main is None or main.reason):
        other = _part_of(apart, seed)
        if other is not None and not other.reason:
            return other
    in_vain = main is None or main.reason not in ("", AMBIGUOUS)
    return unlike.told if in_vain and unlike.told is not None else main


class _Unlike:
    """What is no smooth outline on palms that never stick: looked for when first asked for, and once.

    found: all segments, that of `search` the first: what rides there may ride in others as well.
    """

    def __init__(
        self, search: Search, found: Sequence[DataSegment], rig: RigDescription, seed: int, begun: float,
        say: Callable[[str], None] | None, wanted: bool,
    ):  # fmt: skip
        self._wanted = wanted
        self._search, self._found, self._rig = search, found, rig
        self._seed, self._begun, self._say = seed, begun, say

    @cached_property
    def _others(self) -> list[Search]:
        return _besides(self._found, self._rig)

    @cached_property
    def told(self) -> Reconstruction | None:
        """A dry one, else one with flat sides; None if neither, on palms that are not flat, or if not wanted."""
        search, seed, begun = self._search, self._seed, self._begun
        if search.rig.curved or not self._wanted:
            return None
        told = dry_reconstruction(search, seed, begun)
        return told or sharp_reconstruction(search, seed, begun, self._say, self._others)

    @property
    def enough(self) -> bool:
        """Whether no smooth outline need be looked for: all is explained, or is not without flat sides."""
        return self.told is not None and (self._whole(self.told) or self._sharp(self.told))

    def _whole(self, told: Reconstruction) -> bool:
        segment = self._search.segment
        there = lasting([span for span in told.spans if segment.start <= span[0] <= segment.end])
        return there > WHOLE * segment.lasts and consistent(told.chi2, len(segment.pads), SECOND_OPINION_SIGMAS)

    def _sharp(self, told: Reconstruction) -> bool:
        return len(told.sides) > 0 and not explained_smoothly(self._search, told, self._others)


@dataclass(frozen=True, slots=True)
class _Mapped:
    """A fit with the pads' maps among its constants."""

    record: Record
    known: Prior
    fit: Fit

    @property
    def judged(self) -> Fit:
        """The fit without what its maps cost, which says nothing of the object."""
        maps = self.fit.guess.p[CONSTANTS:]
        return replace(self.fit, strain=self.fit.strain - float(maps @ maps))


@dataclass(frozen=True, slots=True)
class _Part:
    """A segment, what is known of the object before it, and the best fit of it; `reason`: why that is in doubt.

    as_described: whether the rig was left as it is believed to be: else a worse minimum may have made it fit. mapped:
    the fit with the pads' maps, where they have any.
    """

    search: Search
    known: Prior
    fit: Fit
    record: Record
    belief: RigBelief
    as_described: bool
    reason: str
    mapped: _Mapped | None = None

    @property
    def segment(self) -> DataSegment:
        """What it is the motion of."""
        return self.search.segment

    @property
    def judged(self) -> Fit:
        """The fit that tells whether the part is explained, and how likely its object is."""
        return self.fit if self.mapped is None else self.mapped.judged

    @property
    def deviance(self) -> float:
        """−2 log-likelihood up to a constant: fits go by forces of different noise."""
        fit = self.fit if self.mapped is None else self.mapped.fit
        return fit.cost + float(np.log(self.record.force_variance).sum())

    @property
    def blind(self) -> Prior:
        """What was believed of any object, on this rig as the segment tells it to be."""
        return replace(self.known, information=None)

    def felt(self) -> Felt:
        """What its readings tell of the object, and those that have been joined to it."""
        chain = Chain(self.search.library, self.fit.noise, self.blind)
        if self.known.information is not None:
            chain.learn(self.known.information)
        chain.append(self.record, self.fit.guess)
        p = self.fit.guess.p
        return Felt(chain.information(p), marks_of(contact_normals(self.record, self.fit.guess.x[:, 0], p[C.SHAPE :])))


@dataclass(frozen=True, slots=True)
class _Joined:
    """A segment's motion, ψ in the gauge of the one that the others were joined to."""

    record: Record
    psi: FloatArray
    omega0: FloatArray


def _by_length(found: Sequence[DataSegment], rig: RigDescription) -> list[DataSegment]:
    """Those that last long enough without their rests, the longest first."""
    noise = max(math.hypot(pad.noise, pad.resolution) for pad in rig.pads)
    long_enough = (segment for segment in (each.trimmed(noise) for each in found) if segment.lasts >= LEAST_S)
    return sorted(long_enough, key=lambda segment: segment.lasts, reverse=True)


def _search(segment: DataSegment, rig: RigDescription) -> Search:
    return Search(segment, map_as_noise(with_scatter(rig, segment.pads), MAP_READINGS))


def _besides(found: Sequence[DataSegment], rig: RigDescription) -> list[Search]:
    """Segments besides the longest, `MOST_RIDDEN_S` long together with it."""
    lasted = np.cumsum([segment.lasts for segment in found[:MOST_PARTS]])
    within = int(np.searchsorted(lasted, MOST_RIDDEN_S, side="right"))
    return [_search(segment, rig) for segment in found[1:within]]


def attempts_on(search: Search) -> Numbered:
    """What is tried on a record: what is hard from the beginning is easy from later on, where enough is left then."""
    live, lasts = attempts_for(search.rig), float(search.record.t[-1] - search.record.t[0])
    later = [each for each in LATER if each.later_s + each.seconds <= lasts]  # others would be no second opinion
    exact = [live[0]._replace(exact=True)] if has_map(search.rig) else []
    return tuple(enumerate((*exact, live[0], *later, *live[1:])))


def _part_of(search: Search, seed: int) -> _Part | None:
    return _part(search, seed, attempts_on(search))


def _part(
    believing: Search, seed: int, attempts: Iterable[tuple[int, Attempt]], best: _Part | None = None
) -> _Part | None:
    """The best that any attempt, or one before (`best`), finds in a segment; None when nothing is, or moves."""
    if (best is not None and not best.reason) or still(believing.record):
        return best
    doubting = believing.believing(believing.belief.suspended())
    for number, attempt in attempts:
        search = doubting if attempt.free else believing
        try:
            finding = (_exact(search) if attempt.exact else search).blind(attempt, seed)
            part = None if finding is None else _refined(search, finding)
        except NUMERICAL_FAILURES:  # of this attempt alone
            continue
        if part is not None and (best is None or part.deviance < best.deviance):
            best = part
        if best is None or best.reason:
            continue
        if number > 0 or (best.as_described and beyond_question(best.fit, best.record)):
            break  # one other opinion is enough, whatever it is
    return best


def _exact(search: Search) -> Search:
    """The same segment, searched as if its pads had no smooth error of place."""
    return Search(search.segment, without_map(search.rig), belief=search.belief)


def _found_again(part: _Part, seed: int) -> _Part:
    """`part`, unless it claims an unlikely object that the rest of its readings, without the first, tell otherwise.

    How an object moves at first nothing foretells: where it is let go in haste the search may begin in a valley next to
    the right one, which an unlikely object and rig explain. Where the rest tells of another it stands for the whole.
    """
    if part.reason or part.judged.strain <= DEAR:
        return part
    for later_s in LATER_S:
        segment = part.segment.since(part.segment.start + later_s)
        if segment.lasts < LEAST_S:
            break
        other = _part(_search(segment, without_map(part.search.rig)), seed + 1, [(0, AGAIN)])
        if other is None or other.reason:
            continue
        there = from_zero(part.fit.guess.on(part.record.t, other.record.t))
        smoother = Smoother(other.search.library, other.record, other.known)
        mine = smoother.fit(there, other.fit.noise)
        told = smoother.posterior_if_any(min(mine, other.fit, key=lambda fit: fit.cost))
        if told is not None and told.distance2(there.p) < SAME:
            return part
        return other if other.fit.cost < mine.cost + DOUBT else replace(part, reason=AMBIGUOUS)
    return part


def _refined(search: Search, finding: Minima) -> _Part:
    """The best of what was found, made finer; where pads have maps, the best of it and its rivals.

    Outlines that look alike under the wider noise of a search without maps the readings may well tell apart.
    """
    best, rivals = _finer(search, finding, finding.fits[0]), rivals_of(finding)
    if best.reason not in ("", NO_SUCH_RIG) or not rivals:
        return best
    if best.mapped is None:
        return replace(best, reason=AMBIGUOUS)
    parts = [best]
    for rival in rivals:
        try:
            part = _finer(search, finding, rival)
        except NUMERICAL_FAILURES:  # it explains nothing, then
            continue
        if all(different(part.fit, other.fit) for other in parts):
            parts.append(part)
    first, *others = sorted(parts, key=lambda part: part.deviance)
    ambiguous = any(other.deviance < first.deviance + DOUBT for other in others)
    return replace(first, reason=AMBIGUOUS if ambiguous else first.reason)


def _finer(search: Search, finding: Minima, found: Fit) -> _Part:
    """A fit of `finding` again on finer nodes, contacts' forces and forces' noise taken from the model, not readings.

    Constants of the rig that the readings contradict are given free. Last of all steps in which contacts hop are
    uncertain: before, that would favour bodies that hop.
    """
    prior, belief = search.prior, search.belief
    segment, rig = search.segment, search.rig
    record = lay_out(segment.pads, search.path, rig, segment.start, segment.end, SPACING_S)
    guess = found.guess.on(finding.record.t, record.t)
    smoother = Smoother(search.library, record, prior)
    level = np.maximum(smoother.forces(guess), LEAST_FORCE_N)
    record = replace(smoother.pressed(guess), force_variance=rig.force_variances(level, record.force_pad))
    finer = minima(lambda each: Smoother(search.library, each, prior), record, [guess], found.noise)
    record, fit = finer.record, finer.fits[0]
    smoother = Smoother(search.library, record, prior)
    for _ in range(MOST_REVISIONS):
        before, belief = belief, belief.after(smoother.posterior_if_any(fit))
        if np.array_equal(before.sd, belief.sd):
            break
        prior = replace(prior, sd=np.concatenate([prior.sd[: C.RIG], belief.sd, prior.sd[C.SHAPE :]]))
        smoother = Smoother(search.library, record, prior)
        fit = smoother.fit(belief.within(fit.guess), fit.noise)
    record = smoother.judged(fit.guess, hopping_only=True)
    if record.left_open.any():
        fit = _fitted(Smoother(search.library, record, prior), fit.guess, fit.noise)
    mapped = _mapped(search, record, prior, fit) if has_map(rig) else None
    as_described = np.array_equal(belief.sd, search.belief.sd)
    part = _Part(search, prior, fit, record, belief, as_described, "", mapped)
    reason = OVERFITTED if overfits(part.judged) else unfit(part.judged, finding.record)
    return replace(part, reason=reason or NO_SUCH_RIG * belief.beyond_all(fit.guess))


def _mapped(search: Search, record: Record, prior: Prior, fit: Fit) -> _Mapped:
    """A fit again, the pads' errors of place being estimated."""
    places = Smoother(search.library, record, prior).places(fit.guess)
    record, prior, guess = with_map(record, places, prior, fit.guess, search.rig)
    return _Mapped(record, prior, _fitted(Smoother(search.library, record, prior), guess, fit.noise))


def _fitted(smoother: Smoother, guess: Guess, noise: ProcessNoise) -> Fit:
    """The fit of a problem that is freer than the one that `guess` is of: it may have farther to go than one fit."""
    fit = smoother.fit(guess, noise)
    return fit if fit.settled else smoother.fit(fit.guess, noise)


def _longest_together(parts: Sequence[_Part]) -> tuple[_Part, list[_Joined]]:
    """Those parts that are of the same object beyond doubt: of all such sets the one that lasts longest."""
    left, best, longest = list(parts), (parts[0], list[_Joined]()), 0.0
    while left:
        main, others = left.pop(0), list[_Joined]()
        lasts = main.segment.lasts
        waiting = list(left)
        while waiting:
            part = waiting.pop(0)
            joined = _joined(main, part)
            if joined is not None:
                main, other = joined
                others.append(other)
                left = [each for each in left if each is not part]
                lasts += part.segment.lasts
                waiting = list(left)  # more of the outline is known now that they may overlap with
        if lasts > longest:
            best, longest = (main, others), lasts
    return best


def _joined(main: _Part, part: _Part) -> tuple[_Part, _Joined] | None:
    """`main` with what `part` tells besides; None unless that is of the same object beyond doubt."""
    p = main.fit.guess.p
    prior = Chain(main.search.library, main.fit.noise, main.blind).prior(p)
    found = matched(part.felt(), main.felt(), prior)
    if found is None:
        return None
    before, further = main.known.information, found.felt.information
    known = replace(main.known, information=further if before is None else before.plus(further))
    fit = Smoother(main.search.library, main.record, known).fit(main.fit.guess, main.fit.noise)
    if not fit.settled:
        return None
    nodes = part.fit.guess.x
    return replace(main, known=known, fit=fit, mapped=None), _Joined(part.record, nodes[:, 0] + found.turn, nodes[:, 1])


def _result(main: _Part, others: Sequence[_Joined], rig: RigDescription, begun: float) -> Reconstruction:
    fit, record, library, reason = main.fit, main.record, main.search.library, main.reason
    prior = main.known
    if has_map(rig):
        mapped = main.mapped or _mapped(main.search, record, prior, fit)
        record, prior, fit = mapped.record, mapped.known, mapped.fit
        reason = reason or unfit(mapped.judged, record)
    if reason and not explained(fit, record):
        reason += _if_concave(rig)
    try:
        answered = marginalised(library, record, prior, fit)
    except np.linalg.LinAlgError:
        return _nothing(reason or "the fit is not a minimum", begun, fit.chi2)
    x, by_prior = answered.mean.x, (answered.mean.p[RIG], answered.covariance[RIG, RIG])
    everything, covariance = np.concatenate([answered.mean.p, x[-1]]), main.belief.considering(answered.covariance)
    convex = made_convex(everything, covariance, _OUTLINE)
    p = everything[:CONSTANTS]
    parts = sorted([_Joined(record, x[:, 0], x[:, 1]), *others], key=lambda part: float(part.record.t[0]))
    normals = [contact_normals(part.record, part.psi, p[C.SHAPE :]) for part in parts]
    outline = outline_of(p[C.SHAPE :], covariance[_OUTLINE, _OUTLINE], normals)
    told = outline_of(p[C.SHAPE :], given(covariance, RIG, _OUTLINE), normals)
    if not reason and float(np.sqrt(np.mean(told.h_sd[told.touched] ** 2))) > SHARP_M:
        reason = "the readings tell too little of the outline"
    if not reason and (lying := most_lying(p[C.SHAPE :], normals, rig.curvatures)) >= MOST_LYING:
        reason = f"the palms are too concave for the object: kappa v reaches {lying:.2f} where it touches"
    if not reason and not convex:
        reason = "only a hollow outline explains the readings"
    root = root_of(shape.basis(outline.theta, ORDER), covariance[_OUTLINE, _OUTLINE])
    sd = np.sqrt(np.diagonal(covariance))
    rho = math.exp(p[C.LN_RHO])
    mass, mass_sd = _weighed(main, rig, answered)
    everywhere = np.concatenate(normals)
    radii = [shape.basis(everywhere[:, i], ORDER) @ p[C.SHAPE :] for i in range(everywhere.shape[1])]
    t, psi, omega0 = (
        np.concatenate(columns)
        for columns in zip(*((part.record.t, part.psi, part.omega0) for part in parts), strict=True)
    )
    return Reconstruction(
        converged=not reason, chi2=fit.chi2,
        theta=outline.theta, h=outline.h, h_sd=outline.h_sd, touched=outline.touched,
        visits=np.sum([visits_of(each) for each in normals], axis=0),
        rho=rho, rho_sd=rho * float(sd[C.LN_RHO]), mu=answered.mu, mu_sd=answered.mu_sd,
        mass=mass, mass_sd=mass_sd, rig=p[RIG], rig_covariance=covariance[RIG, RIG],
        contradicted=main.belief.contradicted, rig_prior_sd=main.belief.sd,
        t=t, psi=psi, omega0=omega0, radii=np.stack(radii),
        reason=reason, seconds=time.perf_counter() - begun,
        turned_sd=math.nan if others else float(sd[CONSTANTS]),  # ψ is 0 at the first node: gauge
        rig_by_prior=by_prior,
        evidence=answered.evidence - main.belief.opened_nats,
        shape_class=UNTOLD if reason else shape_class(outline.theta, outline.h, root, outline.touched),
    )  # fmt: skip


def most_lying(coefficients: FloatArray, normals: Sequence[FloatArray], curvatures: Sequence[float]) -> float:
    """The largest κv at a contact: from 1 on an object would lie in its palm, touching twice. 0 on flat palms."""
    if not any(curvatures):
        return 0.0
    bent = coefficients * (1.0 - shape.harmonic_of_coefficient((len(coefficients) - 1) // 2) ** 2)
    at = np.concatenate(normals)
    v = [shape.basis(at[:, palm], (len(bent) - 1) // 2) @ bent for palm in range(len(curvatures))]
    return float(max((kappa * each).max() for kappa, each in zip(curvatures, v, strict=True)))


CLIPPED_SHARE = 0.05
"""Of saturated readings: below it what their absence shifts the mass by is less than the pads' gain is uncertain."""


def _weighed(main: _Part, rig: RigDescription, answered: Marginal) -> tuple[float, float]:
    """Mass and its one-sigma (kg): from the fit, or afterwards where the forces were left out.

    NaN without forces, and where too many are saturated: those that are left are a biased choice.
    """
    if np.mean([sample.at_least is not None for sample in main.segment.pads]) > CLIPPED_SHARE:
        return math.nan, math.nan
    if len(main.record.force_value):
        mass = math.exp(answered.mean.p[C.LN_MASS])
        return mass, mass * math.sqrt(answered.covariance[C.LN_MASS, C.LN_MASS])
    believed, segment, search = rig.with_pads(force_gain_std=0.0), main.segment, main.search
    record = lay_out(segment.pads, search.path, believed, segment.start, segment.end, SPACING_S)
    unit = np.where(np.arange(CONSTANTS) == C.LN_MASS, 0.0, answered.mean.p)
    per_mass = Smoother(search.library, record, search.prior).forces(replace(answered.mean, p=unit))
    scales = MassEstimator(rig.pads)
    for pad, force, f in zip(record.force_pad, record.force_value, per_mass, strict=True):
        scales.feed(int(pad), float(force), float(f))
    return scales.value, scales.sd


def _if_concave(rig: RigDescription) -> str:
    """What may be wrong where nothing explains the readings and palms are concave."""
    told = ", ".join(f"{kappa:.3g} 1/m" for kappa in rig.curvatures)
    return f"; palms as concave as these ({told}) may be too concave for it" if max(rig.curvatures) > 0.0 else ""


def _nothing(reason: str, begun: float, chi2: float = math.nan) -> Reconstruction:
    none: FloatArray = np.zeros(0)
    nan = math.nan
    return Reconstruction(
        False, chi2, directions(), None, None, None, None, nan, nan, nan, nan, nan, nan,
        none, np.zeros((0, 0)), none, none, none, none, none, none, reason, time.perf_counter() - begun,
    )  # fmt: skip
