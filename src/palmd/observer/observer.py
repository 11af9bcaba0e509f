"""What an observer is: a thing that takes events and a time and gives an estimate."""

from __future__ import annotations

from typing import Protocol

from palmd.events import (
    Estimate,
    Event,
    Improvement,
    LiveEstimate,
    ObjectEstimate,
    PlanningBelief,
    ShapeEstimate,
    Unexplained,
)


class LiveObserver(Protocol):
    """Events in, estimates out, of whichever system. All calls but `warm_up` take bounded time and are
    safe inside the loop.

    Per tick: `feed` what has come, `improve`, `estimate`; the rest as often as it is wanted, for that tick's time.
    Times are seconds on the events' clock and never run backwards.
    """

    @property
    def name(self) -> str:
        """As in estimates."""

    @property
    def backend(self) -> str:
        """What runs the models: "c", "vm" or "numpy"."""

    @property
    def object_count(self) -> int:
        """Counts up when a new object is begun."""

    @property
    def late_dropped(self) -> int:
        """Events that could not be fused: too late, or not finite."""

    @property
    def improvements(self) -> int:
        """How many of a smoother's answers have been taken in; 0 without one."""

    def warm_up(self) -> None:
        """Pay the costs of first calls now; ends as if nothing had been fed."""

    def forget_object(self) -> bool:
        """Begin a new object with the next readings, whatever is known of this one; False where that cannot be done."""

    def feed(self, event: Event) -> None:
        """Take one event, at its own time; one too late for that is counted and dropped."""

    def improve(self, t: float) -> object:
        """Exchange with the smoother beside the loop; what it has answered, each answer once. None without one."""

    def estimate(self, t: float) -> LiveEstimate:
        """The answer for time `t`; never raises, NaN where nothing is known."""

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline, None before anything is felt."""

    @property
    def foresees(self) -> bool:
        """Whether there is an outlook, of an estimate that need not be valid yet."""

    def planning_belief(self, t: float) -> object:
        """What is known for choosing motions, None unless it `foresees`."""

    @property
    def invalid_because(self) -> str:
        """Why the last estimate is not valid, with value and limit of what failed; empty when it is valid."""

    @property
    def cornered(self) -> bool:
        """Whether the object has been felt to have a corner, so that no outlook is right about it."""

    def identify(self, t: float) -> ObjectEstimate | None:
        """Which stored object it is, None before anything is felt and where none are stored."""


class Observer(LiveObserver, Protocol):
    """An observer of two palms on a hinge."""

    def improve(self, t: float) -> Improvement | Unexplained | None:
        """As above."""

    def estimate(self, t: float) -> Estimate:
        """As above."""

    def planning_belief(self, t: float) -> PlanningBelief | None:
        """As above."""
