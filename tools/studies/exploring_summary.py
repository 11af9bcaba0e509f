"""What many explorations come to, kind by kind, beside the other strategies on the same objects. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from palmd.console.columns import aligned
from palmd.rig.shapes import KINDS
from tools.studies.exploring import ExploringRow
from tools.studies.exploring_plans import EXPLORES, STRATEGIES, Strategy
from tools.studies.montecarlo_summary import number, percent, quantile

_OTHERS: tuple[Strategy, ...] = tuple(each for each in STRATEGIES if each != "explore")


def table(rows: Sequence[ExploringRow]) -> str:
    """A line for each number, a column for each kind of which there are runs; ∞ where too many runs have none.

    A run that came to nothing has touched nothing.
    """
    columns = [[row for row in rows if row.kind == kind] for kind in KINDS]
    columns = [column for column in columns if column]
    lines: list[tuple[str, list[str]]] = [("", [column[0].kind for column in columns])]
    lines += [(name, [show(column) for column in columns]) for name, show in _LINES]
    return aligned(lines)


def remarks(rows: Sequence[ExploringRow]) -> list[str]:
    """The explorations to look at: a line for each that touched too little, met with a mishap, or came to nothing."""
    return [f"{row.kind} {row.seed}: {_remark(row)}" for row in rows if row.strategy == "explore" and _remark(row)]


def of(strategy: Strategy, rows: Sequence[ExploringRow]) -> list[ExploringRow]:
    """The runs with this strategy."""
    return [row for row in rows if row.strategy == strategy]


def _remark(row: ExploringRow) -> str:
    if row.error:
        return row.error
    parts = []
    if math.isnan(row.enough_s):
        parts.append(f"touched {row.coverage:.0%} of the {row.reachable:.0%} that can be reached ({row.reason})")
    if row.mishap:
        parts.append(
            f"contact lost {row.losses} times, {row.parted_s:.2f} s; at a pad's end for {row.edge_s:.2f} s"
            + ("" if row.recovered else "; not recovered")
        )
    if row.outside or row.refused:
        parts.append(f"{row.outside} set-points outside the limits, {row.refused} refused")
    return ", ".join(parts)


def _enough(strategy: Strategy) -> Callable[[Sequence[ExploringRow]], str]:
    def show(rows: Sequence[ExploringRow]) -> str:
        runs = of(strategy, rows)
        return percent(sum(math.isfinite(row.enough_s) for row in runs) / len(runs)) if runs else percent(math.nan)

    return show


def _quantiles(
    value: Callable[[ExploringRow], float], unit: float = 1.0, strategy: Strategy = "explore"
) -> Callable[[Sequence[ExploringRow]], str]:
    """Median and 90th percentile, a run without the number counting as infinite."""

    def show(rows: Sequence[ExploringRow]) -> str:
        values = [value(row) for row in of(strategy, rows)]
        values = [each if math.isfinite(each) else math.inf for each in values]
        return " / ".join(number(quantile(values, q), unit) for q in (0.5, 0.9))

    return show


def _lowest(strategy: Strategy) -> Callable[[Sequence[ExploringRow]], str]:
    """Median and 10th percentile of what was touched in the end."""

    def show(rows: Sequence[ExploringRow]) -> str:
        shares = [0.0 if math.isnan(row.coverage) else row.coverage for row in of(strategy, rows)]
        return " / ".join(percent(quantile(shares, q)) for q in (0.5, 0.1))

    return show


def _count(
    marks: Callable[[ExploringRow], bool], strategy: Strategy = "explore"
) -> Callable[[Sequence[ExploringRow]], str]:
    return lambda rows: str(sum(marks(row) for row in of(strategy, rows)))


def over_clairvoyant(rows: Sequence[ExploringRow]) -> list[float]:
    """How many times as long as who knows it an exploration took to 95 % of each object that both were tried on.

    Infinite where it never came to it; objects which who knows them never did are left out.
    """
    explored, known = ({row.seed: row.enough_s for row in of(strategy, rows)} for strategy in EXPLORES)
    seeds = [seed for seed in explored if math.isfinite(known.get(seed, math.nan))]
    return [explored[seed] / known[seed] if math.isfinite(explored[seed]) else math.inf for seed in seeds]


def _times_as_long(rows: Sequence[ExploringRow]) -> str:
    ratios = over_clairvoyant(rows)
    return " / ".join(number(quantile(ratios, q), 1.0) for q in (0.5, 0.9)) if ratios else number(math.nan, 1.0)


def _lines() -> Iterable[tuple[str, Callable[[Sequence[ExploringRow]], str]]]:
    yield "objects", lambda rows: str(len({row.seed for row in rows}))
    yield "ended in an error", lambda rows: str(sum(bool(row.error) for row in rows))
    for strategy in STRATEGIES:
        yield f"{strategy}: touched 95 % (% of objects)", _enough(strategy)
    for strategy in STRATEGIES:
        yield (
            f"{strategy}: time to 95 %, median / p90 (s)",
            _quantiles(lambda row: row.enough_s, strategy=strategy),
        )
    yield "explore: times as long as clairvoyant, median / p90", _times_as_long
    for strategy in STRATEGIES:
        yield f"{strategy}: touched in the end, median / p10 (%)", _lowest(strategy)
    yield "first valid after, median / p90 (s)", _quantiles(lambda row: row.valid_s)
    yield "ended by itself after, median / p90 (s)", _quantiles(lambda row: row.ended_s)
    yield "whole outline: largest error, median / p90 (mm)", _quantiles(lambda row: row.hausdorff_m, 1e3)
    yield "whole outline: RMS, median / p90 (µm)", _quantiles(lambda row: row.e_h_m, 1e6)
    yield "open of the rig though touch tells it, median / p90 (µm)", _quantiles(lambda row: row.open_rig_m, 1e6)
    yield "contact lost or pad's end reached (runs)", _count(lambda row: row.mishap)
    yield "of these not recovered", _count(lambda row: row.mishap and not row.recovered)
    yield "limits or workspace violated (runs)", _count(lambda row: row.outside + row.refused > 0)
    for strategy in _OTHERS:
        yield f"{strategy}: contact lost or pad's end reached (runs)", _count(lambda row: row.mishap, strategy)
    yield "a decision, median / p90 of the runs (ms)", _quantiles(lambda row: row.decision_median_ms)
    yield "an exploration's processor time, median / p90 (s)", _quantiles(lambda row: row.seconds)


_LINES = tuple(_lines())
