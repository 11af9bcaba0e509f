"""The report of a body between three palms: its surface from four sides, its motion, and what was found of it."""

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
from palmd.report.sections import Plate, Report, Section
from palmd.report.surface_figure import FeltBody, draw_surface


def body_report(name: str, told: Mapping[str, Any]) -> Report:
    """Of a result as `palmd reconstruct` writes it for three palms; one that did not converge is told, not drawn."""
    sections: list[Section] = []
    if has_estimate(told):
        track = {key: np.array(values, dtype=np.float64) for key, values in told["trajectory"].items()}
        touched = np.array(told["touched"], dtype=bool)
        mesh = Mesh(np.array(told["points_m"]), np.array(told["triangles"]), np.array(told["h_sd_m"]), touched)
        body = FeltBody(mesh, track["contacts_body_m"])
        sections = [
            Section("Surface", (Plate(partial(draw_surface, body=body), 6.2, _under_surface(told, touched)),)),
            Section("Motion", (Plate(partial(_draw_motion, track=track), 4.2, _UNDER_MOTION),)),
        ]
    return Report(name, _facts(told), tuple(sections))


_UNDER_MOTION = (
    "Angular velocity in the world, how far the body has turned since the beginning, and its centre of mass from where"
    " it was first."
)


def _under_surface(told: Mapping[str, Any], touched: FloatArray) -> str:
    band = math.sqrt(float(np.mean(np.array(told["h_sd_m"])[touched] ** 2)))
    return (
        f"The surface where palms have been, within 4 degrees, by its one-sigma ({1e6 * band:.0f} µm in the mean square"
        f" on {np.mean(touched):.0%} of the directions). Lines: where each pad was touched. What is grey was never"
        " touched; its form is no more than what is believed of any body."
    )


def _facts(told: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    facts = [("outcome", "converged" if told["converged"] else f"not converged: {told['reason']}")]
    if not has_estimate(told):
        return tuple(facts)
    t = told["trajectory"]["t"]
    facts += [
        ("duration", f"{t[-1] - t[0]:.1f} s"),
        ("touched", f"{np.mean(told['touched']):.0%} of the directions"),
        ("friction", f"{told['mu']:z.4f} ± {told['mu_sd']:.4f}"),
        ("inertia", _inertia(told)),
    ]
    if told["mass_kg"] is not None:
        facts.append(("mass", f"{1e3 * told['mass_kg']:.2f} ± {1e3 * told['mass_sd_kg']:.2f} g"))
    facts.append(("readings", f"explained to {math.sqrt(told['chi2']):.3f} of their noise"))
    return tuple(facts)


def _inertia(told: Mapping[str, Any]) -> str:
    """The principal radii of gyration, and by how much the mean square of them is known."""
    inertia, sd = np.array(told["inertia_m2"]), np.array(told["inertia_sd_m2"])
    radii = 1e3 * np.sqrt(np.linalg.eigvalsh(inertia))
    share = float(np.mean(np.diagonal(sd)) / np.mean(np.diagonal(inertia)))
    return f"radii of gyration {', '.join(f'{each:.2f}' for each in radii)} mm; inertia ± {share:.0%}"


def _draw_motion(figure: FigureBase, track: Mapping[str, FloatArray]) -> None:
    top, middle, low = figure.subplots(3, 1, sharex=True)
    t, q = track["t"], track["quat_xyzw"]
    turned = 2.0 * np.degrees(np.arccos(np.clip(np.abs(q @ q[0]), 0.0, 1.0)))
    moved = 1e3 * (track["com_m"] - track["com_m"][0])
    for k, (axis, colour) in enumerate(zip("xyz", (BLUE, ORANGE, GREEN), strict=True)):
        top.plot(t, track["omega_rad_s"][:, k], color=colour, label=axis)
        low.plot(t, moved[:, k], color=colour)
    middle.plot(t, turned, color=BLUE)
    top.set_ylabel("rad/s")
    top.legend(ncols=3)
    middle.set_ylabel("turned (deg)")
    low.set(ylabel="moved (mm)", xlabel="s")
