"""Everything felt of one object so far, as information about its constants: a chain of marginalised segments.

A record is cut into segments of some seconds. Of each only its cost as a function of (p, first node, last node) counts,
the nodes in between being marginalised; one after the other they are added up and the nodes between them are
marginalised too, down to what all say about p and the last node. A segment keeps its readings and is linearised again
when the constants have moved; the oldest are folded into one quadratic cost for good. So information only grows, while
memory and time stay bounded. Not for use inside the loop.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import Library
from palmd.model.smoothing import CONSTANTS, NODE, RIG
from palmd.observer.factor import SIZE, Factor, Knowledge, marginal_of_constants
from palmd.observer.normal_equations import Guess, ProcessNoise, Residuals
from palmd.observer.record import Record

SEGMENT_S = 2.0
READINGS_KEPT = 60  # segments whose readings are kept: two minutes
RELINEARISED = 12  # segments at most in one call: the cost of an answer is bounded
NEAR = 2.0  # squared sigmas of a segment's own readings by which p and its ends may move
INNER_STEPS = 2  # of Newton's, of a segment's nodes when its ends and the constants have moved
MOST_SETTLING = 6  # iterations, when something else is believed than before
_NODE = slice(CONSTANTS, SIZE)


@dataclass(frozen=True, slots=True)
class Segment:
    """Some seconds of readings, and their cost about one trajectory and one set of constants."""

    record: Record
    x: FloatArray
    summary: Factor

    def near(self, ends: FloatArray) -> bool:
        """Whether (p, first node, last node) are where its linearisation holds, by what its own readings tell apart."""
        by = ends - self.summary.about
        return float(by @ self.summary.matrix @ by) < NEAR


class Chain:
    """Segments in order of time, each beginning with the node with which the one before ends."""

    def __init__(self, library: Library, noise: ProcessNoise, prior: Knowledge, kept: int = READINGS_KEPT):
        """`prior` is about the constants and the first node of all; `kept`: segments that keep their readings."""
        self._library = library
        self._noise = noise
        self._prior = prior
        self._scale = prior.scale
        self._base: Factor | None = None  # of the segments that have been folded, and the prior
        self._learnt: Factor | None = None
        self._revised: Factor | None = None  # by how much the prior of the rig's constants has changed, all along
        self._kept = kept
        self._segments: list[Segment] = []

    def append(self, record: Record, guess: Guess) -> None:
        """Take a segment of two steps or more, already smoothed to `guess`."""
        self._segments.append(self._linearised(record, guess))
        while len(self._segments) > self._kept:
            self._fold()

    def learn(self, information: Factor) -> None:
        """Take what other readings tell of the constants."""
        self._learnt = information if self._learnt is None else self._learnt.plus(information)

    def revise(self, before: FloatArray, sd: FloatArray) -> None:
        """Believe the rig's constants to be known to `sd`, no longer to `before`; one-sigmas.

        The damping measures their steps by it too: by what was all but certain it would hold what is open now.
        """
        nowhere, matrix = np.zeros(CONSTANTS), np.zeros((CONSTANTS, CONSTANTS))
        matrix[RIG, RIG] = np.diag(sd**-2.0 - before**-2.0)
        self._scale = self._scale.copy()
        self._scale[RIG] = sd
        change = Factor(nowhere, 0.0, matrix, nowhere, self._scale)
        self.learn(change)
        self._revised = change if self._revised is None else self._revised.plus(change)

    def known(self, p: FloatArray) -> Factor:
        """What all of this says of the constants and of the last node, expanded at `p`; the prior included."""
        return self._forward(p)[-1]

    def information(self, p: FloatArray) -> Factor:
        """What all of this says of the constants without the prior, expanded at `p`."""
        return self.known(p).marginalised(_NODE).minus(self.prior(p))

    def prior(self, p: FloatArray) -> Factor:
        """What was believed of the constants beforehand, expanded at `p`."""
        prior = replace(marginal_of_constants(self._prior, p), scale=self._scale)
        return prior if self._revised is None else prior.plus(self._revised)

    def renew(self, p: FloatArray, x: FloatArray) -> int:
        """Linearise anew what is too far from the constants `p` and the last node `x`; how many segments that were.

        The latest first: theirs are the readings about the part of the outline where the motion is. Where the readings
        cannot be solved for the nodes over there, what was linearised before stays: its minimum is known.
        """
        ends = self._ends(p, x)
        stale = [i for i, segment in enumerate(self._segments) if not segment.near(ends[i])]
        for i in stale[::-1][:RELINEARISED]:
            segment = self._segments[i]
            moved = segment.x.copy()
            moved[0], moved[-1] = ends[i][CONSTANTS:-NODE], ends[i][-NODE:]
            with suppress(np.linalg.LinAlgError):
                self._segments[i] = self._linearised(segment.record, Guess(moved, p), INNER_STEPS)
        return len(stale)

    def settle(self, p: FloatArray) -> FloatArray:
        """The constants that all of this tells, everything being linearised anew on the way there from `p`."""
        for _ in range(MOST_SETTLING):
            known = self.known(p)
            by = known.solved(known.side)
            p = p + by[:CONSTANTS]
            if not self.renew(p, known.about[_NODE] + by[_NODE]):
                break
        return p

    def _linearised(self, record: Record, guess: Guess, steps: int = 0) -> Segment:
        residuals = Residuals(self._library, record)
        now = residuals.linearised(guess, self._noise)
        for _ in range(steps):
            guess = Guess(guess.x + now.inner_step(), guess.p)
            now = residuals.linearised(guess, self._noise)
        return Segment(record, guess.x, now.summary(guess, self._scale))

    def _forward(self, p: FloatArray) -> list[Factor]:
        """What is known of (p, first node) of each segment before it, and of (p, last node) after all."""
        passed = [self._beginning(p)]
        for segment in self._segments:
            passed.append(_joined(passed[-1], segment, p).marginalised(_NODE))
        return passed

    def _beginning(self, p: FloatArray) -> Factor:
        first = self._segments[0].x[0] if self._segments else np.zeros(NODE)
        about = np.concatenate([p, first])
        at = (self._base or self._prior).terms(p, first)
        known = Factor(about, at.cost, at.matrix, at.side, self._scale)
        if self._learnt is None:
            return known
        learnt, matrix, side = self._learnt.moved(p), known.matrix.copy(), known.side.copy()
        matrix[:CONSTANTS, :CONSTANTS] += learnt.matrix
        side[:CONSTANTS] += learnt.side
        return Factor(about, known.cost + learnt.cost, matrix, side, known.scale)

    def _ends(self, p: FloatArray, x: FloatArray) -> list[FloatArray]:
        """(p, first node, last node) of each segment, given p and the last node of all."""
        ends: list[FloatArray] = []
        for known, segment in zip(self._forward(p)[-2::-1], reversed(self._segments), strict=True):
            both = _joined(known, segment, p)
            pull = both.side[_NODE] - both.matrix[_NODE, SIZE:] @ (x - both.about[SIZE:])
            first = both.about[_NODE] + np.linalg.solve(both.matrix[_NODE, _NODE], pull)
            ends.append(np.concatenate([p, first, x]))
            x = first
        return ends[::-1]

    def _fold(self) -> None:
        """Make the oldest segment part of what is known beforehand: its readings are forgotten, not what they told."""
        oldest = self._segments[0]
        p = oldest.summary.about[:CONSTANTS]
        self._base = _joined(self._beginning(p), oldest, p).marginalised(_NODE)
        self._learnt = None
        del self._segments[0]


def _joined(known: Factor, segment: Segment, p: FloatArray) -> Factor:
    """What is known before a segment and what the segment says, as one cost of (p, first node, last node)."""
    here = segment.summary.moved(np.concatenate([p, known.about[_NODE], segment.summary.about[SIZE:]]))
    matrix, side = here.matrix.copy(), here.side.copy()
    matrix[:SIZE, :SIZE] += known.matrix
    side[:SIZE] += known.side
    return Factor(here.about, known.cost + here.cost, matrix, side, known.scale)
