"""Data of the playback on a report's page: poses, outlines as known at the time, states and faults, thinned. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from palmd.report.body import pose_at
from palmd.report.errors import body_at, last_outlines, outline_errors
from palmd.report.series import SD, Interval, OutlineAt, Series
from palmd.system.mechanism import CONTACTS, JOINTS, RADII

MAX_FRAMES = 1200
MAX_OUTLINES = 240
_STEP_S = 0.05
_MAX_NORMALS = 180


def player_data(series: Series) -> dict[str, Any] | None:
    """The JSON data that `player.js` draws; None for a run without a pose.

    Integers to save space: lengths in µm, angles in mrad, times in ms (0.5 MB per minute). frames: rows as in
    `columns`, relative to the hinge; `outline` is the index of the latest outline, -1 for none. curvatures: of the
    palms (1/µm). truth: true h by object, on the normals of its last outline and rotated to fit it.
    """
    shown = _shown(series)
    if not len(shown):
        return None
    outlines = _thinned(series.outlines, MAX_OUTLINES)
    estimate = series.estimate
    frames = [_frame(series, int(number), outlines) for number in shown]
    return {
        "columns": ["t", "way1", "way2", "psi", "x", "y", *CONTACTS, "valid", "outline", "touched", "mass", "mass_sd"],
        "curvatures": [kappa * 1e-6 for kappa in series.run.rig.curvatures],
        "frames": frames,
        "outlines": [_outline(outline) for outline in outlines],
        "truth": {str(outline.number): true_h for outline, true_h in _truths(series)},
        "states": _interval_rows(series.states),
        "segments": _interval_rows(interval for interval in series.segments if interval.label),
        "faults": [
            [round(1e3 * each.begin), round(1e3 * each.end), f"{each.code}: {each.hint}"] for each in series.faults
        ],
        "duration": round(1e3 * (estimate.t[-1])),
    }


def _shown(series: Series) -> list[int]:
    """Numbers of the estimates to show, evenly spaced in time."""
    t = series.estimate.t
    names = ("psi_rad", *(f"{name}_m" for name in (*RADII, *CONTACTS)), *(f"{joint}_rad" for joint in JOINTS))
    known = np.flatnonzero(np.isfinite(np.sum([series.estimate[name] for name in names], axis=0)))
    if not len(known):
        return []
    count = min(MAX_FRAMES, max(2, round((t[-1] - t[0]) / _STEP_S)))
    nearest = known[np.searchsorted(t[known], np.linspace(t[known[0]], t[known[-1]], count)).clip(0, len(known) - 1)]
    return [int(number) for number in np.unique(nearest)]


def _frame(series: Series, number: int, outlines: tuple[OutlineAt, ...]) -> list[int | None]:
    pose, estimate = pose_at(series, number), series.estimate
    object_number = int(estimate["object"][number])
    known = [i for i, each in enumerate(outlines) if each.t <= pose.t + 1e-6 and each.number == object_number]
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
    """Every `step`th normal: h and its standard deviation in µm, touched normals as a text of 0 and 1."""
    step = max(1, len(outline.theta) // _MAX_NORMALS)
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
            step = max(1, len(outline.theta) // _MAX_NORMALS)
            yield outline, np.rint(1e6 * outline_errors(outline, body).h[::step]).astype(int).tolist()


def _thinned(outlines: tuple[OutlineAt, ...], most: int) -> tuple[OutlineAt, ...]:
    """At most `most` outlines, including the last."""
    kept = (
        np.unique(np.linspace(0, len(outlines) - 1, min(most, len(outlines))).round().astype(int)) if outlines else ()
    )
    return tuple(outlines[int(i)] for i in kept)


def _interval_rows(intervals: Iterable[Interval]) -> list[list[int | str]]:
    return [[round(1e3 * interval.begin), round(1e3 * interval.end), interval.label] for interval in intervals]


def _whole(value: float) -> int | None:
    return round(value) if math.isfinite(value) else None
