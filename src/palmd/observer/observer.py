"""The interface of observers: events in, estimates for requested times out."""

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
    """An observer of any system. All calls except `warm_up` take bounded time and are safe inside the loop.

    Each tick: `feed` the new events, `improve`, `estimate`; the other calls as needed, for that tick's time. Times are
    seconds on the events' clock and never decrease.
    """

    @property
    def name(self) -> str:
        """Name of the observer, as in estimates."""

    @property
    def backend(self) -> str:
        """The backend that evaluates the models: "c", "vm" or "numpy"."""

    @property
    def object_count(self) -> int:
        """Number of the present object; increases when a new object is started."""

    @property
    def late_dropped(self) -> int:
        """Number of events that could not be fused: too late, or not finite."""

    @property
    def improvements(self) -> int:
        """Number of a smoother's improvements that have been used; 0 without a smoother."""

    def warm_up(self) -> None:
        """Pay the costs of first calls now; ends as if nothing had been fed."""

    def forget_object(self) -> bool:
        """Start a new object with the next readings and forget this one; False if that is not possible."""

    def feed(self, event: Event) -> None:
        """Take one event, at its own time; an event that is too late is counted and dropped."""

    def improve(self, t: float) -> object:
        """Exchange data with the smoother beside the loop; returns each of its results once, None without one."""

    def estimate(self, t: float) -> LiveEstimate:
        """The estimate for time `t`; never raises, NaN where nothing is known."""

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline, None while there is no object."""

    @property
    def has_planning_belief(self) -> bool:
        """Whether there is a belief for planning; the estimate need not be valid yet."""

    def planning_belief(self, t: float) -> object:
        """The belief for planning motions, None unless `has_planning_belief`."""

    @property
    def invalid_because(self) -> str:
        """Why the last estimate is not valid, with value and limit of what failed; empty when it is valid."""

    @property
    def cornered(self) -> bool:
        """Whether a corner has been detected, so that no planning belief of a smooth outline is valid."""

    def identify(self, t: float) -> ObjectEstimate | None:
        """Which stored object it is, None while there is no object or if none are stored."""


class Observer(LiveObserver, Protocol):
    """An observer of two palms on a hinge."""

    def improve(self, t: float) -> Improvement | Unexplained | None:
        """As `LiveObserver.improve`."""

    def estimate(self, t: float) -> Estimate:
        """As `LiveObserver.estimate`."""

    def planning_belief(self, t: float) -> PlanningBelief | None:
        """As `LiveObserver.planning_belief`."""
