"""Figures of docs/theory/outlook.md, the systems of CMU-CS-01-107's last chapter; needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmd.lab.curved_coverage import SHOWN, SWINGS, Covered, Share, by_motion, by_swing

COLOURS = ("#0072b2", "#d55e00")
_GREY = "#808080"


def save_coverage(rows: Sequence[Covered], path: Path) -> None:
    """Share of the normals touched against the palms' curvature, by equal motion and by equal swing; and what is kept.

    Raises OSError.
    """
    _save(lambda: coverage_figure(rows), path)


def _save(draw: Callable[[], Figure], path: Path) -> None:
    with matplotlib.rc_context({"svg.hashsalt": "palmd", "font.size": 9.0, "axes.grid": True, "grid.alpha": 0.3}):
        draw().savefig(path, format="svg", metadata={"Date": None})


def coverage_figure(rows: Sequence[Covered]) -> Figure:
    """Three panels over one axis of curvature."""
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    motion, swing, kept = figure.subplots(1, 3, sharex=True)
    (flat,) = (row for row in rows if not row.curvature)
    kappa = [row.curvature for row in rows]
    for colour, amplitude in zip(COLOURS, SHOWN, strict=True):
        shares = [by_motion(row, flat, amplitude) for row in rows]
        _line(motion, kappa, shares, colour, f"palms ± {math.degrees(amplitude):.0f}°")
        kept.plot(
            kappa, [share.kept for share in shares], "o-", color=colour, label=f"palms ± {math.degrees(amplitude):.0f}°"
        )
    for colour, most in zip(COLOURS, SWINGS, strict=True):
        shares = [by_swing(row, flat, most) for row in rows]
        _line(swing, kappa, shares, colour, f"normals ± {math.degrees(most):.0f}°")
        kept.plot(
            kappa, [share.kept for share in shares], "s--", color=colour, label=f"normals ± {math.degrees(most):.0f}°"
        )
    motion.set(title="The same motion of the palms", ylabel="share of the normals touched")
    swing.set(title="The same swing of the contacts' normals")
    kept.set(title="Both contacts kept", ylabel="share of objects and poses", ylim=(0.0, 1.05))
    for axes in (motion, swing, kept):
        axes.set_xlabel("curvature (1/m): < 0 dome, > 0 cradle")
        axes.legend(fontsize=7.5)
    for axes in (motion, swing):
        axes.set_ylim(0.0, 1.0)
        axes.axvline(0.0, color=_GREY, linewidth=0.8, linestyle=":")
    return figure


def _line(axes: Axes, kappa: Sequence[float], shares: Sequence[Share], colour: str, label: str) -> None:
    axes.plot(kappa, [share.touched for share in shares], "o-", color=colour, label=label)
    axes.plot(kappa, [share.on_flat for share in shares], "--", color=colour, linewidth=0.8, alpha=0.7)
