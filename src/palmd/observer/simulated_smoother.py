"""The smoother as it would run beside the loop, for replays: what is ready when depends on the log's time alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

from palmd.events import Event, Improvement, Unexplained
from palmd.observer.incremental import IncrementalSmoother
from palmd.observer.smoothing import Session, period
from palmd.system.description import RigDescription


class Simulated:
    """A `Smoothing` that is deterministic; see the module."""

    def __init__(self, rig: RigDescription, seed: int = 0, latency_s: float = 0.2):
        """Each run of the smoother is taken to last `latency_s` of the log's time."""
        self._smoother = IncrementalSmoother(rig, seed)
        self._latency = latency_s
        self._next = -math.inf
        self._ready: tuple[float, Improvement | Unexplained | None] | None = None

    def submit(self, t: float, session: Session, events: Sequence[Event]) -> None:
        """Take the tick's events, and start when it is time."""
        self._smoother.add(session, events)
        if t >= self._next and self._ready is None:
            self._next = t + period(t - session.begun)
            self._ready = (t + self._latency, self._smoother.result())

    def collect(self, t: float) -> Improvement | Unexplained | None:
        """What was started at least the latency ago."""
        if self._ready is None or t < self._ready[0]:
            return None
        improvement = self._ready[1]
        self._ready = None
        return improvement
