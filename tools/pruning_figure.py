"""Figure of one outline pruned by both rules, side by side; needs matplotlib."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmd.events import FloatArray
from palmd.observer.reconstruction import Reconstruction
from palmd.observer.visits import KEPT_SD_M, KEPT_VISITS, kept_by_band, kept_by_visits
from palmd.polygon import boundary, degrees, normals
from palmd.score import support_at
from tools.studies.scoring import RIGHT_M, OutlineErrors

_BLUE, _ORANGE, _GREY = "#0072b2", "#d55e00", "#606060"
_MAGNIFIED = 10.0


def save(answer: Reconstruction, errors: OutlineErrors, true_h: FloatArray, path: Path) -> None:
    """Draw the truth, and the estimate with its error magnified; the same run gives the same file.

    `errors`: of `answer`; `true_h`: (360,) the true support function (m). Raises ValueError without an outline.
    """
    if answer.h_sd is None or answer.touched is None or answer.visits is None:
        raise ValueError("the reconstruction has no outline")
    rules = (
        (f"touched {KEPT_VISITS} times or more (the paper)", kept_by_visits(answer.visits)),
        (f"known to {KEPT_SD_M * 1e6:.0f} µm (the band)", kept_by_band(answer.h_sd, answer.touched)),
    )
    with matplotlib.rc_context({"svg.hashsalt": "palmd", "font.size": 9.0, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(10.0, 5.2), layout="constrained")
        for axes, (title, kept) in zip(figure.subplots(1, 2, sharex=True, sharey=True), rules, strict=True):
            _rule(axes, title, errors, answer.touched, kept, true_h)
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def _rule(
    axes: Axes,
    title: str,
    errors: OutlineErrors,
    touched: npt.NDArray[np.bool_],
    kept: npt.NDArray[np.bool_],
    true_h: FloatArray,
) -> None:
    outline = boundary(support_at(true_h, degrees() + errors.score.rotation)) * 1e3  # in the estimate's own frame
    away = _MAGNIFIED * 1e3 * normals(degrees())
    found, band = outline + away * errors.error[:, None], away * 2.0 * errors.h_sd[:, None]
    axes.plot(*np.concatenate([outline, outline[:1]]).T, color=_GREY, linewidth=0.8, label="true outline")
    bad = np.abs(errors.error) > RIGHT_M
    for some, colour, name in ((touched & kept, _BLUE, "kept"), (touched & ~kept, _ORANGE, "pruned")):
        low, high = (found - band)[some], (found + band)[some]
        axes.plot(*np.stack([low, high], axis=1).transpose(2, 1, 0), color=colour, linewidth=0.5, alpha=0.5)
        label = f"{name}: {some.sum()}, of these {(bad & some).sum()} with errors above {RIGHT_M * 1e3:g} mm"
        axes.plot(*found[some].T, ".", color=colour, markersize=4.0, label=label)
    reach = 1.2 * float(np.abs(outline).max())
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach), title=title)
    title = f"directions; error and ±2 sd × {_MAGNIFIED:g}"
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 0.5), fontsize=7.5, title=title, title_fontsize=7.5)
