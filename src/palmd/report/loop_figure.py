"""How the loop kept its time, and how old what it read was; needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from palmd.events import FloatArray
from palmd.report.axes import BLACK, BLUE, GREEN, ORANGE, line, logarithmic, over_time
from palmd.report.series import Series
from palmd.report.thinning import thinned_band

_OF_A_SECOND = (("p50", BLUE), ("p99", ORANGE), ("max", BLACK))
_AGES = (("age1_ms", "pad 1", BLUE), ("age2_ms", "pad 2", ORANGE), ("arm_age_ms", "arm", GREEN))
_COLUMNS = 120  # of the ages, each of which swings all the time


def draw_loop(figure: FigureBase, series: Series) -> None:
    """Lateness and work of each second, ticks skipped, ages of the readings."""
    (lateness, work), (skipped, ages) = figure.subplots(2, 2, sharex=True)
    for axes, what in ((lateness, "lateness"), (work, "work")):
        begun = series.loop["ticks"] > 0.0  # the first message comes before there is anything to tell
        for part, colour in _OF_A_SECOND:
            values = np.where(begun, series.loop[f"{what}_{part}_ms"], math.nan)
            line(axes, series.loop.t, values, color=colour, linewidth=0.8, label=part)
        _positive(axes, [series.loop[f"{what}_{part}_ms"][begun] for part, _ in _OF_A_SECOND])
        axes.set_ylabel(f"{what} (ms)")
    line(skipped, series.loop.t, series.loop["overruns"], color=BLUE)
    skipped.set(
        ylabel="ticks skipped",
        ylim=(0.0, max(1.0, 1.05 * float(np.nan_to_num(series.loop["overruns"]).max(initial=0.0)))),
    )
    skipped.yaxis.get_major_locator().set_params(integer=True)
    t = series.contact.t
    for name, label, colour in _AGES:
        t_oldest, _, oldest = thinned_band(t, series.contact[name], series.contact[name], _COLUMNS)
        ages.plot(t_oldest, oldest, color=colour, linewidth=0.8, label=label)
    _positive(ages, [series.contact[name] for name, *_ in _AGES])
    ages.set_ylabel("oldest reading (ms)")
    for axes in (lateness, work, skipped, ages):
        over_time(axes, series, last=axes in (skipped, ages))


def _positive(axes: Axes, drawn: Sequence[FloatArray]) -> None:
    """A logarithmic axis for all of them, and room for the legend."""
    values = np.concatenate(drawn)
    positive = values[np.isfinite(values) & (values > 0.0)]
    if len(positive):
        low, high = np.percentile(positive, (0.5, 100.0))
        logarithmic(axes, low / 1.5, max(high * 2.5, low * 10.0))
    axes.legend(loc="upper right", ncols=3)
