"""Interface between the loop and the smoother, wherever the smoother runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

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


def period(elapsed_s: float) -> float:
    """Time (s) between two answers of the smoother, `elapsed_s` after the object was put down."""
    return min(max(elapsed_s / 8.0, 0.25), 2.0)
