"""The search for an unknown object while its readings come in: each answer starts the next. Not for the loop."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray
from palmd.observer.criticism import MOST_REVISIONS, RigBelief
from palmd.observer.data_segment import DataSegment
from palmd.observer.fixed_lag_smoother import LOST_S, OPEN_S, PATIENCE, Solution
from palmd.observer.noise import with_scatter
from palmd.observer.normal_equations import Guess
from palmd.observer.search import (
    AMBIGUOUS,
    LIVE_BUDGET,
    MOTIONS,
    SPACING_S,
    Attempt,
    Minima,
    Search,
    agree,
    doubt,
    far_fetched,
    still,
    unfit,
)
from palmd.observer.smoother import Budget
from palmd.system.description import RigDescription
from palmd.system.rig_constants import declared_exact

UNFOUND = "nothing explains the readings"
LEAST_S = 1.0  # of readings, before which the bank is as good
STILL_KEPT_S = 2.0  # of readings at rest, when those and what came before tell nothing
_ATTEMPTS = (Attempt(2.0, 3), Attempt(3.5, 4), Attempt(1.2, 8), Attempt(5.0, 4))
_BEGUN = (0.5, -0.5)  # with palms that rub so unequally
_UNEQUAL = tuple(Attempt(seconds, 4, a) for seconds in (2.0, 3.5) for a in _BEGUN)
_FREE = (Attempt(2.0, 4, free=True), Attempt(3.5, 4, free=True))
SUFFICIENT_S = 6.0
"""Of readings. In simulation every hypothesis that was the only one to explain longer records was right; once
confirmed, it is handed to the follower."""
ALONE_S = 12.0  # of readings: what foretold their end, and alone explains them, need not be found again
CHALLENGE = 2.0  # by how much the record grows from one blind search to the next, until one confirms what was sure
REACH_S = 2.0  # of new readings in one step (choice: twice the follower's, since all readings are fitted again)
STEADY_S = 3.0  # of readings since the machine was last starved, by which an object may be sought without those before
LONGEST_S, KEPT_S = 30.0, 15.0  # of readings in which nothing has been found, and that are kept then
IN_VAIN, RENEWED_S = 2, 2.5
"""After so many searches in a row that explain nothing, so much of the latest readings is kept: longer records begin
with what none of the searches passes (study 2026-11-30, explorations 98305 and 563143372: known again after 12 and
11 s, not after 31 and 23)."""


def attempts_for(rig: RigDescription) -> tuple[Attempt, ...]:
    """The blind searches one after the other; some begin with palms that rub unequally, where they may.

    The last are for rigs that are not what they are taken for.
    """
    return _ATTEMPTS + _UNEQUAL * bool(rig.friction_sd) + _FREE


class Initialiser:
    """Deterministic for a given seed and the same calls.

    Where constants of the rig are uncertain, a wrong outline often explains a short record as well. There a hypothesis
    is confirmed by a second blind search with the same result, by blind searches of a long record that find no rival,
    or by its prediction of the last second or more of one. Where none are, on flat palms, it must be likelier than an
    object that turns with a palm or not at all. On a fixed hinge two confirmations are needed, by searches that begin
    with unequal friction, one way and the other, and no rival may explain the readings nearly as well.
    """

    def __init__(self, rig: RigDescription, seed: int):
        """`seed` draws where blind searches start."""
        self._rig = rig
        self._seed = seed
        self._start: float | None = None
        self._guesses: tuple[Guess, ...] = ()
        self._belief = RigBelief.of(rig)
        self._challenge_s = 0.0
        self._exact = declared_exact(rig)
        self._rolls = False
        self._motions: tuple[FloatArray, tuple[int, ...]] | None = None  # that explained it, under which belief
        self._survived = self._challenges = 0
        self._failed = self._in_vain = 0
        self._doubtful = True
        self.hypothesis: Solution | None = None  # the last answer that explained its readings, with or without rivals
        self.stuck = False  # the search could not extend the hypothesis to the last readings
        self.unexplained = False  # the last readings, by any smooth outline
        self.needs_from = -float("inf")

    def sought(self, segment: DataSegment, hint: FloatArray | None, budget: Budget | None = None) -> Solution | None:
        """What the readings of `segment` tell; None while that is in doubt. `needs_from`: those before are useless.

        `hint`: constants that a live filter has settled on, in whatever gauge. Readings are processed in steps of
        `REACH_S` until the `budget`, by default `LIVE_BUDGET`, is spent or the hypothesis can be handed to the
        follower; the answer may be of an earlier time than the last reading.
        """
        budget = budget or Budget(LIVE_BUDGET)
        while True:
            known = self._known_until(segment)
            end = segment.start + SUFFICIENT_S if known is None else known + REACH_S
            if segment.end < end + LEAST_S:
                end = segment.end
            answer = self._sought(segment.until(end), hint, segment.end, budget)
            if answer is None or end == segment.end or answer.end < end - SPACING_S:
                return answer
            if budget.left <= 0.0 or (self.sure and end - segment.start >= SUFFICIENT_S):
                return answer

    def _known_until(self, segment: DataSegment) -> float | None:
        """End of the readings of `segment` that the hypotheses explain (s); None where there is no hypothesis."""
        if not self._guesses or segment.start != self._start:
            return None
        return segment.start + (len(self._guesses[0].x) - 1) * SPACING_S

    def _sought(
        self,
        segment: DataSegment,
        hint: FloatArray | None,
        now: float,
        budget: Budget,
    ) -> Solution | None:
        """As `sought`, in one step to the end of `segment`; `now`: the time of the last reading of all (s)."""
        seconds = segment.lasts
        self.unexplained = self.stuck = False
        if seconds < LEAST_S:
            return None
        rig = with_scatter(self._rig, segment.pads)
        search = Search(segment, rig, PATIENCE, belief=self._belief, budget=budget)
        if still(search.record) or (self._doubtful and search.rested(segment.end) > STILL_KEPT_S):
            self.needs_from = segment.end - STILL_KEPT_S
            return None
        finding: Minima | None = None
        known = self._known_until(segment)
        if known is not None:
            finding = self._resumed(search, budget)
            self.stuck = self._tries and (finding is None or not search.covers(finding))
            if self.stuck:
                return None
            if finding is None and self.sure and now - known < LOST_S:
                return None  # one step that is hard to fit does not reject a confirmed hypothesis
        else:
            self._challenge_s, self._survived, self._rolls, self._motions = 0.0, 0, False, None
            self.hypothesis = None
        if finding is None and hint is not None and not self._exact:
            finding = search.placed(hint)
        if finding is None or (self._to_challenge(search, finding) and segment.end == now):
            search, finding = self._sought_blindly(search, finding, hint, seconds)
        if finding is not None and not finding.fits[0].settled:
            finding = search.doubted(finding)
        answer = None if finding is None else self._criticised(Solution(search, finding))
        before, self._start, self._guesses = self._guesses, segment.start, ()
        if answer is not None:
            self._guesses = tuple(fit.guess for fit in answer.finding.fits)
        doubts = UNFOUND if answer is None else doubt(answer.finding.fits[0], answer.finding)
        self.unexplained = answer is None or far_fetched(answer.finding.fits[0], answer.finding.record)
        self._doubtful = bool(doubts) or self.unexplained
        if doubts in {"", AMBIGUOUS} and not self.unexplained:
            self.hypothesis = answer
        elif self._tries:
            self.stuck = True
            return None
        if self._doubtful and budget.left <= 0.0 and known is not None and now - known < LOST_S:
            self._guesses, self.unexplained = self._guesses or before, False
            return None  # the budget was spent: neither accepted nor rejected
        if self._doubtful:
            self._failed += seconds > _ATTEMPTS[0].seconds
            self.needs_from = max(self._useful_from(segment, doubts, now), self.needs_from)
            return None
        self._in_vain = 0
        if answer is not None and known is not None and answer.end - known > LEAST_S and answer.lasts > SUFFICIENT_S:
            self._survived += len(answer.finding.fits) == 1  # the only one, and it predicted them
        return answer

    def _resumed(self, search: Search, budget: Budget) -> Minima | None:
        """Extend the hypotheses to the last readings; half the budget at most where a trial comes next."""
        if not self._tries:
            return search.resumed(self._guesses)
        half = Budget(min(budget.left, LIVE_BUDGET / 2))
        budget.left -= half.left
        finding = search.spending(half).resumed(self._guesses)
        budget.left += half.left
        return finding

    def _to_challenge(self, search: Search, finding: Minima) -> bool:
        """Whether a hypothesis that explains all readings is due for a challenge by a blind search."""
        due = search.segment.lasts >= self._challenge_s or not self.sure or bool(unfit(finding.fits[0], finding.record))
        return due and search.covers(finding)

    def _useful_from(self, segment: DataSegment, doubts: str, now: float) -> float:
        """Since when readings are of use for the next search (s), by what is doubted of the last one's answer."""
        seconds = now - segment.start
        self._in_vain = 0 if doubts == AMBIGUOUS else self._in_vain + 1  # more readings will tell rivals apart
        if self._in_vain >= IN_VAIN and seconds > _ATTEMPTS[1].seconds:
            self._in_vain = 0
            return now - RENEWED_S
        if self.unexplained and segment.start < segment.steady_since < now - STEADY_S:
            return segment.steady_since
        return now - KEPT_S if seconds > LONGEST_S else -math.inf

    def _sought_blindly(
        self, search: Search, finding: Minima | None, hint: FloatArray | None, seconds: float
    ) -> tuple[Search, Minima | None]:
        """What has been found, beside what a blind search of so many seconds finds; and the search to go on with.

        A window that has grown may have been led into a valley next to the right one.
        """
        attempt = self._attempt(finding is not None)
        self._seed += 1
        attempt = attempt._replace(seconds=min(attempt.seconds, seconds))
        if finding is None and attempt.free:
            search = search.believing(self._belief.suspended())
        budget = Budget(LIVE_BUDGET / 2)
        blind = search.spending(budget).blind(attempt, self._seed)
        if blind is None and budget.left <= 0.0 and finding is not None:
            return search, finding  # a search that was cut short is no evidence
        if blind is None and finding is None and hint is not None and self._exact:
            blind = search.placed(hint)  # dear, and what it is held against elsewhere are rides here
        merged = search.merged(finding, blind)
        again = self.sure and agree(finding, blind)
        self._survived = self._challenges_survived(finding, blind, merged, seconds)
        if merged is not None and self._exact and not self._rig.curved:
            merged = self._likeliest(search, merged)
        confirmed = again and self.sure and merged is not None and len(merged.fits) == 1
        self._challenge_s = math.inf if confirmed else CHALLENGE * seconds
        return search, merged

    def _likeliest(self, search: Search, finding: Minima) -> Minima:
        """As `Search.likeliest`, without the motions that have not explained what there was before."""
        before, sd = self._motions, search.belief.sd
        motions = before[1] if before is not None and before[0] is sd else MOTIONS
        found = search.likeliest(finding, motions)
        self._rolls, self._motions = found.decided, (sd, found.motions)
        return found.finding

    def _attempt(self, found: bool) -> Attempt:
        """The next blind search; what has been `found` is set against those that begin with unequal palms."""
        if found and self._rig.unequal_friction:
            self._challenges += 1
            return _UNEQUAL[self._challenges % len(_UNEQUAL)]
        attempts = attempts_for(self._rig)
        return attempts[self._failed % len(attempts)]

    def _challenges_survived(
        self, finding: Minima | None, blind: Minima | None, merged: Minima | None, seconds: float
    ) -> int:
        """In how many searches since what has been found it has been found again, or been better than what was.

        That one comes to nothing says little of a short record, and of a long one that it has no rival.
        """
        if not self._rig.unequal_friction:
            alone = blind is None and merged is not None and len(merged.fits) == 1 and seconds > ALONE_S
            return int(agree(finding, blind) or ((alone or self._survived > 0) and agree(finding, merged)))
        if merged is None or not agree(finding, merged):
            return 0
        return self._survived + (len(merged.fits) == 1 and (blind is not None or seconds > SUFFICIENT_S))

    @property
    def sure(self) -> bool:
        """Whether the last answer is one to vouch for."""
        if self._exact:
            return self._rolls or self._rig.curved
        return self._survived >= (len(_BEGUN) if self._rig.unequal_friction else 1)

    @property
    def _tries(self) -> bool:
        """Whether a hypothesis that cannot be extended is followed on trial (decision 82), not searched for again.

        Not on an exactly known rig nor with unequal friction of the palms: searches decide there.
        """
        known = self.hypothesis
        return known is not None and not self._exact and not self._rig.unequal_friction and known.lasts > OPEN_S

    def _criticised(self, answer: Solution) -> Solution:
        """What is found once the rig is taken for what the readings tell."""
        for _ in range(MOST_REVISIONS):
            search, finding = answer.search, answer.finding
            if doubt(finding.fits[0], finding):
                break
            self._belief = answer.belief
            if np.array_equal(self._belief.sd, search.belief.sd):
                break
            anew = search.believing(self._belief)
            found = anew.resumed([self._belief.within(fit.guess) for fit in finding.fits])
            if found is None:
                self._belief = search.belief
                break
            answer = Solution(anew, found)
        return answer
