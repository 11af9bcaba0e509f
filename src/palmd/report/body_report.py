"""The report of a body between three palms: surface from four sides, motion, estimated parameters; needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import FigureBase

from palmd.events import FloatArray
from palmd.record.surface import SD_COLOURS, SD_RANGE_M, UNTOUCHED, Mesh, sd_colours
from palmd.record.verdict import has_estimate
from palmd.report.axes import BLACK, BLUE, GREEN, ORANGE, PINK
from palmd.report.sections import CaptionedFigure, Report, Section

SIDES = ("most touched", "from its right", "from behind", "from its left")
PAD_COLOURS = (ORANGE, BLACK, PINK)
_LIGHT = np.array([-0.4, 0.5, 0.77])
_DULL = 0.55  # brightness of faces turned away from the light


@dataclass(frozen=True, slots=True)
class TouchedBody:
    """A surface with its standard deviations, and the contacts (K, 3 palms, 3) on it (m, body frame)."""

    mesh: Mesh
    contacts: FloatArray


def draw_surface(figure: FigureBase, body: TouchedBody) -> None:
    """Draw four views at the same scale, the first one of the side that was touched most."""
    grid = list(figure.subplots(2, 2).ravel())
    first = first_view(body.contacts)
    reach = 1.08e3 * float(np.linalg.norm(body.mesh.points, axis=1).max())
    for number, (axes, name) in enumerate(zip(grid, SIDES, strict=True)):
        angle = 0.5 * math.pi * number
        turn = np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
        _view(axes, body, turn @ first)
        axes.set(title=name, xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="mm")
        axes.grid(visible=False)
    pads = [grid[0].plot([], [], color=colour, label=f"pad {i}")[0] for i, colour in enumerate(PAD_COLOURS, 1)]
    grid[0].legend(handles=pads, loc="upper left")
    scale = LinearSegmentedColormap.from_list("band", SD_COLOURS / 255)
    bar = figure.colorbar(
        ScalarMappable(LogNorm(1e6 * SD_RANGE_M[0], 1e6 * SD_RANGE_M[1]), scale),
        ax=grid,
        shrink=0.6,
        label="standard deviation (µm)",
    )
    bar.ax.text(0.5, -0.05, "grey:\nuntouched", transform=bar.ax.transAxes, ha="center", va="top", fontsize=7.0,
                color=tuple(UNTOUCHED / 400))  # fmt: skip


def first_view(contacts: FloatArray) -> FloatArray:
    """View matrix (3, 3) of the side that was touched most; rows: right, up, towards the eye."""
    touched = contacts.reshape(-1, 3) / np.linalg.norm(contacts.reshape(-1, 3), axis=1)[:, None]
    spread, axes = np.linalg.eigh(touched.T @ touched)
    del spread
    mean = touched.mean(0)
    eye = mean / np.linalg.norm(mean) if np.linalg.norm(mean) > 0.1 else axes[:, 2]
    up = axes[:, 0] - eye * (axes[:, 0] @ eye)
    up /= np.linalg.norm(up)
    return np.stack([np.cross(up, eye), up, eye])


def _view(axes: Axes, body: TouchedBody, view: FloatArray) -> None:
    mesh = body.mesh
    points = 1e3 * mesh.points @ view.T
    corners = points[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    facing = normals[:, 2] > 0.0
    shade = _DULL + (1.0 - _DULL) * np.maximum(normals @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0)
    if mesh.sd is None or mesh.touched is None:
        colours = np.tile(UNTOUCHED / 255, (len(points), 1))
    else:
        colours = sd_colours(mesh.sd, mesh.touched) / 255
    faces = (colours[mesh.triangles].mean(1) * shade[:, None])[facing]
    axes.add_collection(
        PolyCollection(
            list(corners[facing, :, :2]), facecolors=faces, edgecolors=faces, linewidths=0.3, rasterized=True
        )
    )
    for pad, colour in enumerate(PAD_COLOURS):
        curve = 1e3 * body.contacts[:, pad] @ view.T
        outward = body.contacts[:, pad] / np.linalg.norm(body.contacts[:, pad], axis=1)[:, None] @ view[2]
        steps = np.stack([curve[:-1, :2], curve[1:, :2]], axis=1)[(outward[:-1] > 0.0) & (outward[1:] > 0.0)]
        axes.add_collection(LineCollection(list(steps), colors=colour, linewidths=0.8, rasterized=True))


def body_report(name: str, result: Mapping[str, Any]) -> Report:
    """The report of a result of `palmd reconstruct` for three palms; without an estimate it has no figures."""
    sections: list[Section] = []
    if has_estimate(result):
        track = {key: np.array(values, dtype=np.float64) for key, values in result["trajectory"].items()}
        touched = np.array(result["touched"], dtype=bool)
        mesh = Mesh(np.array(result["points_m"]), np.array(result["triangles"]), np.array(result["h_sd_m"]), touched)
        body = TouchedBody(mesh, track["contacts_body_m"])
        sections = [
            Section(
                "Surface", (CaptionedFigure(partial(draw_surface, body=body), 6.2, _surface_caption(result, touched)),)
            ),
            Section("Motion", (CaptionedFigure(partial(_draw_motion, track=track), 4.2, _MOTION_CAPTION),)),
        ]
    return Report(name, _facts(result), tuple(sections))


_MOTION_CAPTION = (
    "Angular velocity in the world frame, rotation since the beginning, and displacement of the centre of mass from its"
    " first position."
)


def _surface_caption(result: Mapping[str, Any], touched: FloatArray) -> str:
    band = math.sqrt(float(np.mean(np.array(result["h_sd_m"])[touched] ** 2)))
    return (
        f"The surface where it was touched, within 4 degrees, coloured by standard deviation ({1e6 * band:.0f} µm RMS"
        f" on {np.mean(touched):.0%} of the directions). Lines: contacts with each pad. Grey parts were never touched;"
        " their shape follows from the prior only."
    )


def _facts(result: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    facts = [("outcome", "converged" if result["converged"] else f"not converged: {result['reason']}")]
    if not has_estimate(result):
        return tuple(facts)
    t = result["trajectory"]["t"]
    facts += [
        ("duration", f"{t[-1] - t[0]:.1f} s"),
        ("touched", f"{np.mean(result['touched']):.0%} of the directions"),
        ("friction", f"{result['mu']:z.4f} ± {result['mu_sd']:.4f}"),
        ("inertia", _inertia(result)),
    ]
    if result["mass_kg"] is not None:
        facts.append(("mass", f"{1e3 * result['mass_kg']:.2f} ± {1e3 * result['mass_sd_kg']:.2f} g"))
    facts.append(("readings", f"RMS residual {math.sqrt(result['chi2']):.3f} of the noise"))
    return tuple(facts)


def _inertia(result: Mapping[str, Any]) -> str:
    """The principal radii of gyration, and the relative standard deviation of their mean square."""
    inertia, sd = np.array(result["inertia_m2"]), np.array(result["inertia_sd_m2"])
    radii = 1e3 * np.sqrt(np.linalg.eigvalsh(inertia))
    relative_sd = float(np.mean(np.diagonal(sd)) / np.mean(np.diagonal(inertia)))
    return f"radii of gyration {', '.join(f'{each:.2f}' for each in radii)} mm; inertia ± {relative_sd:.0%}"


def _draw_motion(figure: FigureBase, track: Mapping[str, FloatArray]) -> None:
    top, middle, low = figure.subplots(3, 1, sharex=True)
    t, q = track["t"], track["quat_xyzw"]
    rotation = 2.0 * np.degrees(np.arccos(np.clip(np.abs(q @ q[0]), 0.0, 1.0)))
    displacement = 1e3 * (track["com_m"] - track["com_m"][0])
    for k, (axis, colour) in enumerate(zip("xyz", (BLUE, ORANGE, GREEN), strict=True)):
        top.plot(t, track["omega_rad_s"][:, k], color=colour, label=axis)
        low.plot(t, displacement[:, k], color=colour)
    middle.plot(t, rotation, color=BLUE)
    top.set_ylabel("rad/s")
    top.legend(ncols=3)
    middle.set_ylabel("rotation (deg)")
    low.set(ylabel="displacement (mm)", xlabel="s")
