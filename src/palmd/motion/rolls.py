"""How a gripper on a slide explores a body: set down anywhere, and rolled to and fro over the pad. Pure.

The carriage gives way, so the pivot may pass over the contact, and the pad bears no more than carriage and body weigh.
Friction rolls the body while the arm drags; how far ahead of the pivot the pad is touched does not matter. The arm has
the slide's lower stop: once the body stands, it is lowered clear of the carriage, and raised to lift the body off.
"""

from __future__ import annotations

import math

from palmd.config.plans import ExploreGoal
from palmd.motion.drags import CLEAR_M, PAD_END_M, WAIT, Drags, DragStep
from palmd.motion.pivot import PivotLimits
from palmd.motion.segments import Angles
from palmd.system.pivot import Touching

SINK_M_S = 0.006
FREE_M = 8e-3  # that the stop is lowered by below where the body was set down
ROLL_M, LEAST_ROLL_M, ROLL_M_S = 0.010, 0.002, 0.030  # at a time
AHEAD = 1.3  # how far the contact may go for what the arm does
HEAVY = 0.8  # share of the force's limit that weight alone may come to
ENOUGH, PASSES = 4, 10  # from end to end: after so many it may be known; or it is lifted off, to be set down elsewhere
SETTINGS = 3  # before it is given up that its outline is told
_FREE_M_S = 0.015


class Rolls(Drags):
    """See the module. Asked at every tick; safe in the loop. `ends` are those of the pad."""

    def __init__(self, limits: PivotLimits, goal: ExploreGoal) -> None:
        super().__init__(limits, goal)
        self._towards, self._passes, self._settings = 1.0, 0, 0

    @property
    def coverage(self) -> float:
        """Share of the pad's two ends that were reached."""
        return min(len(self._ends) / 2.0, 1.0)

    def _request(self) -> str:
        return "lifted off: turn the body as you like, and hold it so until it stands on the pad"

    def _start_of(self, side: float) -> float:
        del side
        (low, high), _ = self._limits.angles
        return min(max(0.5 * self._limits.pad_length, low), high)

    def _lift(self, felt: Touching, here: Angles) -> DragStep:
        _, (_, top) = self._limits.angles
        if felt.touching and here[1] < top:  # the stop first, then the carriage on it
            return self._moved(here, (here[0], max(felt.z, here[1]) + CLEAR_M), SINK_M_S)
        return super()._lift(felt, here)

    def _seek(self, here: Angles) -> DragStep:
        _, (bottom, _) = self._limits.angles
        start = self._start_of(0.0)
        if here[0] != start:
            return self._moved(here, (start, here[1]), self._limits.rate)
        if here[1] <= bottom:
            return DragStep(
                "done", reason="nothing touches the pad, though the slide is as low as it may be: lower limits.z_mm"
            )
        return self._moved(here, (start, bottom), SINK_M_S)

    def _settle(self, felt: Touching, here: Angles) -> DragStep:
        if not (math.isfinite(felt.e) and math.isfinite(felt.force)):
            return WAIT
        if felt.force > HEAVY * self._limits.force:
            return DragStep(
                "done", reason="body and carriage are too heavy: raise limits.force_n, or make the carriage lighter"
            )
        self._towards, self._passes = 1.0, 0
        self._settings += 1
        self.phase = "roll"
        return self._moved(here, (here[0], min(here[1], felt.z - FREE_M)), _FREE_M_S)

    def _roll(self, felt: Touching, here: Angles) -> DragStep:
        if not math.isfinite(felt.e):
            return WAIT
        if self._passes >= ENOUGH and self._known(felt):
            return DragStep("done", reason="it was rolled to and fro, and the outline is known")
        if self._passes > PASSES:
            if self._settings >= SETTINGS:
                return DragStep("done", reason="it was rolled to and fro again and again, and the outline is not told")
            return self._go("lift", "the outline is not told: lifted off to be set down elsewhere")
        way = self._room(felt, here)
        if way < LEAST_ROLL_M:
            self._ends.add((self._towards, ""))
            self._towards = -self._towards
            self._passes += 1
            way = self._room(felt, here)
        return self._moved(here, (here[0] + self._towards * max(way, 0.0), here[1]), ROLL_M_S)

    def _room(self, felt: Touching, here: Angles) -> float:
        """How far the arm may go on (m): within its limits, and the contact on the pad."""
        (x0, x1), _ = self._limits.angles
        length, contact = self._limits.pad_length, here[0] + felt.e
        ahead, on_pad = (x1 - here[0], length - contact) if self._towards > 0.0 else (here[0] - x0, contact)
        return min(ROLL_M, ahead, (on_pad - PAD_END_M) / AHEAD)
