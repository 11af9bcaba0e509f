"""An observer that costs nothing: it calls valid what it does not know, once both pads are touched for a while."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

from palmd.events import Estimate, Event, Improvement, ObjectEstimate, Outlook, PadLift, PadSample, ShapeEstimate
from palmd.messages import NAMED_STATE
from palmd.observer.observer import Observer
from palmd.system.mechanism import PALMS

VALID_AFTER_S = 1.0


class ModelError(Exception):
    """What a broken model raises."""


class Breakable:
    """An observer that does its work until it is broken: `how` may be set at any time."""

    def __init__(self, sound: Observer) -> None:
        self._sound = sound
        self.how: Literal["raises", "nan", "blind"] | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sound, name)

    def estimate(self, t: float) -> Estimate:
        """As the sound one's; or an error, NaN that is called valid, or nothing."""
        if self.how == "raises":
            raise ModelError("the model is broken")
        estimate = self._sound.estimate(t)
        match self.how:
            case "nan":
                return dataclasses.replace(estimate, valid=True, r1=math.nan)
            case "blind":
                return dataclasses.replace(estimate, valid=False)
        return estimate


class LightObserver:
    """See `Observer` and the module."""

    name, backend = "shape", "none"
    late_dropped = improvements = 0
    foresees = False

    def __init__(self) -> None:
        self.object_count = 0
        self._touched: dict[int, float] = {}
        numbers = {
            field.name: 0.01
            for field in dataclasses.fields(Estimate)
            if field.name not in ("t", "valid", "observer", "object_count", "sd")
        }
        self._estimate = Estimate(
            t=0.0, valid=True, observer="shape", object_count=0, sd=dict.fromkeys(NAMED_STATE, 1e-3), **numbers
        )
        self._estimate = dataclasses.replace(self._estimate, nis=1.0)

    def warm_up(self) -> None:
        """Nothing to warm."""

    def feed(self, event: Event) -> None:
        """Take one event."""
        if isinstance(event, PadSample):
            if len(self._touched) < len(PALMS) and event.pad not in self._touched:
                self._touched[event.pad] = event.t_sample
                self.object_count += len(self._touched) == len(PALMS)
        elif isinstance(event, PadLift):
            self._touched.pop(event.pad, None)

    def improve(self, _t: float) -> Improvement | None:
        """No smoother."""
        return None

    def estimate(self, t: float) -> Estimate:
        """The same numbers ever."""
        touched = len(self._touched) == len(PALMS) and t - max(self._touched.values()) > VALID_AFTER_S
        return dataclasses.replace(self._estimate, t=t, valid=touched, object_count=self.object_count)

    def shape(self, _t: float) -> ShapeEstimate | None:
        """It knows none."""
        return None

    def outlook(self, _t: float) -> Outlook | None:
        """It foresees nothing."""
        return None

    def identify(self, _t: float) -> ObjectEstimate | None:
        """No objects are stored."""
        return None
