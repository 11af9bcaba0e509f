"""What loop and smoother tell each other, wherever the smoother runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from palmd.events import Event, FloatArray, Improvement, Unexplained


@dataclass(frozen=True, slots=True)
class Session:
    """Which object is on the palms, counted from 1, and since when (s, inf while there is none).

    `hint`: the state of `model.shape_map` that a bank of filters has settled on, if it has.
    """

    object_count: int
    begun: float
    hint: FloatArray | None = None


class Smoothing(Protocol):
    """Where the smoother runs; both calls return at once."""

    def submit(self, t: float, session: Session, events: Sequence[Event]) -> None:
        """The tick's time, which object is on the palms since when, and the tick's events."""

    def collect(self, t: float) -> Improvement | Unexplained | None:
        """An improvement, or the word that there is none, that is ready at `t`, each once."""


Answer = TypeVar("Answer", covariant=True)


class SmoothingOfOne(Protocol[Answer]):
    """Where the smoother of one object runs; nothing here keeps the loop waiting."""

    def submit(self, t: float, events: Sequence[Event]) -> None:
        """Hand the events of a tick over."""

    def collect(self, t: float) -> Answer | None:
        """The newest answer that has come by `t` (s), each once."""


def period(elapsed_s: float) -> float:
    """How long to wait from one answer of the smoother to the next, so long after the object was begun (s)."""
    return min(max(elapsed_s / 8.0, 0.25), 2.0)
