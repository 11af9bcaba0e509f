"""The smoother in a process of its own beside the loop.

What the process cannot take at once is kept for some seconds, then dropped. It sleeps most of the time, so that a rig
with two cores keeps one for itself.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import msgpack
import numpy as np

from palmd.daemon.worker import WorkerProcess, give_back_memory, meet
from palmd.events import Event, Improvement, PadLift, PadSample, PalmSample, Unexplained
from palmd.observer.smoothing import Session, period
from palmd.system.description import PadSensor, RigDescription

BATCH_S = 0.05  # of events that go out in one message
HIGH_WATER = 100  # messages on their way: five seconds
KEPT_EVENTS = 1000  # for a process that does not take them: some four seconds; packing them takes 1 ms
SHARE = 0.5  # of one core that the process takes at most, and that only before it has found anything
NICENESS = 3  # after the loop, but not so far behind others that its answers come too late

_KINDS: tuple[type[PadSample] | type[PadLift] | type[PalmSample], ...] = (PadSample, PadLift, PalmSample)


class SmootherProcess:
    """The loop's end; `submit` and `collect` are safe inside the loop, starting the process again takes it 1 ms."""

    def __init__(self, rig: RigDescription) -> None:
        """Start the process; raises OSError when it cannot be."""
        self._process = WorkerProcess("smoother", __name__, json.dumps(asdict(rig)), high_water=HIGH_WATER)
        self._waiting: list[list[Any]] = []
        self._t_sent = -np.inf
        self.dropped = 0

    @property
    def starts(self) -> int:
        """How often the process has been started."""
        return self._process.starts

    def submit(self, t: float, session: Session, events: Sequence[Event]) -> None:
        """Hand the tick's events over, a few ticks' together."""
        self._waiting += [packed(event) for event in events]
        if t - self._t_sent < BATCH_S:
            return
        self._t_sent = t
        hint = None if session.hint is None else session.hint.tobytes()
        if self._process.send(msgpack.packb([session.object_count, session.begun, hint, self._waiting])):
            self._waiting = []
            return
        lost = len(self._waiting) - KEPT_EVENTS
        if lost > 0:
            del self._waiting[:lost]
            self.dropped += lost

    def collect(self, t: float) -> Improvement | Unexplained | None:
        """The newest improvement or refusal that has come."""
        del t  # it is ready when it is here
        newest: Improvement | Unexplained | None = None
        for message in self._process.received():
            told = msgpack.unpackb(message)
            if isinstance(told, float):
                newest = Unexplained(told)
                continue
            when, frame, established, touched, *arrays = told
            x, covariance, rig, rig_sd, spread, against = map(np.frombuffer, arrays)
            square, beyond = covariance.reshape(len(x), -1), spread.reshape(-1, len(rig))
            marks = np.frombuffer(touched, dtype=np.bool_)
            newest = Improvement(when, x, square, frame, established, marks, rig, rig_sd, beyond, against)
        return newest

    def close(self) -> None:
        """End the process."""
        self._process.close()


def packed(event: Event) -> list[Any]:
    """An event for a message to a process."""
    kind = next(i for i, each in enumerate(_KINDS) if isinstance(event, each))
    return [kind, *(getattr(event, name) for name in event.__slots__)]


def unpacked(fields: list[Any]) -> Event:
    """The event that was packed."""
    event: Event = _KINDS[fields[0]](*fields[1:])
    return event


def serve(address: str, rig: str) -> None:
    """The process's work, for ever: gather readings, smooth, answer; `rig` is the description's fields as JSON."""
    # in this process alone: the loop's has no use for them
    from palmd.model import shape_map, smoothing
    from palmd.observer.incremental import IncrementalSmoother

    described = _rig_of(json.loads(rig))
    smoother = IncrementalSmoother(described)
    next_one = 0.0
    smoothing.library(described.curved)
    shape_map.library(curved=described.curved)
    with meet(address, NICENESS) as socket:
        while True:
            object_count, begun, hint, events = msgpack.unpackb(socket.recv())
            smoother.add(
                Session(object_count, begun, hint and np.frombuffer(hint)), [unpacked(event) for event in events]
            )
            if socket.poll(0) or time.monotonic() < next_one:
                continue
            started = time.monotonic()
            said = smoother.said()
            ended = time.monotonic()
            next_one = max(started + period(smoother.elapsed_s), ended + (ended - started) * (1.0 / SHARE - 1.0))
            if isinstance(said, Unexplained):
                socket.send(msgpack.packb(said.t))
            elif said is not None:
                a = said
                arrays = (each.tobytes() for each in (a.touched, a.x, a.P, a.rig, a.rig_sd, a.spread, a.contradicted))
                socket.send(msgpack.packb([a.t, a.frame, a.established, *arrays]))
            give_back_memory()


def _rig_of(fields: dict[str, Any]) -> RigDescription:
    pads = tuple(PadSensor(**pad) for pad in fields["pads"])
    return RigDescription(**fields | {"base": tuple(fields["base"]), "pads": pads})
