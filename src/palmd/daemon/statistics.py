"""Timing statistics of the loop, in constant memory."""

from __future__ import annotations

from array import array


class Window:
    """The last `size` values, with median, 99th percentile and maximum."""

    def __init__(self, size: int) -> None:
        """Raises ValueError if `size` is not positive."""
        if size <= 0:
            raise ValueError(f"the size of a window must be positive, not {size}")
        self._values = array("d", bytes(8 * size))
        self._count = 0

    def add(self, value: float) -> None:
        """Add a value; it replaces the oldest if the window is full."""
        self._values[self._count % len(self._values)] = value
        self._count += 1

    def values(self) -> list[float]:
        """The values, oldest first."""
        size = len(self._values)
        start = max(0, self._count - size)
        return [self._values[i % size] for i in range(start, self._count)]

    def summary(self) -> tuple[float, float, float]:
        """Median, 99th percentile (nearest rank) and maximum; zeros when empty."""
        ordered = sorted(self.values())
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
        self._lateness = Window(size)
        self._work = Window(size)

    def tick(self, lateness_s: float, work_s: float, skipped: int) -> None:
        """Add a tick: how late it began, how long it took, how many ticks were skipped after it."""
        self.ticks += 1
        self.overruns += skipped
        self._lateness.add(lateness_s)
        self._work.add(work_s)

    def fields(self) -> dict[str, float | list[float]]:
        """The statistics under their names in `palm/loop`."""
        fields: dict[str, float | list[float]] = {"ticks": self.ticks, "overruns": self.overruns}
        for name, window in (("lateness", self._lateness), ("work", self._work)):
            for part, value in zip(("p50", "p99", "max"), window.summary(), strict=True):
                fields[f"{name}_{part}_ms"] = value * 1e3
        fields["lateness_ms"] = [value * 1e3 for value in self._lateness.values()]
        return fields
