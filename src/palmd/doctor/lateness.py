"""Statistics of tick lateness and wake-up latency, and the decision tree to recommended changes. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from palmd.console.columns import aligned

PARTS = ("p50", "p99", "p99.9", "max")
_PERMILLE = (500, 990, 999, 1000)

WAKEUP_LIMIT_MS = 1.0
"""Limit of the 99th percentile of wake-up latency when idle: a set-point must be sent within 1 ms of its time."""

TICK_LIMIT_MS = 2.0
"""Limit of the 99th percentile of tick lateness: a fifth of the default period."""

IDLE = "idle"
_PRIORITY = "give palmd real-time priority and locked memory (palmd doctor says how), then palmd doctor build"
_BUSY: Mapping[str, str] = {
    "every core busy": "reserve a core for the loop: isolcpus=N on the kernel command line, CPUAffinity=N in the unit",
    "disk busy": "record to another disk (record.directory), or to a faster one",
    "network busy": "move the network card's interrupts to another core (/proc/irq/*/smp_affinity)",
    "recorder and page": "view the page from another machine, and record with palmd record there",
}


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


@dataclass(frozen=True, slots=True)
class Branch:
    """A question, its answer with the measured number, and what to change; empty if nothing needs to be changed."""

    question: str
    answer: str
    change: str = ""


def branches(cases: Sequence[Case]) -> Iterator[Branch]:
    """Yield the branches down to the first change needed when idle, then one branch for each kind of load."""
    by_name = {case.name: case for case in cases}
    idle = by_name.get(IDLE)
    if idle is not None:
        if idle.wakeups_ms:
            wakeup = percentiles(idle.wakeups_ms)[1]
            yield wakeup_branch(wakeup)
            if wakeup > WAKEUP_LIMIT_MS:
                return
        if idle.ticks_ms:
            yield _tick_branch(idle, _PRIORITY)
            if percentiles(idle.ticks_ms)[1] > TICK_LIMIT_MS:
                return
    for name, change in _BUSY.items():
        case = by_name.get(name)
        if case is not None and case.ticks_ms:
            yield _tick_branch(case, change)


def wakeup_branch(p99_ms: float) -> Branch:
    """Branch for the wake-up latency of the idle machine; `p99_ms` is its 99th percentile."""
    late = p99_ms > WAKEUP_LIMIT_MS
    return Branch(
        "Does this machine wake programs in time?", _answer(late, p99_ms, WAKEUP_LIMIT_MS),
        "use a kernel with PREEMPT_RT, the governor `performance` and processor.max_cstate=1; not a virtual machine"
        if late else "",
    )  # fmt: skip


def lines(found: Sequence[Branch]) -> list[str]:
    """The tree as text lines: each question, and below it what to change."""
    texts = []
    for each in found:
        texts.append(f"{each.question} {each.answer}")
        if each.change:
            texts.append(f"  -> {each.change}")
    if not any(each.change for each in found):
        texts.append("  -> nothing to change")
    return texts


def _tick_branch(case: Case, change: str) -> Branch:
    p99 = percentiles(case.ticks_ms)[1]
    late = p99 > TICK_LIMIT_MS
    where = "on the idle machine" if case.name == IDLE else f"with {case.name}"
    return Branch(f"Are ticks in time {where}?", _answer(late, p99, TICK_LIMIT_MS), change if late else "")


def _answer(late: bool, p99_ms: float, limit_ms: float) -> str:
    return f"{'no' if late else 'yes'}: 99 % within {p99_ms:.2f} ms, limit {limit_ms:g} ms"
