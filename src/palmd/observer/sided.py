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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from palmd.model.sharp import LENGTHS, NORMALS, SIDES
from palmd.model.smoothing import NODE
from palmd.observer.data_segment import SUSPICIOUS_GAP_S
from palmd.observer.first_guess import blind_starts
from palmd.observer.followed import followed
from palmd.observer.normal_equations import Guess
from palmd.observer.outline import normal_angles
from palmd.observer.record import Record, joined, lasting, lay_out
from palmd.observer.ridden import NEAR_S, normal_at_first, trimmed, turning
from palmd.observer.rides import Ride, rides_of, same
from palmd.observer.search import Search, astray
from palmd.observer.sided_fits import (
    FINE,
    FIXED,
    LAST_ITERATIONS,
    LEAST_S,
    NOISE,
    SIDE_M,
    Candidate,
    FlatSide,
    SidedFits,
    Stage,
    best_first,
    held,
    smoother_of,
)
from palmd.observer.sides_joined import BRIDGE_S, LEAST_PART_S, MOST_PARTS, Part, SidesJoined

SPACING_S = 0.005  # of the nodes, while looking
BANK_S, BANK_STARTS = 1.0, 3  # seconds that the bank of filters reads, and how many of it are started from
FIRST_S, GROWTH, LEAST_GROWTH_S = 0.4, 1.6, 0.1
SHARES = (0.5, 0.25)  # of a window's growth, where nothing explains all of it
CALM: tuple[Stage, ...] = ((0.012, FIXED, math.inf), (0.004, FIXED, math.inf), (0.0015, FIXED, math.inf))
COARSE: tuple[Stage, ...] = ((0.012, FIXED, math.inf), (0.004, FIXED, math.inf), (0.0015, FIXED, NOISE.gate))
ALIKE_M = 3e-5  # of Y, that tells sides apart by itself
PIECE_S, MOST_PIECES = 6.0, 3  # of a ride that is not explained all along
LAST_S = 0.0025  # spacing of the nodes (s) in the end
HOPELESS = 5.0  # cost for each reading of a ride, on a wide side, that narrower ones will not bring down
RIVALS = 3
OTHER_KIND = 150.0  # of twice the log-likelihood, that an outline with another number of sides may lack
BIRTHS_S = 2.0  # from its beginning, within which a search looks for more sides
PAUSE_S = 0.6  # from where nothing explains the readings to the next search's beginning
WORK = 1e6  # of a segment: iterations times nodes, as bounds the time taken; some 20 µs each


