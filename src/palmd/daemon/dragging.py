"""The loop's side of an exploration by dragging: asks the policy at every tick, for it goes by what is felt. Pure."""

from __future__ import annotations

import logging
import math
from typing import Any

from palmd.daemon.exploring import Senses
from palmd.daemon.setpoints import SetPoints
from palmd.messages import Explored
from palmd.motion.drags import Drags
from palmd.motion.exploration import Exploration
from palmd.motion.pivot import PivotLimits
from palmd.system.pivot import Touching

log = logging.getLogger(__name__)


class Dragging:
    """As `daemon.exploring.Exploring`, without a process beside the loop: a step is decided in microseconds."""

    silent = False
    dropped = 0
    possible = True

    def __init__(self, setpoints: SetPoints) -> None:
        self._setpoints = setpoints
        self._exploration: Exploration | None = None
        self._drags: Drags | None = None
        self._seconds = math.nan
        self._reason = ""
        self._halting = False

    @property
    def under_way(self) -> Exploration | None:
        """The exploration in hand."""
        return self._exploration

    @property
    def reason(self) -> str:
        """Why the present exploration, or the last one, is where it is."""
        return self._reason

    def prepare(self) -> None:
        """There is nothing to prepare."""

    def told(self) -> dict[str, Any] | None:
        """How far it is, or came, and why it stands; None before the first."""
        if self._drags is None:
            return None
        return {"coverage": self._drags.coverage, "reachable": None, "reason": self._reason}

    @property
    def explored(self) -> Explored:
        """What `palm/state` says of it."""
        drags, goal = self._drags, math.nan
        if drags is None:
            return Explored()
        if self._exploration is not None:
            goal = self._exploration.goal.coverage
        return Explored(self._exploration is not None, self._seconds, drags.coverage, goal, math.nan, self._reason)

    def step(self, t: float, senses: Senses) -> None:
        """One tick at `t` (s)."""
        del t
        found, limits = self._setpoints.exploration, self._setpoints.limits
        if found is None or not isinstance(limits, PivotLimits):
            self._exploration = None
            return
        exploration, tau = found
        if exploration is not self._exploration or self._drags is None:
            self._exploration, self._halting = exploration, False
            self._drags = Drags(limits, exploration.goal)
            self._reason = "it has just begun"
        drags, self._seconds = self._drags, tau
        if self._halting or not senses.tracking:
            if not self._setpoints.moving:
                exploration.cut(tau)
                self._halting = False
                self._setpoints.pause(False)
            return
        felt = senses.look() if senses.known else None
        if not isinstance(felt, Touching):
            return
        resting = tau >= exploration.end
        if tau > exploration.goal.time_limit_s and resting and not felt.touching:
            self._end(f"the time limit of {exploration.goal.time_limit_s:g} s is over")
            return
        step = drags.look(felt, exploration.last.end, resting)
        exploration.coverage = drags.coverage
        self._reason = step.reason or self._reason
        if step.kind == "halt" and not resting:
            self._halting = True
            self._setpoints.pause(True)
        elif step.kind == "done":
            self._end(step.reason)
        elif step.move is not None:
            exploration.append(step.move, tau)

    def _end(self, reason: str) -> None:
        self._reason = reason
        self._setpoints.conclude()
        log.info("the exploration is over: %s", reason)
