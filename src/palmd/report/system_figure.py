"""What a system of any kind estimates and how it moves, over time, from its own tables; needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import FigureBase

from palmd.events import FloatArray
from palmd.quantities import Quantity
from palmd.report.axes import BLACK, BLUE, GREY, band, in_view, invalid_shaded, line, over_time, panels
from palmd.report.errors import SDS, without_gauge
from palmd.report.motion_figure import draw_states
from palmd.report.series import SD, Series

COMMANDED = "_cmd_"
TURN = "psi_rad"  # of the object, from an arbitrary zero


def estimated(series: Series) -> tuple[Quantity, ...]:
    """The quantities that are drawn: those with a sign of their own."""
    return tuple(each for each in series.run.topics.estimate.quantities if each.kind == "number" and each.symbol)


def moved(series: Series) -> tuple[Quantity, ...]:
    """What the actuators are commanded to, and told to be at."""
    names = [each.name for each in series.run.topics.motion.quantities if COMMANDED in each.name]
    return tuple(series.run.topics.motion[name.replace(COMMANDED, "_")] for name in names)


def draw_estimate(figure: FigureBase, series: Series, quantities: Sequence[Quantity]) -> None:
    """Each where the estimate is valid with its band, the truth dashed where an emulated rig told it."""
    grid = panels(figure, len(quantities))
    for axes, quantity in zip(grid, quantities, strict=True):
        factor, t = quantity.shown.factor, series.estimate.t
        told = series.estimate[quantity.name] * factor
        value = np.where(series.valid, told, math.nan)
        reach = SDS * series.estimate[SD + quantity.name] * factor
        band(axes, t, value - reach, value + reach, BLUE, f"±{SDS:g} sd")
        line(axes, t, np.where(series.valid, np.nan, told), color=GREY, linewidth=0.5, label="not valid")
        line(axes, t, value, color=BLUE, linewidth=1.3, label="estimate")
        true = truth_of(series, quantity.name) * factor
        line(axes, series.truth.t, true, color=BLACK, linewidth=0.7, linestyle=(0, (4, 2)), label="truth")
        in_view(axes, value if series.valid.any() else told, true)
        invalid_shaded(axes, series)
        axes.set_ylabel(quantity.label)
        over_time(axes, series, last=axes in grid[-2:])
    grid[0].legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=4, borderaxespad=0.0)


def truth_of(series: Series, name: str) -> FloatArray:
    """What the emulated rig told of a quantity at `series.truth.t`; the object's angle from the estimate's own zero."""
    true, t = series.truth[name], series.estimate.t
    if name != TURN or not len(true) or not len(t):
        return true
    _, zero = without_gauge(series, series.estimate[name] - np.interp(t, series.truth.t, true))
    nearest: FloatArray = zero[np.searchsorted(t, series.truth.t).clip(0, len(t) - 1)]
    return true + nearest


def draw_moved(figure: FigureBase, series: Series, rows: int) -> None:
    """Each actuator as commanded and as it was, and below states and faults as bars, of which there are `rows`."""
    quantities = moved(series)
    grid = figure.subplots(1 + len(quantities), 1, sharex=True, height_ratios=(*(1.3,) * len(quantities), 0.24 * rows))
    for axes, quantity in zip(grid, quantities, strict=False):
        stem, _, unit = quantity.name.rpartition("_")
        factor = quantity.shown.factor
        commanded, actual = (series.motion[name] * factor for name in (f"{stem}{COMMANDED}{unit}", quantity.name))
        line(axes, series.motion.t, actual, color=BLUE, linewidth=1.2, label="actual")
        line(axes, series.motion.t, commanded, color=BLACK, linewidth=0.7, linestyle=(0, (4, 2)), label="commanded")
        in_view(axes, actual, commanded)
        axes.set_ylabel(f"{stem} ({quantity.shown.unit})")
    grid[0].legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=2, borderaxespad=0.0)
    key = draw_states(grid[-1], series)
    for axes in grid:
        over_time(axes, series, last=axes is grid[-1])
    if key:
        figure.legend(handles=key, loc="outside lower center", ncols=6)
