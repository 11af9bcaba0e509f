"""One object's outline: at true scale, with its band magnified, and its error over the normals; needs matplotlib."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from palmd.chords import STRAIGHT_LABEL, chords_of
from palmd.events import FloatArray
from palmd.polygon import normals
from palmd.report.axes import BLACK, BLUE, GREY, ORANGE
from palmd.report.body import closed, felt_points, points
from palmd.report.errors import SDS, OutlineAgainst
from palmd.report.series import Bools, OutlineAt, Series

_MAGNIFIED_TO = 0.12  # of the mean radius: how wide the touched normals' band is drawn
_FURTHEST = 0.45  # of the mean radius: what the magnified band is cut off at
_MOST_FELT = 400
_DASHED = (0, (4, 2))


@dataclass(frozen=True, slots=True)
class Found:
    """An outline to be drawn, and how it compares with the truth where that is known."""

    outline: OutlineAt
    against: OutlineAgainst | None

    @property
    def judged(self) -> Bools:
        """The normals that scales are chosen for: the touched ones, all if there are none."""
        touched = self.outline.touched
        return np.asarray(touched if touched.any() else np.ones_like(touched))


def magnification(found: Found) -> float:
    """1, 2 or 5 times a power of ten, so that the band of the touched normals can be seen beside the outline."""
    outline, judged = found.outline, found.judged
    widths = [SDS * outline.h_sd[judged]]
    if found.against is not None:
        widths.append(np.abs(found.against.error[judged]))
    widest = max(float(np.percentile(each, 95)) for each in widths)
    wanted = _MAGNIFIED_TO * float(np.mean(outline.h)) / max(widest, 1e-9)
    decade = 10.0 ** math.floor(math.log10(wanted))
    return max(1.0, decade * max(step for step in (1, 2, 5) if step * decade <= wanted))


def draw_outline(figure: FigureBase, found: Found) -> None:
    """Both views side by side, the error below them."""
    panels = figure.subplot_mosaic([["outline", "band"], ["error", "error"]], height_ratios=(2.1, 1.0))
    _outline(panels["outline"], found)
    _band(panels["band"], found)
    _error(panels["error"], found)


def draw_felt(figure: FigureBase, series: Series) -> None:
    """For an observer without a shape: the contacts in the object's frame as it estimated them, while valid."""
    axes = figure.subplots()
    valid = np.flatnonzero(series.valid)
    some = valid[:: -(-len(valid) // _MOST_FELT) or 1]
    felt = felt_points(series, some) * 1e3
    axes.plot(*felt, ".", color=BLUE, markersize=2.0, label="contacts while valid")
    axes.plot(0.0, 0.0, "+", color=BLACK, label="centre of mass")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", title="Where it was touched, in the object's frame")
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))


def _outline(axes: Axes, found: Found) -> None:
    outline = found.outline
    curve = points(outline.theta, outline.h) * 1e3
    axes.plot(*closed(curve), color=BLUE, linewidth=1.4, alpha=0.4, label="not touched")
    axes.plot(*_where(curve, outline.touched), color=BLUE, linewidth=2.0, label="touched")
    for number, chord in enumerate(chords_of(outline.theta, outline.h, outline.touched)):
        axes.plot(*np.array([chord.begin, chord.end]).T * 1e3, color=ORANGE, linewidth=1.6, linestyle=_DASHED,
                  label=STRAIGHT_LABEL if number == 0 else None)  # fmt: skip
    if found.against is not None:
        axes.plot(*closed(points(outline.theta, found.against.h) * 1e3), color=BLACK, linewidth=0.7,
                  linestyle=_DASHED, label="truth")  # fmt: skip
    axes.plot(0.0, 0.0, "+", color=BLACK, label="centre of mass")
    _square(axes, curve, 1.2)
    axes.set_title("(a) true scale")
    axes.legend(loc="center", bbox_to_anchor=(0.5, 0.33), handlelength=1.2)


def _band(axes: Axes, found: Found) -> None:
    """Everything beside the estimate is drawn so many times as far from it as it is, along the normal."""
    outline, times = found.outline, magnification(found)
    curve, outward = points(outline.theta, outline.h), normals(outline.theta).T
    furthest = _FURTHEST * float(np.mean(outline.h))
    reach = np.minimum(SDS * outline.h_sd * times, furthest)
    ring = np.concatenate([closed(curve + reach * outward), closed(curve - reach * outward)[:, ::-1]], axis=1)
    axes.fill(*ring * 1e3, color=BLUE, alpha=0.22, linewidth=0.0, label=f"±{SDS:g} sd")
    axes.plot(*closed(curve) * 1e3, color=BLUE, linewidth=0.8, label="estimate")
    if found.against is not None:
        beside = np.clip(-found.against.error * times, -furthest, furthest)
        axes.plot(*closed(curve + beside * outward) * 1e3, color=BLACK, linewidth=0.8, linestyle=_DASHED, label="truth")
    axes.plot(0.0, 0.0, "+", color=BLACK)
    _square(axes, curve * 1e3, 1.2 + _MAGNIFIED_TO)
    axes.set_title(f"(b) distances from the estimate × {times:,.0f}")
    axes.legend(loc="center", bbox_to_anchor=(0.5, 0.36), handlelength=1.2)


def _error(axes: Axes, found: Found) -> None:
    outline = found.outline
    order = np.argsort(outline.theta)
    theta = np.degrees(outline.theta[order])
    reach = SDS * outline.h_sd[order] * 1e6
    touched = outline.touched[order]
    axes.fill_between(theta, -reach, reach, color=BLUE, alpha=0.22, linewidth=0.0, label=f"±{SDS:g} sd")
    axes.fill_between(theta, 0, 1, where=~touched, color=GREY, alpha=0.15, linewidth=0.0, step="mid",
                      transform=axes.get_xaxis_transform(), label="not touched")  # fmt: skip
    highest = float(np.max(reach[found.judged[order]]))
    if found.against is not None:
        error = found.against.error[order] * 1e6
        axes.plot(theta, error, color=BLACK, linewidth=0.8, label="estimate − truth")
        highest = max(highest, float(np.max(np.abs(error[found.judged[order]]))))
    axes.axhline(0.0, color=GREY, linewidth=0.5)
    axes.set(xlim=(0, 360), ylim=(-1.3 * highest, 1.3 * highest), xlabel="direction of the normal θ (°)",
             ylabel="h (µm)", title="(c) error of the support function")  # fmt: skip
    axes.set_xticks(range(0, 361, 45))
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, borderaxespad=0.0)


def _where(curve: FloatArray, which: Bools) -> FloatArray:
    """The closed curve (2, n + 1), NaN where it is not wanted."""
    return closed(np.where(which, curve, math.nan))


def _square(axes: Axes, curve: FloatArray, room: float) -> None:
    reach = room * float(np.abs(curve).max())
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach))
    axes.locator_params(nbins=5)
