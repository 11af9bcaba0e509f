"""Causal replay of an event log through an observer: the daemon's estimates, tick by tick. Pure."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from palmd.blas import one_thread
from palmd.events import Estimate, Event, ObjectEstimate, ShapeEstimate
from palmd.jsonvalues import or_none
from palmd.messages import Fields, estimate_fields, object_fields, shape_fields, stamp
from palmd.observer.observer import LiveObserver, Observer
from palmd.record.eventlog import EventLog

PERIOD_S = 0.01
TICKS_PER_SHAPE = 100
_SAME_TIME_S = 1e-9


@dataclass(frozen=True, slots=True)
class Tick:
    """One tick of a replay; `shape` and `object`, if any, come with every `TICKS_PER_SHAPE`th tick."""

    number: int
    t: float
    estimate: Estimate
    shape: ShapeEstimate | None
    object: ObjectEstimate | None


class TimedEvent(Protocol):
    """An event of any system's log."""

    @property
    def t_sample(self) -> float:
        """Sample time (s)."""


class Log(Protocol):
    """A log of any system."""

    @property
    def events(self) -> Sequence[TimedEvent]:
        """The events in file order, at least one."""


def tick_count(log: Log) -> int:
    """Number of ticks from the first event's time to the first tick at or after the last event."""
    span = max(event.t_sample for event in log.events) - log.events[0].t_sample
    return max(1, math.ceil((span - _SAME_TIME_S) / PERIOD_S))


def replay(log: EventLog, observer: Observer) -> Iterator[Tick]:
    """The observer's estimates at t0 + k·10 ms, each from events up to that time only, fed in file order."""
    for number, t in feed_ticks(log, log.events, observer):
        shape, identified = None, None
        with one_thread():
            estimate = observer.estimate(t)
            if number % TICKS_PER_SHAPE == 0:
                shape, identified = observer.shape(t), observer.identify(t)
        yield Tick(number, t, estimate, shape, identified)


def feed_ticks(log: Log, events: Iterable[Event], observer: LiveObserver) -> Iterator[tuple[int, float]]:
    """Feed `events` to `observer`; yield number and time of each tick of the log after feeding the events up to it."""
    t0 = log.events[0].t_sample
    waiting = iter(events)
    event = next(waiting, None)
    for number in range(1, tick_count(log) + 1):
        t = t0 + number * PERIOD_S
        with one_thread():
            while event is not None and event.t_sample <= t + _SAME_TIME_S:
                observer.feed(event)
                event = next(waiting, None)
            observer.improve(t)
        yield number, t


@dataclass(frozen=True, slots=True)
class TickFields:
    """One tick of a replay of any system, as the fields of its estimate and shape topics."""

    number: int
    t: float
    estimate: Fields
    shape: Fields | None = None
    object: ObjectEstimate | None = None


def tick_fields(tick: Tick) -> TickFields:
    """Convert a tick of two palms to fields."""
    shape = None if tick.shape is None else shape_fields(tick.shape)
    return TickFields(tick.number, tick.t, estimate_fields(tick.estimate), shape, tick.object)


def lines(tick: TickFields) -> Iterator[dict[str, Any]]:
    """The tick as JSON objects: the fields of the estimate, and of outline and object if there are any.

    `t` and the stamps are the log's own time. Unknown values are NaN.
    """
    t = round(tick.t, 9)
    yield stamp({"t": t, **tick.estimate}, t, t, tick.number)
    if tick.shape is not None:
        yield {"t": t, "shape": tick.shape}
    if tick.object is not None:
        yield {"t": t, "object": object_fields(tick.object)}


def texts(tick: TickFields) -> Iterator[str]:
    """The same as lines of JSON text; unknown values are null."""
    return (json.dumps(or_none(line), allow_nan=False) for line in lines(tick))
