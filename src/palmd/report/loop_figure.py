"""Figure of the loop's timing and the age of its readings; needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from palmd.events import FloatArray
from palmd.quantities import CONTACT, LOOP, drawn
from palmd.report.axes import BLACK, BLUE, GREEN, ORANGE, line, logarithmic, over_time
from palmd.report.series import Series
from palmd.report.thinning import thinned_band

_OF_A_SECOND = (BLUE, ORANGE, BLACK)
_OF_A_PORT = (BLUE, ORANGE, GREEN)
_COLUMNS = 120  # for the ages, which oscillate


def draw_loop(figure: FigureBase, series: Series) -> None:
    """Draw lateness and work of each second, skipped ticks, and ages of the readings."""
    (lateness, work), (skipped, ages) = figure.subplots(2, 2, sharex=True)
    for axes, quantity in ((lateness, "lateness"), (work, "work")):
        measured = series.loop["ticks"] > 0.0  # the first message precedes the first statistics
        parts = tuple(drawn(LOOP, chart=quantity))
        for part, colour in zip(parts, _OF_A_SECOND, strict=True):
            values = np.where(measured, series.loop[part.name], math.nan)
            line(axes, series.loop.t, values, color=colour, linewidth=0.8, label=part.symbol)
        _positive(axes, [series.loop[part.name][measured] for part in parts])
        axes.set_ylabel(f"{quantity} ({parts[0].unit})")
    line(skipped, series.loop.t, series.loop["overruns"], color=BLUE)
    skipped.set(
        ylabel="ticks skipped",
        ylim=(0.0, max(1.0, 1.05 * float(np.nan_to_num(series.loop["overruns"]).max(initial=0.0)))),
    )
    skipped.yaxis.get_major_locator().set_params(integer=True)
    t = series.contact.t
    of_ports = tuple(drawn(CONTACT, chart="age"))
    for age, colour in zip(of_ports, _OF_A_PORT, strict=True):
        t_oldest, _, oldest = thinned_band(t, series.contact[age.name], series.contact[age.name], _COLUMNS)
        ages.plot(t_oldest, oldest, color=colour, linewidth=0.8, label=age.symbol)
    _positive(ages, [series.contact[age.name] for age in of_ports])
    ages.set_ylabel("oldest reading (ms)")
    for axes in (lateness, work, skipped, ages):
        over_time(axes, series, last=axes in (skipped, ages))


def _positive(axes: Axes, drawn: Sequence[FloatArray]) -> None:
    """Set a logarithmic axis for all curves, with room for the legend."""
    values = np.concatenate(drawn)
    positive = values[np.isfinite(values) & (values > 0.0)]
    if len(positive):
        low, high = np.percentile(positive, (0.5, 100.0))
        logarithmic(axes, low / 1.5, max(high * 2.5, low * 10.0))
    axes.legend(loc="upper right", ncols=3)
