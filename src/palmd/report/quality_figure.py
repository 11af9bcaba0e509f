"""Figures of forces, consistency and coverage over time; needs matplotlib."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from palmd.events import FloatArray
from palmd.observer.bank import NIS_READINGS
from palmd.observer.validity import MOST_NIS
from palmd.quantities import ESTIMATE, drawn
from palmd.report.axes import (
    BLACK,
    BLUE,
    DASHED,
    GREEN,
    GREY,
    ORANGE,
    dashed_line,
    estimate_lines,
    in_view,
    invalid_shaded,
    legend_above,
    line,
    logarithmic,
    over_time,
    panels,
)
from palmd.report.errors import Errors, normalised_errors, scores_over_time
from palmd.report.series import Series

FORCES = tuple(drawn(ESTIMATE, tab="forces"))
_AVERAGED_TICKS = 200  # window of the running mean of the errors


def draw_forces(figure: FigureBase, series: Series, errors: Errors | None) -> None:
    """Draw normal forces, friction and mass with their bands, and the truth dashed."""
    rows = panels(figure, len(FORCES))
    for axes, quantity in zip(rows, FORCES, strict=True):
        drawn = [estimate_lines(axes, series, quantity, invalid=False)]
        if errors is not None and quantity.name in errors.true:
            drawn.append(errors.true[quantity.name] * quantity.shown.factor)
            dashed_line(axes, series.estimate.t, drawn[-1], "truth")
        in_view(axes, *drawn)
        axes.set_ylabel(quantity.label)
        invalid_shaded(axes, series)
        over_time(axes, series, last=axes in rows[-2:])
    legend_above(rows[0])


def nis_band() -> tuple[float, float]:
    """The 95 % interval of running means for normal readings: n exponentially weighted readings count as 2n − 1."""
    reach = 1.96 * math.sqrt(2.0 / (2.0 * NIS_READINGS - 1.0))
    return 1.0 - reach, 1.0 + reach


def draw_consistency(figure: FigureBase, series: Series, errors: Errors | None) -> None:
    """Draw innovations, observability and, if the truth is known, normalised errors."""
    grid = np.atleast_1d(figure.subplots(2 if errors is None else 3, 1, sharex=True))
    t = series.estimate.t
    nis, observability = grid[0], grid[1]
    nis.axhspan(0.0, MOST_NIS, color=BLUE, alpha=0.10, linewidth=0.0, label="consistent")
    nis.axhspan(*nis_band(), color=BLUE, alpha=0.18, linewidth=0.0, label="95 % if normal")
    line(nis, t, series.estimate["nis"], color=BLACK, linewidth=0.8, label="running mean")
    nis.axhline(1.0, color=GREY, linewidth=0.5)
    nis.set(ylabel="NIS", ylim=(0.0, max(2.4, _high(series.estimate["nis"]))))
    line(observability, t, series.estimate["observability"], color=BLUE)
    observability.set_ylabel("smallest\nsingular value")
    _logarithmic(observability, series.estimate["observability"])
    if errors is not None:
        squares = normalised_errors(series, errors)
        line(grid[2], t, squares, color=BLUE, linewidth=0.6, label="mean of r₁, r₂, ω₀")
        line(grid[2], t, _running_mean(squares), color=BLACK, label="mean of the last 2 s")
        grid[2].axhline(1.0, color=GREY, linewidth=0.7, linestyle=DASHED)
        grid[2].set_ylabel("(error / sd)²")
        _logarithmic(grid[2], squares)
        legend_above(grid[2])
    legend_above(nis)
    for axes in grid:
        invalid_shaded(axes, series)
        over_time(axes, series, last=axes is grid[-1])


def draw_coverage(figure: FigureBase, series: Series) -> None:
    """Draw the fraction of touched normals, and the uncertainty of the whole outline."""
    touched, known = figure.subplots(ncols=2)
    line(touched, series.estimate.t, 100 * series.estimate["touched"], color=BLUE)
    touched.set(ylabel="touched normals (%)", ylim=(0.0, 102.0))
    t = np.array([outline.t for outline in series.outlines])
    drawn = [
        (t, _worst(series, touched_only=False), BLUE, "-", "largest sd"),
        (t, _worst(series, touched_only=True), GREEN, "-", "largest sd where touched"),
    ]
    if series.bodies:
        t_scored, e_h, largest = scores_over_time(series)
        drawn += [(t_scored, largest, BLACK, "--", "largest error"), (t_scored, e_h, ORANGE, "--", "RMS error")]
    for t_of, values, colour, style, label in drawn:
        line(known, t_of, values * 1e6, color=colour, linestyle=style, label=label)
    known.set_ylabel("h (µm)")
    _logarithmic(known, np.concatenate([values * 1e6 for _, values, *_ in drawn]))
    legend_above(known, 2)
    for axes in (touched, known):
        invalid_shaded(axes, series)
        over_time(axes, series, last=True)
        for each in series.improvements:
            axes.axvline(each, ymax=0.03, color=BLACK, linewidth=0.5)


def _worst(series: Series, *, touched_only: bool) -> FloatArray:
    """The largest standard deviation (m) of each outline, over all or over touched normals; NaN without any."""
    sds = (outline.h_sd[outline.touched] if touched_only else outline.h_sd for outline in series.outlines)
    return np.array([sd.max() if len(sd) else math.nan for sd in sds])


def _running_mean(values: FloatArray) -> FloatArray:
    """Mean of the known values among the last `_AVERAGED_TICKS`; NaN where the value itself is unknown."""
    known = np.isfinite(values)
    total = np.cumsum(np.where(known, values, 0.0))
    count = np.cumsum(known)
    total[_AVERAGED_TICKS:] -= total[:-_AVERAGED_TICKS].copy()
    count[_AVERAGED_TICKS:] -= count[:-_AVERAGED_TICKS].copy()
    return np.where(known, total / np.maximum(count, 1), math.nan)


def _logarithmic(axes: Axes, values: FloatArray) -> None:
    positive = values[np.isfinite(values) & (values > 0.0)]
    if len(positive):
        low, high = np.percentile(positive, (1.0, 99.9))
        logarithmic(axes, low / 2, max(high * 2, low * 10))


def _high(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return 1.1 * float(np.percentile(known, 99.9)) if len(known) else 0.0
