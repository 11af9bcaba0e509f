"""The figures of CMU-CS-01-107, chapter 3, drawn from runs made here (`paper_runs`); needs matplotlib."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palmd.events import FloatArray
from palmd.model import quasistatic as qs
from palmd.model.shape import coefficients_of
from palmd.model.stable_poses import outline_at
from tools.studies.balanced import BalancedRun
from tools.studies.paper_published import HARDWARE, SIMULATION
from tools.studies.paper_runs import (
    OUTLINE,
    Method,
    PaperSimulation,
    SideBySide,
    Trace,
    psi_error,
    relative_radius_error,
)

TRUE, PAPER, PALMD, GREY = "#000000", "#d55e00", "#0072b2", "#999999"
FRAMES_EACH = 20  # readings between frames; the paper draws every tenth
_PALM_MM = 60.0
_SHOWN = slice(None, None, 3)  # one by one they would make a large file


def save(simulation: PaperSimulation, sides: Sequence[SideBySide], folder: Path) -> list[Path]:
    """Draws `paper_frames.svg`, `paper_simulation.svg`, `paper_experiment.svg`; the same runs give the same files."""
    figures = {
        "paper_frames": frames_figure(simulation),
        "paper_simulation": simulation_figure(simulation),
        "paper_experiment": experiment_figure(sides),
    }
    paths = []
    with matplotlib.rc_context({"svg.hashsalt": "palmd"}):
        for name, figure in figures.items():
            paths.append(folder / f"{name}.svg")
            figure.savefig(paths[-1], metadata={"Date": None})
    return paths


def _styled(draw: Callable[[], Figure]) -> Figure:
    with matplotlib.rc_context({"font.size": 8.0, "axes.grid": True, "grid.alpha": 0.3, "axes.titlesize": 8.5}):
        return draw()


def frames_figure(simulation: PaperSimulation) -> Figure:
    """Figure 3.9: what has been reconstructed after 20, 40, … readings, palms and contacts."""
    return _styled(lambda: _frames(simulation))


def _frames(simulation: PaperSimulation) -> Figure:
    run, found = simulation.run, simulation.found
    numbers = range(FRAMES_EACH - 1, len(run.t), FRAMES_EACH)
    columns = 5
    rows = -(-len(numbers) // columns)
    figure = Figure(figsize=(7.5, 1.55 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    true = _body_curve(OUTLINE)
    points = _felt_points(run, found)
    for axes, number in zip(grid.flat, numbers, strict=False):
        felt = run.felt[number]
        phi1, phi12 = float(felt.phi1), float(felt.phi12)
        for angle in (phi1, phi12):
            axes.plot([0, _PALM_MM * np.cos(angle)], [0, _PALM_MM * np.sin(angle)], color=GREY, linewidth=1.5)
        centre = _centre(phi1, float(felt.phi2), run.contacts.r1[number], run.contacts.r2[number])
        axes.plot(*_placed(true, float(run.psi[number]), centre), color=GREY, linewidth=0.6)
        seen = _placed(points[:, : 2 * (number + 1)][:, _SHOWN], float(found.psi[number]), centre)
        axes.plot(*seen, ".", color=PAPER, markersize=1.2)
        contacts = _placed(points[:, 2 * number : 2 * number + 2], float(found.psi[number]), centre)
        axes.plot(*contacts, "o", color=PAPER, markersize=3.5)
        axes.plot(*centre, "o", color=TRUE, markersize=3.0)
        axes.set(xlim=(-52, 52), ylim=(-3, 63), aspect="equal", title=f"t = {run.t[number]:.2f}")
        axes.axis("off")
    for axes in grid.flat[len(numbers) :]:
        axes.axis("off")
    return figure


def simulation_figure(simulation: PaperSimulation) -> Figure:
    """Figures 3.10 and 3.11 in one, and which errors tell the mean radius."""
    return _styled(lambda: _simulation(simulation))


def _simulation(simulation: PaperSimulation) -> Figure:
    run, found, valley = simulation.run, simulation.found, simulation.valley
    radius_error, psi_off = relative_radius_error(run, found), psi_error(run, found)
    figure = Figure(figsize=(7.5, 8.6), layout="constrained")
    grid = figure.add_gridspec(5, 2, height_ratios=(1.35, 1, 1, 1, 1))
    shape, radii, psi, rate, x, norm, e_f, e_c = (figure.add_subplot(grid[i // 2, i % 2]) for i in range(8))
    wide = figure.add_subplot(grid[4, :])
    shape.plot(*_body_curve(OUTLINE), color=TRUE, linewidth=0.8, label="actual")
    shape.plot(
        *_felt_points(run, simulation.astray),
        ".",
        color=GREY,
        markersize=1.5,
        label="mean radius 6 % off,\nsame e_f and e_c",
    )
    shape.plot(*_felt_points(run, found), ".", color=PAPER, markersize=2, label="observed")
    shape.set(aspect="equal", xlabel="mm", ylabel="mm", title="(3.10a) shape")
    for name, true, seen, style in (
        ("r1", run.contacts.r1, found.r1, "-"),
        ("r2", run.contacts.r2, found.r2, "--"),
    ):
        radii.plot(run.t, true * 1e3, style, color=TRUE, linewidth=0.8, label=f"{name}")
        radii.plot(run.t, seen * 1e3, style, color=PAPER, linewidth=0.8, label=f"observed {name}")
    radii.set(ylabel="mm", title=f"(3.10b) radii: off by {radius_error:.2%}, in the paper {SIMULATION.radius:.0%}")
    psi.plot(run.t, run.psi, color=TRUE, linewidth=0.8, label="ψ")
    psi.plot(found.t, found.psi, "--", color=PAPER, linewidth=0.8, label="observed ψ")
    psi.set(ylabel="rad", title=f"(3.10c) orientation: off by {psi_off:.3f} rad, in the paper {SIMULATION.psi_rad:g}")
    true_rate = np.gradient(run.psi, run.t)
    rate.plot(run.t, true_rate, color=TRUE, linewidth=0.8, label="dψ/dt")
    rate.plot(found.t, found.omega0, "--", color=PAPER, linewidth=0.8, label="observed dψ/dt")
    margin = 1.3 * np.abs(true_rate).max()
    rate.set(ylabel="rad per unit of time", ylim=(-margin, margin), title="(3.10d) rotational velocity")
    real_x, seen_x = (
        _centre(run.phi1, run.phi2, *radii)[0] for radii in ((run.contacts.r1, run.contacts.r2), (found.r1, found.r2))
    )
    x.plot(run.t, real_x, color=TRUE, linewidth=0.8, label="real")
    x.plot(run.t, seen_x, "--", color=PAPER, linewidth=0.8, label="observed")
    x.set(ylabel="mm", title="(3.11a) X of the centre of mass")
    e_f.plot(run.t, found.e_f * 1e3, color=PAPER, linewidth=0.8)
    e_f.set(ylabel="mm", title="(3.11c) error in X: e_f")
    apart = np.array([_apart(float(f.s1), float(f.s2), float(f.phi2)) for f in run.felt])
    norm.plot(run.t, apart, color=TRUE, linewidth=0.8, label="real")
    norm.plot(run.t, apart + found.e_c * 1e3, "--", color=PAPER, linewidth=0.8, label="observed")
    norm.set(ylabel="mm", title="(3.11b) distance between the contacts")
    e_c.plot(run.t, found.e_c * 1e3, color=PAPER, linewidth=0.8)
    e_c.set(ylabel="mm", title="(3.11d) error in that vector: e_c")
    for axes in (radii, psi, rate, x, norm):
        axes.legend(ncols=4, fontsize=6.5, loc="upper center")
    for axes in (radii, psi, rate, x, norm, e_f, e_c):
        axes.set_xlim(0.0, 1.0)
    shape.legend(fontsize=6.0, loc="center", frameon=False)
    for axes in (radii, psi, x, norm):
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.35 * (high - low))
    wide.semilogy(
        valley.mean * 1e3, valley.observable * 1e3, "o-", color=PAPER, markersize=3, label="e_f and e_c (RMS)"
    )
    wide.semilogy(valley.mean * 1e3, valley.conflict * 1e3, "s-", color=PALMD, markersize=3, label="conflict (RMS)")
    true_mean = float(run.contacts.r1[0] + run.contacts.r2[0]) * 500
    wide.axvline(true_mean, color=GREY, linestyle=":", label="the truth")
    wide.set(xlabel="mean radius to begin with (mm)", ylabel="mm", title="What tells the beginning")
    wide.legend(fontsize=6.5, ncols=3)
    return figure


def experiment_figure(sides: Sequence[SideBySide]) -> Figure:
    """Figure 3.15 for each run: outlines and orientation, the paper's method and palmd's."""
    return _styled(lambda: _experiment(sides))


def _experiment(sides: Sequence[SideBySide]) -> Figure:
    figure = Figure(figsize=(7.5, 2.9 * len(sides)), layout="constrained")
    for (shape, psi), side in zip(figure.subplots(len(sides), 2, squeeze=False), sides, strict=True):
        shape.plot(
            *_body_curve(coefficients_of(np.array(side.told["h_m"]), 24)), color=TRUE, linewidth=0.8, label="true"
        )
        psi.plot(side.told["t"], side.told["psi_rad"], color=TRUE, linewidth=1.0, label="true")
        for name, method, colour in (
            ("quasistatic", side.quasistatic, PAPER),
            ("reconstruct", side.smoother, PALMD),
        ):
            if method is not None:
                _outline_of(shape, method, colour, f"{name}: {method.score.e_h * 1e3:.2g} mm RMS where touched")
                _turn_of(psi, side, method, colour, f"{name}: {method.psi_rms:.2g} rad RMS")
        touched = "" if side.smoother is None else f", {side.smoother.score.touched:.0%} touched"
        shape.set(aspect="equal", xlabel="mm", ylabel="mm", title=f"{side.name}{touched}")
        psi.set(
            xlabel="s", ylabel="ψ (rad)", title=f"still: {side.psi_still:.2g} rad; the paper: {HARDWARE.psi_rad:g} rad"
        )
        shape.legend(fontsize=6.5, loc="lower center", bbox_to_anchor=(0.5, 0.25))
        psi.legend(fontsize=6.5, loc="upper left")
        low, high = psi.get_ylim()
        psi.set_ylim(low, high + 0.35 * (high - low))
    return figure


def _outline_of(axes: Axes, method: Method, colour: str, label: str) -> None:
    """In its own gauge, ψ = 0 at the first reading; faint where untouched."""
    curve = _body_curve(coefficients_of(method.h, 12))
    touched = np.interp(np.linspace(0, 2 * np.pi, curve.shape[1]), method.theta, method.touched.astype(float)) > 0.5
    axes.plot(*curve, color=colour, linewidth=0.6, alpha=0.5)
    axes.plot(*np.where(touched, curve, np.nan), color=colour, linewidth=1.6, label=label)


def _turn_of(axes: Axes, side: SideBySide, method: Method, colour: str, label: str) -> None:
    true = np.interp(method.trace.t, side.told["t"], side.told["psi_rad"])
    gauge = float(np.mean(method.trace.psi - true))
    axes.plot(method.trace.t, method.trace.psi - gauge, color=colour, linewidth=1.0, label=label)


# ------------------------------------------------------------------------------------------------ geometry, mm


def _body_curve(coefficients: FloatArray) -> FloatArray:
    """x = h n − d dn/dθ around the outline (2, 361) (mm)."""
    theta = np.linspace(0.0, 2 * np.pi, 361)
    h, d, _ = outline_at(coefficients, theta)
    return np.stack([h * np.cos(theta) + d * np.sin(theta), h * np.sin(theta) - d * np.cos(theta)]) * 1e3


def _felt_points(run: BalancedRun, found: Trace) -> FloatArray:
    """Contacts in the object's frame as observed, one and two by turns (2, 2n) (mm): R x = −(r n + d t)."""
    points = []
    for number, felt in enumerate(run.felt):
        phi1, phi2 = float(felt.phi1), float(felt.phi2)
        centre = _centre(phi1, phi2, found.r1[number], found.r2[number])
        contacts = np.array(
            [
                [float(felt.s1) * np.cos(phi1), float(felt.s2) * np.cos(phi1 + phi2)],
                [float(felt.s1) * np.sin(phi1), float(felt.s2) * np.sin(phi1 + phi2)],
            ]
        )
        points.append(_turned(contacts * 1e3 - centre[:, None], -float(found.psi[number])))
    return np.concatenate(points, axis=1)


def _placed(points: FloatArray, psi: float, centre: FloatArray) -> FloatArray:
    return _turned(points, psi) + centre[:, None]


def _turned(points: FloatArray, angle: float) -> FloatArray:
    cos, sin = np.cos(angle), np.sin(angle)
    turned: FloatArray = np.array([[cos, -sin], [sin, cos]]) @ points
    return turned


def _centre(phi1: qs.Values, phi2: qs.Values, r1: qs.Values, r2: qs.Values) -> FloatArray:
    """The centre of mass (mm) from the hinge: n1·c = r1, n2·c = r2."""
    phi12 = phi1 + phi2
    x = (r1 * np.cos(phi12) + r2 * np.cos(phi1)) / np.sin(phi2)
    y = (r1 * np.sin(phi12) + r2 * np.sin(phi1)) / np.sin(phi2)
    return np.array([x, y]) * 1e3


def _apart(s1: float, s2: float, phi2: float) -> float:
    """|x1 − x2| (mm): the third side of the triangle that hinge and contacts make."""
    return float(np.sqrt(s1**2 + s2**2 - 2 * s1 * s2 * np.cos(phi2))) * 1e3
