"""Input and output types of the explorers, separate so that their users need not import an explorer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from palmd.motion.segments import Move

Kind = Literal["move", "wait", "safe", "unsafe", "done"]


@dataclass(frozen=True, slots=True)
class UnderWay:
    """The commanded move and the time since its start (s); the palms are at rest once that is its duration."""

    move: Move
    elapsed: float


@dataclass(frozen=True, slots=True)
class Decision:
    """An explorer's decision; kind `safe` only means that the move under way may continue.

    move: from the end of the move under way, from rest to rest. then: a move that may follow it if the next decision
    comes too late. reason: text. coverage: touched share of the reachable normals; reachable: their share of all
    normals. blind: the move was not predicted, and continues whether or not the estimate is valid.
    """

    kind: Kind
    move: Move | None = None
    reason: str = ""
    coverage: float = math.nan
    reachable: float = math.nan
    blind: bool = False
    then: Move | None = None
