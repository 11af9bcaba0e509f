"""The report of a recorded body between three palms in space; needs matplotlib."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from matplotlib.figure import FigureBase

from palmd.events import FloatArray
from palmd.polygon import closed_outline
from palmd.record.surface import NORMALS, PLANES, shadow, surface_points
from palmd.report.axes import BLUE, GREY
from palmd.report.sections import Plate, Report, Section
from palmd.report.series import Bools, Series
from palmd.report.system_report import system_report


def report_of(series: Series) -> Report:
    """The surface, then what every system has."""
    if not series.shape:
        return system_report(series, ())
    halvings = int(series.shape["halvings"])
    h, sd, touched = (np.array(series.shape[name], dtype=np.float64) for name in ("h_m", "h_sd_m", "touched"))
    felt = touched > 0
    worst = float(np.max(sd[felt], initial=0.0))
    said = (
        "Shadows of the body on the planes of its own axes (grey) and the points of its surface that were touched"
        f" (blue), {np.mean(felt):.0%} of the directions; there one sd is at most {1e6 * worst:.0f} µm. Elsewhere the"
        " form is no more than what is believed of any body."
    )
    plate = Plate(partial(_draw, h=h, felt=felt, halvings=halvings), 2.9, said)
    return system_report(series, (Section("Surface", (plate,)),))


def _draw(figure: FigureBase, h: FloatArray, felt: Bools, halvings: int) -> None:
    theta: FloatArray = np.arange(NORMALS, dtype=np.float64) * (math.tau / NORMALS)
    points = 1e3 * surface_points(h, halvings)[felt]
    for axes, (plane, (first, second)) in zip(figure.subplots(1, len(PLANES)), PLANES.items(), strict=True):
        outline = 1e3 * closed_outline(theta, shadow(h, halvings, plane))
        axes.plot(outline[:, 0], outline[:, 1], color=GREY, linewidth=0.8)
        axes.plot(points[:, first], points[:, second], ".", color=BLUE, markersize=1.5)
        axes.set(aspect="equal", title=f"{plane} (mm)")
