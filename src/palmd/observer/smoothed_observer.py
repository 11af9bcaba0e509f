"""A live observer with a smoother at its side: the smoother knows the object, one filter carries that to the present.

The smoother works outside the loop, so what it finds is about a time that has passed. A newcomer filter starts there,
reads what has come since, a few events a tick, and then takes over. The bank is for beginnings.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Protocol

from palmd.events import Estimate, Event, Improvement, Outlook, PadLift, ShapeEstimate
from palmd.observer.bank_observer import BankObserver, finite
from palmd.observer.filter_catchup import FilterCatchUp
from palmd.observer.incremental import IncrementalSmoother, Session
from palmd.system.description import RigDescription

MEMORY_S = 30.0  # how long after its time an improvement can still be taken in: on a busy machine answers come late
EVENTS_PER_TICK = 14  # beyond those that come in a tick, that a newcomer reads


class Smoothing(Protocol):
    """Where the smoother runs; both calls return at once."""

    def submit(self, t: float, session: Session, events: Sequence[Event]) -> None:
        """The tick's time, which object is on the palms since when, and the tick's events."""

    def collect(self, t: float) -> Improvement | None:
        """An improvement that is ready at `t`, each once."""


class SmoothedObserver:
    """A `BankObserver` that a smoother improves; `feed` and `estimate` are as safe inside the loop as its own."""

    def __init__(self, bank: BankObserver, rig: RigDescription, smoothing: Smoothing):
        """`bank` holds shape maps. `answered` is what the smoother had to say in the last `estimate`."""
        self._bank = bank
        self._smoothing = smoothing
        self._newcomer = FilterCatchUp(rig)
        self._recent: deque[Event] = deque()
        self._batch: list[Event] = []
        self._awaited: Improvement | None = None
        self.improvements = 0
        self.answered: Improvement | None = None

    @property
    def name(self) -> str:
        """As in estimates."""
        return self._bank.name

    @property
    def backend(self) -> str:
        """What runs the models: "c" or "vm"."""
        return self._bank.backend

    @property
    def object_count(self) -> int:
        """Counts up when a new object is begun."""
        return self._bank.object_count

    @property
    def late_dropped(self) -> int:
        """Events too late to be fused, or not finite."""
        return self._bank.late_dropped

    @property
    def foresees(self) -> bool:
        """Whether there is an outlook."""
        return self._bank.foresees

    def outlook(self, t: float) -> Outlook | None:
        """What the bank knows of the object at `t` (s), for choosing motions."""
        return self._bank.outlook(t)

    def warm_up(self) -> None:
        """Pay the costs of first calls now."""
        self._bank.warm_up()

    def feed(self, event: Event) -> None:
        """Take one event; one that the bank counts as not finite goes no further."""
        self._bank.feed(event)
        if not isinstance(event, PadLift) and not finite(event):
            return
        self._batch.append(event)
        self._recent.append(event)
        while self._recent[0].t_sample < event.t_sample - MEMORY_S:
            self._recent.popleft()
        if self._newcomer.active:
            self._newcomer.hear(event)

    def estimate(self, t: float) -> Estimate:
        """The answer for time `t`."""
        session = Session(self._bank.object_count, self._bank.begun, self._bank.hint)
        self._smoothing.submit(t, session, self._batch)
        self._batch.clear()
        improvement = self.answered = self._smoothing.collect(t)
        if improvement is not None and max(session.begun, t - MEMORY_S) < improvement.t <= t:
            self._newcomer.begin(improvement, self._recent)
            self._awaited = improvement
        if self._awaited is not None and self._newcomer.active and self._newcomer.follow(EVENTS_PER_TICK):
            self.improvements += self._bank.take_in(self._awaited, *self._newcomer.state_at(self._bank.t))
        return self._bank.estimate(t)

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline at time `t`, None before anything is felt."""
        return self._bank.shape(t)


def period(elapsed_s: float) -> float:
    """How long to wait from one answer of the smoother to the next, so long after the object was begun (s)."""
    return min(max(elapsed_s / 8.0, 0.25), 2.0)


class Simulated:
    """The smoother as it would run beside the loop, for replays.

    Deterministic: what is ready when depends on the log's time alone.
    """

    def __init__(self, rig: RigDescription, seed: int = 0, latency_s: float = 0.2):
        """Each run of the smoother is taken to last `latency_s` of the log's time."""
        self._smoother = IncrementalSmoother(rig, seed)
        self._latency = latency_s
        self._next = -math.inf
        self._ready: tuple[float, Improvement | None] | None = None

    def submit(self, t: float, session: Session, events: Sequence[Event]) -> None:
        """Take the tick's events, and start when it is time."""
        self._smoother.add(session, events)
        if t >= self._next and self._ready is None:
            self._next = t + period(t - session.begun)
            self._ready = (t + self._latency, self._smoother.answer())

    def collect(self, t: float) -> Improvement | None:
        """What was started at least the latency ago."""
        if self._ready is None or t < self._ready[0]:
            return None
        improvement = self._ready[1]
        self._ready = None
        return improvement
