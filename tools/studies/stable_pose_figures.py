"""Figures of stable poses: the surface of an object (figure 3.6), and equal readings in many poses (figure 3.8).

Needs matplotlib.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]

from palmd.events import FloatArray
from palmd.model.shape import coefficients_of
from palmd.model.stable_poses import basins, centre_of_mass, centre_of_rotation, follow, outline_at, touch
from palmd.model.stable_surface import Surface, SurfaceLimits, inside_boundary, stable_surface
from palmd.rig.shapes import random_body
from tools.studies.equations.ambiguous import Ambiguous, many_poses

COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
_INSIDE, _OUTSIDE, _GREY = "#000000", "#d55e00", "#808080"
_SHOWN_SEED = 34
_SHOWN_POSES = 5
_DPI = 180
_EXTENT = np.array([2.5, 2.1, 5.5])  # of the drawn box (rad), so that light falls on what is seen
_LAMP = np.array([0.36, -0.48, 0.8])
_TURN = np.radians(15.0)  # how far palm 1 turns to either side of the pose with equal readings


def surface_figure(coefficients: FloatArray, limits: SurfaceLimits) -> Figure:
    """The surface of stable poses in (φ1, φ2, ψ), the outline, and how many stable poses each palm pose has.

    coefficients: of the support function about the centre of mass (m).
    """
    surface = stable_surface(coefficients, limits, phi1_count=300, phi2_count=240)
    figure = Figure(figsize=(10.0, 5.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.75, 1.0))
    axes = figure.add_subplot(grid[:, 0], projection="3d")
    _surface(axes, coefficients, surface, limits)
    _outline(figure.add_subplot(grid[0, 1]), coefficients)
    _counts(figure.add_subplot(grid[1, 1]), coefficients, limits)
    return figure


def ambiguous_figure(shown: Ambiguous) -> Figure:
    """The object in each of its poses with equal readings, and how the readings part when palm 1 turns."""
    columns = -(-(len(shown.psi) + 1) // 2)
    figure = Figure(figsize=(3.4 * columns, 6.2), layout="constrained")
    axes = figure.subplots(2, columns, squeeze=False).ravel()
    for number, (each, psi) in enumerate(zip(axes, shown.psi, strict=False)):
        _pose(each, shown, float(psi), number)
    figure.suptitle("One object in poses with equal readings; the dot is a mark on the object", fontsize=10.0)
    for each in axes[len(shown.psi) : -1]:
        each.set_axis_off()
    _parting(axes[-1], shown)
    return figure


def save(folder: Path) -> list[Path]:
    """Draws a random object's surface and an ambiguous object into `stable_poses.svg` and `ambiguous.svg`."""
    body = random_body("nominal", np.random.default_rng(_SHOWN_SEED))
    coefficients = coefficients_of(body.support.sample(np.linspace(0.0, 2 * np.pi, 360, endpoint=False)))
    paths = [folder / "stable_poses.svg", folder / "ambiguous.svg"]
    with matplotlib.rc_context({"svg.hashsalt": "palmd", "font.size": 9.0, "grid.alpha": 0.3}):
        surface_figure(coefficients, SurfaceLimits()).savefig(paths[0], dpi=_DPI, metadata={"Date": None})
        ambiguous_figure(many_poses(_SHOWN_POSES)).savefig(paths[1], metadata={"Date": None})
    return paths


def _surface(axes: Axes3D, coefficients: FloatArray, surface: Surface, limits: SurfaceLimits) -> None:
    for number, share in enumerate(surface.covered[: len(COLOURS)]):
        own = surface.component == number
        if own.sum() > len(surface.psi) // 200:
            poses = np.stack([surface.phi1, surface.phi2, surface.psi], axis=1)[own]
            light = _light(coefficients, *poses.T)[:, None]
            _dots(axes, poses, 1.2, np.clip(light * np.array(to_rgb(COLOURS[number])), 0.0, 1.0))
            _name(axes, COLOURS[number], f"part {number + 1}: {share:.0%} of the outline")
    edge = np.stack([surface.phi1, surface.phi2, surface.psi], axis=1)[surface.outside]
    _dots(axes, edge, 1.5, _OUTSIDE)
    _name(axes, _OUTSIDE, "outside boundary")
    _dots(axes, inside_boundary(coefficients, limits, np.linspace(*limits.phi2, 600)), 1.5, _INSIDE)
    _name(axes, _INSIDE, "inside boundary")
    axes.set(xlabel="φ1 (°)", ylabel="φ2 (°)", zlabel="ψ (°)", title="Stable poses")
    axes.set_zticks(range(0, 361, 90))
    axes.view_init(elev=18.0, azim=-125.0)
    axes.set_box_aspect((1.0, 1.0, 1.15), zoom=0.92)
    axes.legend(loc="upper left", frameon=False)


def _light(coefficients: FloatArray, phi1: FloatArray, phi2: FloatArray, psi: FloatArray) -> FloatArray:
    """How bright the surface is: its normal is the gradient of d1 sin φ12 + d2 sin φ1 (3.23) in (φ1, φ2, ψ)."""
    at, sin1, sin12 = touch(coefficients, phi1, phi2, psi), np.sin(phi1), np.sin(phi1 + phi2)
    turned1, turned2 = (at.r1 - at.v1) * sin12, (at.r2 - at.v2) * sin1
    along2 = at.d1 * np.cos(phi1 + phi2) + turned2
    normal = np.stack([turned1 + along2 + at.d2 * np.cos(phi1), along2, -(turned1 + turned2)]) * _EXTENT[:, None]
    return np.asarray(0.55 + 0.75 * np.abs(_LAMP @ normal) / np.linalg.norm(normal, axis=0))


