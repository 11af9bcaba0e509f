"""Figure of a study: cumulative distributions for each group of runs, one panel for each quantity.

Needs matplotlib.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9")
_GREY = "#808080"
_ACROSS, _SIZE_IN = 2, (5.0, 3.75)

Groups = Mapping[str, Sequence[Any]]


@dataclass(frozen=True, slots=True)
class Panel:
    """A quantity with its axis label, the factor to the axis' unit, and values to mark, in units of the axis."""

    label: str
    value: Callable[[Any], float]
    unit: float = 1.0
    marks: Sequence[float] = ()
    log: bool = True


def save(groups: Groups, panels: Sequence[Panel], stem: Path) -> list[Path]:
    """Draw the runs into `stem`.svg and .png; the same rows give the same files."""
    paths = [stem.with_suffix(".svg"), stem.with_suffix(".png")]
    with matplotlib.rc_context({"svg.hashsalt": "palmd", "font.size": 9.0, "axes.grid": True, "grid.alpha": 0.3}):
        figure = drawn(groups, panels)
        figure.savefig(paths[0], metadata={"Date": None})
        figure.savefig(paths[1], dpi=150)
    return paths


def drawn(groups: Groups, panels: Sequence[Panel]) -> Figure:
    """The figure."""
    down = -(-len(panels) // _ACROSS)
    figure = Figure(figsize=(_ACROSS * _SIZE_IN[0], down * _SIZE_IN[1]), layout="constrained")
    for axes, panel in zip(figure.subplots(down, _ACROSS, squeeze=False).flat, panels, strict=False):
        _shares(axes, panel, groups)
    return figure


def _shares(axes: Axes, panel: Panel, groups: Groups) -> None:
    """Draw cumulative shares of all runs; a run without the value counts as infinite."""
    positive = False
    for colour, (name, rows) in zip(COLOURS, groups.items(), strict=False):
        known = sorted(value * panel.unit for row in rows if math.isfinite(value := panel.value(row)))
        positive |= bool(known) and known[-1] > 0.0
        ends = [*known[:1], *known]  # the first step starts at 0
        shares = [i / len(rows) for i in range(len(ends))]
        axes.step(ends, shares, where="post", color=colour, label=f"{name} ({len(rows)})")
    for mark in panel.marks:
        axes.axvline(mark, color=_GREY, linestyle="--")
    scale = "log" if panel.log and positive else "linear"
    axes.set(ylim=(0.0, 1.02), ylabel="share of runs", xlabel=panel.label, xscale=scale)
    axes.legend(loc="lower right")
