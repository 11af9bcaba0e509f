"""Findings of a soak as a table: leaks, lateness, and gaps in the recording. Pure.

Memory, descriptors and threads by robust slopes; missed ticks, drift and storms minute by minute; whether everything
published is recorded once and in order, and whether its replay is identical.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from palmd.bus.subscriber import Message
from palmd.console.columns import aligned
from palmd.record.recheck import CheckedTick
from palmd.record.run import Survey

JUDGED_FROM_S = 1800.0
"""Slopes are judged from this duration on (s); in a shorter soak leaks and drift do not stand out from the noise."""


@dataclass(frozen=True, slots=True)
class SoakFinding:
    """One quantity with its goal; `met`: whether it is met, None if it is not judged.

    `group` is one of `leak`, `lateness`, `counters`, `recording`, `behaviour`.
    """

    group: str
    name: str
    value: float
    unit: str
    goal: str
    met: bool | None
    why: str = ""


def at_most(group: str, name: str, value: float, most: float, unit: str = "", why: str = "") -> SoakFinding:
    """A quantity that must not exceed `most`; NaN misses the goal."""
    return SoakFinding(group, name, value, unit, f"≤ {most:g}", value <= most, why)


def between(
    group: str, name: str, value: float, least: float, most: float, unit: str = "", why: str = ""
) -> SoakFinding:
    """A quantity that must lie between two limits, both included."""
    goal = f"= {least:g}" if least == most else f"{least:g} to {most:g}"
    return SoakFinding(group, name, value, unit, goal, least <= value <= most, why)


def without_goal(group: str, name: str, value: float, unit: str = "") -> SoakFinding:
    """A quantity without a goal."""
    return SoakFinding(group, name, value, unit, "", None)


def all_met(findings: Sequence[SoakFinding]) -> bool:
    """Whether there are findings and none has missed its goal."""
    return bool(findings) and all(finding.met is not False for finding in findings)


def table(findings: Sequence[SoakFinding]) -> str:
    """One line for each finding."""
    verdict = {True: "met", False: "MISSED", None: "-"}
    head = ("finding", ("value", "unit", "goal", "verdict"))
    rows = [
        (f"{each.group}: {each.name}", (f"{each.value:.6g}", each.unit, each.goal, verdict[each.met]))
        for each in findings
    ]
    why = [f"  {each.name}: {each.why}" for each in findings if each.met is False and each.why]
    return "\n".join([aligned([head, *rows]), *why])


# ----------------------------------------------------------------------------------------------------- leaks


MEMORY_MB_H = 1.0
POINTS_MOST = 600  # of a series for its slope: there is a slope for every pair
WARM_UP_PART, WARM_UP_MOST_S = 0.25, 600.0
HOUR_S = 3600.0


@dataclass(slots=True)
class ProcessSeries:
    """One process over time: seconds, resident memory (MB), open descriptors, threads."""

    t: list[float] = field(default_factory=list)
    rss_mb: list[float] = field(default_factory=list)
    descriptors: list[int] = field(default_factory=list)
    threads: list[int] = field(default_factory=list)


def slope(t: Sequence[float], values: Sequence[float]) -> float:
    """Theil–Sen slope: the median of Δvalue/Δt over all pairs of points; NaN for fewer than two points."""
    x, y = np.asarray(t, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if x.size > POINTS_MOST:
        keep = np.linspace(0, x.size - 1, POINTS_MOST).round().astype(int)
        x, y = x[keep], y[keep]
    i, j = np.triu_indices(x.size, 1)
    distinct = x[j] != x[i]
    if not distinct.any():
        return float("nan")
    return float(np.median((y[j] - y[i])[distinct] / (x[j] - x[i])[distinct]))


def warm_up_s(seconds: float) -> float:
    """Warm-up time (s) of a soak of so many seconds, which slopes do not include."""
    return min(WARM_UP_PART * seconds, WARM_UP_MOST_S)


def leaks(processes: Mapping[str, ProcessSeries], t_begin: float, seconds: float) -> list[SoakFinding]:
    """Memory slope (MB/h) and growth of descriptors and threads of each process after the warm-up."""
    judged = seconds >= JUDGED_FROM_S
    found = []
    for name, series in processes.items():
        t = np.asarray(series.t) - t_begin
        warm = t >= warm_up_s(seconds)
        rate = slope(t[warm].tolist(), np.asarray(series.rss_mb)[warm].tolist()) * HOUR_S
        met = rate <= MEMORY_MB_H if judged else None
        found.append(SoakFinding("leak", f"{name} memory", rate, "MB/h", f"≤ {MEMORY_MB_H:g}", met))
        for what, counts in (("descriptors", series.descriptors), ("threads", series.threads)):
            more = growth(np.asarray(counts, dtype=np.float64)[warm].tolist())
            found.append(SoakFinding("leak", f"{name} {what}", more, "more", "≤ 0", more <= 0.0 if judged else None))
    return found


def growth(counts: Sequence[float]) -> float:
    """Increase of the lower quartile from the first to the last third; NaN without values.

    The lower quartile ignores descriptors that are open temporarily.
    """
    third = max(1, len(counts) // 3)
    if not counts:
        return float("nan")
    first, last = (np.percentile(part, 25.0) for part in (counts[:third], counts[-third:]))
    return float(last - first)


# -------------------------------------------------------------------------------------------------- lateness


MISSED_MOST_PERCENT = 0.01
DRIFT_MOST_MS_H = 0.1
STORM_SECONDS_MOST = 2
STORM_MINUTE_MOST = 30
"""Limits for a storm of missed ticks: consecutive seconds with misses, and misses among a minute's 6000 ticks."""


