"""Observers for studies and tests: without estimates, with constant estimates, and one that fails on request."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

from palmd.events import (
    Estimate,
    Event,
    Improvement,
    ObjectEstimate,
    PadLift,
    PadSample,
    PlanningBelief,
    ShapeEstimate,
)
from palmd.messages import NAMED_STATE
from palmd.observer import Observer
from palmd.observer.estimates import empty_estimate
from palmd.system.mechanism import PALMS

VALID_AFTER_S = 1.0
LATE_S = 0.1
"""Readings this much older than the newest cannot be fused at their own time (s)."""


class EmptyObserver:
    """An `Observer` without estimates; subclasses override what they know."""

    name, backend = "silent", "none"
    object_count = late_dropped = improvements = 0
    has_planning_belief = cornered = False
    invalid_because = ""

    def warm_up(self) -> None:
        """Nothing to warm."""

    def forget_object(self) -> bool:
        """False: there is no object to forget."""
        return False

    def feed(self, event: Event) -> None:
        """Take one event."""

    def improve(self, _t: float) -> Improvement | None:
        """No smoother."""
        return None

    def estimate(self, t: float) -> Estimate:
        """An estimate with no value."""
        return empty_estimate(t, self.name, self.object_count, None)

    def shape(self, _t: float) -> ShapeEstimate | None:
        """None: there is no outline."""
        return None

    def planning_belief(self, _t: float) -> PlanningBelief | None:
        """None: there is no planning belief."""
        return None

    def identify(self, _t: float) -> ObjectEstimate | None:
        """No objects are stored."""
        return None


class TrivialObserver(EmptyObserver):
    """Constant estimates, valid but without information, once both pads have been touched for `VALID_AFTER_S`."""

    name = "shape"

    def __init__(self) -> None:
        self.object_count = self.late_dropped = 0
        self._newest = -math.inf
        self._touched: dict[int, float] = {}
        values: dict[str, Any] = {each.name: 0.01 for each in dataclasses.fields(Estimate)}
        values |= {"t": 0.0, "valid": True, "observer": "shape", "object_count": 0, "nis": 1.0, "invalid_reasons": ()}
        self._estimate = Estimate(**values | {"sd": dict.fromkeys(NAMED_STATE, 1e-3)})

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


class ModelError(Exception):
    """Raised by a failing `FaultyObserver`."""


class FaultyObserver:
    """An observer that works until `how` is set to the kind of its failure, and again after it is None."""

    def __init__(self, sound: Observer) -> None:
        self._sound = sound
        self.how: Literal["raises", "nan", "blind"] | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sound, name)

    def estimate(self, t: float) -> Estimate:
        """The sound observer's estimate; or an exception, NaN marked valid, or an invalid estimate, by `how`."""
        if self.how == "raises":
            raise ModelError("the model is broken")
        estimate = self._sound.estimate(t)
        match self.how:
            case "nan":
                return dataclasses.replace(estimate, valid=True, r1=math.nan)
            case "blind":
                return dataclasses.replace(estimate, valid=False)
        return estimate
