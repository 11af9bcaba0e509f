"""Smoother and explorer of three palms without wires, at the pace of a machine as busy as is asked for.

Each answer comes after so many times the processor time that it took, as it does beside the loop.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from palmd.daemon.exploration_requests import Decides, ExplorationAnswer, Question
from palmd.events import Event
from palmd.observer.three_palms.growing import SimulatedGrowing
from palmd.system.three_palms import ThreePalmsRig

PERIOD_S = 0.2  # of looking whether there is anything new, as `daemon.three_palms_smoothing` does
PASSED_ON_S = 0.1  # an answer's way to the loop


class PacedGrowing(SimulatedGrowing):
    """The smoother, an `observer.three_palms.live.BodySmoothing`."""

    def __init__(self, rig: ThreePalmsRig, pace: float) -> None:
        """pace: seconds that pass for one of the processor."""
        super().__init__(rig)
        self._pace, self._free = pace, 0.0

    def submit(self, t: float, events: Sequence[Event]) -> None:
        """Take the tick's events, and think when it is free."""
        self._smoother.add(events)
        if self._ready is not None or t < self._free:
            return
        begun = time.process_time()
        answer = self._smoother.answer()
        took = self._pace * (time.process_time() - begun)
        self._free = t + max(took, PERIOD_S)
        if answer is not None:
            self._ready = t + took + PASSED_ON_S, answer


class PacedExplorer:
    """Who decides, a `daemon.exploration_requests.Source`: the last of the questions that come meanwhile is next."""

    def __init__(self, decider: Decides, pace: float) -> None:
        """pace: seconds that pass for one of the processor."""
        self._decider, self._pace = decider, pace
        self._waiting: Question | None = None
        self._ready: tuple[float, ExplorationAnswer] | None = None

    def prepare(self) -> None:
        """Nothing to do."""

    def ask(self, question: Question) -> None:
        """Decide at once when it is free, and keep the answer back."""
        if self._ready is None:
            self._decide(question, question.t)
        else:
            self._waiting = question

    def collect(self, t: float) -> ExplorationAnswer | None:
        """What has been decided by `t` (s)."""
        if self._ready is None or t < self._ready[0]:
            return None
        answer, self._ready = self._ready[1], None
        if self._waiting is not None:
            question, self._waiting = self._waiting, None
            self._decide(question, t)
        return answer

    def _decide(self, question: Question, t: float) -> None:
        begun = time.process_time()
        answer = self._decider.answer(question)
        self._ready = t + self._pace * (time.process_time() - begun), answer
