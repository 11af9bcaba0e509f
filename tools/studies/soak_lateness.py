"""Whether the loop keeps its deadlines for hours: missed ticks, lateness minute by minute, drift, storms. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tools.studies.soak import JUDGED_FROM_S, SoakFinding, at_most, told
from tools.studies.soak_slopes import HOUR_S, slope

MISSED_MOST_PERCENT = 0.01
DRIFT_MOST_MS_H = 0.1
STORM_SECONDS_MOST = 2
STORM_MINUTE_MOST = 30
"""A storm: ticks missed in more than so many seconds on end, or more than so many of a minute's 6000."""

WAITED_MS = 3.0  # without a processor within a second: what was missed in it is no wonder


@dataclass(frozen=True, slots=True)
class Second:
    """One `palm/loop`: when (s), ticks and skipped ticks since the start, how late each of its ticks began (ms).

    `waited_ms` is for how long the loop has been ready to run and had no processor, since the start.
    """

    t: float
    ticks: int
    overruns: int
    lateness_ms: tuple[float, ...]
    waited_ms: float = 0.0


@dataclass(frozen=True, slots=True)
class Minute:
    """A minute's median, 99th percentile and largest lateness (ms), and how many ticks were missed in it."""

    t: float
    p50_ms: float
    p99_ms: float
    max_ms: float
    missed: int


def minutes(seconds: Sequence[Second]) -> list[Minute]:
    """Whole minutes of the seconds, in their order."""
    found: list[Minute] = []
    for begin in range(0, len(seconds) - 60, 60):
        part = seconds[begin : begin + 61]
        late = np.concatenate([np.asarray(second.lateness_ms) for second in part[1:]])
        p50, p99 = np.percentile(late, (50.0, 99.0))
        missed = part[-1].overruns - part[0].overruns
        found.append(Minute(part[0].t, float(p50), float(p99), float(late.max()), missed))
    return found


def longest_run(missed: Sequence[int]) -> int:
    """Over how many seconds on end ticks were missed."""
    longest = run = 0
    for count in missed:
        run = run + 1 if count > 0 else 0
        longest = max(longest, run)
    return longest


def kept_from(seconds: Sequence[Second]) -> int:
    """How many ticks were missed in seconds in which the loop waited for a processor."""
    return sum(b.overruns - a.overruns for a, b in pairwise(seconds) if b.waited_ms - a.waited_ms > WAITED_MS)


def punctuality(seconds: Sequence[Second], goal: bool = True) -> list[SoakFinding]:
    """All that is to be said; without `goal` (no real-time priority, a short test) nothing is judged."""
    if len(seconds) < 2:
        return [at_most("lateness", "missed ticks", math.nan, MISSED_MOST_PERCENT, "%", "no palm/loop was heard")]
    ticks, missed = seconds[-1].ticks - seconds[0].ticks, seconds[-1].overruns - seconds[0].overruns
    each = [b.overruns - a.overruns for a, b in pairwise(seconds)]
    late = np.concatenate([np.asarray(second.lateness_ms) for second in seconds])
    percent = 100.0 * missed / max(1, ticks + missed)
    found = [
        told("lateness", "ticks", ticks),
        told("lateness", "missed ticks, number", missed),
        told("lateness", "missed ticks, while others had the processors", kept_from(seconds)),
        at_most("lateness", "missed ticks", percent, MISSED_MOST_PERCENT, "%"),
        at_most("lateness", "longest run of seconds with misses", longest_run(each), STORM_SECONDS_MOST, "s"),
        *(
            told("lateness", name, float(value), "ms")
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
        found.append(told("lateness", "drift of p99", slope(t, [one.p99_ms for one in each_minute]) * HOUR_S, "ms/h"))
        found.append(told("lateness", "worst minute's p99", max(one.p99_ms for one in each_minute), "ms"))
    if goal:
        return found
    return [_unjudged(one) for one in found]


def _unjudged(finding: SoakFinding) -> SoakFinding:
    return SoakFinding(finding.group, finding.name, finding.value, finding.unit, finding.goal, None)
