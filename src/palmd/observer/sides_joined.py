"""One outline from segments on different sides, by the corners they share and the readings between (decision 43)."""

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
from palmd.observer.normal_equations import Guess
from palmd.observer.record import Record, lasting
from palmd.observer.ridden import NEAR_S, rotated, trimmed, turning
from palmd.observer.rides import Ride
from palmd.observer.sided_fits import MOST_CUT, MOST_OUTLIERS, SIDE_M, Candidate, FlatSide, SidedFits

LEAST_PART_S, MOST_PARTS = 0.7, 20  # of rides on one side, to be joined to others; of such parts, the longest
BEYOND = 4.0  # sigmas, of readings between two rides that are not explained
BRIDGE_S = 3.0  # from a ride to one on another side, at most
SETTLED_NODES = 10  # of a ride, after which its beginning or before which its end is told
SAME_TURN_RAD = 0.02  # between two frames
JOINING = 2e6  # iterations times nodes, in which rides are joined


@dataclass(frozen=True, slots=True)
class Part:
    """What explains rides, and what these tell of sides and corners, in its frame."""

    candidate: Candidate
    footings: tuple[Footing, ...]

    @classmethod
    def of(cls, candidate: Candidate, rides: Sequence[Ride]) -> Part:
        """Of these rides on one side."""
        return cls(candidate, (footing(candidate.record, candidate.fit.guess, rides[0].palm, rides),))


class SidesJoined:
    """What `fits` makes of several parts together."""

    def __init__(self, fits: SidedFits):
        self._fits = fits

    def joined(self, parts: Sequence[Part]) -> Candidate | None:
        """What explains most of these, each ridden on one side, by one outline; None where no two are of one."""
        most = self._fits.work + JOINING
        best: Part | None = None
        left = _longest_first(self._lying_still(self._explained_parts(parts)))
        while left:
            first, *left = left
            whole, waiting = first, left
            while waiting and self._fits.work < most:
                part, *waiting = waiting
                both = self.together(whole, part)
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
                yield from self._explained_parts(Part.of(self._fits.on_one_side([ride])[0], [ride]) for ride in alone)

    def _lying_still(self, parts: Iterable[Part]) -> list[Part]:
        """These, rides on one side with one corner after the other as one: of them no turn need be sought."""
        told = list[Part]()
        for part in sorted(parts, key=lambda part: part.candidate.record.spans[0][0]):
            before = next((each for each in told if _stays(each, part)), None)
            both = None if before is None else self.together(*_longest_first([before, part]))
            if both is not None:
                told = [each for each in told if each is not before]
            told.append(both or part)
        return told

    def together(self, whole: Part, part: Part) -> Part | None:
        """Both as of one outline; None where none explains both and what lies between, or more than one."""
        pairs = [(one, other) for one in whole.footings for other in part.footings]
        for one, other in pairs:
            turned = other.turned(one.normal - other.normal)
            if one.stays(other) and abs(turned.corner - one.corner) > APART_M:
                return self.turned_together(whole, part, one.normal - other.normal, side_between(one, turned))
        asked = list[float]()
        for turn in (each for one, other in pairs for each in turns(one, other)):
            if all(abs(math.remainder(turn - other, math.tau)) > SAME_TURN_RAD for other in asked):
                asked.append(turn)
        found = [both for turn in asked if (both := self.turned_together(whole, part, turn)) is not None]
        return found[0] if len(found) == 1 else None

    def turned_together(self, whole: Part, part: Part, turn: float, passed: tuple[Footing, ...] = ()) -> Part | None:
        """Both, normals of `part` turned by `turn` (rad), if that explains them and what lies between two rides.

        passed: a side that the other palm went by in between.
        """
        one, other = whole.candidate, part.candidate
        there = rotated(other.fit.guess, turn)
        normals = [each.normal for each in one.settled]
        normal, before = float(there.p[NORMALS]), len(normals)
        for new in (normal, *(each.normal for each in passed[:1])):
            if all(abs(math.remainder(new - each, math.tau)) > SAME_SIDE_RAD for each in normals):
                normals.append(new)
        together = sorted([*one.record.spans, *other.record.spans])
        if len(normals) > SIDES or any(end > start for (_, end), (start, _) in pairwise(together)):
            return None
        footings = [*whole.footings, *(each.turned(turn) for each in part.footings), *passed]
        record, p = self._fits.record.within(together), one.fit.guess.p.copy()
        p[NORMALS : NORMALS + len(normals)] = normals
        p[LENGTHS + before : LENGTHS + len(normals)] = SIDE_M
        p = sketched(p, footings, self._fits.prior(tuple(map(FlatSide, normals))), len(normals))
        x = np.empty((len(record.t), NODE))
        for each, guess, on in ((one, one.fit.guess, normals[:before]), (other, there, [normal])):
            nodes = np.searchsorted(record.t, each.record.t - NEAR_S)
            x[nodes] = seated(each.record, guess.x, guess.p, p, on)
        shift = float(x[0, 0])
        torn, sides = rotated(Guess(x, p), shift), tuple(FlatSide(each + shift) for each in normals)
        ways = self.bridges(record, torn, len(sides), one.record.spans)
        for gap, spans, x in [(None, record.spans, torn.x)] if passed else ways:
            both = self._fits.loosened(self._fits.record.within(spans), sides, Guess(x, torn.p))
            explained = self._fits.calm(both)
            if lasting(explained) < (1.0 - MOST_CUT) * both.lasts:
                continue
            between_told = gap is None or (both.explains and _explained_between(both, *gap))
            both = self._fits.cut(both, explained)
            if not both.explains:  # what has been left out had bent it
                both = self._fits.loosened(both.record, both.sides, both.fit.guess)
            if between_told and both.explains:
                shift = float(both.fit.guess.p[NORMALS] - one.fit.guess.p[NORMALS])
                p = both.fit.guess.p
                return Part(both, tuple(told_by(p, len(sides), each.turned(shift)) for each in footings))
        return None

    def bridges(
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
            gap = self._fits.record.within([(float(record.t[i]), float(record.t[j]))])
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


def _explained_between(found: Candidate, start: float, end: float) -> bool:
    """Whether it explains its contact readings from `start` to `end` (s), but for a few."""
    there = found.residuals()[(found.record.contact_t > start) & (found.record.contact_t < end)]
    return len(there) > 0 and bool(np.mean(np.abs(there) > BEYOND) < MOST_OUTLIERS)


def _stays(one: Part, other: Part) -> bool:
    """Whether the object lay on between two of their rides."""
    return any(each.stays(another) for each in one.footings for another in other.footings)


def _longest_first(parts: Iterable[Part]) -> list[Part]:
    return sorted(parts, key=lambda part: -part.candidate.lasts)
