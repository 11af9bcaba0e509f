"""All readings of one object as information about its constants: a chain of marginalised segments.

A record is cut into segments of some seconds. Each segment contributes its cost as a function of (p, first node, last
node), with the nodes in between marginalised. The segments are added up in order of time, and the nodes between them
are marginalised too, which leaves the information about p and the last node. A segment keeps its readings and is
relinearised when the constants have moved; the oldest segments are permanently marginalised into one quadratic cost.
Information only grows, while memory and time stay bounded. Not for use inside the loop.
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
from palmd.observer.smoother import NEGLIGIBLE

SEGMENT_S = 2.0
READINGS_KEPT = 60  # segments whose readings are kept: two minutes
RELINEARISED = 12  # segments relinearised in one call at most, which bounds the cost of an estimate
NEAR = 2.0  # squared Mahalanobis distance, by a segment's own readings, by which p and its ends may move
INNER_STEPS = 6
"""Newton steps of a segment's nodes after its ends and the constants have moved, at most (study 2026-12-01, two
explorations in MuJoCo: 6 of 108 relinearisations converge within 4, 10 of 106 within 10)."""
MOST_SETTLING = 6  # iterations after the prior of the rig has changed
_NODE = slice(CONSTANTS, SIZE)


@dataclass(frozen=True, slots=True)
class Segment:
    """Some seconds of readings, and their cost linearised about one trajectory and one set of constants."""

    record: Record
    x: FloatArray
    summary: Factor

    def near(self, ends: FloatArray) -> bool:
        """Whether its linearisation holds at (p, first node, last node), in units of its own readings' covariance."""
        difference = ends - self.summary.about
        return float(difference @ self.summary.matrix @ difference) < NEAR


class Chain:
    """Segments in order of time; each begins with the last node of the one before."""

    def __init__(self, library: Library, noise: ProcessNoise, prior: Knowledge, kept: int = READINGS_KEPT):
        """`prior`: of the constants and the very first node; `kept`: number of segments that keep their readings."""
        self._library = library
        self._noise = noise
        self._prior = prior
        self._scale = prior.scale
        self._base: Factor | None = None  # marginalised segments and the prior
        self._learnt: Factor | None = None
        self._revised: Factor | None = None  # accumulated change of the prior of the rig's constants
        self._kept = kept
        self._segments: list[Segment] = []

    def append(self, record: Record, guess: Guess) -> None:
        """Append a segment of two steps or more, already smoothed to `guess`."""
        equations = Residuals(self._library, record).linearised(guess, self._noise)
        self._segments.append(Segment(record, guess.x, equations.summary(guess, self._scale)))
        while len(self._segments) > self._kept:
            self._marginalise_oldest()

    def learn(self, information: Factor) -> None:
        """Add information about the constants from other readings."""
        self._learnt = information if self._learnt is None else self._learnt.plus(information)

    def revise(self, before: FloatArray, sd: FloatArray) -> None:
        """Change the prior of the rig's constants from standard deviations `before` to `sd`.

        The damping scales their steps by `sd` too; the old, smaller scale would hold constants that may now move.
        """
        nowhere, matrix = np.zeros(CONSTANTS), np.zeros((CONSTANTS, CONSTANTS))
        matrix[RIG, RIG] = np.diag(sd**-2.0 - before**-2.0)
        self._scale = self._scale.copy()
        self._scale[RIG] = sd
        change = Factor(nowhere, 0.0, matrix, nowhere, self._scale)
        self.learn(change)
        self._revised = change if self._revised is None else self._revised.plus(change)

    def known(self, p: FloatArray) -> Factor:
        """Information about the constants and the last node, expanded at `p`; the prior included."""
        return self._forward(p)[-1]

    def information(self, p: FloatArray) -> Factor:
        """Information about the constants, expanded at `p`; the prior excluded."""
        return self.known(p).marginalised(_NODE).minus(self.prior(p))

    def prior(self, p: FloatArray) -> Factor:
        """The prior of the constants, expanded at `p`."""
        prior = replace(marginal_of_constants(self._prior, p), scale=self._scale)
        return prior if self._revised is None else prior.plus(self._revised)

    def renew(self, p: FloatArray, x: FloatArray) -> int:
        """Relinearise segments that are too far from the constants `p` and the last node `x`; returns their number.

        The latest first: their readings are about the part of the outline where the motion is. A segment keeps its
        previous linearisation where its nodes do not converge, or to a less likely motion.
        """
        ends, renewed = self._ends(p, x), 0
        stale = [i for i, segment in enumerate(self._segments) if not segment.near(ends[i])]
        for i in stale[::-1][:RELINEARISED]:
            with suppress(np.linalg.LinAlgError):
                self._segments[i] = self._moved(self._segments[i], ends[i])
                renewed += 1
        return renewed

    def settle(self, p: FloatArray) -> FloatArray:
        """The estimate of the constants, iterated from `p` with relinearisation."""
        for _ in range(MOST_SETTLING):
            known = self.known(p)
            step = known.solved(known.side)
            p = p + step[:CONSTANTS]
            if not self.renew(p, known.about[_NODE] + step[_NODE]):
                break
        return p

    def _moved(self, segment: Segment, ends: FloatArray) -> Segment:
        """The segment, linearised at other (p, first node, last node) with its nodes at the minimum of the cost.

        Raises LinAlgError where the nodes do not converge, or to a less likely motion.
        """
        residuals, before = Residuals(self._library, segment.record), segment.summary
        equations = residuals.linearised(Guess(segment.x, before.about[:CONSTANTS]), self._noise)
        x, still = segment.x + equations.inner_step(ends - before.about), np.zeros_like(ends)
        for _ in range(INNER_STEPS):
            guess = Guess(x, ends[:CONSTANTS])
            equations = residuals.linearised(guess, self._noise)
            step = equations.inner_step(still)
            if equations.node_side @ step.ravel() < NEGLIGIBLE:
                summary = equations.summary(guess, self._scale)
                if summary.cost > before.cost + NEAR:
                    raise np.linalg.LinAlgError("the motion is less likely")
                return Segment(segment.record, x, summary)
            x = x + step
        raise np.linalg.LinAlgError("the nodes do not converge")

    def _forward(self, p: FloatArray) -> list[Factor]:
        """Information about (p, first node) of each segment from all before it, and about (p, last node) from all."""
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

    def _marginalise_oldest(self) -> None:
        """Marginalise the oldest segment into the base: its readings are dropped, their information is kept."""
        oldest = self._segments[0]
        p = oldest.summary.about[:CONSTANTS]
        self._base = _joined(self._beginning(p), oldest, p).marginalised(_NODE)
        self._learnt = None
        del self._segments[0]


def _joined(known: Factor, segment: Segment, p: FloatArray) -> Factor:
    """The information before a segment plus the segment's, as one cost of (p, first node, last node)."""
    here = segment.summary.moved(np.concatenate([p, known.about[_NODE], segment.summary.about[SIZE:]]))
    matrix, side = here.matrix.copy(), here.side.copy()
    matrix[:SIZE, :SIZE] += known.matrix
    side[:SIZE] += known.side
    return Factor(here.about, known.cost + here.cost, matrix, side, known.scale)
