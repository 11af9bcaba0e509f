"""Thinning of long records for figures without visible loss, gaps included. Pure."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray

COLUMNS = 300
"""Number of columns that can be distinguished in a printed panel; each keeps its least and its greatest value."""

GAP = 5.0  # steps longer than this multiple of the median step are gaps


def with_gaps(t: FloatArray, *values: FloatArray) -> tuple[FloatArray, ...]:
    """Insert NaN into values (n,) at gaps of their times (n,), so that lines are interrupted there."""
    steps = np.diff(t)
    if not len(steps):
        return (t, *values)
    after = np.flatnonzero(steps > GAP * float(np.median(steps))) + 1
    return np.insert(t, after, (t[after] + t[after - 1]) / 2), *(np.insert(each, after, math.nan) for each in values)


def thinned(t: FloatArray, values: FloatArray, columns: int = COLUMNS) -> tuple[FloatArray, FloatArray]:
    """The least and greatest value of each column, in time order; a short line unchanged."""
    t, values = with_gaps(t, values)
    if len(t) <= 2 * columns:
        return t, values
    t_in, in_column = _columns(t, columns), _columns(values, columns)
    known = np.isfinite(in_column)
    lowest = np.where(known, in_column, math.inf).argmin(axis=1)
    highest = np.where(known, in_column, -math.inf).argmax(axis=1)
    # a column with a gap keeps the gap as one of its three points
    gap = np.where((~known).any(axis=1), (~known).argmax(axis=1), lowest)
    chosen = np.sort(np.stack([lowest, highest, gap], axis=1), axis=1)
    rows = np.arange(len(chosen))[:, None]
    return t_in[rows, chosen].ravel(), in_column[rows, chosen].ravel()


def thinned_band(
    t: FloatArray, low: FloatArray, high: FloatArray, columns: int = COLUMNS
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, least `low` and greatest `high` of each column, NaN if unknown; a short band unchanged."""
    t, low, high = with_gaps(t, low, high)
    if len(t) <= columns:
        return t, low, high
    lowest = np.where(np.isfinite(low), low, math.inf)
    highest = np.where(np.isfinite(high), high, -math.inf)
    least, greatest = _columns(lowest, columns).min(axis=1), _columns(highest, columns).max(axis=1)
    middle = np.nanmean(_columns(t, columns), axis=1)
    return (
        middle,
        np.where(np.isfinite(least), least, math.nan),
        np.where(np.isfinite(greatest), greatest, math.nan),
    )


def _columns(values: FloatArray, columns: int) -> FloatArray:
    """Reshape to (columns, k), padded with the last value."""
    each = -(-len(values) // columns)
    rows = -(-len(values) // each)
    return np.pad(values, (0, rows * each - len(values)), mode="edge").reshape(rows, each)
