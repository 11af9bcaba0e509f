"""Forces, consistency and coverage over time; needs matplotlib."""

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
    GREEN,
    GREY,
    ORANGE,
    band,
    estimated,
    in_view,
    invalid_shaded,
    line,
    logarithmic,
    over_time,
    panels,
)
from palmd.report.errors import SDS, Errors, normalised, scores_over_time
from palmd.report.series import Series

_DASHED = (0, (4, 2))
FORCES = tuple(drawn(ESTIMATE, tab="forces"))
_SETTLED_TICKS = 200  # over which the errors are averaged


def draw_forces(figure: FigureBase, series: Series, errors: Errors | None) -> None:
    """Normal forces, friction and mass, each with its band; the truth dashed."""
    rows = panels(figure, len(FORCES))
    t = series.estimate.t
    for axes, quantity in zip(rows, FORCES, strict=True):
        name, factor = quantity.name, quantity.shown.factor
        value, low, high = estimated(series, name, SDS)
        band(axes, t, low, high, BLUE, f"±{SDS:g} sd")
        line(axes, t, value, color=BLUE, linewidth=1.3, label="estimate")
        drawn = [value]
        if errors is not None and name in errors.true:
            drawn.append(errors.true[name] * factor)
            line(axes, t, drawn[-1], color=BLACK, linewidth=0.7, linestyle=_DASHED, label="truth")
        in_view(axes, *drawn)
        axes.set_ylabel(quantity.label)
        invalid_shaded(axes, series)
        over_time(axes, series, last=axes in rows[-2:])
    _legend(rows[0])


def nis_band() -> tuple[float, float]:
    """What 95 % of running means stay within if every reading is normal: n readings count as 2n − 1 when fading."""
    reach = 1.96 * math.sqrt(2.0 / (2.0 * NIS_READINGS - 1.0))
    return 1.0 - reach, 1.0 + reach


def draw_consistency(figure: FigureBase, series: Series, errors: Errors | None) -> None:
    """Innovations, observability, and where truth is known the errors against what their sd promise."""
    grid = np.atleast_1d(figure.subplots(2 if errors is None else 3, 1, sharex=True))
    t = series.estimate.t
    nis, observability = grid[0], grid[1]
    nis.axhspan(0.0, MOST_NIS, color=BLUE, alpha=0.10, linewidth=0.0, label="called consistent")
    nis.axhspan(*nis_band(), color=BLUE, alpha=0.18, linewidth=0.0, label="95 % if normal")
    line(nis, t, series.estimate["nis"], color=BLACK, linewidth=0.8, label="running mean")
    nis.axhline(1.0, color=GREY, linewidth=0.5)
    nis.set(ylabel="NIS", ylim=(0.0, max(2.4, _high(series.estimate["nis"]))))
    line(observability, t, series.estimate["observability"], color=BLUE)
    observability.set_ylabel("smallest\nsingular value")
    _logarithmic(observability, series.estimate["observability"])
    if errors is not None:
        squares = normalised(series, errors)
        line(grid[2], t, squares, color=BLUE, linewidth=0.6, label="mean of r₁, r₂, ω₀")
        line(grid[2], t, _running_mean(squares), color=BLACK, label="of the 2 s before")
        grid[2].axhline(1.0, color=GREY, linewidth=0.7, linestyle=_DASHED)
        grid[2].set_ylabel("(error / sd)²")
        _logarithmic(grid[2], squares)
        _legend(grid[2])
    _legend(nis)
    for axes in grid:
        invalid_shaded(axes, series)
        over_time(axes, series, last=axes is grid[-1])


def draw_coverage(figure: FigureBase, series: Series) -> None:
    """What share of the normals was touched, and how well the whole outline is known."""
    touched, known = figure.subplots(ncols=2)
    line(touched, series.estimate.t, 100 * series.estimate["touched"], color=BLUE)
    touched.set(ylabel="touched normals (%)", ylim=(0.0, 102.0))
    t = np.array([outline.t for outline in series.outlines])
    drawn = [
        (t, _worst(series, felt=False), BLUE, "-", "largest sd"),
        (t, _worst(series, felt=True), GREEN, "-", "largest sd where touched"),
    ]
    if series.bodies:
        t_scored, e_h, largest = scores_over_time(series)
        drawn += [(t_scored, largest, BLACK, "--", "largest error"), (t_scored, e_h, ORANGE, "--", "RMS error")]
    for t_of, values, colour, style, label in drawn:
        line(known, t_of, values * 1e6, color=colour, linestyle=style, label=label)
    known.set_ylabel("h (µm)")
    _logarithmic(known, np.concatenate([values * 1e6 for _, values, *_ in drawn]))
    known.legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=2, borderaxespad=0.0)
    for axes in (touched, known):
        invalid_shaded(axes, series)
        over_time(axes, series, last=True)
        for each in series.improvements:
            axes.axvline(each, ymax=0.03, color=BLACK, linewidth=0.5)


def _worst(series: Series, *, felt: bool) -> FloatArray:
    """Of each outline the largest sd (m), of all normals or of the touched ones; NaN where there are none."""
    sds = (outline.h_sd[outline.touched] if felt else outline.h_sd for outline in series.outlines)
    return np.array([sd.max() if len(sd) else math.nan for sd in sds])


def _running_mean(values: FloatArray) -> FloatArray:
    """Of the last `_SETTLED_TICKS` values that are known; NaN where the value itself is not."""
    known = np.isfinite(values)
    total = np.cumsum(np.where(known, values, 0.0))
    count = np.cumsum(known)
    total[_SETTLED_TICKS:] -= total[:-_SETTLED_TICKS].copy()
    count[_SETTLED_TICKS:] -= count[:-_SETTLED_TICKS].copy()
    return np.where(known, total / np.maximum(count, 1), math.nan)


def _logarithmic(axes: Axes, values: FloatArray) -> None:
    positive = values[np.isfinite(values) & (values > 0.0)]
    if len(positive):
        low, high = np.percentile(positive, (1.0, 99.9))
        logarithmic(axes, low / 2, max(high * 2, low * 10))


def _high(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return 1.1 * float(np.percentile(known, 99.9)) if len(known) else 0.0


def _legend(axes: Axes) -> None:
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=4, borderaxespad=0.0)
