"""Whether something grows all the time: robust slopes of memory, descriptors and threads. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tools.studies.soak import JUDGED_FROM_S, SoakFinding

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
    """Theil and Sen's slope: the median over all pairs of points of Δvalue/Δt; NaN for fewer than two points."""
    x, y = np.asarray(t, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if x.size > POINTS_MOST:
        keep = np.linspace(0, x.size - 1, POINTS_MOST).round().astype(int)
        x, y = x[keep], y[keep]
    i, j = np.triu_indices(x.size, 1)
    apart = x[j] != x[i]
    if not apart.any():
        return float("nan")
    return float(np.median((y[j] - y[i])[apart] / (x[j] - x[i])[apart]))


def warm_up_s(seconds: float) -> float:
    """How much of a soak of so many seconds belongs to no slope."""
    return min(WARM_UP_PART * seconds, WARM_UP_MOST_S)


def leaks(processes: Mapping[str, ProcessSeries], t_begin: float, seconds: float) -> list[SoakFinding]:
    """Of each process after the warm-up: MB an hour, and by how many the descriptors and threads have become more."""
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
    """By how much the lower quartile of the last third is above that of the first third; NaN without any.

    The lower quartile, because what comes and goes opens things for a while.
    """
    third = max(1, len(counts) // 3)
    if not counts:
        return float("nan")
    first, last = (np.percentile(part, 25.0) for part in (counts[:third], counts[-third:]))
    return float(last - first)
