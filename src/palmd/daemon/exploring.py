"""The loop's side of an exploration: asks where to go next, and lets the palms do what is answered. Pure.

The decisions come from elsewhere and may come late or never (`daemon.exploration_requests`). A move follows the one
before when that ends; the newest decision counts. Without a decision the palms stand. A move that has become unsafe,
or during which the estimate is lost, is stopped along its path and dropped.
"""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

from palmd.daemon.exploration_requests import ExplorationAnswer, ExplorationTask, Question, Source
from palmd.daemon.setpoints import SetPoints
from palmd.jsonvalues import or_none
from palmd.messages import Explored
from palmd.motion.decisions import UnderWay
from palmd.motion.exploration import Exploration
from palmd.motion.segments import Move

log = logging.getLogger(__name__)

ASK_S, AHEAD_S = 0.3, 0.7  # how often the next move is asked for, from so long before the end of the one in hand on
AHEAD_MOST_S = 3.0  # the same where decisions take so long
CHECK_S = 1.0  # how often before that, whether the one in hand is still safe
MORE_S = 0.5  # of standing for a decision, beyond which two moves are made of one
STALE_S = 10.0  # after which an answer is about the past, even if what it is to follow is still the last move
LEAD_S = 0.05  # before the end of a move, when the next one is settled
LOST_S = 0.5  # without knowing the object, after which a move is not gone on with
BLIND_S = 1.0  # of standing without knowing it, before the object is rocked
OVERTIME_S = 5.0  # after the time limit, for whoever decides to end it and say what is missing
SILENT_S = 2.0  # of standing with one, before it is said that no decision comes


class Senses(NamedTuple):
    """What is known at a tick: whether the palms may move by themselves, whether both pads are touched,
    whether the object is known well enough to foresee motions and which it is; `look` gets the outlook, which costs
    time. sticking: of an object that sticks, where its contacts are (m). cornered: whether a corner of it was felt."""

    tracking: bool
    touching: bool
    known: bool
    object_count: int
    look: Callable[[], object]
    sticking: tuple[float, ...] | None = None
    cornered: bool = False


class Explores(ABC):
    """The loop's side of explorations, of any system: what is under way, how far it is, and why. Safe in the loop.

    `silent` says that decisions fail to come, `dropped` counts those that came too late.
    """

    silent = False
    dropped = 0

    def __init__(self, setpoints: SetPoints) -> None:
        self._setpoints = setpoints
        self._exploration: Exploration | None = None
        self._begun = False
        self._coverage = self._reachable = self._goal = self._seconds = math.nan
        self._reason = ""

    @property
    def possible(self) -> bool:
        """Whether there is anybody to decide."""
        return True

    def prepare(self) -> None:
        """A plan that explores is in hand: have everything ready before it moves."""
        return

    @property
    def under_way(self) -> Exploration | None:
        """The exploration in hand."""
        return self._exploration

    @property
    def reason(self) -> str:
        """Why the present exploration, or the last one, is where it is."""
        return self._reason

    def told(self) -> dict[str, Any] | None:
        """How far the present exploration is, or the last one came, and why it stands; None before the first."""
        if not self._begun:
            return None
        return {
            "coverage": or_none(self._coverage), "reachable": or_none(self._reachable), "reason": self._reason,
        }  # fmt: skip

    @property
    def explored(self) -> Explored:
        """What `palm/state` says of it."""
        running = self._exploration is not None
        return Explored(running, self._seconds, self._coverage, self._goal, self._reachable, self._reason)

    @abstractmethod
    def step(self, t: float, senses: Senses) -> None:
        """One tick at `t` (s)."""


