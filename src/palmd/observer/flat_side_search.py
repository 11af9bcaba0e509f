"""Search for an outline with flat sides and corners behind a segment of readings, blind.

An object that lies on a flat side turns with that palm, and these contact-mode segments are found from the readings
(`observer.mode_segments`). All segments on one side, with one corner on the other palm, determine one outline together,
whatever happened in between, even a lost contact; so segments in other data segments count.

Otherwise the search starts at the beginning of the data segment: ψ follows the supporting palm's angle, while the
contact moves along the side as the balance of torques requires. That gives two starts, one for each palm, besides those
of the bank of filters. The window then grows over the segment. Where no motion of the present outline explains the next
readings, rivals with one more side are created, at the normal by which either palm touches the object there; the
readings decide between them.
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
from palmd.observer.flat_side_fits import (
    FINE,
    FIXED,
    LAST_ITERATIONS,
    LEAST_S,
    NOISE,
    SIDE_M,
    Candidate,
    FlatSide,
    FlatSideFits,
    Stage,
    best_first,
    held,
    smoother_of,
)
from palmd.observer.mode_initialisation import NEAR_S, initial_normal, palm_turn, trimmed_spans
from palmd.observer.mode_segments import ModeSegment, find_mode_segments, group_by_mode
from palmd.observer.normal_equations import Guess
from palmd.observer.orientation_tracking import tracked_orientation
from palmd.observer.outline import normal_angles
from palmd.observer.record import Record, concatenated_records, lay_out, total_duration
from palmd.observer.search import Search, diverged
from palmd.observer.side_merging import BRIDGE_S, LEAST_PART_S, MOST_PARTS, Part, SideMerger

SPACING_S = 0.005  # of the nodes during the search
BANK_S, BANK_STARTS = 1.0, 3  # seconds that the bank of filters reads; number of filters from which fits start
FIRST_S, GROWTH, LEAST_GROWTH_S = 0.4, 1.6, 0.1
SHARES = (0.5, 0.25)  # of a window's growth, where not all of it is explained
WITHOUT_IMPACTS: tuple[Stage, ...] = ((0.012, FIXED, math.inf), (0.004, FIXED, math.inf), (0.0015, FIXED, math.inf))
FROM_WIDE: tuple[Stage, ...] = ((0.012, FIXED, math.inf), (0.004, FIXED, math.inf), (0.0015, FIXED, NOISE.gate))
DISTINCT_SD_M = 3e-5  # 1σ of Y up to which Y alone distinguishes sides
PIECE_S, MOST_PIECES = 6.0, 3  # length and number of pieces of a segment that is not explained as a whole
LAST_S = 0.0025  # spacing of the nodes (s) of the final fit
HOPELESS = 5.0  # cost per reading of a segment, on a wide side, that narrower sides will not reduce enough
RIVALS = 3
OTHER_KIND = 150.0  # twice the log-likelihood by which an outline with another number of sides may be worse
FURTHER_SIDES_S = 2.0  # from its start, within which a search tries further sides
PAUSE_S = 0.6  # from the end of the explained readings to the start of the next search
WORK = 1e6  # limit per segment of iterations times nodes (some 20 µs each)


class FlatSideSearch:
    """Search in the segment of `search`, and in `others` that may be of the same object."""

    def __init__(self, search: Search, seed: int = 0, others: Sequence[Search] = ()):
        self._search, self._seed = search, seed
        self._all = in_order(search, others)
        self._records = [_laid_out(each, each.segment.start, each.segment.end, SPACING_S) for each in self._all]
        self.record = concatenated_records(self._records)
        self.fits = FlatSideFits(self.record, search.prior)
        self._start, self._end = search.segment.start, search.segment.end
        for each in (*reversed(self._all), *self._all):  # too short a gap for the object to be taken away
            segment = each.segment
            if 0.0 < self._start - segment.end < SUSPICIOUS_GAP_S:
                self._start = segment.start
            if 0.0 < segment.start - self._end < SUSPICIOUS_GAP_S:
                self._end = segment.end

    @cached_property
    def segments(self) -> list[ModeSegment]:
        """The contact-mode segments in all records."""
        return [segment for each in self._records for segment in find_mode_segments(each)]

    def segment_fits(self) -> Iterator[tuple[Candidate, ...]]:
        """Fits of contact-mode segments that last long enough: of several sides together, then of one side at a time.

        One side has one corner on the other palm. Best first: the same minimum twice, or another one. Only fits with
        contact-mode segments in the data segment itself count, since others may be of another object.
        """
        by_length = sorted(self.segments, key=lambda segment: -segment.lasts)
        groups = [group for group in group_by_mode(by_length) if any(segment.excludes_disc for segment in group)]
        split = _split_where_uncertain(groups)
        neighbours = [split[i] for i in sorted(_neighbours(split))]
        fits_of = {_key(group): self.fits.on_one_side(group) for group in neighbours}
        neighbour_fits = ((fits_of[_key(group)][0], group) for group in neighbours)
        merged = SideMerger(self.fits).merged(
            [Part.of(fit, group) for fit, group in neighbour_fits if math.isfinite(fit.fit.cost)]
        )
        if merged is not None and merged.lasts > LEAST_S and self._here(merged.record.spans):
            yield (merged,)
        for group in groups:
            if total_duration(trimmed_spans(group)) > LEAST_S and self._here(trimmed_spans(group)):
                fits = fits_of.get(_key(group)) or self.fits.on_one_side(group)
                yield fits
                if not fits[0].explains:
                    yield from (self.fits.on_one_side([piece]) for piece in _pieces(group))

    def _here(self, spans: Sequence[tuple[float, float]]) -> bool:
        """Whether any of these spans (s) is in the data segment itself, or in one separated by a short loss only."""
        return any(self._start < end and start < self._end for start, end in spans)

    def stretches(self, report: Callable[[Candidate], None] | None = None) -> list[tuple[Candidate, ...]]:
        """The explained parts of the data segment, longest first: fits of each part, best first.

        Where nothing explains the transition from one side to another, a new search starts, while `WORK` lasts and the
        rest may be longer than what was found.
        """
        whole, found = self._records[self._all.index(self._search)], list[tuple[Candidate, ...]]()
        begin, longest = 0, LEAST_S
        while begin < len(whole.dt) and whole.t[-1] - whole.t[begin] > longest and self.fits.work < WORK:
            explained = self._explained(whole.between(begin, len(whole.dt)), report)
            duration = explained[0].lasts if explained else FIRST_S
            if duration > longest:
                found.insert(0, explained)
                longest = duration
            begin += round((duration + PAUSE_S) / SPACING_S)
        return found

    def _explained(self, whole: Record, report: Callable[[Candidate], None] | None) -> tuple[Candidate, ...]:
        """Fits of the readings from the beginning as far as any fit explains them, best first; empty if none does."""
        first = whole.until(whole.t[0] + FIRST_S)
        candidates = [self.fits.fitted(first, sides, guess, WITHOUT_IMPACTS) for sides, guess in self._starts(first)]
        best = self._kept(candidates)
        if not best[0].explains:
            best = self._kept([*candidates, *self._with_further_sides(candidates, first.t[0])])
        explained: list[Candidate] = []
        while True:
            if report:
                for c in best:
                    report(c)
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
        """The likeliest candidates, and the likeliest for each number of sides that explains the readings."""
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
        yield from self._side_starts(record)
        still = self.fits.start(())
        yield (), Guess(np.zeros((len(record.t), NODE)), still)
        search, begin = self._search, float(record.t[0])
        events = [event for event in search.segment.events() if event.t_sample >= begin]
        for start in blind_starts(events, search.rig, begin, BANK_S, self._seed, BANK_STARTS):
            guess = start.guess(record.t)
            p = still.copy()
            p[:NORMALS] = guess.p
            yield (), Guess(guess.x, p)

    def _side_starts(self, record: Record) -> Iterator[tuple[tuple[FlatSide, ...], Guess]]:
        """Starts with the object on one side on a palm, turning with it."""
        for palm in (0, 1):
            sides = (FlatSide(initial_normal(record, palm)),)
            yield sides, Guess(palm_turn(record, palm), self.fits.start(sides))

    def _grown(self, rivals: Sequence[Candidate], whole: Record) -> list[Candidate]:
        """The rivals on a longer window, as far as one of them still explains it; empty where none does."""
        begin, end = whole.t[0], rivals[0].record.t[-1]
        for until in dict.fromkeys(self._windows(rivals, whole)):
            longer = whole.until(until)
            grown = [self.fits.fitted(longer, each.sides, each.fit.guess) for each in rivals]
            if not _best(grown).goes_on(rivals[0]):
                led_by_readings = [self._led_by_readings(longer, each.fit.guess) for each in rivals]
                grown += [
                    self.fits.fitted(longer, each.sides, guess)
                    for each, guess in zip(rivals, led_by_readings, strict=True)
                ]
            if _best(grown).doubtful and until - begin < LEAST_S:
                grown += [self._fit_from_wide_side(longer, sides, guess) for sides, guess in self._side_starts(longer)]
            best = _best(grown)
            if best.explains and not best.fit.settled and not best.goes_on(rivals[0]):
                grown.append(self.fits.fitted(longer, best.sides, best.fit.guess, FINE, LAST_ITERATIONS))
            if _best(grown).goes_on(rivals[0]):
                return grown
        if end - begin < FURTHER_SIDES_S:
            grown += self._with_further_sides(self._kept(grown, 4000.0), end)
        return grown if _best(grown).goes_on(rivals[0]) else []

    def _windows(self, rivals: Sequence[Candidate], whole: Record) -> list[float]:
        """Times (s) at which the window may end, in the order in which they are tried."""
        begin, end = whole.t[0], float(rivals[0].record.t[-1])
        far, near = float(self._longer(rivals, whole).t[-1]), self._predicted_until(rivals, whole)
        if end - begin < FURTHER_SIDES_S:
            return [far, near]
        nearer = [share * (near - end) for share in SHARES]
        return [near, far, *(end + growth for growth in nearer if growth > LEAST_GROWTH_S)]

    @staticmethod
    def _longer(rivals: Sequence[Candidate], whole: Record) -> Record:
        begin, end = float(whole.t[0]), float(rivals[0].record.t[-1])
        return whole.until(begin + max(GROWTH * (end - begin), end - begin + LEAST_GROWTH_S))

    def _predicted_until(self, rivals: Sequence[Candidate], whole: Record) -> float:
        """Time (s) until which the window may grow: as far as any rival predicts the readings."""
        end, longer = float(rivals[0].record.t[-1]), self._longer(rivals, whole)
        furthest = end + LEAST_GROWTH_S
        for each in rivals:
            smoother = smoother_of(each.sides, longer, each.prior)
            diverging = diverged(smoother.residuals(smoother.completed(each.fit.guess)))
            furthest = max(
                furthest, longer.t[longer.contact_step[int(np.argmax(diverging))]] if diverging.any() else longer.t[-1]
            )
        return max(float(furthest), end + LEAST_GROWTH_S)

    def _with_further_sides(self, candidates: Sequence[Candidate], now: float) -> Iterator[Candidate]:
        for each in candidates:
            for sides, guess in self._with_further_side(each, now):
                nodes = int(np.searchsorted(each.record.t, now)) + 1
                if 1 < nodes < len(guess.x):
                    led = self._led_by_readings(each.record, Guess(guess.x[:nodes], guess.p))
                    yield self.fits.fitted(each.record, sides, led, FROM_WIDE)
                yield self.fits.fitted(each.record, sides, guess, FROM_WIDE)

    def _with_further_side(self, candidate: Candidate, now: float) -> Iterator[tuple[tuple[FlatSide, ...], Guess]]:
        if len(candidate.sides) == SIDES:
            return
        record, guess = candidate.record, candidate.fit.guess
        theta = normal_angles(record.palms, guess.x[:, 0])
        normals = [float(normal) for normal in guess.p[NORMALS : NORMALS + len(candidate.sides)]]
        for k in (int(np.searchsorted(record.t, now)), len(record.t) - 1):
            for palm in (0, 1):
                normal = float(theta[k, palm])
                if any(abs(math.remainder(normal - other, math.tau)) < 0.1 for other in normals):
                    continue
                normals.append(normal)
                sides = (*candidate.settled, FlatSide(normal))
                p = guess.p.copy()
                p[NORMALS + len(candidate.sides)], p[LENGTHS + len(candidate.sides)] = normal, SIDE_M
                yield sides, Guess(guess.x, p)

    def halved(self, rivals: Sequence[Candidate]) -> Iterator[tuple[Candidate, ...]]:
        """The rivals on the first half of their part, best first, if long enough: it may pass where the whole fails."""
        record = rivals[0].record
        half = record.until(record.t[0] + 0.5 * rivals[0].lasts)
        if total_duration(half.spans) > LEAST_S:
            starts = ((each.sides, Guess(each.fit.guess.x[: len(half.t)], each.fit.guess.p)) for each in rivals)
            yield best_first(self.fits.fitted(half, *start) for start in starts)

    def refined(self, candidate: Candidate) -> Iterator[Candidate]:
        """The candidate iterated to the end: on finer nodes, and on its own nodes, where finer ones fail.

        On finer nodes the width is held: on a side that narrows, steps become impacts, which may explain anything.
        """
        finer = list[Record]()
        for search in self._all:
            segment = search.segment
            mine = [each for each in candidate.record.spans if segment.start - NEAR_S < each[0] < segment.end]
            if mine:
                finer.append(_laid_out(search, mine[0][0], mine[-1][1], LAST_S))
        record = concatenated_records(finer).within(candidate.record.spans)
        guess = candidate.fit.guess
        there = guess.on(candidate.record.t, record.t)
        yield self.fits.fitted(record, candidate.sides, there, (held(guess),), LAST_ITERATIONS)
        yield self.fits.fitted(candidate.record, candidate.sides, guess, FINE, LAST_ITERATIONS)

    def _led_by_readings(self, record: Record, guess: Guess) -> Guess:
        """The guess continued to the record's end by the readings alone, with the outline as it is."""
        known = len(guess.x)
        if known >= len(record.t):
            return guess
        psi = tracked_orientation(guess.p, record, known - 1, float(guess.x[-1, 0]))
        x = np.empty((len(record.t), NODE))
        x[:known] = guess.x
        x[known:, 0] = psi[1:]
        x[known:, 1] = np.gradient(psi, record.t[known - 1 :])[1:]
        return Guess(x, guess.p)

    def _fit_from_wide_side(self, record: Record, sides: tuple[FlatSide, ...], guess: Guess) -> Candidate:
        """As `FlatSideFits.fitted`, on ever narrower sides; stops where a wide side explains nothing."""
        wide = self.fits.fitted(record, sides, guess, WITHOUT_IMPACTS[:1])
        if wide.fit.cost > HOPELESS * record.readings:
            return wide
        return self.fits.fitted(record, sides, wide.fit.guess, WITHOUT_IMPACTS[1:])


