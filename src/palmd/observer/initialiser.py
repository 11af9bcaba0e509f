"""The search for an unknown object while its readings arrive; each result starts the next search. Not for the loop."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray
from palmd.model.smoothing import RIG, R
from palmd.observer.criticism import MOST_REVISIONS, RigBelief
from palmd.observer.data_segment import DataSegment
from palmd.observer.fixed_lag_smoother import LOST_S, OPEN_S, PATIENCE, Solution
from palmd.observer.noise import with_scatter
from palmd.observer.search import (
    AMBIGUOUS,
    LIVE_BUDGET,
    MOTIONS,
    SPACING_S,
    Attempt,
    Minima,
    Search,
    agree,
    is_implausible,
    misfit_reason,
    nothing_moves,
    rejection_reason,
)
from palmd.observer.smoother import Budget
from palmd.system.description import RigDescription
from palmd.system.reasons import NO_REASON, Code, Reason
from palmd.system.rig_constants import declared_exact

UNFOUND = Reason(Code.UNEXPLAINED, "nothing explains the readings")
LEAST_S = 1.0  # s of readings for the first search; on fewer the bank is as good
STILL_KEPT_S = 2.0  # s of readings kept while everything rests and the readings so far determine nothing
_ATTEMPTS = (Attempt(2.0, 3), Attempt(3.5, 4), Attempt(1.2, 8), Attempt(5.0, 4))
_ASYMMETRIES = (0.5, -0.5)  # initial values of unequal friction of the palms
_UNEQUAL = tuple(Attempt(seconds, 4, a) for seconds in (2.0, 3.5) for a in _ASYMMETRIES)
_FREE = (Attempt(2.0, 4, free=True), Attempt(3.5, 4, free=True))
SUFFICIENT_S = 6.0
"""Duration of readings (s). In simulation every hypothesis that alone explained a longer record was right; a confirmed
hypothesis is then handed to the fixed-lag smoother."""
ALONE_S = 12.0  # s of readings; a single hypothesis that predicted their end needs no confirmation by another search
CHALLENGE = 2.0  # growth factor of the record from one blind search to the next, until one repeats the confirmation
REACH_S = 2.0  # s of new readings in one step (choice: twice the fixed-lag smoother's: all readings are refitted)
STEADY_S = 3.0  # s of readings since the machine was last starved, after which earlier ones may be dropped
BANKS = 2  # in which a rival is searched (study 2026-12-01: three of six banks had starts near the right motion)
LONGEST_S, KEPT_S = 30.0, 15.0  # s of readings without any result, and how many of them are kept then
IN_VAIN, RENEWED_S = 2, 2.5
"""After `IN_VAIN` searches in a row that explain nothing, the latest `RENEWED_S` of readings are kept: longer records
start with a part that no search passes (study 2026-11-30, explorations 98305 and 563143372: object known again after 12
and 11 s instead of 31 and 23 s)."""


def attempts_for(rig: RigDescription) -> tuple[Attempt, ...]:
    """The sequence of blind searches; some start with unequal friction of the palms, if the rig allows it.

    The last ones are for rigs that differ from their description.
    """
    return _ATTEMPTS + _UNEQUAL * bool(rig.friction_sd) + _FREE


class Initialiser:
    """Search for one object; deterministic for a given seed and the same calls.

    If constants of the rig are uncertain, a wrong outline often explains a short record as well. Then a hypothesis is
    confirmed by a second blind search with the same result, by blind searches of a long record that find no rival, or
    by its prediction of the last second or more of one. If no constant is uncertain, on flat palms, it must be likelier
    than an object that turns with a palm or not at all. On a fixed hinge two confirmations are needed, by searches that
    start with unequal friction of either sign, and no rival may explain the readings nearly as well.
    """

    def __init__(self, rig: RigDescription, seed: int):
        """`seed`: for the starts of blind searches."""
        self._rig = rig
        self._seed = seed
        self._start: float | None = None
        self._known: Minima | None = None  # hypotheses that were kept after the last step
        self._belief = RigBelief.of(rig)
        self._challenge_s = 0.0
        self._exact = declared_exact(rig)
        self._rolls = False
        self._motions: tuple[FloatArray, tuple[int, ...]] | None = None  # that explained it, under which belief
        self._confirmations = self._challenges = 0
        self._rival_from = -math.inf  # time (s) of the last reading from which on a rival is searched again
        self._failed = self._failed_in_a_row = 0
        self._doubtful = True
        self.hypothesis: Solution | None = None  # the last that explained its readings, with or without rivals
        self.extension_failed = False  # the hypothesis could not be extended to the last readings
        self.unexplained = False  # the last readings, by any smooth outline
        self.cost_jumped = False  # the last readings are explained worse than those before
        self.needs_from = -float("inf")  # time (s) before which readings are not needed any more

    def search(self, segment: DataSegment, hint: FloatArray | None, budget: Budget | None = None) -> Solution | None:
        """The solution for the readings of `segment`; None while it is ambiguous or nothing explains them.

        `hint`: constants to which a live filter has converged, in any gauge. Readings are processed in steps of
        `REACH_S` until the `budget`, by default `LIVE_BUDGET`, is spent or the hypothesis can be handed to the
        fixed-lag smoother; the solution may end before the last reading.
        """
        budget = budget or Budget(LIVE_BUDGET)
        while True:
            known = self._known_until(segment)
            end = segment.start + SUFFICIENT_S if known is None else known + REACH_S
            if segment.end < end + LEAST_S:
                end = segment.end
            solution = self._step(segment.until(end), hint, segment.end, budget)
            if solution is None or end == segment.end or solution.end < end - SPACING_S:
                return solution
            if budget.left <= 0.0 or (self.confirmed and end - segment.start >= SUFFICIENT_S):
                return solution

    def _known_until(self, segment: DataSegment) -> float | None:
        """End of the readings of `segment` that the hypotheses explain (s); None without a hypothesis."""
        if self._known is None or segment.start != self._start:
            return None
        return segment.start + (len(self._known.record.t) - 1) * SPACING_S

    def _step(self, segment: DataSegment, hint: FloatArray | None, now: float, budget: Budget) -> Solution | None:
        """`search` in one step to the end of `segment`; `now`: time of the last of all readings (s)."""
        seconds = segment.lasts
        self.unexplained = self.extension_failed = False
        if seconds < LEAST_S:
            return None
        rig = with_scatter(self._rig, segment.pads)
        search = Search(segment, rig, PATIENCE, belief=self._belief, budget=budget)
        if nothing_moves(search.record) or (self._doubtful and search.rest_duration(segment.end) > STILL_KEPT_S):
            self.needs_from = segment.end - STILL_KEPT_S
            return None
        finding: Minima | None = None
        known = self._known_until(segment)
        self.cost_jumped = False
        if known is not None and self._known is not None:
            finding = self._resumed(search, self._known, budget)
            self.extension_failed = self._allows_trial and (finding is None or not search.covers(finding))
            if self.extension_failed:
                return None
            self.cost_jumped = finding is None or finding.jumps_from(self._known)
            if self.cost_jumped and self.confirmed and segment.end >= self._rival_from:
                finding = self._with_rival(search, finding, self._known)
            if finding is None and self.confirmed and now - known < LOST_S:
                return None  # one step that is hard to fit does not reject a confirmed hypothesis
        else:
            self._challenge_s, self._confirmations, self._rolls, self._motions = 0.0, 0, False, None
            self.hypothesis = None
        if finding is None and hint is not None and not self._exact:
            finding = search.from_constants(hint)
        if finding is None or (self._to_challenge(search, finding) and segment.end == now):
            search, finding = self._search_blindly(search, finding, hint, seconds)
        if finding is not None and not finding.fits[0].settled:
            finding = search.with_friction_discrepancy(finding)
        solution = None if finding is None else self._with_revised_rig(Solution(search, finding))
        before, self._start = self._known, segment.start
        self._known = None if solution is None else solution.finding
        doubts = UNFOUND if solution is None else rejection_reason(solution.finding.fits[0], solution.finding)
        self.unexplained = solution is None or is_implausible(solution.finding.fits[0], solution.finding.record)
        self._doubtful = bool(doubts) or self.unexplained
        if doubts in (NO_REASON, AMBIGUOUS) and not self.unexplained:
            self.hypothesis = solution
        elif self._allows_trial:
            self.extension_failed = True
            return None
        if self._doubtful and budget.left <= 0.0 and known is not None and now - known < LOST_S:
            self._known, self.unexplained = self._known or before, False
            return None  # the budget was spent: neither accepted nor rejected
        if self._doubtful:
            self._failed += seconds > _ATTEMPTS[0].seconds
            self.needs_from = max(self._useful_from(segment, doubts, now), self.needs_from)
            return None
        self._failed_in_a_row = 0
        if (
            solution is not None
            and known is not None
            and solution.end - known > LEAST_S
            and solution.lasts > SUFFICIENT_S
        ):
            self._confirmations += len(solution.finding.fits) == 1  # the only hypothesis, and it predicted the readings
        return solution

    def _resumed(self, search: Search, known: Minima, budget: Budget) -> Minima | None:
        """Extend the hypotheses to the last readings, with half the budget at most if a trial may come next."""
        guesses = [fit.guess for fit in known.fits]
        if not self._allows_trial:
            return search.deepened(search.resumed(guesses))
        half = Budget(min(budget.left, LIVE_BUDGET / 2))
        budget.left -= half.left
        search_half = search.with_budget(half)
        finding = search_half.deepened(search_half.resumed(guesses))
        budget.left += half.left
        return finding

    def _with_rival(self, search: Search, finding: Minima | None, known: Minima) -> Minima | None:
        """`finding`, which extends the hypotheses `known` badly or not at all, merged with a blind search's result.

        The end of their motion may be wrong. Filters that read all readings, with the friction assumed so far, have
        passed the place where fits of a growing window leave the right motion. After a search in vain, some new
        readings are awaited before the next.
        """
        asymmetry = float(known.fits[0].guess.p[RIG][R.FRICTION])
        rival, budget = None, Budget(LIVE_BUDGET)
        for _ in range(BANKS):
            self._seed += 1
            rival = rival or search.with_budget(budget).rival(asymmetry, self._seed)
        merged = search.merged(finding, rival)
        if merged is not None and not agree(finding, merged):
            self._confirmations, self._rolls = 0, False
        else:
            self._rival_from = search.segment.end + LEAST_S
        self.cost_jumped = merged is None or merged.jumps_from(known)
        return merged

    def _to_challenge(self, search: Search, finding: Minima) -> bool:
        """Whether a hypothesis that explains all readings has to be challenged by a blind search now."""
        due = (
            search.segment.lasts >= self._challenge_s
            or not self.confirmed
            or bool(misfit_reason(finding.fits[0], finding.record))
        )
        return due and search.covers(finding)

    def _useful_from(self, segment: DataSegment, doubts: Reason, now: float) -> float:
        """Time (s) before which readings do not help the next search, given the `doubts` about the last result."""
        seconds = now - segment.start
        # if the result is ambiguous, more readings will distinguish the rivals
        self._failed_in_a_row = 0 if doubts == AMBIGUOUS else self._failed_in_a_row + 1
        if self._failed_in_a_row >= IN_VAIN and seconds > _ATTEMPTS[1].seconds:
            self._failed_in_a_row = 0
            return now - RENEWED_S
        if self.unexplained and segment.start < segment.steady_since < now - STEADY_S:
            return segment.steady_since
        return now - KEPT_S if seconds > LONGEST_S else -math.inf

    def _search_blindly(
        self, search: Search, finding: Minima | None, hint: FloatArray | None, seconds: float
    ) -> tuple[Search, Minima | None]:
        """Merge `finding` with the result of a blind search of `seconds`; returns the search to continue with, too.

        Extending a window may lead into a minimum next to the right one; a blind search finds the latter.
        """
        attempt = self._attempt(finding is not None)
        self._seed += 1
        attempt = attempt._replace(seconds=min(attempt.seconds, seconds))
        if finding is None and attempt.free:
            search = search.with_belief(self._belief.suspended())
        budget = Budget(LIVE_BUDGET / 2)
        blind = search.with_budget(budget).blind(attempt, self._seed)
        if blind is None and budget.left <= 0.0 and finding is not None:
            return search, finding  # a search that was cut short is no evidence
        if blind is None and finding is None and hint is not None and self._exact:
            # expensive; on an exact rig its rival is an object that turns with a palm
            blind = search.from_constants(hint)
        merged = search.merged(finding, blind)
        again = self.confirmed and agree(finding, blind)
        self._confirmations = self._count_confirmations(finding, blind, merged, seconds)
        if merged is not None and self._exact and not self._rig.curved:
            merged = self._likeliest(search, merged)
        confirmed = again and self.confirmed and merged is not None and len(merged.fits) == 1
        self._challenge_s = math.inf if confirmed else CHALLENGE * seconds
        return search, merged

    def _likeliest(self, search: Search, finding: Minima) -> Minima:
        """As `Search.likeliest`, without motions that failed to explain an earlier part of the readings."""
        before, sd = self._motions, search.belief.sd
        motions = before[1] if before is not None and before[0] is sd else MOTIONS
        found = search.likeliest(finding, motions)
        self._rolls, self._motions = found.decided, (sd, found.motions)
        return found.finding

    def _attempt(self, found: bool) -> Attempt:
        """The next blind search; a hypothesis that was `found` is challenged by starts with unequal friction."""
        if found and self._rig.unequal_friction:
            self._challenges += 1
            return _UNEQUAL[self._challenges % len(_UNEQUAL)]
        attempts = attempts_for(self._rig)
        return attempts[self._failed % len(attempts)]

    def _count_confirmations(
        self, finding: Minima | None, blind: Minima | None, merged: Minima | None, seconds: float
    ) -> int:
        """Number of blind searches that confirmed `finding`: found it again, or found only worse minima.

        A blind search without result says little about a short record; of a long one it says that there is no rival.
        """
        if not self._rig.unequal_friction:
            alone = blind is None and merged is not None and len(merged.fits) == 1 and seconds > ALONE_S
            return int(agree(finding, blind) or ((alone or self._confirmations > 0) and agree(finding, merged)))
        if merged is None or not agree(finding, merged):
            return 0
        return self._confirmations + (len(merged.fits) == 1 and (blind is not None or seconds > SUFFICIENT_S))

    @property
    def confirmed(self) -> bool:
        """Whether the last solution is confirmed."""
        if self._exact:
            return self._rolls or self._rig.curved
        return self._confirmations >= (len(_ASYMMETRIES) if self._rig.unequal_friction else 1)

    @property
    def _allows_trial(self) -> bool:
        """Whether a hypothesis that cannot be extended is smoothed on trial (decision 82), instead of a new search.

        Not on an exactly known rig nor with unequal friction of the palms: there searches decide.
        """
        known = self.hypothesis
        return known is not None and not self._exact and not self._rig.unequal_friction and known.lasts > OPEN_S

    def _with_revised_rig(self, solution: Solution) -> Solution:
        """The solution after the belief in the rig has been revised by the readings."""
        for _ in range(MOST_REVISIONS):
            search, finding = solution.search, solution.finding
            if rejection_reason(finding.fits[0], finding):
                break
            self._belief = solution.with_correlated_errors().belief
            if np.array_equal(self._belief.sd, search.belief.sd):
                break
            revised = search.with_belief(self._belief)
            found = revised.resumed([self._belief.within(fit.guess) for fit in finding.fits])
            if found is None:
                self._belief = search.belief
                break
            solution = Solution(revised, found)
        return solution