class SidedSearch:
    """One segment, as `search` has laid it out, and `others` in which the object may have ridden as well."""

    def __init__(self, search: Search, seed: int = 0, others: Sequence[Search] = ()):
        self._search, self._seed = search, seed
        self._all = in_order(search, others)
        self._records = [_laid_out(each, each.segment.start, each.segment.end, SPACING_S) for each in self._all]
        self.record = joined(self._records)
        self.fits = SidedFits(self.record, search.prior)
        self._from, self._to = search.segment.start, search.segment.end
        for each in (*reversed(self._all), *self._all):  # nobody takes an object away in so short a time
            segment = each.segment
            if 0.0 < self._from - segment.end < SUSPICIOUS_GAP_S:
                self._from = segment.start
            if 0.0 < segment.start - self._to < SUSPICIOUS_GAP_S:
                self._to = segment.end

    @cached_property
    def rides(self) -> list[Ride]:
        """All of them, wherever the object has ridden."""
        return [ride for each in self._records for ride in rides_of(each)]

    def ridden(self) -> Iterator[tuple[Candidate, ...]]:
        """What explains rides, wherever they last long enough: on several sides together, then on one at a time.

        On one side, with one corner on the other palm. Best first: the same minimum twice, or another. Only what has
        ridden in the segment itself is told, else it may be another object.
        """
        by_length = sorted(self.rides, key=lambda ride: -ride.lasts)
        groups = [rides for rides in same(by_length) if any(ride.rolls for ride in rides)]
        apart = _told_apart(groups)
        near = [apart[i] for i in sorted(_neighbours(apart))]
        told = {_times(rides): self.fits.on_one_side(rides) for rides in near}
        fits = ((told[_times(rides)][0], rides) for rides in near)
        whole = SidesJoined(self.fits).joined(
            [Part.of(fit, rides) for fit, rides in fits if math.isfinite(fit.fit.cost)]
        )
        if whole is not None and whole.lasts > LEAST_S and self._here(whole.record.spans):
            yield (whole,)
        for rides in groups:
            if lasting(trimmed(rides)) > LEAST_S and self._here(trimmed(rides)):
                found = told.get(_times(rides)) or self.fits.on_one_side(rides)
                yield found
                if not found[0].explains:
                    yield from (self.fits.on_one_side([piece]) for piece in _pieces(rides))

    def _here(self, spans: Sequence[tuple[float, float]]) -> bool:
        """Whether any of these (s) is in the segment itself, or in one that is parted from it by a moment's loss."""
        return any(self._from < end and start < self._to for start, end in spans)

    def stretches(self, log: Callable[[Candidate], None] | None = None) -> list[tuple[Candidate, ...]]:
        """The parts of the segment that are explained, longest first: outlines and motions of each, best first.

        Where nothing follows the object from one side to another, a new search begins, as long as `WORK` lasts and what
        is left may be longer than what was found.
        """
        whole, found = self._records[self._all.index(self._search)], list[tuple[Candidate, ...]]()
        begin, longest = 0, LEAST_S
        while begin < len(whole.dt) and whole.t[-1] - whole.t[begin] > longest and self.fits.work < WORK:
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
        candidates = [self.fits.fitted(first, sides, guess, CALM) for sides, guess in self._starts(first)]
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
            if best[0].record.t[-1] >= whole.t[-1] - 1e-9 or self.fits.work > WORK:
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
        still = self.fits.start(())
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
            yield sides, Guess(turning(record, palm), self.fits.start(sides))

    def _grown(self, rivals: Sequence[Candidate], whole: Record) -> list[Candidate]:
        """The rivals on a longer window, as far as one of them goes on explaining it; none where none does."""
        begin, now = whole.t[0], rivals[0].record.t[-1]
        for until in dict.fromkeys(self._windows(rivals, whole)):
            longer = whole.until(until)
            grown = [self.fits.fitted(longer, each.sides, each.fit.guess) for each in rivals]
            if not _best(grown).goes_on(rivals[0]):
                led = [self._by_readings(longer, each.fit.guess) for each in rivals]
                grown += [self.fits.fitted(longer, each.sides, guess) for each, guess in zip(rivals, led, strict=True)]
            if _best(grown).doubtful and until - begin < LEAST_S:
                grown += [self._ridden(longer, sides, guess) for sides, guess in self._rides(longer)]
            best = _best(grown)
            if best.explains and not best.fit.settled and not best.goes_on(rivals[0]):
                grown.append(self.fits.fitted(longer, best.sides, best.fit.guess, FINE, LAST_ITERATIONS))
            if _best(grown).goes_on(rivals[0]):
                return grown
        if now - begin < BIRTHS_S:
            grown += self._with_births(self._kept(grown, 4000.0), now)
        return grown if _best(grown).goes_on(rivals[0]) else []

    def _windows(self, rivals: Sequence[Candidate], whole: Record) -> list[float]:
        """Until when (s) the window may end, in the order in which that is tried."""
        begin, now = whole.t[0], float(rivals[0].record.t[-1])
        far, near = float(self._longer(rivals, whole).t[-1]), self._foretold(rivals, whole)
        if now - begin < BIRTHS_S:
            return [far, near]
        nearer = [share * (near - now) for share in SHARES]
        return [near, far, *(now + growth for growth in nearer if growth > LEAST_GROWTH_S)]

    @staticmethod
    def _longer(rivals: Sequence[Candidate], whole: Record) -> Record:
        begin, now = float(whole.t[0]), float(rivals[0].record.t[-1])
        return whole.until(begin + max(GROWTH * (now - begin), now - begin + LEAST_GROWTH_S))

    def _foretold(self, rivals: Sequence[Candidate], whole: Record) -> float:
        """Until when (s) the window may grow: what no rival foretells any more leads astray."""
        now, longer = float(rivals[0].record.t[-1]), self._longer(rivals, whole)
        furthest = now + LEAST_GROWTH_S
        for each in rivals:
            smoother = smoother_of(each.sides, longer, each.prior)
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
                    yield self.fits.fitted(each.record, sides, led, COARSE)
                yield self.fits.fitted(each.record, sides, guess, COARSE)

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
                sides = (*candidate.settled, FlatSide(normal))
                p = guess.p.copy()
                p[NORMALS + len(candidate.sides)], p[LENGTHS + len(candidate.sides)] = normal, SIDE_M
                yield sides, Guess(guess.x, p)

    def halved(self, rivals: Sequence[Candidate]) -> Iterator[tuple[Candidate, ...]]:
        """The rivals on the first half of their stretch, best first, if that lasts: it may be told where all is not."""
        record = rivals[0].record
        half = record.until(record.t[0] + 0.5 * rivals[0].lasts)
        if lasting(half.spans) > LEAST_S:
            starts = ((each.sides, Guess(each.fit.guess.x[: len(half.t)], each.fit.guess.p)) for each in rivals)
            yield best_first(self.fits.fitted(half, *start) for start in starts)

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
        there = guess.on(candidate.record.t, record.t)
        yield self.fits.fitted(record, candidate.sides, there, (held(guess),), LAST_ITERATIONS)
        yield self.fits.fitted(candidate.record, candidate.sides, guess, FINE, LAST_ITERATIONS)

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

    def _ridden(self, record: Record, sides: tuple[FlatSide, ...], guess: Guess) -> Candidate:
        """As `SidedFits.fitted`, on ever narrower sides; given up where on a wide one already nothing is explained."""
        wide = self.fits.fitted(record, sides, guess, CALM[:1])
        if wide.fit.cost > HOPELESS * record.readings:
            return wide
        return self.fits.fitted(record, sides, wide.fit.guess, CALM[1:])


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


def _best(candidates: Sequence[Candidate]) -> Candidate:
    return min(candidates, key=lambda each: each.deviance)


def _same(one: Candidate, other: Candidate) -> bool:
    if len(one.fit.guess.x) != len(other.fit.guess.x) or len(one.sides) != len(other.sides):
        return False
    return float(np.abs(one.fit.guess.x[:, 0] - other.fit.guess.x[:, 0]).max()) < 0.02
