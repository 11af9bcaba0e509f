"""The bank with a smoother at its side: estimates come from the bank, and what the smoother finds joins it.

The smoother works outside the loop, so what it finds is about a time that has passed. A newcomer filter starts there,
reads what has come since, a few events a tick, and then takes the place of the bank's worst filter.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Protocol

from palmd.events import Estimate, Event, Outlook, PadLift, RigDescription, ShapeEstimate
from palmd.observer.improver import Improvement, Improver
from palmd.observer.live import BankObserver, finite
from palmd.observer.newcomer import Newcomer

MEMORY_S = 4.0  # how long after its time an improvement can still be taken in
EVENTS_PER_TICK = 14  # beyond those that come in a tick, that a newcomer reads
LONGEST_S, KEPT_S = 60.0, 30.0  # of readings that the smoother is given at most, and keeps then


class Smoothing(Protocol):
    """Where the smoother runs; both calls return at once."""

    def submit(self, t: float, begun: float, events: Sequence[Event]) -> None:
        """The tick's time, when the present object was begun (inf while there is none), and the tick's events."""

    def collect(self, t: float) -> Improvement | None:
        """An improvement that is ready at `t`, each once."""


class ImprovedObserver:
    """A `BankObserver` that a smoother improves; `feed` and `estimate` are as safe inside the loop as its own."""

    def __init__(self, bank: BankObserver, rig: RigDescription, smoothing: Smoothing):
        """`bank` holds shape maps. `answered` is what the smoother had to say in the last `estimate`."""
        self._bank = bank
        self._smoothing = smoothing
        self._newcomer = Newcomer(rig)
        self._recent: deque[Event] = deque()
        self._batch: list[Event] = []
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
        begun = self._bank.begun
        self._smoothing.submit(t, begun, self._batch)
        self._batch.clear()
        improvement = self.answered = self._smoothing.collect(t)
        if improvement is not None and max(begun, t - MEMORY_S) < improvement.t <= t:
            self._newcomer.begin(improvement, self._recent)
        if self._newcomer.active and self._newcomer.follow(EVENTS_PER_TICK):
            self.improvements += self._bank.take_in(*self._newcomer.state_at(self._bank.t))
        return self._bank.estimate(t)

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline at time `t`, None before anything is felt."""
        return self._bank.shape(t)


class Readings:
    """The readings of the present object, as the smoother is given them."""

    def __init__(self) -> None:
        self._begun = float("inf")
        self.events: list[Event] = []

    def add(self, begun: float, events: Sequence[Event]) -> None:
        """Append; what came before the object was begun, or long ago, is dropped."""
        self.events += events
        if begun != self._begun:
            self._begun = begun
            self._keep_from(begun)
        if self.seconds > LONGEST_S:
            self._keep_from(self.events[-1].t_sample - KEPT_S)

    @property
    def seconds(self) -> float:
        """How long a time they cover."""
        return self.events[-1].t_sample - self.events[0].t_sample if self.events else 0.0

    def _keep_from(self, t: float) -> None:
        self.events = [event for event in self.events if event.t_sample >= t]


def period(seconds: float) -> float:
    """How long to wait from one start of the smoother to the next when there are `seconds` of readings (s)."""
    return min(max(seconds / 8.0, 0.25), 2.0)


class Simulated:
    """The smoother as it would run beside the loop, for replays.

    Deterministic: what is ready when depends on the log's time alone.
    """

    def __init__(self, rig: RigDescription, seed: int = 0, latency_s: float = 0.2):
        """Each run of the smoother is taken to last `latency_s` of the log's time."""
        self._improver = Improver(rig, seed)
        self._readings = Readings()
        self._latency = latency_s
        self._next = float("-inf")
        self._ready: tuple[float, Improvement | None] | None = None

    def submit(self, t: float, begun: float, events: Sequence[Event]) -> None:
        """Take the tick's events, and start when it is time."""
        self._readings.add(begun, events)
        if t >= self._next and self._ready is None:
            self._next = t + period(self._readings.seconds)
            self._ready = (t + self._latency, self._improver.improve(self._readings.events))

    def collect(self, t: float) -> Improvement | None:
        """What was started at least the latency ago."""
        if self._ready is None or t < self._ready[0]:
            return None
        improvement = self._ready[1]
        self._ready = None
        return improvement
