"""A filter that starts from a smoother's posterior in the past and fuses the readings since then."""

from __future__ import annotations

import math
from collections import deque
from itertools import takewhile

import numpy as np

from palmd.events import Event, FloatArray, Improvement, PalmSample
from palmd.model.smoothing import ORDER
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.pad_map import shared_readings
from palmd.system.description import RigDescription

LEAST_READINGS = 30  # fused before its mean NIS is meaningful
LATEST_S = 1.0  # s by which an event may arrive after later events and still be used
LEAD_S = 0.3  # s of arm reports before the start, from which the palms' motion is estimated


class FilterCatchUp:
    """One filter that catches up with the bank, a few events at a time; safe inside the loop.

    Late readings are skipped: they are few among hundreds.
    """

    def __init__(self, rig: RigDescription):
        """Binds its own block of kernels."""
        self._filters = ShapeFilters(rig, 1, order=ORDER)
        self._variances, self._shared = rig.reading_variances, shared_readings(rig)
        self._angle_noise = rig.palm_angle_noise
        self._waiting: deque[Event] = deque()
        self._palms = self._filters.tracker(self._angle_noise)
        self._t = -np.inf
        self._read = 0
        self.active = False

    def begin(self, improvement: Improvement, recent: deque[Event]) -> None:
        """Start at `improvement.t`; `recent` holds at least the events since `LEAD_S` before it.

        They are in their order of arrival. Events that arrived more than `LATEST_S` after others of their time are
        skipped.
        """
        self._palms = self._filters.tracker(self._angle_noise)
        self._filters.rig_error.values[:] = improvement.rig
        since = improvement.t - LEAD_S
        late = takewhile(lambda event: event.t_sample > since - LATEST_S, reversed(recent))
        needed = [event for event in late if event.t_sample > since]
        needed.reverse()
        self._waiting = deque(sorted(needed, key=_sample_time))
        before: list[Event] = []
        while self._waiting and self._waiting[0].t_sample <= improvement.t:
            event = self._waiting.popleft()
            if isinstance(event, PalmSample):
                before.append(event)
        self._filters.bank.refill()
        self._filters.bank.x[:], self._filters.bank.P[:] = improvement.x, improvement.P
        self._t, self._read = improvement.t, 0
        if before:
            self._filters.fuse_events(before, self._t, self._palms, self._variances, self._shared)
        self.active = self._palms.known

    def add_event(self, event: Event) -> None:
        """Queue one more event."""
        self._waiting.append(event)

    def advance(self, budget: int) -> bool:
        """Fuse up to `budget` queued events; True if none is left and `LEAST_READINGS` have been fused."""
        events = [self._waiting.popleft() for _ in range(min(budget, len(self._waiting)))]
        if events:
            self._t, read = self._filters.fuse_events(events, self._t, self._palms, self._variances, self._shared)
            self._read += read
        return not self._waiting and self._read >= LEAST_READINGS

    def state_at(self, t: float) -> tuple[FloatArray, FloatArray, float]:
        """(mean, covariance, mean NIS since the start) at `t` (s); afterwards it is inactive."""
        self._move_to(max(t, self._t))
        self.active = False
        bank = self._filters.bank
        return bank.x[0].copy(), bank.P[0].copy(), float(bank.nis[0])

    def _move_to(self, t: float) -> None:
        self._filters.propagate(self._t, t, self._palms, math.inf)
        self._t = t


def _sample_time(event: Event) -> float:
    return event.t_sample
