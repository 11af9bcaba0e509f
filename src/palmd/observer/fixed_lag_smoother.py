"""A known object, smoothed on: the latest readings by their trajectory, everything older as a chain of information.

What is open, i.e. in no segment of the chain yet, is smoothed again with each answer, and its start is closed as it
grows. What was felt of the same object before it was taken away joins the chain. Not for use inside the loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palmd.model.smoothing import C
from palmd.observer.chain import SEGMENT_S, Chain
from palmd.observer.coverage import marks_of
from palmd.observer.criticism import RigBelief
from palmd.observer.data_segment import DataSegment
from palmd.observer.matching import ObjectInformation, matched
from palmd.observer.normal_equations import Guess
from palmd.observer.outline import contact_normals
from palmd.observer.pad_map import with_shared_errors
from palmd.observer.search import GRADUATED_ITERATIONS, LIVE_BUDGET, SPACING_S, Minima, Search, explained
from palmd.observer.smoother import Budget, Posterior

PATIENCE = 6
"""Windows that may fail before an object is given up (study 2026-11-29, simulated explorations 70011 to 70018: with 2,
objects were lost whose motion the model explains)."""
LEAST_S = 1.0  # of readings at the end of a segment that are worth an iteration
OPEN_S = 1.5  # of the latest readings at least that no segment holds
REACH_S = 1.0  # of new readings in one step (choice: half a segment)
LOST_S = 6.0  # of readings that what is known does not explain, after which the object is sought anew
TAIL_S = 0.5  # before an object was lost: it may have been held already


@dataclass(frozen=True)
class Answer:
    """What was found, and the search that found it."""

    search: Search
    finding: Minima

    @property
    def end(self) -> float:
        """The time of the last explained reading (s); the search may have had later ones."""
        return float(self.finding.record.t[-1])

    @property
    def lasts(self) -> float:
        """For how long the readings are explained (s)."""
        return self.end - self.search.segment.start

    @cached_property
    def posterior(self) -> Posterior | None:
        """How sure the best fit is of itself, by what the search went by; None where it is no minimum."""
        return self.search.smoother(self.finding.record).posterior_if_any(self.finding.fits[0])

    @cached_property
    def belief(self) -> RigBelief:
        """What is left of the search's belief in the rig."""
        return self.search.belief.after(self.posterior)


@dataclass(frozen=True, slots=True)
class _Open:
    """The smoothed trajectory of the latest readings.

    `resting_since`: since when the palms have rested at `start`, inf when they have not.
    """

    start: float
    guess: Guess
    resting_since: float

    @property
    def end(self) -> float:
        """The time of its last node (s)."""
        return self.start + (len(self.guess.x) - 1) * SPACING_S


