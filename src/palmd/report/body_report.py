"""The report of a reconstructed body between three palms: surface from four sides, motion, estimated parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import FigureBase

from palmd.events import FloatArray
from palmd.record.meshfile import Mesh
from palmd.record.verdict import has_estimate
from palmd.report.axes import BLUE, GREEN, ORANGE
from palmd.report.sections import CaptionedFigure, Report, Section
from palmd.report.surface_figure import TouchedBody, draw_surface


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
