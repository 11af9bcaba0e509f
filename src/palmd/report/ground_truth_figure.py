"""Figure of reconstructed and true outline and orientation, after figure 3.15 of the paper; needs matplotlib."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmd.events import FloatArray
from palmd.outlinefile import Outline
from palmd.polygon import boundary, degrees, normals
from palmd.record.resultfile import Result
from palmd.report.ground_truth import CameraComparison
from palmd.score import support_at

_BLUE, _ORANGE, _GREY = "#0072b2", "#d55e00", "#606060"
_SDS = 2.0


def save(result: Result, found: CameraComparison, outline: Outline | None, path: Path) -> None:
    """Draw the comparison; equal input gives equal files."""
    with matplotlib.rc_context({"svg.hashsalt": "palmd", "font.size": 9.0, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(10.0, 4.6), layout="constrained")
        panels = figure.subplot_mosaic(
            [["outline", "psi"], ["outline", "error"]], width_ratios=(1.0, 1.35), height_ratios=(2.2, 1.0)
        )
        _outline(panels["outline"], result, found, outline)
        _orientation(panels["psi"], panels["error"], result, found)
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def _outline(axes: Axes, result: Result, found: CameraComparison, outline: Outline | None) -> None:
    """Draw the estimate, rotated into the true outline's frame if there is one."""
    rotation = 0.0 if found.outline is None else found.outline.rotation
    theta = degrees()
    at = np.mod(theta - rotation, math.tau)
    h = support_at(result.h, at - result.theta[0])
    h_sd = np.interp(at, result.theta, result.h_sd, period=math.tau)
    touched = np.interp(at, result.theta, result.touched, period=math.tau) > 0.5
    estimate = boundary(h) * 1e3
    band = _SDS * h_sd[:, None] * normals(theta) * 1e3
    ring = np.concatenate([_closed(estimate + band), _closed(estimate - band)[::-1]])
    axes.fill(*ring.T, color=_BLUE, alpha=0.15, linewidth=0.0, label=f"±{_SDS:g} sd")
    if outline is not None:
        axes.plot(*_closed(boundary(outline.h) * 1e3).T, color=_ORANGE, linewidth=1.2, label="true outline")
    axes.plot(*_closed(estimate).T, color=_BLUE, linewidth=0.8, linestyle="--", label="palmd, not touched")
    axes.plot(*_closed(np.where(touched[:, None], estimate, np.nan)).T, color=_BLUE, linewidth=2.4,
              label="palmd, touched")  # fmt: skip
    axes.plot(0.0, 0.0, "+", color=_GREY, label="centre of mass")
    reach = 1.25 * float(np.abs(estimate).max())
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach))
    axes.set_title("(a) Outline" if found.outline is None else f"(a) Outline: e_h {found.outline.e_h * 1e6:.0f} µm")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 0.55), fontsize=7.0)


def _orientation(axes: Axes, below: Axes, result: Result, found: CameraComparison) -> None:
    axes.plot(found.t, found.psi_camera, ".", color=_ORANGE, markersize=3.0, label="camera")
    axes.plot(result.t, result.psi, color=_BLUE, linewidth=1.0, label="palmd")
    axes.set(ylabel="ψ (rad)", title=f"(b) Orientation: RMS {found.psi.rms:.4f} rad")
    axes.legend(loc="upper right")
    axes.tick_params(labelbottom=False)
    below.plot(found.t, found.psi_camera - found.psi_palmd, ".", color=_GREY, markersize=2.0)
    below.set(xlabel="t (s)", ylabel="difference (rad)", xlim=axes.get_xlim())


def _closed(points: FloatArray) -> FloatArray:
    return np.concatenate([points, points[:1]])