class FixedLagSmoother:
    """One object while it is on the palms; deterministic, and each call takes bounded time.

    `touched`: on which normals. `lost`: the readings contradict what is known. `psi`: ψ (rad) when it was last
    felt, NaN before `end`.
    """

    def __init__(self, found: Answer):
        """`found` has the readings so far."""
        self._rig = found.search.rig
        self._chain = Chain(found.search.library, found.search.noise, found.search.known)
        self._belief = found.search.belief
        self._most_forces = found.search.segment.most_forces
        finding = found.finding
        record = found.search.smoother(finding.record).with_predicted_forces(finding.fits[0].guess)
        found = _weighed(replace(found, finding=replace(finding, record=record)))
        self._closed = self.touched = marks_of(np.zeros((0, 2)))
        self.lost = False
        self.psi = math.nan
        self._go_on(found)

    @property
    def needs_from(self) -> float:
        """Earlier readings are of no use any more (s)."""
        return self._open.start

    def smoothed(self, segment: DataSegment) -> Answer | None:
        """The estimate with the readings of `segment`, as far as the budget allows; None while they are not explained.

        Readings are processed in steps of `REACH_S`, so that the open part stays short and the work is proportional to
        their number. After a step that is rejected the next one is twice as long.
        """
        self._most_forces = tuple(map(max, self._most_forces, segment.most_forces))
        budget, reach, begun = Budget(LIVE_BUDGET), REACH_S, self._open.end
        while True:
            end = self._open.end + reach
            if segment.end < end + REACH_S / 2:
                end = segment.end
            answer = self._gone_on(segment.until(end), budget)
            if end == segment.end or budget.left <= 0.0:
                self.lost = self._open.end <= begun and segment.end - self._open.start > LOST_S
                return answer
            reach = 2.0 * reach if answer is None else REACH_S

    def _gone_on(self, segment: DataSegment, budget: Budget) -> Answer | None:
        answer = self._smoothed(segment, self._open.guess, budget)
        if answer is None:
            return None
        guess = answer.finding.fits[0].guess
        if self._chain.renew(guess.p, guess.x[0]):
            answer = self._smoothed(segment, guess, budget) or answer
        likely = self._revised(answer)
        if likely is not None:
            answer = self._smoothed(segment, likely, budget) or answer
        self._go_on(answer)
        return answer

    def join(self, archive: Sequence[ObjectInformation], turn: float | None = None) -> ObjectInformation | None:
        """Join the first of what was felt before that is of the same object beyond doubt; which that was.

        turn (rad): by which its ψ is known to be larger here, of the same object; else the evidence decides. What was
        linearised too far away to be weighed is of no object beyond doubt.
        """
        now = self.felt()
        for known in archive:
            try:
                found = matched(known, now, self._chain.prior(self._open.guess.p), turn)
            except np.linalg.LinAlgError:
                continue
            if found is not None:
                self._chain.learn(found.aligned.information)
                self._closed = self._closed | found.aligned.touched
                self.touched = self.touched | found.aligned.touched
                return known
        return None

    def end(self, last: DataSegment) -> None:
        """The object has been taken away; `last` are its last readings."""
        guess = self._open.guess
        if last.end - TAIL_S > self._open.start + LEAST_S:
            answer = self._smoothed(last.until(last.end - TAIL_S), guess, Budget(LIVE_BUDGET))
            if answer is not None:
                guess = answer.finding.fits[0].guess
                self._close(answer, 0, len(answer.finding.record.dt))
        search = self._search(last, guess, Budget())
        if len(search.record.t) >= len(guess.x):
            guess = search.smoother(search.record).completed(guess)
        self.psi = float(guess.x[-1, 0])

    def felt(self) -> ObjectInformation:
        """What the chain tells of the object."""
        return ObjectInformation(self._chain.information(self._open.guess.p), self._closed)

    def _revised(self, answer: Answer) -> Guess | None:
        """From where to go on when the readings tell that the rig is not what it is taken for; None when they don't."""
        fit = answer.finding.fits[0]
        before = self._belief
        self._belief = answer.belief
        if np.array_equal(self._belief.sd, before.sd):
            return None
        self._chain.revise(before.sd, self._belief.sd)
        return replace(fit.guess, p=self._chain.settle(self._belief.within(fit.guess).p))

    def _smoothed(self, segment: DataSegment, guess: Guess, budget: Budget) -> Answer | None:
        """What explains the readings; None where nothing does."""
        search = self._search(segment, guess, budget)
        finding = search.resumed([Guess(guess.x[: len(search.record.t)], guess.p)], predict_forces=True, strict=False)
        # palms at rest are no reason for doubt here
        if finding is None or not finding.fits[0].settled or not search.explained(finding.fits[0], finding.record):
            return None
        answer = _weighed(Answer(search, finding))
        return answer if explained(answer.finding.fits[0], answer.finding.record) else None

    def _search(self, segment: DataSegment, guess: Guess, budget: Budget) -> Search:
        """The open part up to the end of `segment`, by all that the chain says."""
        return Search(
            segment, self._rig, PATIENCE, self._chain.known(guess.p), self._open.start, self._open.resting_since,
            self._belief, self._most_forces, budget, math.inf,
        )  # fmt: skip

    def _go_on(self, answer: Answer) -> None:
        """What is older than `OPEN_S` becomes part of the chain, the rest is open."""
        record, guess = answer.finding.record, answer.finding.fits[0].guess
        dt = float(record.dt[0])
        first, each = 0, round(SEGMENT_S / dt)
        while (len(record.dt) - first) * dt >= SEGMENT_S + OPEN_S:
            self._close(answer, first, first + each)
            first += each
        start = float(record.t[first])
        rested = answer.search.rest_duration(start)
        self._open = _Open(start, Guess(guess.x[first:], guess.p), start - rested if rested else math.inf)
        self.touched = self._closed | marks_of(contact_normals(record, guess.x[:, 0], guess.p[C.SHAPE :])[first:])

    def _close(self, answer: Answer, first: int, last: int) -> None:
        """The steps from node `first` to node `last` become a segment."""
        guess = answer.finding.fits[0].guess
        record = answer.finding.record.between(first, last)
        nodes = guess.x[first : last + 1]
        self._chain.append(record, Guess(nodes, guess.p))
        self._closed = self._closed | marks_of(contact_normals(record, nodes[:, 0], guess.p[C.SHAPE :]))


def _weighed(answer: Answer) -> Answer:
    """The same readings with errors of long correlation, as covariances need them, fitted anew.

    The law of friction and the pads' errors of place are off in the same way for many readings in a row. The fit that
    decides whether the readings are explained must not include this: nearly every fit would pass.
    """
    search, best = answer.search, answer.finding.fits[0]
    record = search.smoother(answer.finding.record).with_discrepancy(best.guess)
    record = with_shared_errors(record, search.rig)
    fit = search.smoother(record).fit(best.guess, best.noise, GRADUATED_ITERATIONS)
    return Answer(search, Minima(record, (fit,), answer.finding.work))
