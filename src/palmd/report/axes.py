"""Common elements of the figures of a run: style, thinned lines and bands, bars of intervals; needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.ticker import LogLocator, NullFormatter

from palmd.events import FloatArray
from palmd.quantities import Quantity
from palmd.report.series import SD, SDS, Interval, Series

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


BLUE, ORANGE, GREEN, PINK, BLACK, GREY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#8c8c8c"
WIDTH_IN = 7.1
"""Width of every figure: two columns of 85 mm and the gap between them."""

DASHED = (0, (4, 2))
_BAND_ALPHA = 0.22


@contextmanager
def figure_style(salt: str = "") -> Iterator[None]:
    """Context in which figures are made and saved; `salt` makes element ids differ between SVG files."""
    style = matplotlib.rc_context({
        "font.size": 8.0, "axes.titlesize": 8.0, "axes.labelsize": 8.0, "legend.fontsize": 7.0, "xtick.labelsize": 7.0,
        "ytick.labelsize": 7.0, "axes.grid": True, "grid.alpha": 0.3, "grid.linewidth": 0.5, "lines.linewidth": 0.9,
        "axes.linewidth": 0.6, "axes.titlelocation": "left", "legend.frameon": False, "legend.handlelength": 1.6,
        "axes.spines.top": False, "axes.spines.right": False, "xtick.major.width": 0.6, "ytick.major.width": 0.6,
        "axes.formatter.useoffset": False, "svg.hashsalt": f"palmd {salt}", "pdf.fonttype": 42,
    })  # fmt: skip
    with style:
        yield


def panels(figure: FigureBase, count: int) -> list[Axes]:
    """`count` panels in two columns; the place beside an odd last one is empty."""
    grid = list(figure.subplots(-(-count // 2), 2, sharex=True).ravel())
    for spare in grid[count:]:
        spare.set_visible(False)
    return grid[:count]


def line(axes: Axes, t: FloatArray, values: FloatArray, **style: object) -> None:
    """Plot values over time, thinned."""
    axes.plot(*thinned(t, values), **style)  # type: ignore[arg-type]


def band(axes: Axes, t: FloatArray, low: FloatArray, high: FloatArray, colour: str, label: str = "") -> None:
    """Fill the area between two lines over time, thinned."""
    axes.fill_between(*thinned_band(t, low, high), color=colour, alpha=_BAND_ALPHA, linewidth=0.0, label=label or None)


def in_view(axes: Axes, *values: FloatArray, least: float = 0.0) -> None:
    """Set y limits that show all but the extreme 0.2 % of the finite values, at least `least` apart."""
    known = np.concatenate([each[np.isfinite(each)] for each in values])
    if len(known):
        low, high = np.percentile(known, (0.2, 99.8))
        margin = max(0.12 * (high - low), (least - (high - low)) / 2, 1e-9)
        axes.set_ylim(low - margin, high + margin)


def estimate_lines(axes: Axes, series: Series, quantity: Quantity, *, invalid: bool = True) -> FloatArray:
    """Plot a quantity where the estimate is valid, with its band; elsewhere a thin grey line if `invalid`.

    Returns the valid values in the displayed unit.
    """
    t, factor = series.estimate.t, quantity.shown.factor
    value = np.where(series.valid, series.estimate[quantity.name], math.nan) * factor
    reach = SDS * series.estimate[SD + quantity.name] * factor
    band(axes, t, value - reach, value + reach, BLUE, f"±{SDS:g} sd")
    if invalid:
        unconfirmed = np.where(series.valid, math.nan, series.estimate[quantity.name]) * factor
        line(axes, t, unconfirmed, color=GREY, linewidth=0.5, label="not valid")
    line(axes, t, value, color=BLUE, linewidth=1.3, label="estimate")
    return value


def dashed_line(axes: Axes, t: FloatArray, values: FloatArray, label: str) -> None:
    """Plot a truth or a command over time."""
    line(axes, t, values, color=BLACK, linewidth=0.7, linestyle=DASHED, label=label)


def legend_above(axes: Axes, columns: int = 4) -> None:
    """Place the legend above the panel, outside of it."""
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=columns, borderaxespad=0.0)


def invalid_shaded(axes: Axes, series: Series) -> None:
    """Shade the times without a valid estimate."""
    t, valid = series.estimate.t, series.valid
    changes = np.flatnonzero(np.diff(valid.astype(np.int8))) + 1
    for interval in np.split(np.arange(len(t)), changes):
        if not valid[interval[0]]:
            axes.axvspan(
                t[interval[0]], t[min(interval[-1] + 1, len(t) - 1)], color=GREY, alpha=0.13, linewidth=0.0, zorder=0
            )


def over_time(axes: Axes, series: Series, *, last: bool) -> None:
    """Set the x axis to the run's time, labelled only below the `last` panel of a column."""
    axes.set_xlim(0.0, max(series.duration, 1e-3))
    axes.tick_params(labelbottom=last)
    if last:
        axes.set_xlabel("time (s)")


def logarithmic(axes: Axes, *values: FloatArray) -> None:
    """Make the y axis logarithmic for the positive values, with plain numbers, also between two decades."""
    known = np.concatenate(values)
    positive = known[np.isfinite(known) & (known > 0.0)]
    if not len(positive):
        return
    low, high = np.percentile(positive, (0.5, 100.0))
    low, high = low / 2.0, max(2.5 * high, 10.0 * low)
    axes.set(yscale="log", ylim=(low, high))
    few = high < 100.0 * low
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())


def bars(axes: Axes, rows: Sequence[tuple[str, Iterable[Interval]]], colours: dict[str, str]) -> None:
    """Draw each row's intervals as bars, the first row on top; intervals whose label has no colour are omitted."""
    for number, (_, intervals) in enumerate(rows):
        for interval in intervals:
            if interval.label in colours:
                axes.broken_barh(
                    [(interval.begin, interval.end - interval.begin)],
                    (number - 0.36, 0.72),
                    color=colours[interval.label],
                )
    axes.set_yticks(range(len(rows)), [name for name, _ in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.grid(axis="y", visible=False)
