"""Merge fits of contact-mode segments on different sides into one outline (decision 43).

By the corners that they share, and by the readings in between.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palmd.events import FloatArray
from palmd.model.sharp import LENGTHS, NORMALS, SIDES
from palmd.model.smoothing import NODE
from palmd.observer.data_segment import SUSPICIOUS_GAP_S
from palmd.observer.flat_side_fits import MOST_CUT, MOST_OUTLIERS, SIDE_M, Candidate, FlatSide, FlatSideFits
from palmd.observer.mode_initialisation import NEAR_S, palm_turn, rotated, trimmed_spans
from palmd.observer.mode_segments import ModeSegment
from palmd.observer.normal_equations import Guess
from palmd.observer.record import Record, total_duration
from palmd.observer.side_alignment import (
    APART_M,
    NEARLY_RAD,
    SAME_SIDE_RAD,
    SideContact,
    bridged,
    candidate_turns,
    followed_motion,
    initial_outline,
    moved_to_outline,
    side_between,
    side_contact,
    supporting_palm,
    updated_contact,
)

# duration of segments on one side, to be merged with others; number of such parts, the longest first
LEAST_PART_S, MOST_PARTS = 0.7, 20
BEYOND = 4.0  # σ, of residuals between two segments that are not explained
BRIDGE_S = 3.0  # longest pause between two segments on different sides
SETTLED_NODES = 10  # of a segment, after its beginning or before its end, used as part of the bridge
SAME_TURN_RAD = 0.02  # tolerance of turns between two frames
MOST_WORK = 2e6  # iterations times nodes for merging


@dataclass(frozen=True, slots=True)
class Part:
    """A fit of segments, with the sides and corners that they determine, in its frame."""

    candidate: Candidate
    contacts: tuple[SideContact, ...]

    @classmethod
    def of(cls, candidate: Candidate, segments: Sequence[ModeSegment]) -> Part:
        """The part of these segments on one side."""
        return cls(candidate, (side_contact(candidate.record, candidate.fit.guess, segments[0].palm, segments),))


class SideMerger:
    """Merges several parts, using `fits`."""

    def __init__(self, fits: FlatSideFits):
        self._fits = fits

    def merged(self, parts: Sequence[Part]) -> Candidate | None:
        """The longest fit of parts, each on one side, by one outline; None where no two are of one outline."""
        most = self._fits.work + MOST_WORK
        best: Part | None = None
        remaining = _longest_first(self._merged_while_staying(self._explained_parts(parts)))
        while remaining:
            first, *remaining = remaining
            merged, waiting = first, remaining
            while waiting and self._fits.work < most:
                part, *waiting = waiting
                merged_with = self.merged_pair(merged, part)
                if merged_with is not None:
                    merged, remaining = merged_with, [each for each in remaining if each is not part]
                    waiting = remaining  # more of the outline is known now
            if merged is not first and (best is None or merged.candidate.lasts > best.candidate.lasts):
                best = merged
        return None if best is None else best.candidate

    def _explained_parts(self, parts: Iterable[Part]) -> Iterator[Part]:
        """The parts that are explained; of the others each segment alone, since sides may look alike."""
        for part in parts:
            segments = part.contacts[0].segments
            if part.candidate.explains:
                yield part
            elif len(segments) > 1:
                alone = (segment for segment in segments if total_duration(trimmed_spans([segment])) > LEAST_PART_S)
                yield from self._explained_parts(
                    Part.of(self._fits.on_one_side([segment])[0], [segment]) for segment in alone
                )

    def _merged_while_staying(self, parts: Iterable[Part]) -> list[Part]:
        """The parts, those merged between which only the other palm's corner changed: their turn is known."""
        merged = list[Part]()
        for part in sorted(parts, key=lambda part: part.candidate.record.spans[0][0]):
            before = next((each for each in merged if _stay_on_side(each, part)), None)
            both = None if before is None else self.merged_pair(*_longest_first([before, part]))
            if both is not None:
                merged = [each for each in merged if each is not before]
            merged.append(both or part)
        return merged

    def merged_pair(self, whole: Part, part: Part) -> Part | None:
        """Both parts with one outline; None where none explains both and the readings in between, or several do."""
        pairs = [(one, other) for one in whole.contacts for other in part.contacts]
        for one, other in pairs:
            turned = other.turned(one.normal - other.normal)
            if one.stays_with(other) and abs(turned.corner - one.corner) > APART_M:
                return self.merged_with_turn(whole, part, one.normal - other.normal, side_between(one, turned))
        candidates = list[float]()
        for turn in (each for one, other in pairs for each in candidate_turns(one, other)):
            if all(abs(math.remainder(turn - other, math.tau)) > SAME_TURN_RAD for other in candidates):
                candidates.append(turn)
        found = [both for turn in candidates if (both := self.merged_with_turn(whole, part, turn)) is not None]
        return found[0] if len(found) == 1 else None

    def merged_with_turn(
        self, whole: Part, part: Part, turn: float, passed: tuple[SideContact, ...] = ()
    ) -> Part | None:
        """Both parts, normals of `part` turned by `turn` (rad), if that explains them and the readings in between.

        passed: a side that the other palm passed in between.
        """
        one, other = whole.candidate, part.candidate
        turned_guess = rotated(other.fit.guess, turn)
        normals = [each.normal for each in one.settled]
        normal, before = float(turned_guess.p[NORMALS]), len(normals)
        for new in (normal, *(each.normal for each in passed[:1])):
            if all(abs(math.remainder(new - each, math.tau)) > SAME_SIDE_RAD for each in normals):
                normals.append(new)
        spans_of_both = sorted([*one.record.spans, *other.record.spans])
        if len(normals) > SIDES or any(end > start for (_, end), (start, _) in pairwise(spans_of_both)):
            return None
        contacts = [*whole.contacts, *(each.turned(turn) for each in part.contacts), *passed]
        record, p = self._fits.record.within(spans_of_both), one.fit.guess.p.copy()
        p[NORMALS : NORMALS + len(normals)] = normals
        p[LENGTHS + before : LENGTHS + len(normals)] = SIDE_M
        p = initial_outline(p, contacts, self._fits.prior(tuple(map(FlatSide, normals))), len(normals))
        x = np.empty((len(record.t), NODE))
        for each, guess, own_normals in ((one, one.fit.guess, normals[:before]), (other, turned_guess, [normal])):
            nodes = np.searchsorted(record.t, each.record.t - NEAR_S)
            x[nodes] = moved_to_outline(each.record, guess.x, guess.p, p, own_normals)
        shift = float(x[0, 0])
        rotated_guess, sides = rotated(Guess(x, p), shift), tuple(FlatSide(each + shift) for each in normals)
        bridges = self.bridges(record, rotated_guess, len(sides), one.record.spans)
        for gap, spans, x in [(None, record.spans, rotated_guess.x)] if passed else bridges:
            both = self._fits.loosened(self._fits.record.within(spans), sides, Guess(x, rotated_guess.p))
            explained = self._fits.explained_spans(both)
            if total_duration(explained) < (1.0 - MOST_CUT) * both.lasts:
                continue
            between_explained = gap is None or (both.explains and _explained_between(both, *gap))
            both = self._fits.restricted(both, explained)
            if not both.explains:  # the part left out had biased it
                both = self._fits.loosened(both.record, both.sides, both.fit.guess)
            if between_explained and both.explains:
                shift = float(both.fit.guess.p[NORMALS] - one.fit.guess.p[NORMALS])
                p = both.fit.guess.p
                return Part(both, tuple(updated_contact(p, len(sides), each.turned(shift)) for each in contacts))
        return None

    def bridges(
        self, record: Record, guess: Guess, sides: int, one: Sequence[tuple[float, float]]
    ) -> Iterator[tuple[tuple[float, float] | None, Sequence[tuple[float, float]], FloatArray]]:
        """A gap between a part of `record` that is in `one` and another (s), the parts without the gap, and the nodes.

        The shortest gap comes first; left out are gaps that cannot be bridged, and those in which a contact was lost
        for long. Where it was lost for a moment, or the bridge hardly fits, the parts stay as they are and the gap is
        None.
        """
        spans, x = record.spans, guess.x
        gaps = [
            (start - end, k)
            for k, ((_, end), (start, _)) in enumerate(pairwise(spans))
            if start - end < BRIDGE_S and (spans[k] in one) != (spans[k + 1] in one)
        ]
        for _, k in sorted(gaps):
            i, j = int(record.gap_steps[k]) - SETTLED_NODES, int(record.gap_steps[k]) + 1 + SETTLED_NODES
            gap = self._fits.record.within([(float(record.t[i]), float(record.t[j]))])
            if len(gap.gap_steps) and float(np.diff(gap.t).max()) > SUSPICIOUS_GAP_S:
                continue
            before, after = (palm_turn(gap, supporting_palm(record, guess, node, sides))[:, 0] for node in (i, j))
            psi_ends = x[i, 0] + before, x[j, 0] + after - after[-1]
            psi = None if len(gap.gap_steps) else bridged(gap, guess.p, *psi_ends)
            nearly = psi is not None or followed_motion(gap, guess.p, *psi_ends, NEARLY_RAD) is not None
            if psi is not None:
                between = np.stack([psi, np.gradient(psi, gap.t)], axis=1)
                later = x[j + 1 :].copy()
                later[:, 0] += math.tau * round((psi[-1] - x[j, 0]) / math.tau)
                nodes = np.concatenate([x[:i], between, later])
                without = [*spans[:k], (spans[k][0], spans[k + 1][1]), *spans[k + 2 :]]
                yield (spans[k][1], spans[k + 1][0]), without, nodes
            if nearly:
                yield None, spans, x


def _explained_between(found: Candidate, start: float, end: float) -> bool:
    """Whether the contact readings from `start` to `end` (s) are explained, but for a few."""
    residuals = found.residuals()[(found.record.contact_t > start) & (found.record.contact_t < end)]
    return len(residuals) > 0 and bool(np.mean(np.abs(residuals) > BEYOND) < MOST_OUTLIERS)


def _stay_on_side(one: Part, other: Part) -> bool:
    """Whether the object stayed on its side between two of their segments."""
    return any(each.stays_with(another) for each in one.contacts for another in other.contacts)


def _longest_first(parts: Iterable[Part]) -> list[Part]:
    return sorted(parts, key=lambda part: -part.candidate.lasts)
