"""The loop's side of an exploration: asks where to go next and executes the answers. Pure.

Decisions come from elsewhere and may come late or never (`daemon.exploration_requests`). A move starts when the one
before ends; the newest decision counts. Without a decision the palms wait. A move that has become unsafe, or during
which the estimate is lost, is stopped along its path and dropped.
"""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

from palmd.daemon.exploration_requests import DecisionSource, ExplorationAnswer, ExplorationTask, Question
from palmd.daemon.setpoints import SetPoints
from palmd.jsonvalues import or_none
from palmd.messages import Explored
from palmd.motion.decisions import UnderWay
from palmd.motion.exploration import Exploration
from palmd.motion.segments import Move

log = logging.getLogger(__name__)

ASK_S, AHEAD_S = 0.3, 0.7  # period of requests for the next move, and their begin before the end of the current one
AHEAD_MOST_S = 3.0  # largest value of the latter, for slow decisions
CHECK_S = 1.0  # before that, period of requests whether the current move is still safe
MORE_S = 0.5  # if a decision takes this much longer than its move, two moves are executed per decision
STALE_S = 10.0  # age beyond which an answer is dropped, even if the move it follows is still the last
LEAD_S = 0.05  # before the end of a move, when the next one is fixed
LOST_S = 0.5  # without an estimate, after which a move is stopped
BLIND_S = 1.0  # at rest without an estimate, before the object is rocked
OVERTIME_S = 5.0  # after the time limit, in which the decider can end it and say what is missing
SILENT_S = 2.0  # at rest with an estimate, before missing decisions are reported


class ExplorationInputs(NamedTuple):
    """State of a tick: whether the palms are tracking, whether all pads are touched, whether the object's motion can be
    predicted (`known`), and its number; `get_belief` computes the belief for planning, which takes time. sticking:
    contact positions (m) of an object that sticks. cornered: whether a corner was detected.
    """

    tracking: bool
    touching: bool
    known: bool
    object_count: int
    get_belief: Callable[[], object]
    sticking: tuple[float, ...] | None = None
    cornered: bool = False


class ExplorationControl(ABC):
    """The loop's side of explorations of any system: the current one, its coverage and state. Safe in the loop.

    `under_way`: the current one. `reason`: why it or the last one is in its state. `silent`: whether decisions fail to
    arrive. `dropped`: number of decisions that came too late.
    """

    silent = False
    dropped = 0

    def __init__(self, setpoints: SetPoints) -> None:
        self._setpoints = setpoints
        self.under_way: Exploration | None = None
        self._ever_started = False
        self._coverage = self._reachable = self._goal = self._seconds = math.nan
        self.reason = ""

    @property
    def possible(self) -> bool:
        """Whether anything can decide on moves."""
        return True

    def prepare(self) -> None:
        """Get ready for a plan that explores and has just been loaded."""
        return

    def summary(self) -> dict[str, Any] | None:
        """Coverage and state of the present or last exploration, for the status; None before the first."""
        if not self._ever_started:
            return None
        return {
            "coverage": or_none(self._coverage), "reachable": or_none(self._reachable), "reason": self.reason,
        }  # fmt: skip

    @property
    def explored(self) -> Explored:
        """What `palm/state` publishes of it."""
        running = self.under_way is not None
        return Explored(running, self._seconds, self._coverage, self._goal, self._reachable, self.reason)

    @abstractmethod
    def step(self, t: float, inputs: ExplorationInputs) -> None:
        """One tick at `t` (s)."""