@dataclass(frozen=True, slots=True)
class Second:
    """One `palm/loop`: time (s), ticks and skipped ticks since the start, lateness of each of its ticks (ms)."""

    t: float
    ticks: int
    overruns: int
    lateness_ms: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Minute:
    """Median, 99th percentile and largest lateness of a minute (ms), and number of missed ticks."""

    t: float
    p50_ms: float
    p99_ms: float
    max_ms: float
    missed: int


def minutes(seconds: Sequence[Second]) -> list[Minute]:
    """Statistics of whole minutes, in order of time."""
    found: list[Minute] = []
    for begin in range(0, len(seconds) - 60, 60):
        part = seconds[begin : begin + 61]
        late = np.concatenate([np.asarray(second.lateness_ms) for second in part[1:]])
        p50, p99 = np.percentile(late, (50.0, 99.0))
        missed = part[-1].overruns - part[0].overruns
        found.append(Minute(part[0].t, float(p50), float(p99), float(late.max()), missed))
    return found


def longest_run(missed: Sequence[int]) -> int:
    """Largest number of consecutive seconds with missed ticks."""
    longest = run = 0
    for count in missed:
        run = run + 1 if count > 0 else 0
        longest = max(longest, run)
    return longest


def punctuality(seconds: Sequence[Second], goal: bool = True) -> list[SoakFinding]:
    """Findings about lateness; without `goal` (no real-time priority, a short test) nothing is judged."""
    if len(seconds) < 2:
        return [at_most("lateness", "missed ticks", math.nan, MISSED_MOST_PERCENT, "%", "no palm/loop was received")]
    ticks, missed = seconds[-1].ticks - seconds[0].ticks, seconds[-1].overruns - seconds[0].overruns
    each = [b.overruns - a.overruns for a, b in pairwise(seconds)]
    late = np.concatenate([np.asarray(second.lateness_ms) for second in seconds])
    percent = 100.0 * missed / max(1, ticks + missed)
    found = [
        without_goal("lateness", "ticks", ticks),
        without_goal("lateness", "missed ticks, number", missed),
        at_most("lateness", "missed ticks", percent, MISSED_MOST_PERCENT, "%"),
        at_most("lateness", "longest run of seconds with misses", longest_run(each), STORM_SECONDS_MOST, "s"),
        *(
            without_goal("lateness", name, float(value), "ms")
            for name, value in zip(
                ("p50", "p99", "p99.9", "max"), (*np.percentile(late, (50.0, 99.0, 99.9)), late.max()), strict=True
            )
        ),
    ]
    each_minute = minutes(seconds)
    if each_minute:
        found.append(
            at_most("lateness", "worst minute's misses", max(one.missed for one in each_minute), STORM_MINUTE_MOST)
        )
        t = [one.t for one in each_minute]
        judged = seconds[-1].t - seconds[0].t >= JUDGED_FROM_S
        drift = slope(t, [one.p50_ms for one in each_minute]) * HOUR_S
        met = abs(drift) <= DRIFT_MOST_MS_H if judged else None
        found.append(SoakFinding("lateness", "drift of the median", drift, "ms/h", f"within ±{DRIFT_MOST_MS_H:g}", met))
        found.append(
            without_goal("lateness", "drift of p99", slope(t, [one.p99_ms for one in each_minute]) * HOUR_S, "ms/h")
        )
        found.append(without_goal("lateness", "worst minute's p99", max(one.p99_ms for one in each_minute), "ms"))
    return found if goal else [replace(one, met=None) for one in found]


