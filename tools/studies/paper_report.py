"""The paper's figures in numbers: a table of what its method and palmd's make of the same runs. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tools.studies.paper_published import HARDWARE, SIMULATION
from tools.studies.paper_runs import Method, PaperSimulation, SideBySide, psi_error, relative_radius_error

HEAD = ("run", "method", "outline e_h", "of the radius", "r1, r2", "ψ", "touched")
NONE = "–"


def rows(simulation: PaperSimulation, sides: Sequence[SideBySide]) -> list[tuple[str, ...]]:
    """The table's rows under `HEAD`; errors are RMS, the outline's where touched, ψ's without the gauge."""
    run = simulation.run
    table: list[tuple[str, ...]] = [
        (
            "the paper's simulation",
            "the paper's",
            NONE,
            NONE,
            f"{SIMULATION.radius:.0%}",
            _rad(SIMULATION.psi_rad),
            NONE,
        ),
        ("the same here, exact", "e_f, e_c alone", NONE, NONE, "any mean radius does", NONE, NONE),
    ]
    for beginning, trace in (("mean radius 6 % off", simulation.astray), ("with the conflict", simulation.found)):
        off = f"{relative_radius_error(run, trace):.2%}"
        table.append(("the same here, exact", beginning, NONE, NONE, off, _rad(psi_error(run, trace)), NONE))
    touched = f"{HARDWARE.touched:.0%}"
    table.append(
        (
            "the paper's experiment",
            "the paper's",
            f"{HARDWARE.rms_mm:g} mm",
            f"{HARDWARE.rms_mm / HARDWARE.mean_radius_mm:.0%}",
            NONE,
            _rad(HARDWARE.psi_rad),
            touched,
        )
    )
    for side in sides:
        radius = float(np.mean(side.told["h_m"]))
        table.append((side.name, "it does not turn", NONE, NONE, NONE, _rad(side.psi_still), NONE))
        for name, method in (("quasistatic", side.quasistatic), ("reconstruct", side.smoother)):
            table.append((side.name, name, *_told(method, radius)))
    return table


def _told(method: Method | None, radius: float) -> tuple[str, ...]:
    if method is None:
        return ("no answer", NONE, NONE, NONE, NONE)
    return (
        _mm(method.score.e_h),
        f"{method.score.e_h / radius:.2%}",
        _mm(method.r_rms),
        _rad(method.psi_rms),
        f"{method.score.touched:.0%}",
    )


def _mm(metres: float) -> str:
    return f"{metres * 1e3:.3f} mm"


def _rad(angle: float) -> str:
    return f"{angle:.4f} rad" if math.isfinite(angle) else NONE


def as_text(table: Sequence[Sequence[str]]) -> str:
    """In columns, for a terminal."""
    widths = [max(len(row[i]) for row in (HEAD, *table)) for i in range(len(HEAD))]
    lines = [
        "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in (HEAD, *table)
    ]
    return "\n".join(lines) + "\n"
