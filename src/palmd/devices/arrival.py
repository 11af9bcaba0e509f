"""Arrival time of a message's first byte, computed from read times and the line's baud rate."""

from __future__ import annotations

import math

BITS_PER_BYTE = 10
"""8N1: start bit, eight data bits, stop bit."""


def byte_time(baud: int) -> float:
    """Return the duration (s) of one byte at `baud` (bit/s). Raises ValueError if `baud` is not positive."""
    if baud <= 0:
        raise ValueError(f"baud must be positive, not {baud}")
    return BITS_PER_BYTE / baud


class FirstByteClock:
    """Timestamps the first byte of each message; the timestamps never decrease.

    A read shows that its last byte had arrived by then, and each byte before it at least one byte time earlier. So
    each read gives an upper bound of the first byte's arrival time; the smallest bound is the timestamp.
    """

    def __init__(self, baud: int) -> None:
        self._byte_s = byte_time(baud)
        self._t_first = -math.inf
        self._t_floor = -math.inf

    def begin(self, t_recv: float, bytes_after: int) -> None:
        """Begin a message whose first byte is followed by `bytes_after` bytes in the read at `t_recv` (s)."""
        self._t_first = max(self._t_floor, t_recv - bytes_after * self._byte_s)

    def more(self, t_recv: float, bytes_after: int) -> None:
        """Use a further read at `t_recv` (s), which ends `bytes_after` bytes after the message's first byte."""
        self._t_first = max(self._t_floor, min(self._t_first, t_recv - bytes_after * self._byte_s))

    def end(self) -> float:
        """End the message and return its first byte's time (s), not before the time returned last."""
        self._t_floor = self._t_first
        return self._t_first
