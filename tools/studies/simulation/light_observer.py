"""A trivial observer: its estimate is marked valid, without knowledge, once both pads are touched for a while."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from palmd.events import Estimate, Event, PadLift, PadSample
from palmd.messages import NAMED_STATE
from palmd.system.mechanism import PALMS
from tools.studies.silent_observer import SilentObserver

VALID_AFTER_S = 1.0
LATE_S = 0.1
"""Readings this much older than the newest cannot be fused at their own time (s)."""


class LightObserver(SilentObserver):
    """A trivial observer; see `Observer` and the module."""

    name = "shape"

    def __init__(self) -> None:
        self.object_count = self.late_dropped = 0
        self._newest = -math.inf
        self._touched: dict[int, float] = {}
        numbers: dict[str, Any] = {
            field.name: 0.01
            for field in dataclasses.fields(Estimate)
            if field.name not in ("t", "valid", "observer", "object_count", "sd", "invalid_reasons")
        }
        self._estimate = Estimate(
            t=0.0, valid=True, observer="shape", object_count=0, sd=dict.fromkeys(NAMED_STATE, 1e-3), **numbers
        )
        self._estimate = dataclasses.replace(self._estimate, nis=1.0)

    def feed(self, event: Event) -> None:
        """Take one event."""
        if isinstance(event, PadSample):
            self.late_dropped += event.t_sample < self._newest - LATE_S
            self._newest = max(self._newest, event.t_sample)
            if len(self._touched) < len(PALMS) and event.pad not in self._touched:
                self._touched[event.pad] = event.t_sample
                self.object_count += len(self._touched) == len(PALMS)
        elif isinstance(event, PadLift):
            self._touched.pop(event.pad, None)

    def estimate(self, t: float) -> Estimate:
        """Constant numbers."""
        touched = len(self._touched) == len(PALMS) and t - max(self._touched.values()) > VALID_AFTER_S
        return dataclasses.replace(self._estimate, t=t, valid=touched, object_count=self.object_count)
