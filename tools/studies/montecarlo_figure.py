"""The study as one figure of four panels; needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmd.rig.shapes import KINDS
from palmd.score import WRONG_M
from tools.studies.montecarlo_summary import CAUSAL_GOAL_S
from tools.studies.scoring import RIGHT_M, MonteCarloRow

COLOURS = dict(zip(KINDS, ("#0072b2", "#e69f00", "#009e73", "#cc79a7"), strict=True))
_GREY = "#808080"
_RANGE_UM = (1.0, 1e3)


def save(rows: Sequence[MonteCarloRow], folder: Path) -> list[Path]:
    """Draws the runs into `montecarlo.svg` and `montecarlo.png`; the same rows give the same files."""
    paths = [folder / "montecarlo.svg", folder / "montecarlo.png"]
    with matplotlib.rc_context({"svg.hashsalt": "palmd", "font.size": 9.0, "axes.grid": True, "grid.alpha": 0.3}):
        figure = drawn(rows)
        figure.savefig(paths[0], metadata={"Date": None})
        figure.savefig(paths[1], dpi=150)
    return paths


def drawn(rows: Sequence[MonteCarloRow]) -> Figure:
    """The figure, not written yet."""
    figure = Figure(figsize=(10.0, 7.5), layout="constrained")
    (outline, efficiency), (consistency, causal) = figure.subplots(2, 2)
    _outline(outline, rows)
    _efficiency(efficiency, rows)
    _consistency(consistency, rows)
    _causal(causal, rows)
    return figure


def _outline(axes: Axes, rows: Sequence[MonteCarloRow]) -> None:
    _shares(axes, rows, lambda row: row.e_h_m * 1e6)
    for limit in (RIGHT_M, WRONG_M):
        axes.axvline(limit * 1e6, color=_GREY, linestyle="--")
    axes.set(xscale="log", xlabel="error of the outline e_h (µm)", title="Outline: right left of the first line")


def _efficiency(axes: Axes, rows: Sequence[MonteCarloRow]) -> None:
    drawn = [row for row in rows if math.isfinite(row.e_h_m + row.h_bound_m)]
    for kind in KINDS:
        for claims, marker in ((True, "o"), (False, "x")):
            some = [row for row in drawn if row.kind == kind and row.converged == claims]
            bounds, errors = [row.h_bound_m * 1e6 for row in some], [row.e_h_m * 1e6 for row in some]
            axes.scatter(bounds, errors, 18.0, COLOURS[kind], marker=marker, alpha=0.7)
    axes.plot(_RANGE_UM, _RANGE_UM, color=_GREY, linestyle="--")
    axes.set(xscale="log", yscale="log", xlabel="Cramér–Rao bound (µm)", ylabel="e_h (µm)")
    axes.set_title("Efficiency: 1 on the line; × not converged")


def _consistency(axes: Axes, rows: Sequence[MonteCarloRow]) -> None:
    _shares(axes, rows, lambda row: row.nees_h)
    axes.axvline(1.0, color=_GREY, linestyle="--")
    axes.set(xscale="log", xlabel="mean (error / sd)² of the outline", title="Error bars: honest at 1")


def _causal(axes: Axes, rows: Sequence[MonteCarloRow]) -> None:
    _shares(axes, rows, lambda row: row.causal.converged_after_s if row.causal else math.nan)
    axes.axvline(CAUSAL_GOAL_S, color=_GREY, linestyle="--")
    axes.set(xlim=(0.0, None), xlabel="right for good after (s)", title="Causal observer")


def _shares(axes: Axes, rows: Sequence[MonteCarloRow], value: Callable[[MonteCarloRow], float]) -> None:
    """For each kind the share of all its runs that stay below; a run without the number stays nowhere below."""
    for kind in KINDS:
        values = [value(row) for row in rows if row.kind == kind]
        if values:
            known = sorted(each for each in values if math.isfinite(each))
            ends = [*known[:1], *known]  # the first step begins at nothing
            shares = [i / len(values) for i in range(len(ends))]
            axes.step(ends, shares, where="post", color=COLOURS[kind], label=f"{kind} ({len(values)})")
    axes.set(ylim=(0.0, 1.02), ylabel="share of runs")
    axes.legend(loc="lower right")
