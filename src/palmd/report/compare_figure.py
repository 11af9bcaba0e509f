"""Figure of the errors of several trajectories over time and of their outlines; needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from palmd.polygon import boundary, degrees
from palmd.report.alignment import TrajectoryComparison
from palmd.report.axes import BLACK, BLUE, GREEN, ORANGE, PINK, WIDTH_IN, figure_style, line
from palmd.report.tracks import OutlineShape
from palmd.score import support_at

_COLOURS = (BLUE, ORANGE, GREEN, PINK)


def save(found: Sequence[tuple[TrajectoryComparison, OutlineShape | None, OutlineShape | None]], path: Path) -> None:
    """Draw comparisons, each with the outlines of its source and reference; equal input gives equal files."""
    with figure_style("compare"):
        figure = Figure(figsize=(WIDTH_IN, 3.4), layout="constrained")
        axes = figure.subplot_mosaic([["position", "outline"], ["rotation", "outline"]], width_ratios=(1.4, 1.0))
        for i, (each, body, true) in enumerate(found):
            colour = _COLOURS[i % len(_COLOURS)]
            t = each.t - each.t[0]
            line(axes["position"], t, each.position_error * 1e3, color=colour, label=each.source)
            line(axes["rotation"], t, np.degrees(each.rotation_error), color=colour)
            if body is None or true is None:
                continue
            rotated = boundary(support_at(body.h, np.mod(degrees() - each.outline_rotation, 2 * np.pi) - body.theta[0]))
            touched = np.interp(degrees() - each.outline_rotation, body.theta, body.touched, period=2 * np.pi) > 0.5
            axes["outline"].plot(*rotated.T * 1e3, color=colour, linewidth=0.6)
            axes["outline"].plot(*np.where(touched[:, None], rotated, np.nan).T * 1e3, color=colour, linewidth=2.0)
            if i == 0:
                axes["outline"].plot(*boundary(true.h).T * 1e3, "--", color=BLACK, label="reference")
        axes["position"].set(ylabel="position error (mm)", title="(a) position")
        axes["rotation"].set(ylabel="rotation error (°)", xlabel="time (s)", title="(b) orientation")
        axes["outline"].set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", title="(c) outline (bold: touched)")
        figure.legend(loc="outside lower center", ncols=3)
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
