"""In-loop exploration by dragging or rolling; the policy runs every tick, since it depends on the contacts. Pure."""

from __future__ import annotations

import logging

from palmd.daemon.exploring import ExplorationControl, ExplorationInputs
from palmd.daemon.setpoints import SetPoints
from palmd.motion.drags import Drags
from palmd.motion.pivot import PivotLimits
from palmd.motion.rolls import Rolls
from palmd.system.pivot import Touching

log = logging.getLogger(__name__)


class DragExploration(ExplorationControl):
    """Exploration without a process beside the loop: a step is decided in microseconds."""

    def __init__(self, setpoints: SetPoints) -> None:
        super().__init__(setpoints)
        self._drags: Drags | None = None
        self._halting = False

    @property
    def left_the_pad(self) -> int:
        """How often the body was found to leave the pad without being lifted."""
        return 0 if self._drags is None else self._drags.lifted

    def step(self, t: float, inputs: ExplorationInputs) -> None:
        """One tick at `t` (s): follow the policy."""
        del t
        current, limits = self._setpoints.exploration, self._setpoints.limits
        if current is None or not isinstance(limits, PivotLimits):
            self.under_way = None  # coverage and goal of the last exploration are still published
            return
        exploration, tau = current
        if exploration is not self.under_way or self._drags is None:
            self.under_way, self._ever_started, self._halting = exploration, True, False
            self._drags = (Rolls if limits.slides else Drags)(limits, exploration.goal)
            self._coverage, self._goal = self._drags.coverage, exploration.goal.coverage
            self.reason = "it has just started"
        drags, self._seconds = self._drags, tau
        if self._halting or not inputs.tracking:
            if not self._setpoints.moving:
                exploration.cut(tau)
                self._halting = False
                self._setpoints.pause(False)
            return
        contact = inputs.get_belief() if inputs.known else None
        if not isinstance(contact, Touching):
            return
        resting = tau >= exploration.end
        if tau > exploration.goal.time_limit_s and resting and not contact.touching:
            self._end(f"the time limit of {exploration.goal.time_limit_s:g} s is over")
            return
        step = drags.look(contact, exploration.last.end, resting)
        exploration.coverage = self._coverage = drags.coverage
        self.reason = step.reason or self.reason
        if step.kind == "halt" and not resting:
            self._halting = True
            self._setpoints.pause(True)
        elif step.kind == "done":
            self._end(step.reason)
        elif step.move is not None:
            exploration.append(step.move, tau)

    def _end(self, reason: str) -> None:
        self.reason = reason
        self._setpoints.conclude()
        log.info("the exploration is over: %s", reason)
