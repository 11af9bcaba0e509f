"""Figures of a run over time: state, errors, forces, consistency, coverage, motion, timing; needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.patches import Patch

from palmd.events import FloatArray
from palmd.observer.bank import NIS_READINGS
from palmd.observer.validity import MOST_NIS
from palmd.quantities import CONTACT, ESTIMATE, LOOP, Quantity, drawn
from palmd.report.axes import (
    BLACK,
    BLUE,
    DASHED,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    band,
    bars,
    dashed_line,
    estimate_lines,
    in_view,
    invalid_shaded,
    legend_above,
    line,
    logarithmic,
    over_time,
    panels,
    thinned_band,
)
from palmd.report.errors import Errors, count_within_band, normalised_errors, scores_over_time
from palmd.report.series import SD, SDS, Interval, Series
from palmd.system.mechanism import PALMS

FORCES = tuple(drawn(ESTIMATE, tab="forces"))
STATE = (*drawn(ESTIMATE, tab="state"), ESTIMATE["mu"])
_IN_SMALLER = {
    "mm": ("µm", 1e3),
    "°": ("mrad", math.radians(1) * 1e3),
    "°/s": ("mrad/s", math.radians(1) * 1e3),
}
_AVERAGED_TICKS = 200  # window of the running mean of the errors
STATES = {
    "idle": "#d9d9d9", "ready": "#56b4e9", "tracking": GREEN, "hold": "#e69f00", "fault": ORANGE, "stopping": "#f0e442",
    "e-stop": BLACK, "power off": GREY, "manual": PINK, "uncalibrated": "#b3b3b3",
}  # fmt: skip
ARM_STATES = {"R": "ready", "T": "tracking", "H": "hold", "D": "stopping", "F": "fault", "X": "e-stop",
    "P": "power off", "M": "manual", "U": "uncalibrated"}  # fmt: skip
SEVERITIES = {"note": "#9ecae1", "degrade": "#fdae61", "hold": "#d6604d", "stop": "#67001f"}
COMMANDED = "_cmd_"
_MAX_FAULTS = 12
_SEGMENT_COLOURS = (BLUE, "#56b4e9")  # alternating
_OF_A_SECOND = (BLUE, ORANGE, BLACK)
_OF_A_PORT = (BLUE, ORANGE, GREEN)
_COLUMNS = 120  # for the ages, which oscillate

Truth = Callable[[str], tuple[FloatArray, FloatArray] | None]
"""Times and true values of a quantity, by its name; None if its truth is unknown."""


def draw_quantities(
    figure: FigureBase, series: Series, quantities: Sequence[Quantity], truth: Truth, *, invalid: bool = True
) -> None:
    """Draw each quantity with its band where it is valid, elsewhere thin grey if `invalid`, and its truth dashed."""
    grid = panels(figure, len(quantities))
    for axes, quantity in zip(grid, quantities, strict=True):
        factor = quantity.shown.factor
        drawn = [estimate_lines(axes, series, quantity, invalid=invalid)]
        if not series.valid.any():
            drawn = [series.estimate[quantity.name] * factor]
        if (true := truth(quantity.name)) is not None:
            drawn.append(true[1] * factor)
            dashed_line(axes, true[0], drawn[-1], "truth")
        in_view(axes, *drawn)
        _finish(axes, series, quantity.label, grid)


def draw_state(figure: FigureBase, series: Series, errors: Errors | None) -> None:
    """Draw the state with its band, and the truth dashed."""
    draw_quantities(figure, series, STATE, partial(_truth, series, errors))


def draw_forces(figure: FigureBase, series: Series, errors: Errors | None) -> None:
    """Draw normal forces, friction and mass with their bands, and the truth dashed."""
    draw_quantities(figure, series, FORCES, partial(_truth, series, errors), invalid=False)


def _truth(series: Series, errors: Errors | None, name: str) -> tuple[FloatArray, FloatArray] | None:
    return None if errors is None or name not in errors.true else (series.estimate.t, errors.true[name])


def draw_errors(figure: FigureBase, series: Series, errors: Errors) -> None:
    """Draw estimate minus truth, and the band of the standard deviations."""
    grid = panels(figure, len(STATE))
    for axes, quantity in zip(grid, STATE, strict=True):
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
        _finish(axes, series, f"Δ{quantity.symbol} ({unit})" if unit else f"Δ{quantity.symbol}", grid)
        if judged:
            axes.set_title(f"{within / judged:.0%} inside", loc="right", fontsize=7.0, pad=2.0)


def _finish(axes: Axes, series: Series, label: str, grid: Sequence[Axes]) -> None:
    """Shade invalid times and label the axes of a panel of the grid; the legend is over the first one."""
    invalid_shaded(axes, series)
    axes.set_ylabel(label)
    over_time(axes, series, last=axes in grid[-2:])
    if axes is grid[0]:
        legend_above(axes)


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
    logarithmic(observability, series.estimate["observability"])
    if errors is not None:
        squares = normalised_errors(series, errors)
        line(grid[2], t, squares, color=BLUE, linewidth=0.6, label="mean of r₁, r₂, ω₀")
        line(grid[2], t, _running_mean(squares), color=BLACK, label="mean of the last 2 s")
        grid[2].axhline(1.0, color=GREY, linewidth=0.7, linestyle=DASHED)
        grid[2].set_ylabel("(error / sd)²")
        logarithmic(grid[2], squares)
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
    logarithmic(known, *(values * 1e6 for _, values, *_ in drawn))
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


def _high(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return 1.1 * float(np.percentile(known, 99.9)) if len(known) else 0.0


def bar_rows(series: Series) -> int:
    """Number of rows of bars."""
    return 3 + min(len({fault.code for fault in series.faults}), _MAX_FAULTS)


def actuators(series: Series) -> list[Quantity]:
    """The actuators' position quantities, each of which has a commanded counterpart."""
    names = [each.name for each in series.run.topics.motion.quantities if COMMANDED in each.name]
    return [series.run.topics.motion[name.replace(COMMANDED, "_")] for name in names]


