"""The smoother in a process beside the loop.

Events that the process does not take are kept for some seconds, then dropped. The process sleeps most of the time, so
that a rig with two cores keeps one for itself; the smoother of three palms computes in a separate thread and may use a
whole core.
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

from palmd.daemon.worker import WorkerProcess, release_memory, worker_socket
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
    """The loop's side of a smoother process; `collect` is safe inside the loop, restarting the process takes 1 ms."""

    def __init__(self, module: str, rig: Mapping[str, Any], answer_of: Callable[..., Answer]) -> None:
        """Start a process that runs `serve` of `module` with the rig's fields as JSON; raises OSError if that fails.

        `answer_of` constructs an answer from what `work` sends.
        """
        self._process = WorkerProcess("smoother", module, json.dumps(rig), high_water=HIGH_WATER)
        self._answer_of = answer_of
        self._waiting: list[list[Any]] = []
        self._t_sent = -math.inf
        self.dropped = 0

    @property
    def starts(self) -> int:
        """How often the process was started."""
        return self._process.starts

    def tend(self, t: float) -> None:
        """Restart the process at `t` (s) if it does not run; see `WorkerProcess.tend`."""
        self._process.tend(t)

    def conditions(self, t: float) -> Iterator[str]:
        """The fault codes whose condition holds at `t` (s)."""
        if self._process.silent(t):
            yield "smoother-silent"

    def _hand_over(self, t: float, events: Sequence[Event], *head: Any) -> None:
        """Send the events of a few ticks together, after the newest `head`; call in the tick at `t` (s)."""
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
        """The newest answer that has arrived."""
        del t  # it is ready when it is here
        newest: Answer | None = None
        for message in self._process.received():
            newest = self._answer_of(*msgpack.unpackb(message))
        return newest

    def close(self) -> None:
        """Stop the process."""
        self._process.close()


class SmootherProcess(BatchingProcess[Improvement | Unexplained]):
    """Smoother process for two palms; safe inside the loop."""

    def __init__(self, rig: RigDescription) -> None:
        """Start the process; raises OSError if that fails."""
        super().__init__(__name__, asdict(rig), _unpacked_answer)

    def submit(self, t: float, session: Session, events: Sequence[Event]) -> None:
        """Send the events of the tick."""
        hint = None if session.hint is None else session.hint.tobytes()
        self._hand_over(t, events, session.object_count, session.start_time, hint)


def packed(event: Event) -> list[Any]:
    """An event as a list for a message to a process."""
    kind, get_fields = _PACKED[type(event)]
    return [kind, *get_fields(event)]


def unpacked(fields: list[Any]) -> Event:
    """The event that `packed` was given."""
    event: Event = _KINDS[fields[0]](*fields[1:])
    return event


def work(
    address: str,
    add: Callable[..., None],
    answer: Callable[[], list[Any] | None],
    period_s: Callable[[], float],
) -> None:
    """Main loop of a process, endless: `add` what arrives, `answer` at most every `period_s`."""
    t_next = 0.0
    with worker_socket(address, NICENESS) as socket:
        while True:
            *head, events = msgpack.unpackb(socket.recv())
            add(*head, [unpacked(event) for event in events])
            if socket.poll(0) or time.monotonic() < t_next:
                continue
            started, spent = time.monotonic(), time.process_time()
            result = answer()
            spent = time.process_time() - spent  # what it waited for on a busy machine, others have had
            t_next = started + max(period_s(), spent / SHARE)
            if result is not None:
                socket.send(msgpack.packb(result))
                release_memory()  # not beside a thought: the collector stops it, for a third of its time


def rig_from_json(rig: str, kind: type[Rig]) -> Rig:
    """The rig description from its fields as JSON, nested dataclasses included."""
    from pydantic import TypeAdapter  # in the process alone

    return TypeAdapter(kind).validate_json(rig)


def serve(address: str, rig: str) -> None:
    """Main function of the process, endless; `rig` holds the description's fields as JSON."""
    # in this process alone: the loop's has no use for them
    from palmd.model import shape_map, smoothing
    from palmd.observer.incremental import IncrementalSmoother

    description = rig_from_json(rig, RigDescription)
    smoother = IncrementalSmoother(description)
    smoothing.library(description.curved)
    shape_map.library(curved=description.curved)

    def add(object_count: int, begun: float, hint: bytes | None, events: list[Event]) -> None:
        smoother.add(Session(object_count, begun, None if hint is None else np.frombuffer(hint)), events)

    def answer() -> list[Any] | None:
        result = smoother.result()
        if result is None:
            return None
        if isinstance(result, Unexplained):
            return [result.t]
        return [result.t, result.frame, result.established, *(each.tobytes() for each in _arrays_of(result))]

    work(address, add, answer, lambda: period(smoother.elapsed_s))


_arrays_of = attrgetter("touched", "x", "P", "rig", "rig_sd", "spread", "contradicted")


def _unpacked_answer(t: float, *fields: Any) -> Improvement | Unexplained:
    if not fields:
        return Unexplained(t)
    frame, established, touched, *arrays = fields
    x, covariance, rig, rig_sd, spread, against = map(np.frombuffer, arrays)
    square, beyond = covariance.reshape(len(x), -1), spread.reshape(-1, len(rig))
    marks = np.frombuffer(touched, dtype=np.bool_)
    return Improvement(t, x, square, frame, established, marks, rig, rig_sd, beyond, against)
