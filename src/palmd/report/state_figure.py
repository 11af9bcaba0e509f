"""Figures of the named state over time with its band, and of its errors if the truth is known; needs matplotlib."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from palmd.quantities import ESTIMATE, Quantity, drawn
from palmd.report.axes import (
    BLACK,
    BLUE,
    GREY,
    band,
    dashed_line,
    estimate_lines,
    in_view,
    invalid_shaded,
    legend_above,
    line,
    over_time,
    panels,
)
from palmd.report.errors import Errors, count_within_band
from palmd.report.series import SD, SDS, Series

STATE = (*drawn(ESTIMATE, tab="state"), ESTIMATE["mu"])
_IN_SMALLER = {
    "mm": ("µm", 1e3),
    "°": ("mrad", math.radians(1) * 1e3),
    "°/s": ("mrad/s", math.radians(1) * 1e3),
}


def draw_state(figure: FigureBase, series: Series, errors: Errors | None) -> None:
    """Draw the state with its band, and the truth dashed."""
    for axes, quantity, last in _panels(figure):
        factor = quantity.shown.factor
        drawn = [estimate_lines(axes, series, quantity)]
        if errors is not None and quantity.name in errors.true:
            drawn.append(errors.true[quantity.name] * factor)
            dashed_line(axes, series.estimate.t, drawn[-1], "truth")
        if not series.valid.any():
            drawn = [series.estimate[quantity.name] * factor]
        in_view(axes, *drawn)
        _finish(axes, series, last, quantity.label)


def draw_errors(figure: FigureBase, series: Series, errors: Errors) -> None:
    """Draw estimate minus truth, and the band of the standard deviations."""
    for axes, quantity, last in _panels(figure):
        unit, smaller = _IN_SMALLER.get(quantity.shown.unit, (quantity.shown.unit, 1.0))
        factor = quantity.shown.factor * smaller
        t, valid = series.estimate.t, series.valid
        error = errors.error.get(quantity.name, np.full(len(t), math.nan))
        error_shown = np.where(valid, error, math.nan) * factor
        reach = np.where(valid, SDS * series.estimate[SD + quantity.name], math.nan) * factor
        band(axes, t, -reach, reach, BLUE, f"±{SDS:g} sd")
        line(axes, t, error_shown, color=BLACK, linewidth=0.6, label="estimate − truth")
        axes.axhline(0.0, color=GREY, linewidth=0.5)
        in_view(
            axes, error_shown, np.percentile(reach[np.isfinite(reach)], (90,)) if np.isfinite(reach).any() else reach
        )
        highest = max(map(abs, axes.get_ylim()))
        axes.set_ylim(-highest, highest)
        within, judged = count_within_band(series, errors, quantity.name) if quantity.name in errors.error else (0, 0)
        _finish(axes, series, last, f"Δ{quantity.symbol} ({unit})" if unit else f"Δ{quantity.symbol}")
        if judged:
            axes.set_title(f"{within / judged:.0%} inside", loc="right", fontsize=7.0, pad=2.0)


def _panels(figure: FigureBase) -> list[tuple[Axes, Quantity, bool]]:
    grid = panels(figure, len(STATE))
    return [(axes, quantity, axes in grid[-2:]) for axes, quantity in zip(grid, STATE, strict=True)]


def _finish(axes: Axes, series: Series, last: bool, label: str) -> None:
    invalid_shaded(axes, series)
    axes.set_ylabel(label)
    over_time(axes, series, last=last)
    if axes.get_subplotspec().get_geometry()[2] == 0:  # type: ignore[union-attr]
        legend_above(axes)
