"""The reports of recorded runs of systems with their own quantity tables; needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.figure import FigureBase

from palmd.events import FloatArray
from palmd.polygon import closed_outline
from palmd.record.surface import NORMALS, PLANES, shadow, surface_points
from palmd.report.axes import (
    BLUE,
    GREY,
)
from palmd.report.errors import remove_gauge
from palmd.report.sections import CaptionedFigure, Report, Section, assembled, motion
from palmd.report.series import Bools, Series
from palmd.report.time_figures import draw_quantities

PSI = "psi_rad"  # orientation of the object, relative to an arbitrary zero
_PANEL_IN = 1.25
_MOTION = "Commanded and actual positions of the actuators; below, states and faults."


def system_report(series: Series, own: Sequence[Section]) -> Report:
    """The system's `own` sections, then its state and motion; sections without data are omitted."""
    every = series.run.topics.estimate.quantities
    quantities = [each for each in every if each.kind == "number" and each.symbol]

    def truth(name: str) -> tuple[FloatArray, FloatArray]:
        return series.truth.t, truth_of(series, name)

    state = CaptionedFigure(
        partial(draw_quantities, series=series, quantities=quantities, truth=truth),
        _PANEL_IN * (1 + len(quantities) // 2),
        "Blue: valid estimate with its band; grey: invalid estimate; dashed: an emulated rig's truth.",
    )
    return assembled(series, [*own, Section("State", (state,)), Section("Motion", motion(series, _MOTION))])


def truth_of(series: Series, name: str) -> FloatArray:
    """The true value of a quantity at `series.truth.t`; for the object's angle relative to the estimate's zero."""
    true, t = series.truth[name], series.estimate.t
    if name != PSI or not len(true) or not len(t):
        return true
    _, zero = remove_gauge(series, series.estimate[name] - np.interp(t, series.truth.t, true))
    nearest: FloatArray = zero[np.searchsorted(t, series.truth.t).clip(0, len(t) - 1)]
    return true + nearest


def pivot_report(series: Series) -> Report:
    """The outline about the pivot, followed by the sections common to all systems."""
    if not series.shape:
        return system_report(series, ())
    names = ("theta_rad", "hP_m", "hP_sd_m", "touched")
    theta, h, sd, touched = (np.array(series.shape[name], dtype=np.float64) for name in names)
    fraction, worst = float(np.mean(touched > 0)), float(np.max(sd[touched > 0], initial=0.0))
    caption = (
        f"The outline about the pivot (cross) at the end: {fraction:.0%} of the normals were touched (blue), with a"
        f" standard deviation of at most {1e6 * worst:.0f} µm; grey parts were never touched."
    )
    figure = CaptionedFigure(partial(_draw_outline, theta=theta, h=h, touched=touched > 0), 4.4, caption)
    return system_report(series, (Section("Outline", (figure,)),))


def _draw_outline(figure: FigureBase, theta: FloatArray, h: FloatArray, touched: Bools) -> None:
    axes = figure.subplots()
    points = 1e3 * closed_outline(theta, h)
    axes.plot(points[:, 0], points[:, 1], color=GREY, linewidth=0.8)
    nearest = np.rint(np.arange(len(points)) * len(touched) / (len(points) - 1)).astype(int) % len(touched)
    touched_points = np.where(touched[nearest][:, None], points, np.nan)
    axes.plot(touched_points[:, 0], touched_points[:, 1], color=BLUE, linewidth=1.6)
    axes.plot([0.0], [0.0], "+", color="black")
    axes.set(aspect="equal", xlabel="mm", ylabel="mm")


def three_palms_report(series: Series) -> Report:
    """The surface, followed by the sections common to all systems."""
    if not series.shape:
        return system_report(series, ())
    halvings = int(series.shape["halvings"])
    h, sd, touched = (np.array(series.shape[name], dtype=np.float64) for name in ("h_m", "h_sd_m", "touched"))
    touched_points = touched > 0
    worst = float(np.max(sd[touched_points], initial=0.0))
    caption = (
        "Projections of the body onto the planes of its own axes (grey) and the touched points of its surface (blue),"
        f" {np.mean(touched_points):.0%} of the directions, with a standard deviation of at most {1e6 * worst:.0f} µm."
        " Elsewhere the shape follows from the prior only."
    )
    figure = CaptionedFigure(
        partial(_draw_surface, h=h, touched_points=touched_points, halvings=halvings), 2.9, caption
    )
    return system_report(series, (Section("Surface", (figure,)),))


def _draw_surface(figure: FigureBase, h: FloatArray, touched_points: Bools, halvings: int) -> None:
    theta: FloatArray = np.arange(NORMALS, dtype=np.float64) * (math.tau / NORMALS)
    points = 1e3 * surface_points(h, halvings)[touched_points]
    for axes, (plane, (first, second)) in zip(figure.subplots(1, len(PLANES)), PLANES.items(), strict=True):
        outline = 1e3 * closed_outline(theta, shadow(h, halvings, plane))
        axes.plot(outline[:, 0], outline[:, 1], color=GREY, linewidth=0.8)
        axes.plot(points[:, first], points[:, second], ".", color=BLUE, markersize=1.5)
        axes.set(aspect="equal", title=f"{plane} (mm)")
