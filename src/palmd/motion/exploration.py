"""Moves strung together as they are decided: the one segment of a plan that is not known beforehand."""

from __future__ import annotations

import math
from collections.abc import Iterator

from palmd.config.plans import ExploreGoal
from palmd.events import PalmMotion
from palmd.motion.segments import Angles, Move


class Exploration:
    """Goes through its moves one after the other and stands where the last one ended, for ever.

    Times are seconds since it began and must not run backwards from call to call: a move that is over is
    forgotten when the next one is appended. Everything is safe in the loop.
    """

    duration = math.inf

    def __init__(self, start: Angles, goal: ExploreGoal) -> None:
        """`start` is where it stands at first (rad); `goal` and `coverage` are kept for who decides and who asks."""
        self.goal = goal
        self.coverage = 0.0
        self._moves = [(0.0, Move(start, start, 0.0))]  # each with the time when it begins

    @property
    def last(self) -> Move:
        """The move after which it stands."""
        return self._moves[-1][1]

    @property
    def end(self) -> float:
        """When the last move ends (s)."""
        begins, move = self._moves[-1]
        return begins + move.duration

    def at(self, t: float) -> PalmMotion:
        """The motion t (s) after the beginning."""
        move, elapsed = self.under_way(t)
        return move.at(elapsed)

    def sample_times(self) -> Iterator[float]:
        """Only where it begins is known beforehand; every move is checked when it is decided."""
        return iter((0.0,))

    def under_way(self, t: float) -> tuple[Move, float]:
        """The move in hand at t (s) and how long ago it began (s); longer than it takes when it is over."""
        for begins, move in reversed(self._moves):
            if begins <= t:
                return move, t - begins
        return self._moves[0][1], 0.0

    def append(self, move: Move, t: float) -> None:
        """Let a move follow the last one, at t (s) at the earliest; ValueError unless it starts where that one ends."""
        if move.start != self.last.end:
            raise ValueError(f"a move from {move.start} cannot follow one to {self.last.end}")
        begins = max(t, self.end)
        self._moves = [each for each in self._moves if each[0] + each[1].duration > t] or self._moves[-1:]
        self._moves.append((begins, move))

    def cut(self, t: float) -> None:
        """Drop what was to come after t (s) and stand where it is then: only while nothing moves along this path."""
        if t < self.end:
            here = self.at(t).angles
            self._moves = [(t, Move(here, here, 0.0))]