def in_order(search: Search, others: Sequence[Search]) -> list[Search]:
    """All searches in order of time."""
    return sorted((search, *others), key=lambda each: each.segment.start)


def _laid_out(search: Search, start: float, end: float, spacing: float) -> Record:
    """The readings of `search` from `start` to `end` (s)."""
    return lay_out(search.segment.pads, search.path, search.rig, start, end, spacing)


def _pieces(segments: Sequence[ModeSegment]) -> list[ModeSegment]:
    """The first pieces of length `PIECE_S` of the longest segment, each of which may be accepted alone."""
    longest = max(segments, key=lambda segment: segment.lasts)
    starts = longest.start + PIECE_S * np.arange(min(int(longest.lasts / PIECE_S), MOST_PIECES))
    return [replace(longest, start=start, end=start + PIECE_S) for start in starts.tolist()]


def _neighbours(groups: Sequence[Sequence[ModeSegment]]) -> set[int]:
    """Groups of sufficient duration that have a segment next to one of another such group."""
    enough = [
        i for i, segments in enumerate(groups[:MOST_PARTS]) if total_duration(trimmed_spans(segments)) > LEAST_PART_S
    ]
    segments = sorted((segment.start, segment.end, i) for i in enough for segment in groups[i])
    pairs = ((i, j) for (_, end, i), (start, _, j) in pairwise(segments) if i != j and start - end < BRIDGE_S)
    return {each for pair in pairs for each in pair}


def _key(segments: Sequence[ModeSegment]) -> tuple[tuple[int, float], ...]:
    return tuple((segment.palm, segment.start) for segment in segments)


def _split_where_uncertain(groups: Sequence[Sequence[ModeSegment]]) -> list[list[ModeSegment]]:
    """The groups, with those that are too uncertain to distinguish sides split into single segments."""
    split = list[list[ModeSegment]]()
    for group in groups:
        uncertain = any(segment.covariance[0, 0] > DISTINCT_SD_M**2 for segment in group)
        split += [[segment] for segment in group] if uncertain else [list(group)]
    return sorted(split, key=lambda group: -sum(segment.lasts for segment in group))


def _best(candidates: Sequence[Candidate]) -> Candidate:
    return min(candidates, key=lambda each: each.deviance)


def _same(one: Candidate, other: Candidate) -> bool:
    if len(one.fit.guess.x) != len(other.fit.guess.x) or len(one.sides) != len(other.sides):
        return False
    return float(np.abs(one.fit.guess.x[:, 0] - other.fit.guess.x[:, 0]).max()) < 0.02
