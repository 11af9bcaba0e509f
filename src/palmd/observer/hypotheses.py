"""Which object it is: what is believed of it beforehand, besides that it is one never felt, and what is decided."""

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
    """What the readings so far say of the hypotheses."""

    OPEN = auto()  # no estimate is valid yet
    DECIDED = auto()
    REJECTED = auto()  # it is another object than was believed, and to be begun as one


class Hypotheses(Protocol):
    """All calls are safe inside the loop; `begin` takes some milliseconds."""

    pruning: Pruning
    one_gauge: bool
    """Whether all filters have the same: else each has its own, and ψ of one means nothing beside another's."""

    @property
    def banks(self) -> Sequence[Filters]:
        """All that are ever used, the one for objects never felt before first."""

    def reset(self) -> None:
        """As if no object had ever been felt."""

    def choose(self) -> Filters:
        """The bank that the next object is to be begun with."""

    def begin(self, track: Track, t: float) -> bool:
        """Let filters of a track at `t` (s), all of them blind, begin otherwise; whether it counts as a new object."""

    def constants(self, track: Track) -> Belief:
        """What was believed of each filter's constants at the start."""

    def renumber(self, kept: npt.NDArray[np.intp]) -> None:
        """The bank has been pruned: the former numbers of the filters that stay."""

    def decide(self, track: Track, t: float, settled: bool) -> Verdict:
        """What is decided at `t` (s), where the estimate is `settled` or not."""

    def keep(self, track: Track, t: float) -> None:
        """The estimate at `t` (s) is valid: remember what is to be remembered."""

    def lost(self, track: Track) -> None:
        """The readings contradict all that was believed of the object."""

    def identify(self, t: float, object_count: int) -> ObjectEstimate | None:
        """Which of several stored objects the one on the palms is at `t` (s); None where none are stored."""
