"""Fixed-lag smoother of a known object: a trajectory of the latest readings, marginalised information of all older.

The open part, i.e. the readings that are in no segment of the chain yet, is smoothed again with each update; as it
grows, its oldest readings are closed, i.e. become segments of the chain. Information from earlier contacts with the
same object can join the chain. Not for use inside the loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palmd.model.friction import FRICTION_ERROR_S
from palmd.model.smoothing import C
from palmd.observer.chain import SEGMENT_S, Chain
from palmd.observer.coverage import marks_of
from palmd.observer.criticism import RigBelief
from palmd.observer.data_segment import DataSegment
from palmd.observer.matching import ObjectInformation, matched
from palmd.observer.normal_equations import Guess
from palmd.observer.outline import contact_normals
from palmd.observer.search import LIVE_BUDGET, PLACED_S, SPACING_S, Minima, Search, explained
from palmd.observer.smoother import Budget, Posterior, evidence_of

PATIENCE = 6
"""Windows that may fail before an object is given up (study 2026-11-29, simulated explorations 70011 to 70018: with 2,
objects were lost whose motion the model explains)."""
LEAST_S = 1.0  # s of readings at the end of a segment that are worth an iteration
OPEN_S = 1.5  # s of the latest readings at least that are in no segment
REACH_S = 1.0  # s of new readings in one step (choice: half a segment)
LOST_S = 6.0  # s of unexplained readings after which the object is lost and a new search starts
TAIL_S = 0.5  # s of readings dropped before a loss, in which the object may have been held by hand


@dataclass(frozen=True)
class Solution:
    """Minima of a search, with the search that found them."""

    search: Search
    finding: Minima

    @property
    def end(self) -> float:
        """The time of the last explained reading (s); the search may have had later ones."""
        return float(self.finding.record.t[-1])

    @property
    def lasts(self) -> float:
        """Duration of the explained readings (s)."""
        return self.end - self.search.segment.start

    @property
    def contradicts_friction(self) -> bool:
        """Whether the motion needs larger errors of the friction law than one of 1σ in each `FRICTION_ERROR_S`."""
        record = self.finding.record
        return self.finding.fits[0].process_cost > float(record.t[-1] - record.t[0]) / FRICTION_ERROR_S

    def with_correlated_errors(self, alone: bool = False) -> Solution:
        """As `Search.with_correlated_errors`; without rivals."""
        record, fit = self.search.with_correlated_errors(self.finding.record, self.finding.fits[0], alone)
        return Solution(self.search, Minima(record, (fit,), self.finding.work))

    @cached_property
    def posterior(self) -> Posterior | None:
        """The posterior of the best fit under the search's prior; None if it is not a minimum."""
        return self.search.smoother(self.finding.record).posterior_if_any(self.finding.fits[0])

    @cached_property
    def belief(self) -> RigBelief:
        """The search's belief in the rig, revised by the posterior."""
        return self.search.belief.after(self.posterior)


def _likelier(one: Solution | None, other: Solution | None) -> Solution | None:
    """The solution that explains more readings, or the same with more evidence; None if there is neither."""
    if one is None or other is None:
        return one or other
    return max(one, other, key=lambda each: (round(each.end / SPACING_S), evidence_of(each.posterior)))


@dataclass(frozen=True, slots=True)
class _Open:
    """The smoothed trajectory of the latest readings.

    `resting_since`: since when the palms were at rest at `start` (s), inf if they were not.
    """

    start: float
    guess: Guess
    resting_since: float

    @property
    def end(self) -> float:
        """The time of its last node (s)."""
        return self.start + (len(self.guess.x) - 1) * SPACING_S


