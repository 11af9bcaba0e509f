"""Counters of a device, and its fault conditions derived from them. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass

Limits = Mapping[str, tuple[float, int, str]]
"""For each condition: the largest acceptable share of errors, the smallest count it is evaluated for, and the unit."""

CUT_BYTES = 11
"""Bytes of a cut packet (longest: a strip's) that are normal when a port is opened in the middle of it."""

SERIAL_PAD_LIMITS: Limits = {
    "garbled": (0.2, 5 * CUT_BYTES, "bytes"),
    "out-of-range": (0.2, 10, "packets"),
    "batched": (0.5, 10, "packets"),
}


@dataclass(slots=True)
class Counters:
    """Base of the counters of ports, lines and devices."""

    def as_dict(self) -> dict[str, int]:
        """All counters by name."""
        return asdict(self)


class ErrorShare:
    """Share of errors since the last evaluation, from two counters: `new_errors` of `new_total`."""

    def __init__(self, max_share: float, min_count: int) -> None:
        """The share is too large above `max_share`, if `new_total` is at least `min_count`."""
        self.new_total = self.new_errors = 0
        self._max_share, self._min_count = max_share, min_count
        self._total = self._errors = 0

    def exceeded(self, total: int, errors: int) -> bool:
        """Update with both counters, which never decrease; return whether the share is too large."""
        self.new_total, self.new_errors = total - self._total, errors - self._errors
        self._total, self._errors = total, errors
        return self.new_total >= self._min_count and self.new_errors > self._max_share * self.new_total

    def text(self, unit: str) -> str:
        """The share as text."""
        return f"{self.new_errors} of {self.new_total} {unit} since the last check"


class ErrorShares:
    """The conditions whose share of errors was too large at the last evaluation; iterating yields their names."""

    def __init__(self, limits: Limits) -> None:
        self._units = {condition: what for condition, (_, _, what) in limits.items()}
        self._shares = {
            condition: ErrorShare(max_share, min_count) for condition, (max_share, min_count, _) in limits.items()
        }
        self._active: tuple[str, ...] = ()

    def update(self, counted: Mapping[str, tuple[int, int]]) -> None:
        """Evaluate again; `counted` has, for each condition, the total and the errors since the start."""
        self._active = tuple(each for each, counts in counted.items() if self._shares[each].exceeded(*counts))

    def __iter__(self) -> Iterator[str]:
        return iter(self._active)

    def text(self, condition: str) -> str:
        """The share of a condition as text; empty for an unknown condition."""
        return self._shares[condition].text(self._units[condition]) if condition in self._shares else ""


def ago(seconds: float) -> str:
    """An age as text."""
    return f"{seconds * 1e3:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s"


def last_report(t_last: float | None, t: float) -> str:
    """Age at `t` (s) of the last report, received at `t_last` (s), as text."""
    return "no packet has come yet" if t_last is None else f"its last packet is {ago(t - t_last)} old"


def bytes_since(count: int) -> str:
    """Number of bytes received since the last report, as text."""
    return f"{count} bytes have come since, which are no packet" if count else "not a byte has come since"
