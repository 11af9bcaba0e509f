"""The search for an outline with flat sides and corners behind a segment of readings, blind.

What lies on a flat side rides on its palm, and where it does is read off the readings (`observer.rides`): all rides on
one side, with one corner on the other palm, tell of one outline together, whatever came between them: a contact that
was lost, too, so rides in other segments count.

Else the search begins at the segment's beginning: ψ follows that palm's angle, while the contact wanders along the
side as the balance of torques asks. That gives two starts, one a palm, besides those of the bank of filters. The window
then grows over the segment. Where no motion of the present outline explains what comes next, rivals are born that have
one more side, at the normal by which either palm feels the object there; the readings choose among them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from palmd.events import FloatArray
from palmd.model import sharp
from palmd.model.sharp import CONSTANTS, LENGTHS, NORMALS, SIDES, WIDTH
from palmd.model.smoothing import NODE, C
from palmd.observer.data_segment import SUSPICIOUS_GAP_S
from palmd.observer.factor import Prior
from palmd.observer.first_guess import blind_starts
from palmd.observer.followed import followed
from palmd.observer.joined import (
    APART_M,
    NEARLY_RAD,
    SAME_SIDE_RAD,
    Footing,
    bridged,
    footing,
    led,
    ridden_at,
    seated,
    side_between,
    sketched,
    told_by,
    turns,
)
from palmd.observer.normal_equations import Guess, ProcessNoise
from palmd.observer.outline import normal_angles
from palmd.observer.record import Record, joined, lasting, lay_out
from palmd.observer.ridden import NEAR_S, begun, calm, kept, narrowed, normal_at_first, rotated, trimmed, turning
from palmd.observer.rides import Ride, corner_of, rides_of, same
from palmd.observer.search import MOST_STRAIN, UNLIKELY, Search, astray
from palmd.observer.smoother import Fit, Posterior, Smoother

NOISE = ProcessNoise(1e-10, 1e-5, gate=4.0)
SPACING_S = 0.005  # of the nodes, while looking
BANK_S, BANK_STARTS = 1.0, 3  # seconds that the bank of filters reads, and how many of it are started from
FIRST_S, GROWTH, LEAST_GROWTH_S = 0.4, 1.6, 0.1
SIDE_M, SIDE_SD_M = 15e-3, 8e-3  # length of a side before it is felt
BORN_SD_RAD = 0.05
Stage = tuple[
    float, float, float
]  # the width w of a side (rad), ln w's one-sigma, and from where on a defect is a blow
FIXED = 1e-3
CALM: tuple[Stage, ...] = ((0.012, FIXED, math.inf), (0.004, FIXED, math.inf), (0.0015, FIXED, math.inf))
COARSE: tuple[Stage, ...] = ((0.012, FIXED, math.inf), (0.004, FIXED, math.inf), (0.0015, FIXED, NOISE.gate))
FINE: tuple[Stage, ...] = ((0.001, 1.0, NOISE.gate),)
Way = tuple[tuple[float, float], ...]  # widths of a side (rad), and by how much the motion is noisier
WAYS: tuple[Way, ...] = (((5e-4, 1.0), (2.5e-4, 1.0)), ((5e-4, 1e3), (5e-4, 10.0), (2.5e-4, 1.0)))  # to what rides
LEAST_PART_S, MOST_PARTS = 0.7, 20  # of rides on one side, to be joined to others; of such parts, the longest
BEYOND = 4.0  # sigmas, of readings between two rides that are not explained
LOOSENED = (1e3, 10.0)  # by which the motion is noisier at first, where rides are joined
ALIKE_M = 3e-5  # of Y, that tells sides apart by itself
PIECE_S, MOST_PIECES = 6.0, 3  # of a ride that is not explained all along
BRIDGE_S = 3.0  # from a ride to one on another side, at most
SETTLED_NODES = 10  # of a ride, after which its beginning or before which its end is told
SAME_TURN_RAD = 0.02  # between two frames
LAST_S = 0.0025  # spacing of the nodes (s) in the end
SHAPE_SD = 2.0  # times that of a smooth lump
LN_GYRATION, LN_GYRATION_SD = math.log(0.67), 0.12  # of a triangle 0.61, of a square 0.64, of a disc 0.71
MOST_CUT = 0.2  # of the rides, that may be left out as nothing explains it
HOPELESS = 5.0  # cost for each reading of a ride, on a wide side, that narrower ones will not bring down
PRICE = 12.0  # of a side more: twice the log-likelihood that it must gain
ITERATIONS, LAST_ITERATIONS = 25, 60
MOST_SCATTER, MOST_OUTLIERS = 1.25, 0.10  # of the readings, while looking
MOST_ASTRAY = 20  # readings in a row that are missed: more is no rocking after a jump
MOST_PER_READING, SURPRISE = 1.25, 60.0  # that the deviance may rise by while the window grows
SCATTER = 0.455  # median of x², x standard normal
RIVALS = 3
OTHER_KIND = 150.0  # of twice the log-likelihood, that an outline with another number of sides may lack
LEAST_S = 5.0  # of readings that are explained, before anything is told; until then the object may have ridden
BIRTHS_S = 2.0  # from its beginning, within which a search looks for more sides
JOINING = 2e6  # iterations times nodes, in which rides are joined
PAUSE_S = 0.6  # from where nothing explains the readings to the next search's beginning
WORK = 1e6  # of a segment: iterations times nodes, as bounds the time taken; some 20 µs each


@dataclass(frozen=True, slots=True)
class FlatSide:
    """What is believed of a side before the readings speak: its normal (rad, in the object's frame)."""

    normal: float


@dataclass(frozen=True, slots=True)
class Candidate:
    """A fit of a record by an outline with so many sides."""

    sides: tuple[FlatSide, ...]
    prior: Prior
    record: Record
    fit: Fit
    scatter: float

    @property
    def deviance(self) -> float:
        """Twice the negative log-likelihood up to a constant, with the price of its sides."""
        return self.fit.cost + PRICE * len(self.sides)

    @property
    def lasts(self) -> float:
        """How long its record is (s)."""
        return lasting(self.record.spans)

    @property
    def explains(self) -> bool:
        """Whether the readings are explained to their noise but for some while a contact jumps."""
        fit = self.fit
        n = len(self.record.contact_value)
        return (
            math.isfinite(fit.cost)
            and self.scatter < MOST_SCATTER + 4.0 / math.sqrt(n)
            and fit.outliers < MOST_OUTLIERS
            and fit.slack < 0.5 * n
            and fit.strain < MOST_STRAIN
            and fit.astray < MOST_ASTRAY
        )

    def goes_on(self, before: Candidate) -> bool:
        """Whether it explains what has come since `before`, the best on a shorter window, and all the rest as well."""
        more = self.record.readings - before.record.readings
        return self.explains and self.deviance < before.deviance + MOST_PER_READING * more + SURPRISE

    @property
    def doubtful(self) -> bool:
        """Whether it may be a lesser minimum: the readings are explained less well than by most that are right."""
        few = math.sqrt(2.0 / len(self.record.contact_value))
        return not self.explains or self.fit.chi2 > 1.0 + few or self.fit.strain > UNLIKELY


@dataclass(frozen=True, slots=True)
class Part:
    """What explains rides, and what these tell of sides and corners, in its frame."""

    candidate: Candidate
    footings: tuple[Footing, ...]

    @classmethod
    def of(cls, candidate: Candidate, rides: Sequence[Ride]) -> Part:
        """Of these rides on one side."""
        return cls(candidate, (footing(candidate.record, candidate.fit.guess, rides[0].palm, rides),))


class SidedSmoother(Smoother):
    """The smoother of an outline with sides."""

    def sane(self, guess: Guess) -> bool:
        """As `Smoother.sane`, and no side is longer than 0.1 m."""
        p = guess.p
        return (
            super().sane(guess)
            and bool(abs(p[C.LN_RHO] - math.log(p[C.SHAPE]) + 0.4) < 1.0)
            and bool((p[LENGTHS:WIDTH] > -1e-3).all() and (p[LENGTHS:WIDTH] < 0.1).all())
        )


class SidedSearch:
    """One segment, as `search` has laid it out, and `others` in which the object may have ridden as well."""

    def __init__(self, search: Search, seed: int = 0, others: Sequence[Search] = ()):
        self._search, self._seed = search, seed
        self._all = in_order(search, others)
        self._records = [_laid_out(each, each.segment.start, each.segment.end, SPACING_S) for each in self._all]
        self.record = joined(self._records)
        self._work = 0
        self._from, self._to = search.segment.start, search.segment.end
        for each in (*reversed(self._all), *self._all):  # nobody takes an object away in so short a time
            segment = each.segment
            if 0.0 < self._from - segment.end < SUSPICIOUS_GAP_S:
                self._from = segment.start
            if 0.0 < segment.start - self._to < SUSPICIOUS_GAP_S:
                self._to = segment.end

    def ridden(self) -> Iterator[tuple[Candidate, ...]]:
        """What explains rides, wherever they last long enough: on several sides together, then on one at a time.

        On one side, with one corner on the other palm. Best first: the same minimum twice, or another. Only what has
        ridden in the segment itself is told, else it may be another object.
        """
        by_length = sorted((ride for each in self._records for ride in rides_of(each)), key=lambda ride: -ride.lasts)
        groups = [rides for rides in same(by_length) if any(ride.rolls for ride in rides)]
        apart = _told_apart(groups)
        near = [apart[i] for i in sorted(_neighbours(apart))]
        told = {_times(rides): self._on_one_side(rides) for rides in near}
        fits = ((told[_times(rides)][0], rides) for rides in near)
        whole = self._joined([Part.of(fit, rides) for fit, rides in fits if math.isfinite(fit.fit.cost)])
        if whole is not None and whole.lasts > LEAST_S and self._here(whole.record.spans):
            yield (whole,)
        for rides in groups:
            if lasting(trimmed(rides)) > LEAST_S and self._here(trimmed(rides)):
                found = told.get(_times(rides)) or self._on_one_side(rides)
                yield found
                if not found[0].explains:
                    yield from (self._on_one_side([piece]) for piece in _pieces(rides))

    def _here(self, spans: Sequence[tuple[float, float]]) -> bool:
        """Whether any of these (s) is in the segment itself, or in one that is parted from it by a moment's loss."""
        return any(self._from < end and start < self._to for start, end in spans)

    def _on_one_side(self, rides: Sequence[Ride]) -> tuple[Candidate, ...]:
        found = _in_order(self._along(way, rides) for way in WAYS)
        spans = self._calm(found[0])
        least = LEAST_S if found[0].lasts > LEAST_S else 0.0
        if lasting(spans) > max(least, (1.0 - MOST_CUT) * found[0].lasts):
            found = _in_order(self._cut(each, spans) for each in found)
        return found

    def _joined(self, parts: Sequence[Part]) -> Candidate | None:
        """What explains most of these, each ridden on one side, by one outline; None where no two are of one."""
        most = self._work + JOINING
        best: Part | None = None
        left = _longest_first(self._lying_still(self._explained_parts(parts)))
        while left:
            first, *left = left
            whole, waiting = first, left
            while waiting and self._work < most:
                part, *waiting = waiting
                both = self._together(whole, part)
                if both is not None:
                    whole, left = both, [each for each in left if each is not part]
                    waiting = left  # more of the outline is known now
            if whole is not first and (best is None or whole.candidate.lasts > best.candidate.lasts):
                best = whole
        return None if best is None else best.candidate

    def _explained_parts(self, parts: Iterable[Part]) -> Iterator[Part]:
        """These, and of what is not explained each ride by itself: sides may be alike."""
        for part in parts:
            rides = part.footings[0].rides
            if part.candidate.explains:
                yield part
            elif len(rides) > 1:
                alone = (ride for ride in rides if lasting(trimmed([ride])) > LEAST_PART_S)
                yield from self._explained_parts(Part.of(self._on_one_side([ride])[0], [ride]) for ride in alone)

    def _lying_still(self, parts: Iterable[Part]) -> list[Part]:
        """These, rides on one side with one corner after the other as one: of them no turn need be sought."""
        told = list[Part]()
        for part in sorted(parts, key=lambda part: part.candidate.record.spans[0][0]):
            before = next((each for each in told if _stays(each, part)), None)
            both = None if before is None else self._together(*_longest_first([before, part]))
            if both is not None:
                told = [each for each in told if each is not before]
            told.append(both or part)
        return told

    def _together(self, whole: Part, part: Part) -> Part | None:
        """Both as of one outline; None where none explains both and what lies between, or more than one."""
        pairs = [(one, other) for one in whole.footings for other in part.footings]
        for one, other in pairs:
            turned = other.turned(one.normal - other.normal)
            if one.stays(other) and abs(turned.corner - one.corner) > APART_M:
                return self._turned_together(whole, part, one.normal - other.normal, side_between(one, turned))
        asked = list[float]()
        for turn in (each for one, other in pairs for each in turns(one, other)):
            if all(abs(math.remainder(turn - other, math.tau)) > SAME_TURN_RAD for other in asked):
                asked.append(turn)
        found = [both for turn in asked if (both := self._turned_together(whole, part, turn)) is not None]
        return found[0] if len(found) == 1 else None

    def _turned_together(self, whole: Part, part: Part, turn: float, passed: tuple[Footing, ...] = ()) -> Part | None:
        """Both, normals of `part` turned by `turn` (rad), if that explains them and what lies between two rides.

        passed: a side that the other palm went by in between.
        """
        one, other = whole.candidate, part.candidate
        there = rotated(other.fit.guess, turn)
        normals = [each.normal for each in self._settled(one)]
        normal, before = float(there.p[NORMALS]), len(normals)
        for new in (normal, *(each.normal for each in passed[:1])):
            if all(abs(math.remainder(new - each, math.tau)) > SAME_SIDE_RAD for each in normals):
                normals.append(new)
        together = sorted([*one.record.spans, *other.record.spans])
        if len(normals) > SIDES or any(end > start for (_, end), (start, _) in pairwise(together)):
            return None
        footings = [*whole.footings, *(each.turned(turn) for each in part.footings), *passed]
        record, p = self.record.within(together), one.fit.guess.p.copy()
        p[NORMALS : NORMALS + len(normals)] = normals
        p[LENGTHS + before : LENGTHS + len(normals)] = SIDE_M
        p = sketched(p, footings, self._prior(tuple(map(FlatSide, normals))), len(normals))
        x = np.empty((len(record.t), NODE))
        for each, guess, on in ((one, one.fit.guess, normals[:before]), (other, there, [normal])):
            nodes = np.searchsorted(record.t, each.record.t - NEAR_S)
            x[nodes] = seated(each.record, guess.x, guess.p, p, on)
        shift = float(x[0, 0])
        torn, sides = rotated(Guess(x, p), shift), tuple(FlatSide(each + shift) for each in normals)
        ways = self._bridges(record, torn, len(sides), one.record.spans)
        for gap, spans, x in [(None, record.spans, torn.x)] if passed else ways:
            both = self._loosened(self.record.within(spans), sides, Guess(x, torn.p))
            explained = self._calm(both)
            if lasting(explained) < (1.0 - MOST_CUT) * both.lasts:
                continue
            between_told = gap is None or (both.explains and self._explained_between(both, *gap))
            both = self._cut(both, explained)
            if not both.explains:  # what has been left out had bent it
                both = self._loosened(both.record, both.sides, both.fit.guess)
            if between_told and both.explains:
                shift = float(both.fit.guess.p[NORMALS] - one.fit.guess.p[NORMALS])
                p = both.fit.guess.p
                return Part(both, tuple(told_by(p, len(sides), each.turned(shift)) for each in footings))
        return None

    def _loosened(self, record: Record, sides: tuple[FlatSide, ...], guess: Guess) -> Candidate:
        """As `_fitted`, of a motion that is noisier at first, and sides that are as wide as they are."""
        held: Stage = (math.exp(guess.p[WIDTH]), FIXED, NOISE.gate)
        for noisier in LOOSENED:
            noise = ProcessNoise(noisier * NOISE.psi, noisier * NOISE.omega0)
            guess = self._fitted(record, sides, guess, (held,), noise=noise).fit.guess
        return self._fitted(record, sides, guess, FINE, LAST_ITERATIONS)

    def _bridges(
        self, record: Record, guess: Guess, sides: int, one: Sequence[tuple[float, float]]
    ) -> Iterator[tuple[tuple[float, float] | None, Sequence[tuple[float, float]], FloatArray]]:
        """A gap between a part of `record` that is in `one` and another (s), the parts without it, and the nodes.

        The shortest gap comes first; those without a way over it are left out, and where a contact was lost for long.
        Where it was lost for a moment, or the way hardly arrives, parts stay as they are, and there is no gap.
        """
        spans, x = record.spans, guess.x
        gaps = [
            (start - end, k)
            for k, ((_, end), (start, _)) in enumerate(pairwise(spans))
            if start - end < BRIDGE_S and (spans[k] in one) != (spans[k + 1] in one)
        ]
        for _, k in sorted(gaps):
            i, j = int(record.torn[k]) - SETTLED_NODES, int(record.torn[k]) + 1 + SETTLED_NODES
            gap = self.record.within([(float(record.t[i]), float(record.t[j]))])
            if len(gap.torn) and float(np.diff(gap.t).max()) > SUSPICIOUS_GAP_S:
                continue
            before, after = (turning(gap, ridden_at(record, guess, node, sides))[:, 0] for node in (i, j))
            rides = x[i, 0] + before, x[j, 0] + after - after[-1]
            psi = None if len(gap.torn) else bridged(gap, guess.p, *rides)
            nearly = psi is not None or led(gap, guess.p, *rides, NEARLY_RAD) is not None
            if psi is not None:
                between = np.stack([psi, np.gradient(psi, gap.t)], axis=1)
                later = x[j + 1 :].copy()
                later[:, 0] += math.tau * round((psi[-1] - x[j, 0]) / math.tau)
                nodes = np.concatenate([x[:i], between, later])
                without = [*spans[:k], (spans[k][0], spans[k + 1][1]), *spans[k + 2 :]]
                yield (spans[k][1], spans[k + 1][0]), without, nodes
            if nearly:
                yield None, spans, x

    def _along(self, way: Way, rides: Sequence[Ride]) -> Candidate:
        record, palm = self.record.within(trimmed(rides)), rides[0].palm
        sides = (FlatSide(normal_at_first(record, palm)),)
        p = self._start(sides)
        p[WIDTH] = math.log(way[0][0])
        guess = begun(record, palm, corner_of(rides), p, self._prior(sides))
        for width, noisier in way:
            noise = ProcessNoise(noisier * NOISE.psi, noisier * NOISE.omega0)
            guess = narrowed(guess, record, palm, width)
            guess = self._fitted(record, sides, guess, ((width, FIXED, math.inf),), noise=noise).fit.guess
        return self._fitted(record, sides, guess)

    @staticmethod
    def _calm(found: Candidate) -> list[tuple[float, float]]:
        """The parts (s) of its record that `found` explains all along."""
        return calm(found.record, _smoother(found.sides, found.record, found.prior).residuals(found.fit.guess))

    @staticmethod
    def _explained_between(found: Candidate, start: float, end: float) -> bool:
        """Whether it explains its contact readings from `start` to `end` (s), but for a few."""
        missed = _smoother(found.sides, found.record, found.prior).residuals(found.fit.guess)
        there = missed[(found.record.contact_t > start) & (found.record.contact_t < end)]
        return len(there) > 0 and bool(np.mean(np.abs(there) > BEYOND) < MOST_OUTLIERS)

    def _cut(self, found: Candidate, spans: list[tuple[float, float]]) -> Candidate:
        """The same, of these parts (s) alone."""
        record = self.record.within(spans)
        if len(record.t) == len(found.record.t):
            return found
        guess = kept(found.fit.guess, found.record.t, record.t)
        turn = float(guess.p[NORMALS] - found.fit.guess.p[NORMALS])
        return self._fitted(record, tuple(FlatSide(side.normal + turn) for side in found.sides), guess)

    def stretches(self, log: Callable[[Candidate], None] | None = None) -> list[tuple[Candidate, ...]]:
        """The parts of the segment that are explained, longest first: outlines and motions of each, best first.

        Where nothing follows the object from one side to another, a new search begins, as long as `WORK` lasts and what
        is left may be longer than what was found.
        """
        whole, found = self._records[self._all.index(self._search)], list[tuple[Candidate, ...]]()
        begin, longest = 0, LEAST_S
        while begin < len(whole.dt) and whole.t[-1] - whole.t[begin] > longest and self._work < WORK:
            explained = self._explained(whole.between(begin, len(whole.dt)), log)
            lasted = explained[0].lasts if explained else FIRST_S
            if lasted > longest:
                found.insert(0, explained)
                longest = lasted
            begin += round((lasted + PAUSE_S) / SPACING_S)
        return found

    def _explained(self, whole: Record, log: Callable[[Candidate], None] | None) -> tuple[Candidate, ...]:
        """What explains the readings from the beginning as far as anything does, best first; none if nothing does."""
        first = whole.until(whole.t[0] + FIRST_S)
        candidates = [self._fitted(first, sides, guess, CALM) for sides, guess in self._starts(first)]
        best = self._kept(candidates)
        if not best[0].explains:
            best = self._kept([*candidates, *self._with_births(candidates, first.t[0])])
        explained: list[Candidate] = []
        while True:
            if log:
                for c in best:
                    log(c)
            if not best[0].explains:
                return tuple(explained)
            explained = [each for each in best if each.explains]
            if best[0].record.t[-1] >= whole.t[-1] - 1e-9 or self._work > WORK:
                return tuple(explained)
            grown = self._grown(best, whole)
            if not grown:
                return tuple(explained)
            best = self._kept(grown)

    def _kept(self, candidates: Sequence[Candidate], margin: float = 40.0) -> list[Candidate]:
        """The likeliest, and the likeliest of each number of sides as long as it explains the readings itself."""
        ordered = sorted(candidates, key=lambda each: each.deviance)
        kept: list[Candidate] = []
        for each in ordered:
            near = not kept or each.deviance < kept[0].deviance + margin
            other_kind = each.explains and all(len(each.sides) != len(other.sides) for other in kept)
            if (
                (len(kept) < RIVALS and near) or (other_kind and each.deviance < kept[0].deviance + OTHER_KIND)
            ) and not any(_same(each, other) for other in kept):
                kept.append(each)
        return kept

    def _starts(self, record: Record) -> Iterator[tuple[tuple[FlatSide, ...], Guess]]:
        yield from self._rides(record)
        still = self._start(())
        yield (), Guess(np.zeros((len(record.t), NODE)), still)
        search, begin = self._search, float(record.t[0])
        events = [event for event in search.segment.events() if event.t_sample >= begin]
        for start in blind_starts(events, search.rig, begin, BANK_S, self._seed, BANK_STARTS):
            guess = start.guess(record.t)
            p = still.copy()
            p[:NORMALS] = guess.p
            yield (), Guess(guess.x, p)

    def _rides(self, record: Record) -> Iterator[tuple[tuple[FlatSide, ...], Guess]]:
        """The object lies on one side on a palm, and turns with it."""
        for palm in (0, 1):
            sides = (FlatSide(normal_at_first(record, palm)),)
            yield sides, Guess(turning(record, palm), self._start(sides))

    def _start(self, sides: tuple[FlatSide, ...]) -> FloatArray:
        """The constants most likely before anything is felt."""
        p = self._prior(sides).mean.copy()
        dither = math.exp(p[C.SATURATION])
        p[C.LN_RHO] += math.log(p[C.SHAPE])
        p[C.DRAG], p[C.SATURATION] = p[C.DRAG] / dither, dither**-2.0
        return p

    def _grown(self, rivals: Sequence[Candidate], whole: Record) -> list[Candidate]:
        """The rivals on a longer window, as far as one of them goes on explaining it; none where none does."""
        begin, now = whole.t[0], rivals[0].record.t[-1]
        far, near = float(self._longer(rivals, whole).t[-1]), self._foretold(rivals, whole)
        for until in dict.fromkeys((far, near) if now - begin < BIRTHS_S else (near, far)):
            longer = whole.until(until)
            grown = [self._fitted(longer, each.sides, each.fit.guess) for each in rivals]
            if not _best(grown).goes_on(rivals[0]):
                led = [self._by_readings(longer, each.fit.guess) for each in rivals]
                grown += [self._fitted(longer, each.sides, guess) for each, guess in zip(rivals, led, strict=True)]
            if _best(grown).doubtful and until - begin < LEAST_S:
                grown += [self._ridden(longer, sides, guess) for sides, guess in self._rides(longer)]
            if _best(grown).goes_on(rivals[0]):
                return grown
        if now - begin < BIRTHS_S:
            grown += self._with_births(self._kept(grown, 4000.0), now)
        return grown if _best(grown).goes_on(rivals[0]) else []

    @staticmethod
    def _longer(rivals: Sequence[Candidate], whole: Record) -> Record:
        begin, now = float(whole.t[0]), float(rivals[0].record.t[-1])
        return whole.until(begin + max(GROWTH * (now - begin), now - begin + LEAST_GROWTH_S))

    def _foretold(self, rivals: Sequence[Candidate], whole: Record) -> float:
        """Until when (s) the window may grow: what no rival foretells any more leads astray."""
        now, longer = float(rivals[0].record.t[-1]), self._longer(rivals, whole)
        furthest = now + LEAST_GROWTH_S
        for each in rivals:
            smoother = _smoother(each.sides, longer, each.prior)
            gone = astray(smoother.residuals(smoother.completed(each.fit.guess)))
            furthest = max(
                furthest, longer.t[longer.contact_step[int(np.argmax(gone))]] if gone.any() else longer.t[-1]
            )
        return max(float(furthest), now + LEAST_GROWTH_S)

    def _with_births(self, candidates: Sequence[Candidate], now: float) -> Iterator[Candidate]:
        for each in candidates:
            for sides, guess in self._births(each, now):
                nodes = int(np.searchsorted(each.record.t, now)) + 1
                if 1 < nodes < len(guess.x):
                    led = self._by_readings(each.record, Guess(guess.x[:nodes], guess.p))
                    yield self._fitted(each.record, sides, led, COARSE)
                yield self._fitted(each.record, sides, guess, COARSE)

    def _births(self, candidate: Candidate, now: float) -> Iterator[tuple[tuple[FlatSide, ...], Guess]]:
        if len(candidate.sides) == SIDES:
            return
        record, guess = candidate.record, candidate.fit.guess
        at = normal_angles(record.palms, guess.x[:, 0])
        taken = [float(normal) for normal in guess.p[NORMALS : NORMALS + len(candidate.sides)]]
        for k in (int(np.searchsorted(record.t, now)), len(record.t) - 1):
            for palm in (0, 1):
                normal = float(at[k, palm])
                if any(abs(math.remainder(normal - other, math.tau)) < 0.1 for other in taken):
                    continue
                taken.append(normal)
                sides = (*self._settled(candidate), FlatSide(normal))
                p = guess.p.copy()
                p[NORMALS + len(candidate.sides)], p[LENGTHS + len(candidate.sides)] = normal, SIDE_M
                yield sides, Guess(guess.x, p)

    def refined(self, candidate: Candidate) -> Iterator[Candidate]:
        """The same iterated to the end: on finer nodes, and as it is where they lead astray.

        On finer ones the width is held: on a side that narrows steps become blows, which explain what they like.
        """
        finer = list[Record]()
        for search in self._all:
            segment = search.segment
            mine = [each for each in candidate.record.spans if segment.start - NEAR_S < each[0] < segment.end]
            if mine:
                finer.append(_laid_out(search, mine[0][0], mine[-1][1], LAST_S))
        record = joined(finer).within(candidate.record.spans)
        guess = candidate.fit.guess
        held: Stage = (math.exp(guess.p[WIDTH]), FIXED, NOISE.gate)
        there = guess.on(candidate.record.t, record.t)
        yield self._fitted(record, candidate.sides, there, (held,), LAST_ITERATIONS)
        yield self._fitted(candidate.record, candidate.sides, guess, FINE, LAST_ITERATIONS)

    def posterior(self, candidate: Candidate) -> Posterior:
        """How sure it is of itself, the width open though it was held; raises LinAlgError where it is no minimum."""
        ((width, width_sd, _),) = FINE
        prior = self._prior(candidate.sides, width, width_sd)
        return _smoother(candidate.sides, candidate.record, prior).posterior(candidate.fit)

    def _by_readings(self, record: Record, guess: Guess) -> Guess:
        """The guess carried on to the record's end by the readings alone, the outline taken as it is."""
        known = len(guess.x)
        if known >= len(record.t):
            return guess
        psi = followed(guess.p, record, known - 1, float(guess.x[-1, 0]))
        x = np.empty((len(record.t), NODE))
        x[:known] = guess.x
        x[known:, 0] = psi[1:]
        x[known:, 1] = np.gradient(psi, record.t[known - 1 :])[1:]
        return Guess(x, guess.p)

    @staticmethod
    def _settled(candidate: Candidate) -> tuple[FlatSide, ...]:
        return tuple(FlatSide(float(candidate.fit.guess.p[NORMALS + j])) for j in range(len(candidate.sides)))

    def _fitted(
        self,
        record: Record,
        sides: tuple[FlatSide, ...],
        guess: Guess,
        stages: Sequence[Stage] = FINE,
        iterations: int = ITERATIONS,
        noise: ProcessNoise = NOISE,
    ) -> Candidate:
        for width, width_sd, gate in stages:
            prior = self._prior(sides, width, width_sd)
            p = guess.p.copy()
            if width_sd == FIXED:
                p[WIDTH] = math.log(width)
            smoother = _smoother(sides, record, prior)
            fit = smoother.fit(Guess(guess.x, p), replace(noise, gate=gate), iterations)
            guess = fit.guess
            self._work += fit.iterations * len(record.t)
        residual = smoother.residuals(guess)
        return Candidate(sides, prior, record, fit, float(np.median(residual**2)) / SCATTER)

    def _ridden(self, record: Record, sides: tuple[FlatSide, ...], guess: Guess) -> Candidate:
        """As `_fitted`, on ever narrower sides; given up where on a wide one already nothing is explained."""
        wide = self._fitted(record, sides, guess, CALM[:1])
        if wide.fit.cost > HOPELESS * record.readings:
            return wide
        return self._fitted(record, sides, wide.fit.guess, CALM[1:])

    def _prior(self, sides: tuple[FlatSide, ...], width: float = FINE[0][0], width_sd: float = FIXED) -> Prior:
        base = self._search.prior
        mean, sd = np.zeros(CONSTANTS), np.zeros(CONSTANTS)
        mean[:NORMALS], sd[:NORMALS] = base.mean, base.sd
        mean[C.LN_RHO], sd[C.LN_RHO] = LN_GYRATION, LN_GYRATION_SD
        sd[C.SHAPE : NORMALS] *= SHAPE_SD
        mean[NORMALS:LENGTHS], sd[NORMALS:LENGTHS] = np.arange(SIDES), 0.01
        sd[LENGTHS:WIDTH] = 1e-8
        for j, side in enumerate(sides):
            mean[NORMALS + j], sd[NORMALS + j] = side.normal, BORN_SD_RAD
            mean[LENGTHS + j], sd[LENGTHS + j] = SIDE_M, SIDE_SD_M
        mean[WIDTH], sd[WIDTH] = math.log(width), width_sd
        return Prior(mean, sd, base.omega0_sd)


def in_order(search: Search, others: Sequence[Search]) -> list[Search]:
    """All of them in order of time."""
    return sorted((search, *others), key=lambda each: each.segment.start)


def _laid_out(search: Search, start: float, end: float, spacing: float) -> Record:
    """Of the readings of `search` those from `start` to `end` (s)."""
    return lay_out(search.segment.pads, search.path, search.rig, start, end, spacing)


def _pieces(rides: Sequence[Ride]) -> list[Ride]:
    """The first pieces of the longest that are as long as `PIECE_S` and may be told alone."""
    longest = max(rides, key=lambda ride: ride.lasts)
    starts = longest.start + PIECE_S * np.arange(min(int(longest.lasts / PIECE_S), MOST_PIECES))
    return [replace(longest, start=start, end=start + PIECE_S) for start in starts.tolist()]


def _neighbours(groups: Sequence[Sequence[Ride]]) -> set[int]:
    """Those that have rides enough, and one next to a ride of another of them."""
    enough = [i for i, rides in enumerate(groups[:MOST_PARTS]) if lasting(trimmed(rides)) > LEAST_PART_S]
    rides = sorted((ride.start, ride.end, i) for i in enough for ride in groups[i])
    near = ((i, j) for (_, end, i), (start, _, j) in pairwise(rides) if i != j and start - end < BRIDGE_S)
    return {each for both in near for each in both}


def _times(rides: Sequence[Ride]) -> tuple[tuple[int, float], ...]:
    return tuple((ride.palm, ride.start) for ride in rides)


def _told_apart(groups: Sequence[Sequence[Ride]]) -> list[list[Ride]]:
    """The same, but for what is told so roughly that it may well be of sides that are alike: each ride by itself."""
    apart = list[list[Ride]]()
    for rides in groups:
        rough = any(ride.covariance[0, 0] > ALIKE_M**2 for ride in rides)
        apart += [[ride] for ride in rides] if rough else [list(rides)]
    return sorted(apart, key=lambda rides: -sum(ride.lasts for ride in rides))


def _stays(one: Part, other: Part) -> bool:
    """Whether the object lay on between two of their rides."""
    return any(each.stays(another) for each in one.footings for another in other.footings)


def _longest_first(parts: Iterable[Part]) -> list[Part]:
    return sorted(parts, key=lambda part: -part.candidate.lasts)


def _smoother(sides: Sequence[FlatSide], record: Record, prior: Prior) -> SidedSmoother:
    return SidedSmoother(sharp.library_for(len(sides)), record, prior)


def _in_order(candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    return tuple(sorted(candidates, key=lambda each: each.deviance))


def _best(candidates: Sequence[Candidate]) -> Candidate:
    return min(candidates, key=lambda each: each.deviance)


def _same(one: Candidate, other: Candidate) -> bool:
    if len(one.fit.guess.x) != len(other.fit.guess.x) or len(one.sides) != len(other.sides):
        return False
    return float(np.abs(one.fit.guess.x[:, 0] - other.fit.guess.x[:, 0]).max()) < 0.02