def _dots(axes: Axes3D, poses: FloatArray, size: float, colour: str | FloatArray) -> None:
    x, y, z = np.degrees(poses.T)
    axes.scatter(x, y, z, s=size, c=colour, linewidths=0.0, depthshade=False, rasterized=True)


def _name(axes: Axes3D, colour: str, name: str) -> None:
    axes.plot([], [], [], "o", color=colour, markersize=4.0, label=name)


def _outline(axes: Axes, coefficients: FloatArray) -> None:
    x, y = _boundary(coefficients) * 1e3
    axes.fill(x, y, color="#dddddd")
    axes.plot(x, y, color=_GREY)
    axes.plot(0.0, 0.0, "k+", markersize=9.0)
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title="Outline, + centre of mass", aspect="equal")


def _counts(axes: Axes, coefficients: FloatArray, limits: SurfaceLimits) -> None:
    phi1, phi2 = np.meshgrid(np.linspace(*limits.phi1, 120), np.linspace(*limits.phi2, 100), indexing="ij")
    inside = phi1 + phi2 < limits.phi12_max
    counts = np.full(phi1.shape, np.nan)
    counts[inside] = basins(coefficients, phi1[inside], phi2[inside]).count
    fewest, most = int(np.nanmin(counts)), int(np.nanmax(counts))
    shades = ListedColormap(matplotlib.colormaps["cividis"](np.linspace(0.2, 1.0, most - fewest + 1)))
    mesh = axes.pcolormesh(
        np.degrees(phi1), np.degrees(phi2), counts,
        cmap=shades, norm=BoundaryNorm(np.arange(fewest, most + 2) - 0.5, shades.N), rasterized=True,
    )  # fmt: skip
    axes.set(xlabel="φ1 (°)", ylabel="φ2 (°)", title="Number of stable poses")
    axes.figure.colorbar(mesh, ax=axes, ticks=range(fewest, most + 1))


def _pose(axes: Axes, shown: Ambiguous, psi: float, number: int) -> None:
    palms = np.asarray(shown.phi1), np.asarray(shown.phi2)
    contacts = touch(shown.coefficients, *palms, np.asarray(psi))
    com = centre_of_mass(contacts, palms[0]) * 1e3
    meeting = centre_of_rotation(contacts.s1, contacts.s2, *palms) * 1e3
    cos, sin = np.cos(psi), np.sin(psi)
    x, y = np.array([[cos, -sin], [sin, cos]]) @ _boundary(shown.coefficients) * 1e3 + com[:, None]
    axes.fill(x, y, color="#dddddd")
    axes.plot(x, y, color=COLOURS[number % len(COLOURS)], linewidth=1.6)
    axes.plot(x[0], y[0], "o", color=COLOURS[number % len(COLOURS)], markersize=4.0)
    far = 55.0
    for s, angle in ((shown.s1, shown.phi1), (shown.s2, shown.phi1 + shown.phi2)):
        along = np.array([np.cos(angle), np.sin(angle)])
        axes.plot(*np.stack([0 * along, far * along], axis=1), color="black", linewidth=2.0)
        axes.plot(*np.stack([s * 1e3 * along, meeting], axis=1), color=_GREY, linestyle=":")
    axes.axvline(meeting[0], color=_GREY, linestyle="--", linewidth=0.8)
    axes.plot(*com, "k+", markersize=9.0)
    axes.set(xlim=(-45.0, 45.0), ylim=(-4.0, 60.0), xlabel="X (mm)", ylabel="Y (mm)", aspect="equal")
    readings = f"s1 {float(contacts.s1) * 1e3:.2f}, s2 {float(contacts.s2) * 1e3:.2f} mm"
    axes.set_title(f"ψ = {np.degrees(psi):.0f}°: {readings}", fontsize=9.0)


def _parting(axes: Axes, shown: Ambiguous) -> None:
    turn = np.linspace(0.0, _TURN, 61)
    both = [_readings(shown, sign * turn) for sign in (-1.0, 1.0)]
    turn = np.concatenate([-turn[::-1], turn])
    s1, s2 = (np.concatenate([back[::-1], forth]) for back, forth in zip(*both, strict=True))
    for number in range(len(shown.psi)):
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(np.degrees(turn), s1[:, number] * 1e3, color=colour)
        axes.plot(np.degrees(turn), s2[:, number] * 1e3, color=colour, linestyle="--")
    axes.set(xlabel="turn of palm 1 (°)", ylabel="s1 (solid), s2 (dashed) (mm)")
    axes.set_title("Motion tells the poses apart", fontsize=9.0)
    axes.grid(visible=True)


def _readings(shown: Ambiguous, turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """s1 and s2 (m) of each pose as palm 1 turns, (len(turn), poses)."""
    phi1, phi2 = shown.phi1 + turn, np.full(len(turn), shown.phi2)
    psi = follow(shown.coefficients, shown.psi, phi1, phi2).psi
    contacts = touch(shown.coefficients, phi1[:, None], phi2[:, None], psi)
    return contacts.s1, contacts.s2


def _boundary(coefficients: FloatArray) -> FloatArray:
    """Points x = h n + h′ dn/dθ of the outline in the object's frame, (2, 361) (m)."""
    theta = np.linspace(0.0, 2 * np.pi, 361)
    r, d, _ = outline_at(coefficients, theta)
    return np.stack([r * np.cos(theta) + d * np.sin(theta), r * np.sin(theta) - d * np.cos(theta)])
