"""The plan segment of an exploration: moves are appended while it runs."""

from __future__ import annotations

import math
from collections.abc import Iterator

from palmd.config.plans import ExploreGoal
from palmd.events import PalmMotion
from palmd.motion.segments import Angles, Move


class Exploration:
    """Executes its moves one after the other, then stands at the end of the last one, without end.

    Times are seconds since its start and must not decrease from call to call: a finished move is dropped when the next
    one is appended. Safe in the loop.
    """

    duration = math.inf

    def __init__(self, start: Angles, goal: ExploreGoal) -> None:
        """`start`: initial pose (rad). `goal` and `coverage` are stored for the explorer and for status reports."""
        self.goal = goal
        self.coverage = 0.0
        self._moves = [(0.0, Move(start, start, 0.0))]  # (start time, move)

    @property
    def last(self) -> Move:
        """The last move appended."""
        return self._moves[-1][1]

    @property
    def end(self) -> float:
        """When the last move ends (s)."""
        begins, move = self._moves[-1]
        return begins + move.duration

    def at(self, t: float) -> PalmMotion:
        """Return the motion at t (s)."""
        move, elapsed = self.under_way(t)
        return move.at(elapsed)

    def sample_times(self) -> Iterator[float]:
        """Return the start only; every move is checked when it is appended."""
        return iter((0.0,))

    def under_way(self, t: float) -> tuple[Move, float]:
        """Return the current move at t (s) and the time since its start (s), more than its duration once it ended."""
        for begins, move in reversed(self._moves):
            if begins <= t:
                return move, t - begins
        return self._moves[0][1], 0.0

    def append(self, move: Move, t: float) -> None:
        """Append a move, to start at t (s) or later; ValueError unless it starts where the last one ends."""
        if move.start != self.last.end:
            raise ValueError(f"a move from {move.start} cannot follow one to {self.last.end}")
        begins = max(t, self.end)
        self._moves = [each for each in self._moves if each[0] + each[1].duration > t] or self._moves[-1:]
        self._moves.append((begins, move))

    def cut(self, t: float) -> None:
        """Drop all motion after t (s) and stand at the pose of that time; only while the palms are at rest."""
        if t < self.end:
            here = self.at(t).angles
            self._moves = [(t, Move(here, here, 0.0))]
