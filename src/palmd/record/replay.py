"""A run again through the observer, causally: what the daemon would have said, tick by tick. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from palmd.blas import one_thread
from palmd.events import Estimate, Event, ObjectEstimate, ShapeEstimate
from palmd.messages import Fields, estimate_fields, object_fields, shape_fields, stamp
from palmd.observer.observer import LiveObserver, Observer
from palmd.record.eventlog import EventLog
from palmd.record.jsontext import as_json

PERIOD_S = 0.01
TICKS_PER_SHAPE = 100
_SAME_TIME_S = 1e-9


@dataclass(frozen=True, slots=True)
class Tick:
    """One tick of a replay; `shape` and `object` come with every hundredth, where there are any."""

    number: int
    t: float
    estimate: Estimate
    shape: ShapeEstimate | None
    object: ObjectEstimate | None


class Dated(Protocol):
    """An event of any system's log."""

    @property
    def t_sample(self) -> float:
        """When it was true (s)."""


class Log(Protocol):
    """Of any system."""

    @property
    def events(self) -> Sequence[Dated]:
        """In the order of the file, at least one."""


def tick_count(log: Log) -> int:
    """How many ticks there are: from the first event's time to the first tick that has seen them all."""
    span = max(event.t_sample for event in log.events) - log.events[0].t_sample
    return max(1, math.ceil((span - _SAME_TIME_S) / PERIOD_S))


def replay(log: EventLog, observer: Observer) -> Iterator[Tick]:
    """The observer's answers at t0 + k·10 ms, each from events up to that time only, in the file's order."""
    for number, t in fed(log, log.events, observer):
        shape, identified = None, None
        with one_thread():
            estimate = observer.estimate(t)
            if number % TICKS_PER_SHAPE == 0:
                shape, identified = observer.shape(t), observer.identify(t)
        yield Tick(number, t, estimate, shape, identified)


def fed(log: Log, events: Iterable[Event], observer: LiveObserver) -> Iterator[tuple[int, float]]:
    """The number and time of each of a log's ticks, once `observer` has been fed all its `events` up to then."""
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
class Said:
    """What the observer of any system says at one tick, as the fields of its own estimate and shape topics."""

    number: int
    t: float
    estimate: Fields
    shape: Fields | None = None
    object: ObjectEstimate | None = None


def as_said(tick: Tick) -> Said:
    """A tick of two palms, as fields."""
    shape = None if tick.shape is None else shape_fields(tick.shape)
    return Said(tick.number, tick.t, estimate_fields(tick.estimate), shape, tick.object)


def lines(said: Said) -> Iterator[dict[str, Any]]:
    """The tick as JSON objects: the fields of the estimate, and of outline and object where there are any.

    `t` is the log's own time, and so are the stamps. What has no number is NaN.
    """
    t = round(said.t, 9)
    yield stamp({"t": t, **said.estimate}, t, t, said.number)
    if said.shape is not None:
        yield {"t": t, "shape": said.shape}
    if said.object is not None:
        yield {"t": t, "object": object_fields(said.object)}


def texts(said: Said) -> Iterator[str]:
    """The same as lines of text; null for what has no number."""
    return map(as_json, lines(said))
