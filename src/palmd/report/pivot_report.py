"""The report of a recorded run of a pivoting grasp; needs matplotlib."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import FigureBase

from palmd.events import FloatArray
from palmd.polygon import closed_outline
from palmd.report.axes import BLUE, GREY
from palmd.report.sections import CaptionedFigure, Report, Section
from palmd.report.series import Bools, Series
from palmd.report.system_report import system_report


def report_of(series: Series) -> Report:
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
    figure = CaptionedFigure(partial(_draw, theta=theta, h=h, touched=touched > 0), 4.4, caption)
    return system_report(series, (Section("Outline", (figure,)),))


def _draw(figure: FigureBase, theta: FloatArray, h: FloatArray, touched: Bools) -> None:
    axes = figure.subplots()
    points = 1e3 * closed_outline(theta, h)
    axes.plot(points[:, 0], points[:, 1], color=GREY, linewidth=0.8)
    nearest = np.rint(np.arange(len(points)) * len(touched) / (len(points) - 1)).astype(int) % len(touched)
    touched_points = np.where(touched[nearest][:, None], points, np.nan)
    axes.plot(touched_points[:, 0], touched_points[:, 1], color=BLUE, linewidth=1.6)
    axes.plot([0.0], [0.0], "+", color="black")
    axes.set(aspect="equal", xlabel="mm", ylabel="mm")
