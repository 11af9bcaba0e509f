"""Judging a device by its error counters. Pure."""

from __future__ import annotations


class Share:
    """The share of bad ones among what two counters have gained since the last look; `spoilt` of `gained` then."""

    def __init__(self, most: float, least: int) -> None:
        """Too many are more than the share `most`, among `least` or more."""
        self.gained = self.spoilt = 0
        self._most, self._least = most, least
        self._all = self._bad = 0

    def exceeded(self, total: int, bad: int) -> bool:
        """Whether there were too many; the counters only ever grow."""
        self.gained, self.spoilt = total - self._all, bad - self._bad
        self._all, self._bad = total, bad
        return self.gained >= self._least and self.spoilt > self._most * self.gained

    def told(self, what: str) -> str:
        """How many were bad, in words; `what` they are."""
        return f"{self.spoilt} of {self.gained} {what} since the last look"


def ago(seconds: float) -> str:
    """An age in words."""
    return f"{seconds * 1e3:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s"


def last_report(t_last: float | None, t: float) -> str:
    """How old the last report, of `t_last` (s), is at `t` (s)."""
    return "no packet has come yet" if t_last is None else f"its last packet is {ago(t - t_last)} old"


def bytes_since(count: int) -> str:
    """How many bytes have come since the last report, in words."""
    return f"{count} bytes have come since, which are no packet" if count else "not a byte has come since"
