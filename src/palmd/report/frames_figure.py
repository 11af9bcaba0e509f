"""Figure of the reconstruction over time, after figure 3.9 of the paper; needs matplotlib."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from palmd.report.axes import BLACK, BLUE, GREY, ORANGE
from palmd.report.body import closed, contact_points, frames, outline_known, points, pose_at, turned
from palmd.report.series import Series
from palmd.system.mechanism import RADII

MAX_FRAMES, COLUMNS = 12, 4
ROW_IN = 1.2
_PALM_M = 0.06
_MAX_CONTACTS = 150


def row_count(series: Series) -> int:
    """Number of rows of frames."""
    return -(-len(frames(series, MAX_FRAMES)) // COLUMNS)


def draw_frames(figure: FigureBase, series: Series) -> None:
    """Draw palms, contacts and outline as known at each time, one frame each."""
    numbers = frames(series, MAX_FRAMES)
    grid = figure.subplots(row_count(series), COLUMNS, squeeze=False).ravel()
    reach = _reach(series, numbers)
    for axes, number in zip(grid, numbers, strict=False):
        _frame(axes, series, number)
        axes.set(xlim=reach[0], ylim=reach[1], aspect="equal")
        axes.axis("off")
        touched = f", {series.estimate['touched'][number]:.0%}" if series.outlines else ""
        axes.set_title(f"{series.estimate.t[number]:.1f} s{touched}", fontsize=7.5, pad=1.0)
    for axes in grid[len(numbers) :]:
        axes.axis("off")


def _frame(axes: Axes, series: Series, number: int) -> None:
    pose = pose_at(series, number)
    for palm, contact in zip(pose.palms(_PALM_M), pose.contacts, strict=True):
        axes.plot(*palm * 1e3, color=GREY, linewidth=1.6, solid_capstyle="round")
        axes.plot(*contact * 1e3, "o", color=ORANGE, markersize=3.0, zorder=4)
    object_number = int(series.estimate["object"][number])
    known = outline_known(series, pose.t, object_number)
    if known is not None:
        curve = (turned(points(known.theta, known.h), pose.psi) + pose.centre[:, None]) * 1e3
        axes.plot(*closed(curve), color=BLUE, linewidth=0.6, alpha=0.5)
        axes.plot(*closed(np.where(known.touched, curve, math.nan)), color=BLUE, linewidth=1.6)
    else:
        before = np.flatnonzero(series.valid[: number + 1] & (series.estimate["object"][: number + 1] == object_number))
        contacts = contact_points(series, before[:: -(-len(before) // _MAX_CONTACTS)])
        axes.plot(*(turned(contacts, pose.psi) + pose.centre[:, None]) * 1e3, ".", color=BLUE, markersize=1.2)
    axes.plot(*pose.centre * 1e3, "+", color=BLACK, markersize=4.0)


def _reach(series: Series, numbers: tuple[int, ...]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Axis limits for all frames: hinge, drawn part of the palms, and object."""
    ends = [(0.0, 0.0)]
    for number in numbers:
        pose = pose_at(series, number)
        ends += [tuple(palm[:, -1] * 1e3) for palm in pose.palms(_PALM_M)]
        radius = 1.1e3 * max(float(series.estimate[name][number]) for name in map("{}_m".format, RADII))
        ends += [tuple(pose.centre * 1e3 + side * radius) for side in (-1.0, 1.0)]
    low, high = np.min(ends, axis=0) - 3.0, np.max(ends, axis=0) + 3.0
    return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))
