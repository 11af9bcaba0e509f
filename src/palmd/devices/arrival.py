"""When a message's first byte arrived, from read times and the line's speed."""

from __future__ import annotations

import math

BITS_PER_BYTE = 10
"""8N1: start bit, eight data bits, stop bit."""


def byte_time(baud: int) -> float:
    """Return how long (s) one byte takes at `baud` (bit/s). Raises ValueError if not positive."""
    if baud <= 0:
        raise ValueError(f"baud must be positive, not {baud}")
    return BITS_PER_BYTE / baud


class FirstByteClock:
    """Dates the first byte of one message after another; the times it gives never run backwards.

    A read only proves that its last byte had arrived by then, and each byte before it one byte time sooner.
    So every read gives an upper bound on the first byte's arrival, and the earliest bound is the best.
    """

    def __init__(self, baud: int) -> None:
        self._byte_s = byte_time(baud)
        self._t_first = -math.inf
        self._t_floor = -math.inf

    def begin(self, t_recv: float, bytes_after: int) -> None:
        """A message begins with a byte that `bytes_after` bytes of the read at `t_recv` (s) came after."""
        self._t_first = max(self._t_floor, t_recv - bytes_after * self._byte_s)

    def more(self, t_recv: float, bytes_after: int) -> None:
        """A further read at `t_recv` (s) ends `bytes_after` bytes after the message's first byte."""
        self._t_first = max(self._t_floor, min(self._t_first, t_recv - bytes_after * self._byte_s))

    def end(self) -> float:
        """The message is complete: return its first byte's time (s), at or after the one returned before."""
        self._t_floor = self._t_first
        return self._t_first