# ------------------------------------------------------------------------------------------------- recording


@dataclass(slots=True)
class Numbers:
    """Sequence numbers of one topic's messages: first, last, and number missing in between."""

    first: int
    last: int
    missing: int = 0


def recorded(
    surveys: Sequence[Mapping[str, Survey]], received: Mapping[str, Numbers], published: int
) -> list[SoakFinding]:
    """Findings about a run's files in their order, compared with the bus and the daemon's count of messages."""
    missing: list[str] = []
    count = 0
    for topic in sorted({topic for survey in surveys for topic in survey} | set(received)):
        parts = [survey[topic] for survey in surveys if topic in survey]
        ours = topic.startswith("palm/")
        count += sum(part.count for part in parts) if ours else 0
        if not parts:
            missing.append(f"all of {topic}")
            continue
        lost = sum(part.missing for part in parts)
        after = parts[0].first + parts[0].count + parts[0].missing
        for part in parts[1:]:
            lost += part.first - after
            after = part.first + part.count + part.missing
        if ours:
            lost += parts[0].first
        if topic in received:
            lost += max(0, received[topic].last + 1 - after)
        if lost:
            missing.append(f"{lost} of {topic}")
    return [
        without_goal("recording", "files", len(surveys)),
        without_goal("recording", "messages", count),
        between("recording", "topics with gaps", len(missing), 0, 0, why=", ".join(missing[:8])),
        between("recording", "messages published and not recorded", max(0, published - count), 0, 0),
        between("recording", "messages that this study missed", sum(each.missing for each in received.values()), 0, 0),
    ]


def replayed(ticks: Iterable[CheckedTick]) -> list[SoakFinding]:
    """Findings about a replay of the first ticks."""
    count = differ = 0
    for tick in ticks:
        count += 1
        differ += bool(tick.differences)
    return [
        SoakFinding("recording", "ticks replayed", count, "", "> 0", count > 0),
        between("recording", "ticks replayed that differ", differ, 0, 0),
    ]


# ------------------------------------------------------------------------------------------------- collected


@dataclass(slots=True)
class SoakWatch:
    """Collects what is judged: messages of daemon and rig, and the processes' resources.

    `last_state`: the last `palm/state`; `loop`: the last `palm/loop`.
    """

    seconds: list[Second] = field(default_factory=list)
    processes: dict[str, ProcessSeries] = field(default_factory=dict)
    numbers: dict[str, Numbers] = field(default_factory=dict)
    last_state: dict[str, Any] = field(default_factory=dict)
    loop: dict[str, Any] = field(default_factory=dict)
    on_palms: bool = True

    @property
    def state(self) -> str:
        """The last state, empty before the first."""
        return str(self.last_state.get("state", ""))

    @property
    def t_loop(self) -> float:
        """Time of the last `palm/loop` (s)."""
        return float(self.loop.get("mono_ns", 0)) * 1e-9

    def take(self, message: Message) -> None:
        """Take one message."""
        fields = message.fields
        self._number(message.topic, fields["seq"])
        if message.topic == "palm/state":
            self.last_state = fields
        elif message.topic == "palm/loop":
            self.loop = fields
            self.seconds.append(Second(self.t_loop, fields["ticks"], fields["overruns"], tuple(fields["lateness_ms"])))

    def sample(self, name: str, t: float, rss_mb: float, descriptors: int, threads: int) -> None:
        """Add the resources of a process at `t` (s)."""
        series = self.processes.setdefault(name, ProcessSeries())
        series.t.append(t)
        series.rss_mb.append(rss_mb)
        series.descriptors.append(descriptors)
        series.threads.append(threads)

    def _number(self, topic: str, number: int) -> None:
        known = self.numbers.get(topic)
        if known is None:
            self.numbers[topic] = Numbers(number, number)
            return
        known.missing += max(0, number - known.last - 1)
        known.last = number
