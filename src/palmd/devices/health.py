"""Judging a device by its error counters. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

Limits = Mapping[str, tuple[float, int, str]]
"""By condition: the share that is too many when it is exceeded, among how many or more, and what they are."""

CUT_BYTES = 11
"""Of the longest packet, a strip's, when a port is opened in the middle of it: no damage."""

SERIAL_PAD: Limits = {
    "garbled": (0.2, 5 * CUT_BYTES, "bytes"),
    "out-of-range": (0.2, 10, "packets"),
    "batched": (0.5, 10, "packets"),
}


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


class Shares:
    """The conditions that hold by such limits, as they were at the last look."""

    def __init__(self, limits: Limits) -> None:
        self._what = {condition: what for condition, (_, _, what) in limits.items()}
        self._shares = {condition: Share(most, least) for condition, (most, least, _) in limits.items()}
        self._standing: tuple[str, ...] = ()

    def look(self, counted: Mapping[str, tuple[int, int]]) -> None:
        """Judge anew, by condition: how many there were since the start, and how many bad ones."""
        self._standing = tuple(each for each, counts in counted.items() if self._shares[each].exceeded(*counts))

    def __iter__(self) -> Iterator[str]:
        return iter(self._standing)

    def told(self, condition: str) -> str:
        """How many were bad, in words; nothing of a condition that is no share."""
        return self._shares[condition].told(self._what[condition]) if condition in self._shares else ""


def ago(seconds: float) -> str:
    """An age in words."""
    return f"{seconds * 1e3:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s"


def last_report(t_last: float | None, t: float) -> str:
    """How old the last report, of `t_last` (s), is at `t` (s)."""
    return "no packet has come yet" if t_last is None else f"its last packet is {ago(t - t_last)} old"


def bytes_since(count: int) -> str:
    """How many bytes have come since the last report, in words."""
    return f"{count} bytes have come since, which are no packet" if count else "not a byte has come since"
