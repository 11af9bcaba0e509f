"""Figures of docs/theory/outlook.md, the systems of CMU-CS-01-107's last chapter; needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmd.model.pivot import ORDER
from tools.studies.curved_coverage import SHOWN, SWINGS, Covered, CoveredShare, by_motion, by_swing
from tools.studies.outlook import OutlookAnswers
from tools.studies.pivot_observability import RANK_TOLERANCE, SWEEPS, ToldByMotion

COLOURS = ("#0072b2", "#d55e00")
_GREY = "#808080"


def save(outlook: OutlookAnswers, folder: Path) -> list[Path]:
    """Draws `outlook_coverage.svg` and `outlook_pivot.svg`; the same studies give the same files. Raises OSError."""
    paths = [folder / "outlook_coverage.svg", folder / "outlook_pivot.svg"]
    save_coverage(outlook.coverage, paths[0])
    _save(lambda: pivot_figure(outlook.pivot), paths[1])
    return paths


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


def _line(axes: Axes, kappa: Sequence[float], shares: Sequence[CoveredShare], colour: str, label: str) -> None:
    axes.plot(kappa, [share.touched for share in shares], "o-", color=colour, label=label)
    axes.plot(kappa, [share.on_flat for share in shares], "--", color=colour, linewidth=0.8, alpha=0.7,
              label="flat, same objects" if colour == COLOURS[0] else None)  # fmt: skip


def pivot_figure(rows: Sequence[Sequence[ToldByMotion]]) -> Figure:
    """What readings tell of the outline in each direction, motion by motion; and what is known in the end."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    spectra, known = figure.subplots(1, 2)
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.95, len(SWEEPS)))
    for colour, sweep, some in zip(colours, SWEEPS, rows, strict=True):
        values = np.median([each.values[: each.of] for each in some], axis=0)
        values = np.where(values > RANK_TOLERANCE * values[0], values, np.nan)
        spectra.semilogy(np.arange(1, len(values) + 1), values, "o-", color=colour, markersize=3.0, label=sweep.name)
    spectra.axhline(1.0, color=_GREY, linewidth=0.8, linestyle="--")
    spectra.set(xlabel="direction of the outline", ylabel="singular value: 0.1 mm over the noise",
                title="What the pad's readings tell, without force")  # fmt: skip
    spectra.set(ylim=(1e-4, 1e3), xticks=range(0, 2 * ORDER + 1, 5))
    spectra.legend(fontsize=7.0, loc="lower left")
    places = np.arange(len(SWEEPS) - 1)
    by_s = [np.median([each.h_by_s for each in some]) for some in rows[1:]]
    with_force = [np.median([each.h for each in some]) for some in rows[1:]]
    for offset, colour, name, sds in (
        (-0.18, COLOURS[1], "by readings alone", by_s),
        (0.18, COLOURS[0], "with force", with_force),
    ):
        known.barh(places + offset, np.array(sds) * 1e6, height=0.34, color=colour, label=name)
    known.set_yticks(places, [sweep.name for sweep in SWEEPS[1:]])
    known.set(xscale="log", xlabel="one-sigma of h_P where touched (µm)", title="What is known of the outline")
    known.invert_yaxis()
    known.legend(fontsize=7.5)
    return figure
