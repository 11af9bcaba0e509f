"""The smoother beside the loop, simulated for replays: when an answer is ready depends on the log's time only."""

from __future__ import annotations

import math
from collections.abc import Sequence

from palmd.events import Event, Improvement, Unexplained
from palmd.observer.incremental import IncrementalSmoother
from palmd.observer.smoothing import Session, period
from palmd.system.description import RigDescription


class Simulated:
    """A deterministic `Smoothing`; see the module."""

    def __init__(self, rig: RigDescription, seed: int = 0, latency_s: float = 0.2):
        """`latency_s`: assumed duration of each run of the smoother, in the log's time."""
        self._smoother = IncrementalSmoother(rig, seed)
        self._latency = latency_s
        self._next = -math.inf
        self._ready: tuple[float, Improvement | Unexplained | None] | None = None

    def submit(self, t: float, session: Session, events: Sequence[Event]) -> None:
        """Add the tick's events, and start a run when it is due."""
        self._smoother.add(session, events)
        if t >= self._next and self._ready is None:
            self._ready = (t + self._latency, self._smoother.result())
            self._next = t + period(self._smoother.elapsed_s)

    def collect(self, t: float) -> Improvement | Unexplained | None:
        """The answer of the run started at least `latency_s` ago."""
        if self._ready is None or t < self._ready[0]:
            return None
        answer = self._ready[1]
        self._ready = None
        return answer
