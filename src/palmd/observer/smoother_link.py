"""The loop's end of a smoother that works outside it: events go out, what it finds comes back and catches up.

What it finds is about a time that has passed. A filter starts there, reads what has come since, a few events a tick,
and is then handed over.
"""

from __future__ import annotations

import math
from collections import deque

from palmd.events import Event, FloatArray, Improvement, PadSample, Unexplained
from palmd.observer.filter_catchup import FilterCatchUp
from palmd.observer.handover import Handover, outline_sd
from palmd.observer.smoothing import Session, Smoothing
from palmd.observer.track import Track
from palmd.observer.validity import CONFIRMED_M, PRECISE_M
from palmd.system.description import RigDescription

MEMORY_S = 30.0  # how long after its time an improvement can still be taken in: on a busy machine answers come late
EVENTS_PER_TICK = 14  # beyond those that come in a tick, that a filter reads while it catches up


class SmootherLink:
    """What an observer needs of a smoother at its side; safe inside the loop."""

    def __init__(self, smoothing: Smoothing, rig: RigDescription, handover: Handover):
        """Binds a block of kernels for the filter that catches up."""
        self._smoothing = smoothing
        self._handover = handover
        self._catch_up = FilterCatchUp(rig)
        self._recent: deque[Event] = deque()
        self._batch: list[Event] = []
        self._awaited: Improvement | None = None
        self._refused_at = self._vouched_at = self._sure_at = -math.inf
        self.improvements = 0

    def reset(self) -> None:
        """As if nothing had been heard."""
        self._handover.reset()
        self._recent.clear()
        self._batch.clear()
        self._awaited = None
        self._refused_at = self._vouched_at = self._sure_at = -math.inf

    def refuses(self, begun: float) -> bool:
        """Whether the last word on the object that lies there since `begun` (s) is that nothing explains it.

        Or that something may, which is not vouched for: what has been found contradicts the rig, is not sure, or leaves
        too much open.
        """
        return self._refused_at > begun

    def vouches(self, begun: float) -> bool:
        """Whether it has told the outline of the object that lies there since `begun` (s), and vouches for it."""
        return self._vouched_at > begun

    def sure(self, begun: float) -> bool:
        """Whether it vouches for that outline, and tells it so sharply that only a disc may be another."""
        return self._sure_at > begun

    def on_time(self, sample: PadSample) -> PadSample:
        """The reading at the time of what it tells, as far as the smoother knows its lag."""
        return self._handover.rig_error.on_time(sample)

    @property
    def rig_off(self) -> FloatArray:
        """What the rig's constants are off by, as the smoother has told it."""
        return self._handover.rig_error.values.copy()

    def hear(self, event: Event) -> None:
        """Take one event."""
        self._batch.append(event)
        self._recent.append(event)
        while self._recent[0].t_sample < event.t_sample - MEMORY_S:
            self._recent.popleft()
        if self._catch_up.active:
            self._catch_up.hear(event)

    def exchange(self, t: float, session: Session) -> Improvement | Unexplained | None:
        """Hand over the events since the last call; what the smoother says at `t` (s), each answer once."""
        self._smoothing.submit(t, session, self._batch)
        self._batch.clear()
        improvement = self._smoothing.collect(t)
        if isinstance(improvement, Unexplained):
            self._refused_at, self._vouched_at, self._sure_at = improvement.t, -math.inf, -math.inf
            return improvement
        if improvement is not None:
            sd = 0.0 if improvement.established else outline_sd(improvement)
            never, now = -math.inf, improvement.t
            self._refused_at, self._vouched_at = (never, now) if sd < CONFIRMED_M else (now, never)
            self._sure_at = now if sd < PRECISE_M else never
        if improvement is not None and max(session.begun, t - MEMORY_S) < improvement.t <= t:
            self._catch_up.begin(improvement, self._recent)
            self._awaited = improvement
        return improvement

    def catch_up(self, track: Track | None, object_count: int, t: float) -> None:
        """Let the latest answer's filter read on, and take part in the `track` once it has arrived at `t` (s)."""
        if self._awaited is None or not self._catch_up.active or not self._catch_up.follow(EVENTS_PER_TICK):
            return
        arrived: tuple[FloatArray, FloatArray, float] = self._catch_up.state_at(t)
        if track is not None:
            self.improvements += self._handover.hand_over(track, object_count, self._awaited, *arrived)