class Exploring(Explores):
    """Of palms that an explorer beside the loop decides for; see the module."""

    def __init__(self, setpoints: SetPoints, source: Source | None) -> None:
        """Without a `source` there is no exploring: the observer knows no outline."""
        super().__init__(setpoints)
        self._source = source
        self._run = 0
        self._next: tuple[tuple[Move, ...], bool] | None = None  # and whether they rock
        self._rocking = self._halting = self._ending = False
        self._ahead = AHEAD_S
        self._t_known = self._t_moved = self._t_heard = self._t_ask = -math.inf

    @property
    def possible(self) -> bool:
        """With a source."""
        return self._source is not None

    def prepare(self) -> None:
        """Whoever decides is started."""
        if self._source is not None:
            self._source.prepare()

    def step(self, t: float, senses: Senses) -> None:
        """One tick at `t` (s)."""
        found, source = self._setpoints.exploration, self._source
        if found is None or source is None:
            self._leave()
            return
        exploration, tau = found
        if exploration is not self._exploration:
            self._begin(exploration, t)
        self._seconds = tau
        answer = source.collect(t)
        if self._halting or not senses.tracking:
            self._stand(exploration, tau, t)
            return
        at_rest = tau >= exploration.end
        if senses.known:
            self._t_known = t
        if not at_rest:
            self._t_moved = t
        if not (at_rest and senses.known):
            self._t_heard = t
        if answer is not None:
            self._take(answer, exploration, t, senses, at_rest)
        if not (at_rest or self._rocking) and t - self._t_known > LOST_S:
            self._halt("the estimate was lost in the middle of a move")
        if tau > exploration.goal.time_limit_s + OVERTIME_S and not self._ending:
            self._end(f"the time limit of {exploration.goal.time_limit_s:g} s is over")
        if self._ending and at_rest:
            self._setpoints.conclude()
            log.info("the exploration is over: %s", self._reason)
            return
        if self._next is not None and exploration.end - tau <= LEAD_S:
            moves, self._rocking = self._next
            for move in moves:
                exploration.append(move, tau)
            self._next = None
        self._ask(source, exploration, tau, t, senses)
        self.silent = t - self._t_heard > SILENT_S

    def _begin(self, exploration: Exploration, t: float) -> None:
        self._exploration, self._begun = exploration, True
        self._run += 1
        self._coverage = self._reachable = math.nan
        self._goal = exploration.goal.coverage
        self._reason = "it has just begun"
        self._task = ExplorationTask(self._run, exploration.goal, self._setpoints.limits)
        self._forget(t)

    def _forget(self, t: float) -> None:
        """Begin anew from where the palms stand."""
        self._next = None
        self._rocking = self._halting = self._ending = self.silent = False
        self._t_known = self._t_moved = self._t_heard = self._t_ask = t

    def _leave(self) -> None:
        if self._exploration is not None:
            if not self._ending:
                self._reason = "it was stopped"
            self._exploration = None
            self._forget(-math.inf)

    def _stand(self, exploration: Exploration, tau: float, t: float) -> None:
        """While the motion is held: once it stands, the rest of the move is dropped."""
        if not self._setpoints.moving:
            if not self._halting:
                self._reason = "the motion was held: it goes on from here, by another way, when it is started"
            exploration.cut(tau)
            self._setpoints.pause(False)
            self._forget(t)

    def _take(
        self, answer: ExplorationAnswer, exploration: Exploration, t: float, senses: Senses, at_rest: bool
    ) -> None:
        """Let an answer have its effect, if it is still about what is going on."""
        blind = answer.object_count is None
        if answer.run != self._run or t - answer.t > STALE_S:
            self.dropped += 1
            return
        changed = senses.known if blind else answer.object_count != senses.object_count
        if changed or answer.after != exploration.last:
            return
        decision = answer.decision
        self._t_heard = t
        if decision.kind != "safe":
            self._next = None
            if not self._ending:
                self._reason = decision.reason
        if math.isfinite(decision.coverage):
            self._coverage = exploration.coverage = decision.coverage
        if math.isfinite(decision.reachable):
            self._reachable = decision.reachable
        if decision.kind == "done":
            self._end(decision.reason)
        elif decision.kind == "unsafe" and not at_rest:
            self._halt(decision.reason)
        elif decision.kind == "move" and not self._ending:
            move, took = decision.move, t - answer.t
            self._ahead = min(max(AHEAD_S, took + ASK_S), AHEAD_MOST_S)
            if move is not None and move.start == exploration.last.end:
                further = (decision.then,) if decision.then is not None and took > move.duration + MORE_S else ()
                self._next = (move, *further), blind or decision.blind

    def _ask(self, source: Source, exploration: Exploration, tau: float, t: float, senses: Senses) -> None:
        move, elapsed = exploration.under_way(tau)
        if t < self._t_ask or move is not exploration.last:
            return
        to_go = exploration.end - tau - self._ahead
        self._t_ask = t + max(ASK_S, min(CHECK_S, to_go))
        belief = senses.look() if senses.known else None
        may_rock = senses.touching and (self._rocking or t - self._t_moved > BLIND_S)
        if belief is None and (senses.known or not may_rock):
            return
        choose = self._next is None and to_go <= 0.0
        under_way = UnderWay(move, elapsed)
        source.ask(Question(t, self._task, belief, under_way, choose, senses.sticking, senses.cornered))

    def _halt(self, reason: str) -> None:
        self._halting = True
        self._reason = reason
        self._setpoints.pause(True)

    def _end(self, reason: str) -> None:
        """No further move: it is over when the one in hand is."""
        self._ending = True
        self._next = None
        self._reason = reason
