"""Errors of several trajectories over time, and their outlines over the reference's; needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from palmd.polygon import boundary, degrees
from palmd.report.alignment import Compared
from palmd.report.axes import BLACK, BLUE, GREEN, ORANGE, PINK, WIDTH_IN, line, styled
from palmd.report.tracks import OutlineShape
from palmd.score import support_at

_COLOURS = (BLUE, ORANGE, GREEN, PINK)


def save(found: Sequence[tuple[Compared, OutlineShape | None, OutlineShape | None]], path: Path) -> None:
    """Draws each comparison with the bodies of its source and its reference; the same ones give the same file."""
    with styled("compare"):
        figure = Figure(figsize=(WIDTH_IN, 3.4), layout="constrained")
        axes = figure.subplot_mosaic([["place", "outline"], ["turn", "outline"]], width_ratios=(1.4, 1.0))
        for i, (each, body, true) in enumerate(found):
            colour = _COLOURS[i % len(_COLOURS)]
            t = each.t - each.t[0]
            line(axes["place"], t, each.position_error * 1e3, color=colour, label=each.source)
            line(axes["turn"], t, np.degrees(each.rotation_error), color=colour)
            if body is None or true is None:
                continue
            turned = boundary(support_at(body.h, np.mod(degrees() - each.outline_rotation, 2 * np.pi) - body.theta[0]))
            axes["outline"].plot(*turned.T * 1e3, color=colour)
            if i == 0:
                axes["outline"].plot(*boundary(true.h).T * 1e3, "--", color=BLACK, label="reference")
        axes["place"].set(ylabel="position error (mm)", title="(a) position")
        axes["turn"].set(ylabel="rotation error (°)", xlabel="time (s)", title="(b) orientation")
        axes["outline"].set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", title="(c) outline, best rotation")
        figure.legend(loc="outside lower center", ncols=3)
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
