"""How the figures of a run look: colours, lines with bands, bars of what lasted; needs matplotlib."""

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
from palmd.quantities import ESTIMATE
from palmd.report.series import SD, Series, Spell
from palmd.report.thinning import thinned, thinned_band

BLUE, ORANGE, GREEN, PINK, BLACK, GREY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#8c8c8c"
WIDTH_IN = 7.1
"""Of every figure: two columns of 85 mm with what is between them."""

_BAND_ALPHA = 0.22


@contextmanager
def styled(salt: str = "") -> Iterator[None]:
    """Within it figures are made and saved; `salt` tells the names in one SVG from those in another."""
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
    """So many panels in two columns; an odd one has nothing beside it."""
    grid = list(figure.subplots(-(-count // 2), 2, sharex=True).ravel())
    for spare in grid[count:]:
        spare.set_visible(False)
    return grid[:count]


def line(axes: Axes, t: FloatArray, values: FloatArray, **style: object) -> None:
    """Values over time, thinned."""
    axes.plot(*thinned(t, values), **style)  # type: ignore[arg-type]


def band(axes: Axes, t: FloatArray, low: FloatArray, high: FloatArray, colour: str, label: str = "") -> None:
    """What lies between two lines over time, thinned."""
    axes.fill_between(*thinned_band(t, low, high), color=colour, alpha=_BAND_ALPHA, linewidth=0.0, label=label or None)


def in_view(axes: Axes, *values: FloatArray, least: float = 0.0) -> None:
    """Limits of y such that all but the rarest of the finite values are seen, at least `least` apart."""
    known = np.concatenate([each[np.isfinite(each)] for each in values])
    if len(known):
        low, high = np.percentile(known, (0.2, 99.8))
        margin = max(0.12 * (high - low), (least - (high - low)) / 2, 1e-9)
        axes.set_ylim(low - margin, high + margin)


def estimated(series: Series, name: str, sds: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A field where the estimate is valid, and its band of so many sd, all in the quantity's own unit."""
    factor = ESTIMATE[name].shown.factor
    value = np.where(series.valid, series.estimate[name], math.nan) * factor
    reach = sds * series.estimate[SD + name] * factor
    return value, value - reach, value + reach


def invalid_shaded(axes: Axes, series: Series) -> None:
    """The times without a valid estimate, in grey."""
    t, valid = series.estimate.t, series.valid
    changes = np.flatnonzero(np.diff(valid.astype(np.int8))) + 1
    for spell in np.split(np.arange(len(t)), changes):
        if not valid[spell[0]]:
            axes.axvspan(
                t[spell[0]], t[min(spell[-1] + 1, len(t) - 1)], color=GREY, alpha=0.13, linewidth=0.0, zorder=0
            )


def over_time(axes: Axes, series: Series, *, last: bool) -> None:
    """The run's time along x, told of only below the `last` panel of a column."""
    axes.set_xlim(0.0, max(series.duration, 1e-3))
    axes.tick_params(labelbottom=last)
    if last:
        axes.set_xlabel("time (s)")


def logarithmic(axes: Axes, low: float, high: float) -> None:
    """A logarithmic axis y with plain numbers, some even where it spans less than two decades."""
    axes.set(yscale="log", ylim=(low, high))
    few = high < 100.0 * low
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())


def bars(axes: Axes, rows: Sequence[tuple[str, Iterable[Spell]]], colours: dict[str, str]) -> None:
    """For each row what lasted from when to when; what has no colour leaves its row empty. First row on top."""
    for number, (_, spells) in enumerate(rows):
        for spell in spells:
            if spell.what in colours:
                axes.broken_barh(
                    [(spell.begin, spell.end - spell.begin)], (number - 0.36, 0.72), color=colours[spell.what]
                )
    axes.set_yticks(range(len(rows)), [name for name, _ in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.grid(axis="y", visible=False)
