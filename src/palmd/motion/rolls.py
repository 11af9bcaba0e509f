"""Exploration policy of a gripper on a slide: set the body down anywhere and roll it back and forth on the pad. Pure.

The carriage gives way, so the pivot may pass over the contact, and the pad bears only the weight of carriage and body.
Friction rolls the body while the arm drags, for any lever e. The arm carries the slide's lower stop: once the body
stands, the stop is lowered clear of the carriage; it is raised to lift the body off.
"""

from __future__ import annotations

import math

from palmd.config.plans import ExploreGoal
from palmd.motion.drags import CLEAR_M, PAD_END_M, WAIT, Drags, DragStep
from palmd.motion.pivot import PivotLimits
from palmd.motion.segments import Angles
from palmd.system.pivot import Touching

SINK_M_S = 0.006
FREE_M = 8e-3  # the stop is lowered by this, below the height at which the body was set down
ROLL_M, LEAST_ROLL_M, ROLL_M_S = 0.010, 0.002, 0.030  # longest and shortest stroke, and its speed
AHEAD = 1.3  # largest motion of the contact relative to the arm's
HEAVY = 0.8  # largest share of the force limit that the weight alone may use
# passes from end to end before the outline may count as known; before it is set down elsewhere, provided that the
# smoother has answered about them all; and before it is set down elsewhere in any case
ENOUGH, PASSES, MOST_PASSES = 4, 10, 40
SETTINGS = 3  # times that it is set down before the exploration gives up
_FREE_M_S = 0.015
_ROLLING = "rolls the body to and fro over the pad"


class Rolls(Drags):
    """The policy (see the module): call `look` at every tick. Safe in the loop. Its ends are those of the pad."""

    def __init__(self, limits: PivotLimits, goal: ExploreGoal) -> None:
        super().__init__(limits, goal)
        self._towards, self._passes, self._settings = 1.0, 0, 0
        self._t_settled = self._t_passes = math.inf  # when the body was set down; when `PASSES` were complete

    @property
    def coverage(self) -> float:
        """Share of the pad's two ends that were reached."""
        return min(len(self._ends) / 2.0, 1.0)

    def _request(self) -> str:
        return "lifted off: turn the body to another orientation, and hold it until it stands on the pad"

    def _start_of(self, side: float) -> float:
        del side
        (low, high), _ = self._limits.angles
        return min(max(0.5 * self._limits.pad_length, low), high)

    def _lift(self, sensed: Touching, here: Angles) -> DragStep:
        _, (_, top) = self._limits.angles
        if sensed.touching and here[1] < top:  # first the stop rises, then it carries the carriage
            return self._move_to(here, (here[0], max(sensed.z, here[1]) + CLEAR_M), SINK_M_S)
        return super()._lift(sensed, here)

    def _seek(self, here: Angles) -> DragStep:
        _, (bottom, _) = self._limits.angles
        start = self._start_of(0.0)
        if here[0] != start:
            return self._move_to(here, (start, here[1]), self._limits.rate)
        if here[1] <= bottom:
            return DragStep("done", reason="nothing touches the pad at the slide's lowest height: lower limits.z_mm")
        return self._move_to(here, (start, bottom), SINK_M_S)

    def _settle(self, sensed: Touching, here: Angles) -> DragStep:
        if not (math.isfinite(sensed.e) and math.isfinite(sensed.force)):
            return WAIT
        if sensed.force > HEAVY * self._limits.force:
            return DragStep(
                "done", reason="body and carriage are too heavy: raise limits.force_n, or make the carriage lighter"
            )
        self._towards, self._passes = 1.0, 0
        self._t_settled, self._t_passes = sensed.t, math.inf
        self._settings += 1
        self.phase = "roll"
        free = (here[0], min(here[1], sensed.z - FREE_M))
        return self._move_to(here, free, _FREE_M_S, _ROLLING)

    def _roll(self, sensed: Touching, here: Angles) -> DragStep:
        if not math.isfinite(sensed.e):
            return WAIT
        if self._passes >= ENOUGH and sensed.t_answer > self._t_settled and self._known(sensed):
            return DragStep("done", reason="rolled to and fro, and the outline is known")
        if self._passes > PASSES:
            self._t_passes = min(self._t_passes, sensed.t)
        if sensed.t_answer > self._t_passes or self._passes > MOST_PASSES:
            if self._settings >= SETTINGS:
                return DragStep("done", reason="rolled to and fro repeatedly, but the outline is not determined")
            return self._enter("lift", "the outline is not determined yet: lifted off to be set down elsewhere")
        way = self._room(sensed, here)
        if way < LEAST_ROLL_M:
            self._ends.add((self._towards, ""))
            self._towards = -self._towards
            self._passes += 1
            way = self._room(sensed, here)
        return self._move_to(here, (here[0] + self._towards * max(way, 0.0), here[1]), ROLL_M_S, _ROLLING)

    def _room(self, sensed: Touching, here: Angles) -> float:
        """Distance (m) that the arm may move on: within its limits and with the contact on the pad."""
        (x0, x1), _ = self._limits.angles
        length, contact = self._limits.pad_length, here[0] + sensed.e
        ahead, on_pad = (x1 - here[0], length - contact) if self._towards > 0.0 else (here[0] - x0, contact)
        return min(ROLL_M, ahead, (on_pad - PAD_END_M) / AHEAD)
