"""Hypotheses about which object is on the palms: a known one, or one never touched before."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, auto
from typing import Protocol

import numpy as np
import numpy.typing as npt

from palmd.events import ObjectEstimate
from palmd.observer.bank import Belief
from palmd.observer.filters.base import Filters
from palmd.observer.fusion import Pruning
from palmd.observer.track import Track


class Verdict(Enum):
    """What the readings so far decide."""

    OPEN = auto()  # no estimate is valid yet
    DECIDED = auto()
    REJECTED = auto()  # it is another object than assumed; tracking restarts with that


class Hypotheses(Protocol):
    """Hypotheses of an observer. All calls are safe inside the loop; `begin` takes some milliseconds."""

    pruning: Pruning
    one_gauge: bool
    """Whether all filters share one gauge of ψ; else ψ of two filters cannot be compared."""

    @property
    def banks(self) -> Sequence[Filters]:
        """All banks that are ever used; the one for unknown objects is first."""

    def reset(self) -> None:
        """Forget all objects."""

    def choose(self) -> Filters:
        """The bank with which to start tracking the next object."""

    def begin(self, track: Track, t: float) -> bool:
        """Replace blind filters of a track at `t` (s) by those for known objects; whether the object counts as new."""

    def constants(self, track: Track) -> Belief:
        """Prior of each filter's constants at the start."""

    def renumber(self, kept: npt.NDArray[np.intp]) -> None:
        """Update after the bank was pruned; `kept`: former numbers of the filters that stay."""

    def decide(self, track: Track, t: float, settled: bool) -> Verdict:
        """The decision at `t` (s); `settled`: whether the estimate passes the tests."""

    def keep(self, track: Track, t: float) -> None:
        """Remember what is to be remembered of the valid estimate at `t` (s)."""

    def lost(self, track: Track) -> None:
        """Handle that the readings contradict all that is believed of the object."""

    def identify(self, t: float, object_count: int) -> ObjectEstimate | None:
        """Which of the stored objects is on the palms at `t` (s); None where none are stored."""
