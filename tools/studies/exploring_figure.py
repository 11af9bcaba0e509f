"""What is touched, against time: one panel a kind; needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmd.rig.shapes import KINDS
from tools.studies.exploring import ExploringRow
from tools.studies.exploring_plans import STRATEGIES
from tools.studies.exploring_summary import of
from tools.studies.exploring_watch import ENOUGH

_COLOURS = dict(zip(STRATEGIES, ("#0072b2", "#cc79a7", "#e69f00", "#009e73"), strict=True))
_STYLES = dict(zip(STRATEGIES, ("-", "-.", "--", ":"), strict=True))
_GREY = "#808080"


def save(rows: Sequence[ExploringRow], folder: Path) -> list[Path]:
    """Draws the runs into `explore.svg` and `explore.png`; the same rows give the same files."""
    paths = [folder / "explore.svg", folder / "explore.png"]
    drawn = [row for row in rows if row.curve]
    kinds = [kind for kind in KINDS if any(row.kind == kind for row in drawn)]
    with matplotlib.rc_context({"svg.hashsalt": "palmd", "font.size": 9.0, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(7.5, 0.6 + 2.5 * max(1, (len(kinds) + 1) // 2)), layout="constrained")
        panels = figure.subplots(
            -(-len(kinds) // 2) or 1, min(2, len(kinds)) or 1, sharex=True, sharey=True, squeeze=False
        )
        for axes, kind in zip(panels.flat, kinds, strict=False):
            _coverage(axes, [row for row in drawn if row.kind == kind])
        for axes in panels[-1]:
            axes.set_xlabel("time (s)")
        for axes in panels[:, 0]:
            axes.set_ylabel("touched of what can\nbe reached (%)")
        if kinds:
            figure.legend(
                *panels[0, 0].get_legend_handles_labels(),
                loc="outside upper center",
                ncols=len(STRATEGIES),
                title="median of the objects, and from the 10th to the 90th percentile",
            )
        figure.savefig(paths[0], metadata={"Date": None})
        figure.savefig(paths[1], dpi=150)
    return paths


def _coverage(axes: Axes, rows: Sequence[ExploringRow]) -> None:
    """The median of all objects, and from the 10th to the 90th percentile."""
    for strategy in STRATEGIES:
        curves = 100.0 * np.array([row.curve for row in of(strategy, rows)])
        if not len(curves):
            continue
        low, middle, high = np.quantile(curves, (0.1, 0.5, 0.9), axis=0)
        t = np.arange(curves.shape[1])
        axes.fill_between(t, low, high, color=_COLOURS[strategy], alpha=0.15, linewidth=0.0)
        axes.plot(t, middle, color=_COLOURS[strategy], linestyle=_STYLES[strategy], label=strategy)
    axes.axhline(100.0 * ENOUGH, color=_GREY, linewidth=0.8)
    axes.set(xlim=(0.0, None), ylim=(0.0, 102.0))
    axes.set_title(f"{rows[0].kind} (objects: {len({row.seed for row in rows})})")
