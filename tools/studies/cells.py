"""Cells of a study's table: statistics of some rows as text. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

NOTHING = "–"

Rows = Sequence[Any]
Value = Callable[[Any], float]
Cell = Callable[[Rows], str]


def number(value: float, unit: float = 1.0) -> str:
    """The value with three digits; ∞ for infinity, – for NaN."""
    if math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "∞"
    scaled = value * unit
    return f"{scaled:.0f}" if abs(scaled) >= 100.0 else f"{scaled:.3g}"


def percent(value: float) -> str:
    """A share in percent."""
    return NOTHING if math.isnan(value) else f"{100.0 * value:.1f}"


def quantile(values: Iterable[float], q: float) -> float:
    """The q-quantile, linear between neighbours; NaN without values."""
    ordered = sorted(values)
    if not ordered:
        return math.nan
    position = q * (len(ordered) - 1)
    low = math.floor(position)
    part = position - low
    if part == 0.0 or ordered[low] == ordered[low + 1]:
        return ordered[low]
    return ordered[low] + part * (ordered[low + 1] - ordered[low])


def known(values: Iterable[float]) -> list[float]:
    """The finite values."""
    return [value for value in values if math.isfinite(value)]


def share(marks: Iterable[bool]) -> float:
    """The share of true marks; NaN without marks."""
    marked = list(marks)
    return sum(marked) / len(marked) if marked else math.nan


def runs(rows: Rows) -> str:
    """The number of rows."""
    return str(len(rows))


def errors(rows: Rows) -> str:
    """The number of rows with an error."""
    return str(sum(bool(row.error) for row in rows))


def count(mark: Callable[[Any], bool]) -> Cell:
    """The number of marked rows."""
    return lambda rows: str(sum(map(mark, rows)))


def count_of(mark: Callable[[Any], bool]) -> Cell:
    """The number of marked rows, and of all rows."""
    return lambda rows: f"{sum(map(mark, rows))} of {len(rows)}"


def shares(mark: Callable[[Any], bool]) -> Cell:
    """The share of marked rows (%)."""
    return lambda rows: percent(share(map(mark, rows)))


def total(value: Value) -> Cell:
    """The sum."""
    return lambda rows: number(sum(known(map(value, rows))))


def quantiles(value: Value, unit: float = 1.0, qs: Sequence[float] = (0.5,), *, worst: bool = False) -> Cell:
    """Quantiles over the rows that have the value; worst: a row without it counts as infinite."""

    def cell(rows: Rows) -> str:
        values = list(map(value, rows))
        some = [each if math.isfinite(each) else math.inf for each in values] if worst else known(values)
        return " / ".join(number(quantile(some, q), unit) for q in qs)

    return cell


def rms(value: Value, unit: float = 1.0) -> Cell:
    """The root mean square over the rows that have the value."""

    def cell(rows: Rows) -> str:
        some = known(map(value, rows))
        return number(math.sqrt(sum(each * each for each in some) / len(some)), unit) if some else NOTHING

    return cell


def most(value: Value, unit: float = 1.0) -> Cell:
    """The largest value."""
    return lambda rows: number(max(known(map(value, rows)), default=math.nan), unit)


def mean(value: Value, form: str) -> Cell:
    """The mean over the rows that have the value."""

    def cell(rows: Rows) -> str:
        some = known(map(value, rows))
        return format(sum(some) / len(some), form) if some else NOTHING

    return cell


def accepted(cell: Cell) -> Cell:
    """The cell over the accepted rows only."""
    return among(lambda row: row.accepted, cell)


def among(mark: Callable[[Any], bool], cell: Cell) -> Cell:
    """The cell over the marked rows only."""
    return lambda rows: cell([row for row in rows if mark(row)])
