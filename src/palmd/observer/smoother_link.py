"""The loop's side of a smoother that runs outside it: events go out, improvements come back and catch up.

An improvement is an estimate for a time in the past. A filter starts there, fuses the events since then, a few each
tick, and is then handed over.
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

MEMORY_S = 30.0  # largest age of an improvement that is still used: on a busy machine they come late
EVENTS_PER_TICK = 14  # fused by the filter that catches up, in addition to a tick's own events


class SmootherLink:
    """An observer's connection to its smoother; safe inside the loop."""

    def __init__(self, smoothing: Smoothing, rig: RigDescription, handover: Handover):
        """Bind a block of kernels for the filter that catches up."""
        self._smoothing = smoothing
        self._handover = handover
        self._catch_up = FilterCatchUp(rig)
        self._recent: deque[Event] = deque()
        self._batch: list[Event] = []
        self._awaited: Improvement | None = None
        self._rejected_at = self._confirmed_at = self._precise_at = -math.inf
        self.improvements = 0

    def reset(self) -> None:
        """Back to the initial state, as if nothing had been exchanged."""
        self._handover.reset()
        self._recent.clear()
        self._batch.clear()
        self._awaited = None
        self._rejected_at = self._confirmed_at = self._precise_at = -math.inf

    def rejects(self, start_time: float) -> bool:
        """Whether the last result for the object on the palms since `start_time` (s) is unexplained or unconfirmed.

        Unconfirmed: the solution contradicts the rig, lacks confirmation, or leaves too large an uncertainty.
        """
        return self._rejected_at > start_time

    def confirms(self, start_time: float) -> bool:
        """Whether the last result confirms an outline of the object on the palms since `start_time` (s)."""
        return self._confirmed_at > start_time

    def is_precise(self, start_time: float) -> bool:
        """Whether that outline is so precise that the only remaining rival is a disc."""
        return self._precise_at > start_time

    def on_time(self, sample: PadSample) -> PadSample:
        """The reading with its time corrected by the pad's lag, as far as the smoother has estimated it."""
        return self._handover.rig_error.on_time(sample)

    @property
    def rig_errors(self) -> FloatArray:
        """Errors of the rig's constants as estimated by the smoother."""
        return self._handover.rig_error.values.copy()

    def add_event(self, event: Event) -> None:
        """Take one event."""
        self._batch.append(event)
        self._recent.append(event)
        while self._recent[0].t_sample < event.t_sample - MEMORY_S:
            self._recent.popleft()
        if self._catch_up.active:
            self._catch_up.add_event(event)

    def exchange(self, t: float, session: Session) -> Improvement | Unexplained | None:
        """Submit the events since the last call and collect the smoother's result at `t` (s); each result once."""
        self._smoothing.submit(t, session, self._batch)
        self._batch.clear()
        improvement = self._smoothing.collect(t)
        if isinstance(improvement, Unexplained):
            self._rejected_at, self._confirmed_at, self._precise_at = improvement.t, -math.inf, -math.inf
            return improvement
        if improvement is not None:
            sd = 0.0 if improvement.established else outline_sd(improvement)
            never, now = -math.inf, improvement.t
            self._rejected_at, self._confirmed_at = (never, now) if sd < CONFIRMED_M else (now, never)
            self._precise_at = now if sd < PRECISE_M else never
        if improvement is not None and max(session.start_time, t - MEMORY_S) < improvement.t <= t:
            self._catch_up.begin(improvement, self._recent)
            self._awaited = improvement
        return improvement

    def catch_up(self, track: Track | None, object_count: int, t: float) -> None:
        """Advance the latest improvement's filter, and hand it over to the `track` once it has arrived at `t` (s)."""
        if self._awaited is None or not self._catch_up.active or not self._catch_up.advance(EVENTS_PER_TICK):
            return
        arrived: tuple[FloatArray, FloatArray, float] = self._catch_up.state_at(t)
        if track is not None:
            self.improvements += self._handover.hand_over(track, object_count, self._awaited, *arrived)
