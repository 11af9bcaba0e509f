"""Anybody's results on the field's runs against the truth: one row a run, one line a method. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palmd.events import FloatArray
from palmd.polygon import degrees
from palmd.score import score_outline, support_at
from tools.studies.peers.task import PeerTruth

Line = Mapping[str, Any]

LOST_M = 1e-3
"""A radius vector off by more (RMS over the second half) is lost: a twentieth of the object."""
SDS = 2.0
HEAD = (
    "method", "answers", "lost", "r mm", "r 90 % mm", "outline µm", "90 % µm", "known", "in 2 sd", "ρ %", "mass %",
    "× real time",
)  # fmt: skip


class ResultLineError(ValueError):
    """A line of results that cannot be scored; its text says what is wrong with it."""


@dataclass(frozen=True, slots=True)
class FieldScore:
    """One method on one run; NaN for what was not told. SI units.

    r_rms: of r1 and r2 over the run's second half, at the times told; inf where the last answer comes before that half.
    e_h: of the outline over the normals that the palms really touched and the method told, after the best rotation;
    known: their share of those touched. inside: share of them within `SDS` of the method's own sd. rho, mass: relative
    errors. cpu: processor time over the run's length.
    """

    method: str
    run: str
    r_rms_m: float = math.nan
    e_h_m: float = math.nan
    known: float = 0.0
    inside: float = math.nan
    rho: float = math.nan
    mass: float = math.nan
    cpu: float = math.nan

    @property
    def answered(self) -> bool:
        """Whether it told anything of the second half."""
        return math.isfinite(self.r_rms_m)

    @property
    def lost(self) -> bool:
        """Whether what it told is off by more than `LOST_M`."""
        return self.answered and self.r_rms_m > LOST_M


def scored(line: Line, truth: PeerTruth) -> FieldScore:
    """The score of one line of results; raises ResultLineError for what does not fit together."""
    told = FieldScore(str(line["method"]), str(line["run"]), r_rms_m=_r_rms(line, truth))
    e_h, known, inside = _outline(line, truth)
    return FieldScore(
        told.method,
        told.run,
        told.r_rms_m,
        e_h,
        known,
        inside,
        _relative(line, "rho_m", truth.rho),
        _relative(line, "mass_kg", truth.mass),
        _number(line, "cpu_s") / float(truth.t[-1] - truth.t[0]),
    )


def table(scores: Iterable[FieldScore]) -> list[tuple[str, ...]]:
    """A row of cells for each method under `HEAD`, medians unless it says otherwise; in the order of first mention."""
    by_method: dict[str, list[FieldScore]] = {}
    for score in scores:
        by_method.setdefault(score.method, []).append(score)
    return [_row(method, rows) for method, rows in by_method.items()]


def _row(method: str, rows: Sequence[FieldScore]) -> tuple[str, ...]:
    answered = [row for row in rows if row.answered]
    outlined = [row for row in rows if math.isfinite(row.e_h_m)]
    r = [row.r_rms_m for row in answered]
    e_h = [row.e_h_m for row in outlined]
    return (
        method,
        f"{len(answered)} of {len(rows)}",
        str(sum(row.lost for row in rows)),
        _told(r, 50, 1e3, ".3f"),
        _told(r, 90, 1e3, ".3f"),
        _told(e_h, 50, 1e6, ".0f"),
        _told(e_h, 90, 1e6, ".0f"),
        _told([row.known for row in outlined], 50, 1.0, ".0%"),
        _mean([row.inside for row in outlined]),
        _told([abs(row.rho) for row in rows], 50, 1e2, ".1f"),
        _told([abs(row.mass) for row in rows], 50, 1e2, ".1f"),
        _told([row.cpu for row in rows], 50, 1.0, ".2f"),
    )


def _told(values: Sequence[float], percentile: float, unit: float, form: str) -> str:
    finite = [value for value in values if math.isfinite(value)]
    return f"{float(np.percentile(finite, percentile)) * unit:{form}}" if finite else "–"


def _mean(values: Sequence[float]) -> str:
    finite = [value for value in values if math.isfinite(value)]
    return f"{np.mean(finite):.0%}" if finite else "–"


def _r_rms(line: Line, truth: PeerTruth) -> float:
    if line.get("t") is None:
        return math.nan
    t, r1, r2 = (_column(line, name) for name in ("t", "r1_m", "r2_m"))
    if not len(t) == len(r1) == len(r2):
        raise ResultLineError(f"t, r1_m and r2_m have {len(t)}, {len(r1)} and {len(r2)} values")
    late = (t >= (truth.t[0] + truth.t[-1]) / 2) & (t <= truth.t[-1]) & np.isfinite(r1 + r2)
    if not late.any():
        return math.nan
    errors = [r - np.interp(t[late], truth.t, true) for r, true in ((r1[late], truth.r1), (r2[late], truth.r2))]
    return math.sqrt(float(np.mean(np.square(errors))))


def _outline(line: Line, truth: PeerTruth) -> tuple[float, float, float]:
    """e_h (m), the share known of what was touched, the share of it within the band."""
    if line.get("h_m") is None:
        return math.nan, 0.0, math.nan
    theta, h = degrees(), _column(line, "h_m")
    if len(h) != len(theta):
        raise ResultLineError(f"h_m has {len(h)} values; it must have one for each whole degree")
    touched = truth.touched(theta)
    judged = touched & np.isfinite(h)
    if not judged.any():
        return math.nan, 0.0, math.nan
    score = score_outline(theta, h, judged, truth.h)
    known = float(np.sum(judged) / np.sum(touched))
    if line.get("h_sd_m") is None:
        return score.e_h, known, math.nan
    h_sd = _column(line, "h_sd_m")
    if len(h_sd) != len(theta):
        raise ResultLineError(f"h_sd_m has {len(h_sd)} values; it must have one for each whole degree")
    off = np.abs(h - support_at(truth.h, theta + score.rotation))
    return score.e_h, known, float(np.mean(off[judged] <= SDS * h_sd[judged]))


def _column(line: Line, name: str) -> FloatArray:
    values = line.get(name)
    if not isinstance(values, list):
        raise ResultLineError(f"{name} must be a list of numbers")
    try:
        return np.array([math.nan if value is None else float(value) for value in values], dtype=np.float64)
    except (TypeError, ValueError):
        raise ResultLineError(f"{name} must be a list of numbers") from None


def _number(line: Line, name: str) -> float:
    value = line.get(name)
    if value is None:
        return math.nan
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise ResultLineError(f"{name} must be a number")
    return float(value)


def _relative(line: Line, name: str, true: float) -> float:
    return _number(line, name) / true - 1.0
