"""What live observers of one object, whose outline or motion a smoother beside the loop estimates, have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

from palmd.events import Event
from palmd.observer.smoothing import SmoothingOfOne

Answer = TypeVar("Answer")


class ObserverOfOne(ABC, Generic[Answer]):
    """See the module and `observer.observer.LiveObserver`. Knows smooth objects only and recognises none. Loop-safe."""

    def __init__(self, name: str, smoothing: SmoothingOfOne[Answer]) -> None:
        self.name = name
        self.object_count, self.late_dropped, self.improvements = 1, 0, 0
        self._smoothing = smoothing
        self._unsent: list[Event] = []
        self.invalid_because = ""  # reason of the last estimate, in words; empty if it was valid

    def improve(self, t: float) -> Answer | None:
        """Send events to the smoother beside the loop and take its answer; returns each answer once."""
        events, self._unsent = self._unsent, []
        self._smoothing.submit(t, events)
        answer = self._smoothing.collect(t)
        if answer is not None:
            self.improvements += 1
            self._take_answer(answer)
        return answer

    @abstractmethod
    def _take_answer(self, answer: Answer) -> None:
        """Use an answer of the smoother."""

    @property
    def cornered(self) -> bool:
        """Always False: only smooth objects are modelled."""
        return False

    def forget_object(self) -> bool:
        """Not supported: returns False."""
        return False

    def identify(self, t: float) -> None:
        """Not supported: no objects are stored."""
        del t
