"""A run thinned to what a page needs to play it back: poses, outlines as they were known, what was said. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from palmd.report.body import pose_at
from palmd.report.errors import against, body_at, last_outlines
from palmd.report.series import SD, OutlineAt, Series, Spell
from palmd.system.mechanism import CONTACTS, JOINTS, RADII

MOST_FRAMES = 1200
MOST_OUTLINES = 240
_STEP_S = 0.05
_MOST_NORMALS = 180


def player_data(series: Series) -> dict[str, Any] | None:
    """What `player.js` draws, as JSON takes it; None for a run in which there is never a pose to draw.

    Lengths in µm, angles in mrad, times in ms, as whole numbers: a minute takes half a megabyte. frames: rows as in
    `columns`, seen from the hinge; `outline` the number of the one known then, -1 for none. curvatures: of the palms
    (1/µm). truth: h of what really lay there, by object, on the normals of its last outline and turned to fit it.
    """
    shown = _shown(series)
    if not len(shown):
        return None
    outlines = _thinned(series.outlines, MOST_OUTLINES)
    estimate = series.estimate
    frames = [_frame(series, int(number), outlines) for number in shown]
    return {
        "columns": ["t", "way1", "way2", "psi", "x", "y", *CONTACTS, "valid", "outline", "touched", "mass", "mass_sd"],
        "curvatures": [kappa * 1e-6 for kappa in series.run.rig.curvatures],
        "frames": frames,
        "outlines": [_outline(outline) for outline in outlines],
        "truth": {str(outline.number): told for outline, told in _truths(series)},
        "states": _spells(series.states),
        "segments": _spells(spell for spell in series.segments if spell.what),
        "faults": [
            [round(1e3 * each.begin), round(1e3 * each.end), f"{each.code}: {each.hint}"] for each in series.faults
        ],
        "duration": round(1e3 * (estimate.t[-1])),
    }


def _shown(series: Series) -> list[int]:
    """Numbers of the estimates to show: evenly in time, as many as there is use for."""
    t = series.estimate.t
    names = ("psi_rad", *(f"{name}_m" for name in (*RADII, *CONTACTS)), *(f"{joint}_rad" for joint in JOINTS))
    known = np.flatnonzero(np.isfinite(np.sum([series.estimate[name] for name in names], axis=0)))
    if not len(known):
        return []
    count = min(MOST_FRAMES, max(2, round((t[-1] - t[0]) / _STEP_S)))
    nearest = known[np.searchsorted(t[known], np.linspace(t[known[0]], t[known[-1]], count)).clip(0, len(known) - 1)]
    return [int(number) for number in np.unique(nearest)]


def _frame(series: Series, number: int, outlines: tuple[OutlineAt, ...]) -> list[int | None]:
    pose, estimate = pose_at(series, number), series.estimate
    about = int(estimate["object"][number])
    known = [i for i, each in enumerate(outlines) if each.t <= pose.t + 1e-6 and each.number == about]
    lengths = [*pose.centre, *(float(estimate[f"{name}_m"][number]) for name in CONTACTS)]
    return [
        round(1e3 * pose.t),
        *(round(1e3 * angle) for angle in (pose.directions[0], pose.directions[-1], pose.psi % math.tau)),
        *(_whole(1e6 * length) for length in lengths),
        int(series.valid[number]),
        known[-1] if known else -1,
        _whole(1e3 * float(estimate["touched"][number])),
        *(_whole(1e6 * float(estimate[name][number])) for name in ("mass_kg", SD + "mass_kg")),
    ]


def _outline(outline: OutlineAt) -> dict[str, Any]:
    """Every `step`th normal: h and its sd in µm, marks of touch as a text of 0 and 1."""
    step = max(1, len(outline.theta) // _MOST_NORMALS)
    some = slice(None, None, step)
    touched = outline.touched
    return {
        "object": outline.number,
        "theta0": round(1e6 * float(outline.theta[0])) / 1e6,
        "h": np.rint(1e6 * outline.h[some]).astype(int).tolist(),
        "sd": np.rint(1e6 * outline.h_sd[some]).astype(int).tolist(),
        "touched": "".join("01"[int(mark)] for mark in touched[some]),
        "typical": _whole(1e6 * float(np.median(outline.h_sd[touched]))) if touched.any() else None,
        "worst": _whole(1e6 * float(outline.h_sd.max())),
    }


def _truths(series: Series) -> Iterable[tuple[OutlineAt, list[int]]]:
    for outline in last_outlines(series):
        body = body_at(series, outline.t)
        if body is not None and outline.valid:
            step = max(1, len(outline.theta) // _MOST_NORMALS)
            yield outline, np.rint(1e6 * against(outline, body).h[::step]).astype(int).tolist()


def _thinned(outlines: tuple[OutlineAt, ...], most: int) -> tuple[OutlineAt, ...]:
    """As many as that, the last one among them."""
    kept = (
        np.unique(np.linspace(0, len(outlines) - 1, min(most, len(outlines))).round().astype(int)) if outlines else ()
    )
    return tuple(outlines[int(i)] for i in kept)


def _spells(spells: Iterable[Spell]) -> list[list[int | str]]:
    return [[round(1e3 * spell.begin), round(1e3 * spell.end), spell.what] for spell in spells]


def _whole(value: float) -> int | None:
    return round(value) if math.isfinite(value) else None
