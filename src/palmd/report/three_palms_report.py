"""The report of a recorded run of three palms in space; needs matplotlib."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from matplotlib.figure import FigureBase

from palmd.events import FloatArray
from palmd.polygon import closed_outline
from palmd.record.surface import NORMALS, PLANES, shadow, surface_points
from palmd.report.axes import BLUE, GREY
from palmd.report.sections import CaptionedFigure, Report, Section
from palmd.report.series import Bools, Series
from palmd.report.system_report import system_report


def report_of(series: Series) -> Report:
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
    figure = CaptionedFigure(partial(_draw, h=h, touched_points=touched_points, halvings=halvings), 2.9, caption)
    return system_report(series, (Section("Surface", (figure,)),))


def _draw(figure: FigureBase, h: FloatArray, touched_points: Bools, halvings: int) -> None:
    theta: FloatArray = np.arange(NORMALS, dtype=np.float64) * (math.tau / NORMALS)
    points = 1e3 * surface_points(h, halvings)[touched_points]
    for axes, (plane, (first, second)) in zip(figure.subplots(1, len(PLANES)), PLANES.items(), strict=True):
        outline = 1e3 * closed_outline(theta, shadow(h, halvings, plane))
        axes.plot(outline[:, 0], outline[:, 1], color=GREY, linewidth=0.8)
        axes.plot(points[:, first], points[:, second], ".", color=BLUE, markersize=1.5)
        axes.set(aspect="equal", title=f"{plane} (mm)")
