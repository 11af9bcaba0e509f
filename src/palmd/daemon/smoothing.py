"""The smoother in a process of its own beside the loop.

What the process cannot take at once is kept for some seconds, then dropped. It sleeps most of the time, so that a rig
with two cores keeps one for itself; that of three palms thinks in a thread beside, and may take a core whole.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from operator import attrgetter
from typing import Any, Generic, TypeVar

import msgpack
import numpy as np

from palmd.daemon.worker import WorkerProcess, give_back_memory, meet
from palmd.events import Event, Improvement, PadLift, PadSample, PalmSample, Unexplained
from palmd.observer.smoothing import Session, period
from palmd.system.description import RigDescription

BATCH_S = 0.05  # of events that go out in one message
HIGH_WATER = 100  # messages on their way: five seconds
KEPT_EVENTS = 1000  # for a process that does not take them: some four seconds; packing them takes 1 ms
SHARE = 0.8  # of one core, at most (study 2026-11-30: at 0.5 hard motions leave 5 s between two answers)
NICENESS = 3  # after the loop, but not so far behind others that its answers come too late

Answer = TypeVar("Answer")
Rig = TypeVar("Rig")
_KINDS: tuple[type[PadSample] | type[PadLift] | type[PalmSample], ...] = (PadSample, PadLift, PalmSample)
_PACKED = {each: (kind, attrgetter(*each.__slots__)) for kind, each in enumerate(_KINDS)}


class BatchingProcess(Generic[Answer]):
    """The loop's end of a smoother; `collect` is safe inside the loop, starting the process again takes it 1 ms."""

    def __init__(self, module: str, rig: Mapping[str, Any], answer_of: Callable[..., Answer]) -> None:
        """Start a process with `module`, whose `serve` gets the rig's fields as JSON; raises OSError when it cannot be.

        `answer_of` makes an answer of what `work` sends.
        """
        self._process = WorkerProcess("smoother", module, json.dumps(rig), high_water=HIGH_WATER)
        self._answer_of = answer_of
        self._waiting: list[list[Any]] = []
        self._t_sent = -math.inf
        self.dropped = 0

    @property
    def starts(self) -> int:
        """How often the process has been started."""
        return self._process.starts

    def tend(self, t: float) -> None:
        """Start the process again at `t` (s) if it does not run; see `WorkerProcess.tend`."""
        self._process.tend(t)

    def conditions(self, t: float) -> Iterator[str]:
        """The codes of the fault table that hold at `t` (s)."""
        if self._process.silent(t):
            yield "smoother-silent"

    def _hand_over(self, t: float, events: Sequence[Event], *head: Any) -> None:
        """Of the tick at `t` (s): the events of a few ticks go together, behind the newest `head`."""
        self._waiting += [packed(event) for event in events]
        if t - self._t_sent < BATCH_S:
            return
        self._t_sent = t
        if self._process.send(msgpack.packb([*head, self._waiting])):
            self._waiting = []
            return
        lost = len(self._waiting) - KEPT_EVENTS
        if lost > 0:
            del self._waiting[:lost]
            self.dropped += lost

    def collect(self, t: float) -> Answer | None:
        """The newest answer that has come."""
        del t  # it is ready when it is here
        newest: Answer | None = None
        for message in self._process.received():
            newest = self._answer_of(*msgpack.unpackb(message))
        return newest

    def close(self) -> None:
        """End the process."""
        self._process.close()


class SmootherProcess(BatchingProcess[Improvement | Unexplained]):
    """Of two palms; safe inside the loop."""

    def __init__(self, rig: RigDescription) -> None:
        """Start the process; raises OSError when it cannot be."""
        super().__init__(__name__, asdict(rig), _told)

    def submit(self, t: float, session: Session, events: Sequence[Event]) -> None:
        """Hand the tick's events over."""
        hint = None if session.hint is None else session.hint.tobytes()
        self._hand_over(t, events, session.object_count, session.begun, hint)


def packed(event: Event) -> list[Any]:
    """An event for a message to a process."""
    kind, told_of = _PACKED[type(event)]
    return [kind, *told_of(event)]


def unpacked(fields: list[Any]) -> Event:
    """The event that was packed."""
    event: Event = _KINDS[fields[0]](*fields[1:])
    return event


def work(
    address: str,
    add: Callable[..., None],
    answer: Callable[[], list[Any] | None],
    period_s: Callable[[], float],
) -> None:
    """A process's work, for ever: `add` what was handed over, `answer` every `period_s` at most."""
    next_one = 0.0
    with meet(address, NICENESS) as socket:
        while True:
            *head, events = msgpack.unpackb(socket.recv())
            add(*head, [unpacked(event) for event in events])
            if socket.poll(0) or time.monotonic() < next_one:
                continue
            started, spent = time.monotonic(), time.process_time()
            said = answer()
            spent = time.process_time() - spent  # what it waited for on a busy machine, others have had
            next_one = started + max(period_s(), spent / SHARE)
            if said is not None:
                socket.send(msgpack.packb(said))
                give_back_memory()  # not beside a thought: the collector stops it, for a third of its time


def rig_from_json(rig: str, kind: type[Rig]) -> Rig:
    """The rig of which a process was given the fields as JSON, nested dataclasses included."""
    from pydantic import TypeAdapter  # in the process alone

    return TypeAdapter(kind).validate_json(rig)


def serve(address: str, rig: str) -> None:
    """The process's work, for ever; `rig` is the description's fields as JSON."""
    # in this process alone: the loop's has no use for them
    from palmd.model import shape_map, smoothing
    from palmd.observer.incremental import IncrementalSmoother

    described = rig_from_json(rig, RigDescription)
    smoother = IncrementalSmoother(described)
    smoothing.library(described.curved)
    shape_map.library(curved=described.curved)

    def add(object_count: int, begun: float, hint: bytes | None, events: list[Event]) -> None:
        smoother.add(Session(object_count, begun, None if hint is None else np.frombuffer(hint)), events)

    def answer() -> list[Any] | None:
        a = smoother.result()
        if a is None:
            return None
        if isinstance(a, Unexplained):
            return [a.t]
        arrays = (each.tobytes() for each in (a.touched, a.x, a.P, a.rig, a.rig_sd, a.spread, a.contradicted))
        return [a.t, a.frame, a.established, *arrays]

    work(address, add, answer, lambda: period(smoother.elapsed_s))


def _told(t: float, *fields: Any) -> Improvement | Unexplained:
    if not fields:
        return Unexplained(t)
    frame, established, touched, *arrays = fields
    x, covariance, rig, rig_sd, spread, against = map(np.frombuffer, arrays)
    square, beyond = covariance.reshape(len(x), -1), spread.reshape(-1, len(rig))
    marks = np.frombuffer(touched, dtype=np.bool_)
    return Improvement(t, x, square, frame, established, marks, rig, rig_sd, beyond, against)