class DelegatedExploration(ExplorationControl):
    """Exploration of palms whose moves are decided in a process beside the loop; see the module."""

    def __init__(self, setpoints: SetPoints, source: DecisionSource | None) -> None:
        """Without a `source` there is no exploration: the observer estimates no outline."""
        super().__init__(setpoints)
        self._source = source
        self._run = 0
        self._next: tuple[tuple[Move, ...], bool] | None = None  # next moves, and whether they rock the object
        self._rocking = self._halting = self._ending = False
        self._ahead = AHEAD_S
        self._t_known = self._t_moved = self._t_heard = self._t_ask = -math.inf

    @property
    def possible(self) -> bool:
        """True with a source."""
        return self._source is not None

    def prepare(self) -> None:
        """Start the process that decides."""
        if self._source is not None:
            self._source.prepare()

    def step(self, t: float, inputs: ExplorationInputs) -> None:
        current, source = self._setpoints.exploration, self._source
        if current is None or source is None:
            self._leave()
            return
        exploration, tau = current
        if exploration is not self.under_way:
            self._begin(exploration, t)
        self._seconds = tau
        answer = source.collect(t)
        if self._halting or not inputs.tracking:
            self._stand(exploration, tau, t)
            return
        at_rest = tau >= exploration.end
        if inputs.known:
            self._t_known = t
        if not at_rest:
            self._t_moved = t
        if not (at_rest and inputs.known):
            self._t_heard = t
        if answer is not None:
            self._take(answer, exploration, t, inputs, at_rest)
        if not (at_rest or self._rocking) and t - self._t_known > LOST_S:
            self._halt("the estimate was lost during a move")
        if tau > exploration.goal.time_limit_s + OVERTIME_S and not self._ending:
            self._end(f"the time limit of {exploration.goal.time_limit_s:g} s is over")
        if self._ending and at_rest:
            self._setpoints.conclude()
            log.info("the exploration is over: %s", self.reason)
            return
        if self._next is not None and exploration.end - tau <= LEAD_S:
            moves, self._rocking = self._next
            for move in moves:
                exploration.append(move, tau)
            self._next = None
        self._ask(source, exploration, tau, t, inputs)
        self.silent = t - self._t_heard > SILENT_S

    def _begin(self, exploration: Exploration, t: float) -> None:
        self.under_way, self._ever_started = exploration, True
        self._run += 1
        self._coverage = self._reachable = math.nan
        self._goal = exploration.goal.coverage
        self.reason = "it has just started"
        self._task = ExplorationTask(self._run, exploration.goal, self._setpoints.limits)
        self._forget(t)

    def _forget(self, t: float) -> None:
        """Reset the state to the present pose."""
        self._next = None
        self._rocking = self._halting = self._ending = self.silent = False
        self._t_known = self._t_moved = self._t_heard = self._t_ask = t

    def _leave(self) -> None:
        if self.under_way is not None:
            if not self._ending:
                self.reason = "it was stopped"
            self.under_way = None
            self._forget(-math.inf)

    def _stand(self, exploration: Exploration, tau: float, t: float) -> None:
        """While the motion is held: drop the rest of the move once the palms are at rest."""
        if not self._setpoints.moving:
            if not self._halting:
                self.reason = "the motion was held: it continues from here on another path after start"
            exploration.cut(tau)
            self._setpoints.pause(False)
            self._forget(t)

    def _take(
        self, answer: ExplorationAnswer, exploration: Exploration, t: float, inputs: ExplorationInputs, at_rest: bool
    ) -> None:
        """Apply an answer if it still refers to the present situation."""
        blind = answer.object_count is None
        if answer.run != self._run or t - answer.t > STALE_S:
            self.dropped += 1
            return
        changed = inputs.known if blind else answer.object_count != inputs.object_count
        if changed or answer.after != exploration.last:
            return
        decision = answer.decision
        self._t_heard = t
        if decision.kind != "safe":
            self._next = None
            if not self._ending:
                self.reason = decision.reason
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

    def _ask(
        self, source: DecisionSource, exploration: Exploration, tau: float, t: float, inputs: ExplorationInputs
    ) -> None:
        move, elapsed = exploration.under_way(tau)
        if t < self._t_ask or move is not exploration.last:
            return
        to_go = exploration.end - tau - self._ahead
        self._t_ask = t + max(ASK_S, min(CHECK_S, to_go))
        belief = inputs.get_belief() if inputs.known else None
        may_rock = inputs.touching and (self._rocking or t - self._t_moved > BLIND_S)
        if belief is None and (inputs.known or not may_rock):
            return
        choose = self._next is None and to_go <= 0.0
        under_way = UnderWay(move, elapsed)
        source.ask(Question(t, self._task, belief, under_way, choose, inputs.sticking, inputs.cornered))

    def _halt(self, reason: str) -> None:
        self._halting = True
        self.reason = reason
        self._setpoints.pause(True)

    def _end(self, reason: str) -> None:
        """Decide on no further move: the exploration is over when the current one ends."""
        self._ending = True
        self._next = None
        self.reason = reason
