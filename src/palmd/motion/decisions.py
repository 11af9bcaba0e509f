"""What is asked of an explorer and what it says, apart from it: who only asks need not load it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from palmd.motion.segments import Move

Kind = Literal["move", "wait", "safe", "unsafe", "done"]


@dataclass(frozen=True, slots=True)
class UnderWay:
    """What the palms are commanded to do: a move, and for how long already (s); at rest when that is its duration."""

    move: Move
    elapsed: float


@dataclass(frozen=True, slots=True)
class Decision:
    """What to do next; `safe` says no more than that the move under way may go on.

    move: from where the one under way ends, from rest to rest. then: what may follow that unseen, for whom the next
    decision would come too late. reason: in words. coverage: the share touched of the normals that can be reached;
    reachable: their share of all. blind: nothing was foreseen, so that the move goes on whether or not the object is
    known.
    """

    kind: Kind
    move: Move | None = None
    reason: str = ""
    coverage: float = math.nan
    reachable: float = math.nan
    blind: bool = False
    then: Move | None = None
