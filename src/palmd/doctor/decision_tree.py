"""Decision tree from measured latencies to recommended changes. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from palmd.doctor.lateness import Case, percentiles

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
