"""Figure of an outline: at true scale, with magnified uncertainty, and its error over the normals; needs matplotlib."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from palmd.chords import STRAIGHT_LABEL, chords_of
from palmd.events import FloatArray
from palmd.polygon import normals
from palmd.report.axes import BLACK, BLUE, DASHED, GREY, ORANGE
from palmd.report.body import closed, contact_points, points
from palmd.report.errors import OutlineErrors
from palmd.report.series import SDS, Bools, OutlineAt, Series

_MAGNIFIED_TO = 0.12  # of the mean radius: width of the magnified band on touched normals
_CLIP = 0.45  # of the mean radius: limit of the magnified band
_MAX_CONTACTS = 400


@dataclass(frozen=True, slots=True)
class DrawnOutline:
    """An outline to draw, and its errors if the truth is known."""

    outline: OutlineAt
    errors: OutlineErrors | None

    @property
    def scale_normals(self) -> Bools:
        """The normals that determine scales: the touched ones, or all if there are none."""
        touched = self.outline.touched
        return np.asarray(touched if touched.any() else np.ones_like(touched))


def magnification(drawn: DrawnOutline) -> float:
    """Magnification (1, 2 or 5 times a power of ten) that makes the band of the touched normals visible."""
    outline, scale_normals = drawn.outline, drawn.scale_normals
    widths = [SDS * outline.h_sd[scale_normals]]
    if drawn.errors is not None:
        widths.append(np.abs(drawn.errors.error[scale_normals]))
    widest = max(float(np.percentile(each, 95)) for each in widths)
    wanted = _MAGNIFIED_TO * float(np.mean(outline.h)) / max(widest, 1e-9)
    decade = 10.0 ** math.floor(math.log10(wanted))
    return max(1.0, decade * max(step for step in (1, 2, 5) if step * decade <= wanted))


def draw_outline(figure: FigureBase, drawn: DrawnOutline) -> None:
    """Draw both views side by side and the error below."""
    panels = figure.subplot_mosaic([["outline", "band"], ["error", "error"]], height_ratios=(2.1, 1.0))
    _outline(panels["outline"], drawn)
    _band(panels["band"], drawn)
    _error(panels["error"], drawn)


def draw_contacts(figure: FigureBase, series: Series) -> None:
    """Draw the estimated contacts in the object's frame while valid, for an observer without a shape."""
    axes = figure.subplots()
    valid = np.flatnonzero(series.valid)
    some = valid[:: -(-len(valid) // _MAX_CONTACTS) or 1]
    contacts = contact_points(series, some) * 1e3
    axes.plot(*contacts, ".", color=BLUE, markersize=2.0, label="contacts while valid")
    axes.plot(0.0, 0.0, "+", color=BLACK, label="centre of mass")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", title="Contacts in the object's frame")
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))


def _outline(axes: Axes, drawn: DrawnOutline) -> None:
    outline = drawn.outline
    curve = points(outline.theta, outline.h) * 1e3
    axes.plot(*closed(curve), color=BLUE, linewidth=1.4, alpha=0.4, label="not touched")
    axes.plot(*closed(np.where(outline.touched, curve, math.nan)), color=BLUE, linewidth=2.0, label="touched")
    for number, chord in enumerate(chords_of(outline.theta, outline.h, outline.touched)):
        axes.plot(*np.array([chord.begin, chord.end]).T * 1e3, color=ORANGE, linewidth=1.6, linestyle=DASHED,
                  label=STRAIGHT_LABEL if number == 0 else None)  # fmt: skip
    if drawn.errors is not None:
        axes.plot(*closed(points(outline.theta, drawn.errors.h) * 1e3), color=BLACK, linewidth=0.7,
                  linestyle=DASHED, label="truth")  # fmt: skip
    axes.plot(0.0, 0.0, "+", color=BLACK, label="centre of mass")
    _square(axes, curve, 1.2)
    axes.set_title("(a) true scale")
    axes.legend(loc="center", bbox_to_anchor=(0.5, 0.33), handlelength=1.2)


def _band(axes: Axes, drawn: DrawnOutline) -> None:
    """Draw band and truth with their distance from the estimate magnified along the normal."""
    outline, times = drawn.outline, magnification(drawn)
    curve, outward = points(outline.theta, outline.h), normals(outline.theta).T
    furthest = _CLIP * float(np.mean(outline.h))
    reach = np.minimum(SDS * outline.h_sd * times, furthest)
    ring = np.concatenate([closed(curve + reach * outward), closed(curve - reach * outward)[:, ::-1]], axis=1)
    axes.fill(*ring * 1e3, color=BLUE, alpha=0.22, linewidth=0.0, label=f"±{SDS:g} sd")
    axes.plot(*closed(curve) * 1e3, color=BLUE, linewidth=0.8, label="estimate")
    if drawn.errors is not None:
        offset = np.clip(-drawn.errors.error * times, -furthest, furthest)
        axes.plot(*closed(curve + offset * outward) * 1e3, color=BLACK, linewidth=0.8, linestyle=DASHED, label="truth")
    axes.plot(0.0, 0.0, "+", color=BLACK)
    _square(axes, curve * 1e3, 1.2 + _MAGNIFIED_TO)
    axes.set_title(f"(b) distances from the estimate × {times:,.0f}")
    axes.legend(loc="center", bbox_to_anchor=(0.5, 0.36), handlelength=1.2)


def _error(axes: Axes, drawn: DrawnOutline) -> None:
    outline = drawn.outline
    order = np.argsort(outline.theta)
    theta = np.degrees(outline.theta[order])
    reach = SDS * outline.h_sd[order] * 1e6
    touched = outline.touched[order]
    axes.fill_between(theta, -reach, reach, color=BLUE, alpha=0.22, linewidth=0.0, label=f"±{SDS:g} sd")
    axes.fill_between(theta, 0, 1, where=~touched, color=GREY, alpha=0.15, linewidth=0.0, step="mid",
                      transform=axes.get_xaxis_transform(), label="not touched")  # fmt: skip
    highest = float(np.max(reach[drawn.scale_normals[order]]))
    if drawn.errors is not None:
        error = drawn.errors.error[order] * 1e6
        axes.plot(theta, error, color=BLACK, linewidth=0.8, label="estimate − truth")
        highest = max(highest, float(np.max(np.abs(error[drawn.scale_normals[order]]))))
    axes.axhline(0.0, color=GREY, linewidth=0.5)
    axes.set(xlim=(0, 360), ylim=(-1.3 * highest, 1.3 * highest), xlabel="direction of the normal θ (°)",
             ylabel="h (µm)", title="(c) error of the support function")  # fmt: skip
    axes.set_xticks(range(0, 361, 45))
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, borderaxespad=0.0)


def _square(axes: Axes, curve: FloatArray, room: float) -> None:
    reach = room * float(np.abs(curve).max())
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach))
    axes.locator_params(nbins=5)
