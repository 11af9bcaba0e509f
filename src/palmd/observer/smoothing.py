"""Interface between the loop and the smoother, wherever the smoother runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from palmd.events import Event, FloatArray, Improvement, Unexplained


@dataclass(frozen=True, slots=True)
class Session:
    """Number of the object on the palms, counted from 1, and since when it is there (s, inf while there is none).

    hint: state of `model.shape_map` on which a bank of filters has settled, if it has.
    """

    object_count: int
    start_time: float
    hint: FloatArray | None = None


class Smoothing(Protocol):
    """A running smoother; both calls return at once."""

    def submit(self, t: float, session: Session, events: Sequence[Event]) -> None:
        """Pass the tick's time, the session and the tick's events."""

    def collect(self, t: float) -> Improvement | Unexplained | None:
        """The answer that is ready at `t` (s), an improvement or that there is none; each answer once."""


Answer = TypeVar("Answer", covariant=True)


class SmoothingOfOne(Protocol[Answer]):
    """A running smoother of one object; the calls never block the loop."""

    def submit(self, t: float, events: Sequence[Event]) -> None:
        """Pass the events of a tick."""

    def collect(self, t: float) -> Answer | None:
        """The newest answer at `t` (s), each once."""


class SimulatedSmoothingOfOne(Generic[Answer]):
    """Simulates a smoother that runs beside the loop: an answer comes some time after it was begun."""

    def __init__(
        self, add: Callable[[Sequence[Event]], None], answer: Callable[[], Answer | None],
        latency_s: Callable[[Answer, Answer | None], float], period_s: float = 0.0,
    ) -> None:  # fmt: skip
        """`latency_s`: of an answer, from it and the one before. `period_s`: of answers, or longer; inf for none."""
        self._add, self._answer, self._latency_s, self._period = add, answer, latency_s, period_s
        self._next = -math.inf if math.isfinite(period_s) else math.inf
        self._newest: Answer | None = None
        self._ready = math.inf  # when the newest answer is ready; infinite once it was taken

    def submit(self, t: float, events: Sequence[Event]) -> None:
        """Add the tick's events, and begin an answer if one is due and none is pending."""
        self._add(events)
        if t < self._next or math.isfinite(self._ready):
            return
        self._next = t + self._period
        answer = self._answer()
        if answer is not None:
            self._ready = t + self._latency_s(answer, self._newest)
            self._newest = answer

    def collect(self, t: float) -> Answer | None:
        """The answer whose latency has passed at `t` (s), once."""
        if t < self._ready:
            return None
        self._ready = math.inf
        return self._newest


def period(elapsed_s: float) -> float:
    """Time (s) between two answers of the smoother, which has followed an object for `elapsed_s`, or searches (0)."""
    return min(max(elapsed_s / 8.0, 0.25), 2.0)