class FixedLagSmoother:
    """Smoother of one object while it is on the palms; deterministic, and each call takes bounded time.

    `touched`: normals that have been in contact. `lost`: the readings contradict the estimate. `psi`: ψ (rad) at the
    last contact, NaN before `end`.
    """

    def __init__(self, solution: Solution):
        """Start from a `solution` of the readings so far."""
        self._rig = solution.search.rig
        self._chain = Chain(solution.search.library, solution.search.noise, solution.search.known)
        self._belief = solution.search.belief
        self._most_forces = solution.search.segment.most_forces
        finding = solution.finding
        record = solution.search.smoother(finding.record).with_predicted_forces(finding.fits[0].guess)
        solution = replace(solution, finding=replace(finding, record=record)).with_correlated_errors()
        self._closed = self.touched = marks_of(np.zeros((0, 2)))
        self.lost = False
        self.psi = math.nan
        self._update_open(solution)

    @property
    def needs_from(self) -> float:
        """Time (s) before which readings are not needed any more."""
        return self._open.start

    def smoothed(self, segment: DataSegment) -> Solution | None:
        """The estimate with the readings of `segment`, as far as the budget allows; None while they are not explained.

        Readings are processed in steps of `REACH_S`, so that the open part stays short and the work is proportional to
        their number. After a step that is rejected the next one is twice as long.
        """
        self._most_forces = tuple(map(max, self._most_forces, segment.most_forces))
        budget, reach, end_before = Budget(LIVE_BUDGET), REACH_S, self._open.end
        latest: Solution | None = None
        while True:
            end = self._open.end + reach
            if segment.end < end + REACH_S / 2:
                end = segment.end
            solution = self._step(segment.until(end), budget)
            latest = solution or latest
            if end == segment.end or budget.left <= 0.0:
                self.lost = self._open.end <= end_before and segment.end - self._open.start > LOST_S
                # a step that was cut short contradicts nothing
                return solution if budget.left > 0.0 else latest
            reach = 2.0 * reach if solution is None else REACH_S

    def _step(self, segment: DataSegment, budget: Budget) -> Solution | None:
        solution = self._smoothed(segment, self._open.guess, budget)
        if solution is None:
            return None
        guess = solution.finding.fits[0].guess
        if self._chain.renew(guess.p, guess.x[0]):
            solution = self._smoothed(segment, guess, budget) or solution
        revised = self._revised_guess(solution)
        if revised is not None:
            solution = self._smoothed(segment, revised, budget) or solution
        self._update_open(solution)
        return solution

    def join(self, archive: Sequence[ObjectInformation], turn: float | None = None) -> ObjectInformation | None:
        """Add the first entry of `archive` that is certainly of the same object to the chain; returns that entry.

        turn (rad): by how much ψ is larger here, if the object is known to be the same; else the evidence decides.
        Entries whose linearisation is too far away to be compared are skipped.
        """
        now = self.summary()
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
        """Close all readings after the object has been taken away; `last` are its last readings."""
        guess = self._open.guess
        if last.end - TAIL_S > self._open.start + LEAST_S:
            solution = self._smoothed(last.until(last.end - TAIL_S), guess, Budget(LIVE_BUDGET))
            if solution is not None:
                guess = solution.finding.fits[0].guess
                self._close(solution, 0, len(solution.finding.record.dt))
        search = self._search(last, guess, Budget())
        if len(search.record.t) >= len(guess.x):
            guess = search.smoother(search.record).completed(guess)
        self.psi = float(guess.x[-1, 0])

    def summary(self) -> ObjectInformation:
        """The chain's information about the object, with the normals touched in it."""
        return ObjectInformation(self._chain.information(self._open.guess.p), self._closed)

    def _revised_guess(self, solution: Solution) -> Guess | None:
        """A new initial guess if the readings changed the belief in the rig; None if they did not."""
        fit = solution.finding.fits[0]
        before = self._belief
        self._belief = solution.belief
        if np.array_equal(self._belief.sd, before.sd):
            return None
        self._chain.revise(before.sd, self._belief.sd)
        return replace(fit.guess, p=self._chain.settle(self._belief.within(fit.guess).p))

    def _smoothed(self, segment: DataSegment, guess: Guess, budget: Budget) -> Solution | None:
        """A solution that explains the readings; None if there is none.

        Where the motion known so far leads to none, or to one that contradicts the law of friction, its end may be
        wrong: then the motion is found again from its beginning.
        """
        solution = self._fitted(segment, guess, budget)
        if budget.left > 0.0 and (solution is None or solution.contradicts_friction):
            beginning = Guess(guess.x[: round(PLACED_S / SPACING_S)], guess.p)
            solution = _likelier(solution, self._fitted(segment, beginning, budget))
        if solution is None:
            return None
        solution = solution.with_correlated_errors()
        return solution if explained(solution.finding.fits[0], solution.finding.record) else None

    def _fitted(self, segment: DataSegment, guess: Guess, budget: Budget) -> Solution | None:
        """A minimum that explains the readings, without correlated errors; None if there is none."""
        search = self._search(segment, guess, budget)
        finding = search.resumed([Guess(guess.x[: len(search.record.t)], guess.p)], predict_forces=True, strict=False)
        # resting palms are no reason to reject a solution here
        if finding is None or not finding.fits[0].settled or not explained(finding.fits[0], finding.record):
            return None
        return Solution(search, finding)

    def _search(self, segment: DataSegment, guess: Guess, budget: Budget) -> Search:
        """A search of the open part up to the end of `segment`, with the chain's information as prior."""
        return Search(
            segment, self._rig, PATIENCE, self._chain.known(guess.p), self._open.start, self._open.resting_since,
            self._belief, self._most_forces, budget,
        )  # fmt: skip

    def _update_open(self, solution: Solution) -> None:
        """Move readings older than `OPEN_S` into the chain; the rest becomes the open part."""
        record, guess = solution.finding.record, solution.finding.fits[0].guess
        dt = float(record.dt[0])
        first, each = 0, round(SEGMENT_S / dt)
        while (len(record.dt) - first) * dt >= SEGMENT_S + OPEN_S:
            self._close(solution, first, first + each)
            first += each
        start = float(record.t[first])
        rested = solution.search.rest_duration(start)
        self._open = _Open(start, Guess(guess.x[first:], guess.p), start - rested if rested else math.inf)
        self.touched = self._closed | marks_of(contact_normals(record, guess.x[:, 0], guess.p[C.SHAPE :])[first:])

    def _close(self, solution: Solution, first: int, last: int) -> None:
        """Append the steps from node `first` to node `last` to the chain as a segment."""
        guess = solution.finding.fits[0].guess
        record = solution.finding.record.between(first, last)
        nodes = guess.x[first : last + 1]
        self._chain.append(record, Guess(nodes, guess.p))
        self._closed = self._closed | marks_of(contact_normals(record, nodes[:, 0], guess.p[C.SHAPE :]))
