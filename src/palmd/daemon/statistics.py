"""Timing statistics of the loop, in constant memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable


def summary(values: Iterable[float]) -> tuple[float, float, float]:
    """Median, 99th percentile (nearest rank) and maximum; zeros without values."""
    ordered = sorted(values)
    count = len(ordered)
    if count == 0:
        return (0.0, 0.0, 0.0)
    return (ordered[(count - 1) // 2], ordered[-(-99 * count // 100) - 1], ordered[-1])


class LoopStatistics:
    """Number of ticks and skipped ticks; lateness and duration of those of the last second."""

    def __init__(self, rate_hz: float) -> None:
        size = max(1, round(rate_hz))
        self.ticks = 0
        self.overruns = 0
        self._lateness: deque[float] = deque(maxlen=size)
        self._work: deque[float] = deque(maxlen=size)

    def tick(self, lateness_s: float, work_s: float, skipped: int) -> None:
        """Add a tick: how late it began, how long it took, how many ticks were skipped after it."""
        self.ticks += 1
        self.overruns += skipped
        self._lateness.append(lateness_s)
        self._work.append(work_s)

    def fields(self) -> dict[str, float | list[float]]:
        """The statistics under their names in `palm/loop`."""
        fields: dict[str, float | list[float]] = {"ticks": self.ticks, "overruns": self.overruns}
        for name, values in (("lateness", self._lateness), ("work", self._work)):
            for part, value in zip(("p50", "p99", "max"), summary(values), strict=True):
                fields[f"{name}_{part}_ms"] = value * 1e3
        fields["lateness_ms"] = [value * 1e3 for value in self._lateness]
        return fields