def motion_height_in(series: Series, *, differences: bool) -> float:
    """Height (inches) of `draw_motion`."""
    return 0.6 + 1.3 * len(actuators(series)) + 1.4 * differences + 0.24 * bar_rows(series)


def draw_motion(figure: FigureBase, series: Series, *, differences: bool) -> None:
    """Draw positions of the actuators, their `differences` from the commanded ones, and states and faults as bars."""
    quantities, t = actuators(series), series.motion.t
    ratios = (*[1.3] * len(quantities), *[1.0] * differences, 0.24 * bar_rows(series))
    grid = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    for number, (axes, quantity) in enumerate(zip(grid, quantities, strict=False)):
        stem, _, unit = quantity.name.rpartition("_")
        names = f"{stem}{COMMANDED}{unit}", quantity.name
        commanded, actual = (series.motion[name] * quantity.shown.factor for name in names)
        line(axes, t, actual, color=BLUE, linewidth=1.2, label="actual")
        dashed_line(axes, t, commanded, "commanded")
        in_view(axes, actual, commanded, least=1.0)
        axes.set_ylabel(quantity.label if quantity.symbol else f"{stem} ({quantity.shown.unit})")
        if differences:
            label = f"palm {PALMS[number]}"
            line(grid[-2], t, actual - commanded, color=(BLUE, ORANGE)[number], linewidth=0.7, label=label)
    legend_above(grid[0], 2)
    if differences:
        grid[-2].set_ylabel("actual −\ncommanded (°)")
        grid[-2].legend(loc="upper right", ncols=2)
    draw_states(figure, grid, series)


def draw_states(figure: FigureBase, grid: Sequence[Axes], series: Series) -> None:
    """Draw states and faults as bars in the last of the panels, and the time axis and legend of all."""
    segments = tuple(
        Interval(str(number % 2), interval.begin, interval.end)
        for number, interval in enumerate(interval for interval in series.segments if interval.label)
    )
    arm = tuple(
        Interval(ARM_STATES.get(interval.label, ""), interval.begin, interval.end) for interval in series.arm_states
    )
    codes = list(dict.fromkeys(fault.code for fault in series.faults))[:_MAX_FAULTS]
    faults = [
        (
            code,
            [Interval(f"fault: {each.severity}", each.begin, each.end) for each in series.faults if each.code == code],
        )
        for code in codes
    ]
    colours = STATES | {f"fault: {name}": colour for name, colour in SEVERITIES.items()}
    rows = [("palmd", series.states), ("arm", arm), ("segment", segments), *faults]
    bars(grid[-1], rows, colours | dict(zip("01", _SEGMENT_COLOURS, strict=True)))
    for axes in grid:
        over_time(axes, series, last=axes is grid[-1])
    occurring = {interval.label for _, spans in rows for interval in spans}
    key = [Patch(color=colour, label=name) for name, colour in colours.items() if name in occurring]
    if key:
        figure.legend(handles=key, loc="outside lower center", ncols=6)


def draw_loop(figure: FigureBase, series: Series) -> None:
    """Draw lateness and work of each second, skipped ticks, and ages of the readings."""
    (lateness, work), (skipped, ages) = figure.subplots(2, 2, sharex=True)
    for axes, quantity in ((lateness, "lateness"), (work, "work")):
        measured = series.loop["ticks"] > 0.0  # the first message precedes the first statistics
        parts = tuple(drawn(LOOP, chart=quantity))
        for part, colour in zip(parts, _OF_A_SECOND, strict=True):
            values = np.where(measured, series.loop[part.name], math.nan)
            line(axes, series.loop.t, values, color=colour, linewidth=0.8, label=part.symbol)
        logarithmic(axes, *(series.loop[part.name][measured] for part in parts))
        axes.legend(loc="upper right", ncols=3)
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
    logarithmic(ages, *(series.contact[age.name] for age in of_ports))
    ages.legend(loc="upper right", ncols=3)
    ages.set_ylabel("oldest reading (ms)")
    for axes in (lateness, work, skipped, ages):
        over_time(axes, series, last=axes in (skipped, ages))
