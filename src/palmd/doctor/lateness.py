"""Statistics of tick lateness and wake-up latency. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from palmd.console.columns import aligned

PARTS = ("p50", "p99", "p99.9", "max")
_PERMILLE = (500, 990, 999, 1000)


class TickLateness:
    """Collects the lateness (ms) of every tick from `palm/loop`, each tick once."""

    def __init__(self) -> None:
        self.values_ms: list[float] = []
        self.skipped = 0
        self._before: tuple[int, int] | None = None

    def take(self, fields: Mapping[str, Any]) -> None:
        """Process one message; the first one only initialises the counters."""
        ticks, overruns = int(fields["ticks"]), int(fields["overruns"])
        if self._before is not None:
            fresh = min(ticks - self._before[0], len(fields["lateness_ms"]))
            if fresh > 0:
                self.values_ms += fields["lateness_ms"][-fresh:]
            self.skipped += overruns - self._before[1]
        self._before = (ticks, overruns)


@dataclass(frozen=True, slots=True)
class Case:
    """Measurements under one load; lateness in ms, `wakeups_ms` empty if not measured."""

    name: str
    ticks_ms: Sequence[float]
    skipped: int
    wakeups_ms: Sequence[float]


def percentiles(values: Sequence[float]) -> tuple[float, ...]:
    """Return median, 99th and 99.9th percentile (nearest rank), and maximum, as in `PARTS`; NaN without values."""
    ordered = sorted(values)
    if not ordered:
        return (math.nan,) * len(PARTS)
    return tuple(ordered[-(-len(ordered) * permille // 1000) - 1] for permille in _PERMILLE)


def table(cases: Sequence[Case], by: str) -> str:
    """Return a table of the cases in ms with the ratio of the 99th percentiles; `by` names the wake-up meter."""
    head = ["ticks", "skipped", *_headed("late", PARTS), *_headed(by, PARTS), "ratio p99"]
    return aligned([("", head), *((case.name, _cells(case)) for case in cases)])


def _headed(name: str, parts: Sequence[str]) -> list[str]:
    """Column heads, the first one with the group's name."""
    return [f"{name}: {parts[0]}", *parts[1:]]


def _cells(case: Case) -> list[str]:
    late, wakeups = percentiles(case.ticks_ms), percentiles(case.wakeups_ms)
    ratio = late[1] / wakeups[1] if wakeups[1] > 0.0 else math.nan
    counts = [str(len(case.ticks_ms)), str(case.skipped)]
    return [*counts, *(_shown(value, 3) for value in (*late, *wakeups)), _shown(ratio, 2)]


def _shown(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"
