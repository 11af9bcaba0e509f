"""Observers for studies and tests: one that knows nothing, and one that can be broken."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

from palmd.events import Estimate, Event, Improvement, ObjectEstimate, PlanningBelief, ShapeEstimate
from palmd.observer import Observer
from palmd.observer.estimates import empty_estimate


class SilentObserver:
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


class ModelError(Exception):
    """What a broken model raises."""


class Breakable:
    """An observer that works until it is broken; `how` may be set at any time."""

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
