"""A recorded run against the rig's truth: errors of the estimates over time, and of the outlines. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize_scalar

from palmd.events import FloatArray
from palmd.quantities import ESTIMATE, TRUTH
from palmd.report.series import CONSTANTS, SD, OutlineAt, Series, TrueBody
from palmd.score import OutlineScore, score_outline, support_at
from palmd.system.mechanism import JOINTS, RADII
from palmd.topics import truth_of

SDS = 2.0
"""How many one-sigmas every band has to both sides."""

STATE = tuple(quantity.name for quantity in ESTIMATE.quantities if quantity.role == "named")
"""The named state and ψ, as published."""

OBJECTS_OWN = (*(f"{name}_m" for name in RADII), "omega0_rad_s")
"""What neither pads nor arm measure."""

_MOVING = tuple(quantity.name for quantity in ESTIMATE.quantities if truth_of(quantity) is TRUTH)
_MOST_SCORES = 60
_TURNS = 360
_LEAST_SD_M = 1e-7  # of an outline that was told beforehand


@dataclass(frozen=True, slots=True)
class Errors:
    """Estimate less truth at the times of the estimates, by field name; NaN where there is no truth. `true` likewise.

    psi_rad is without its gauge, the median over the valid ticks of each object.
    """

    true: Mapping[str, FloatArray]
    error: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True)
class OutlineAgainst:
    """An outline against the true one, `h` (m) on the estimate's normals; `error` (m) is the estimate less that.

    Both are turned so that Σ (error / sd)² is least: by what the estimate claims to know. `felt` is scored on the
    touched normals, `all` on all of them, each after the rotation that is best for its own plain sum of squares.
    """

    h: FloatArray
    error: FloatArray
    felt: OutlineScore
    all: OutlineScore


def errors_of(series: Series) -> Errors | None:
    """What the estimates are off by; None without the rig's truth. Angles are compared modulo a turn."""
    truth, t = series.truth, series.estimate.t
    known = np.isfinite(truth["psi_rad"] + truth["omega0_rad_s"]) & (np.diff(truth.t, prepend=-math.inf) > 0.0)
    if known.sum() < 2:
        return None
    t_true = truth.t[known]
    outside = (t < t_true[0]) | (t > t_true[-1])
    true: dict[str, FloatArray] = {}
    for name in _MOVING:
        if name == "psi_rad":  # a straight line between two ticks would be off by as much as a good estimate
            turn = CubicHermiteSpline(t_true, truth[name][known], truth["omega0_rad_s"][known])
            true[name] = np.where(outside, math.nan, turn(np.clip(t, t_true[0], t_true[-1])))
        else:
            true[name] = np.interp(t, t_true, truth[name][known], math.nan, math.nan)
    if series.bodies:
        number = np.maximum(np.searchsorted([body.t for body in series.bodies], t, side="right") - 1, 0)
        for name in CONSTANTS:
            true[name] = np.array([body.constants[name] for body in series.bodies])[number]
    error = {name: series.estimate[name] - values for name, values in true.items()}
    for name in (f"{joint}_rad" for joint in JOINTS):
        error[name] = _wrapped(error[name])
    error["psi_rad"], gauge = without_gauge(series, error["psi_rad"])
    true["psi_rad"] = true["psi_rad"] + gauge
    return Errors(true, error)


def inside(series: Series, errors: Errors, name: str) -> tuple[int, int]:
    """How many of the valid ticks have an error within `SDS` of their sd, and how many there are to judge."""
    error, sd = errors.error[name], series.estimate[SD + name]
    judged = series.valid & np.isfinite(error) & np.isfinite(sd)
    return int(np.sum(np.abs(error[judged]) <= SDS * sd[judged])), int(judged.sum())


def normalised(series: Series, errors: Errors) -> FloatArray:
    """Mean of (error / sd)² over `OBJECTS_OWN`, 1 on average when honest; NaN where the estimate is not valid.

    Runs tell of no covariances between fields, so that this is not the NEES of the joint state.
    """
    squares = [(errors.error[name] / series.estimate[SD + name]) ** 2 for name in OBJECTS_OWN]
    return np.where(series.valid, np.mean(squares, axis=0), math.nan)


def last_outlines(series: Series) -> tuple[OutlineAt, ...]:
    """The last valid outline of each object that has one; if none has, the last one there is."""
    last = {outline.number: outline for outline in series.outlines if outline.valid}
    return tuple(last.values()) or series.outlines[-1:]


def body_at(series: Series, t: float) -> TrueBody | None:
    """What lay on the palms at `t` (s), None when nobody knows."""
    before = [body for body in series.bodies if body.t <= t]
    return before[-1] if before else next(iter(series.bodies), None)


def against(outline: OutlineAt, body: TrueBody) -> OutlineAgainst:
    """The outline's errors, and its scores."""
    theta, h = outline.theta, outline.h
    whole = score_outline(theta, h, None, body.h)
    felt = score_outline(theta, h, outline.touched, body.h)
    rotation = _likeliest_turn(outline, body)
    true_h = support_at(body.h, theta + rotation)
    return OutlineAgainst(true_h, h - true_h, felt, whole)


def scores_over_time(series: Series) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (s) of up to `_MOST_SCORES` valid outlines; their e_h and largest error over all normals (m)."""
    valid = [outline for outline in series.outlines if outline.valid]
    chosen = valid[:: -(-len(valid) // _MOST_SCORES) or 1]
    rows = []
    for outline in chosen:
        body = body_at(series, outline.t)
        if body is not None:
            score = score_outline(outline.theta, outline.h, None, body.h)
            rows.append((outline.t, score.e_h, score.max_error))
    t, e_h, largest = np.array(rows).reshape(-1, 3).T
    return t, e_h, largest


def _likeliest_turn(outline: OutlineAt, body: TrueBody) -> float:
    """The rotation (rad) of the true outline at which Σ (error / sd)² is least."""

    def misfit(true_h: FloatArray) -> float:
        return float(np.sum(((outline.h - true_h) / np.maximum(outline.h_sd, _LEAST_SD_M)) ** 2))

    normals = np.arange(len(body.h)) * (math.tau / len(body.h))
    turns = np.arange(_TURNS) * (math.tau / _TURNS)
    roughly = [misfit(np.interp(outline.theta + turn, normals, body.h, period=math.tau)) for turn in turns]
    nearest, step = float(turns[np.argmin(roughly)]), math.tau / _TURNS
    exactly = minimize_scalar(
        lambda turn: misfit(support_at(body.h, outline.theta + turn)),
        bounds=(nearest - step, nearest + step),
        method="bounded",
    )
    return float(exactly.x)


def without_gauge(series: Series, off: FloatArray) -> tuple[FloatArray, FloatArray]:
    """ψ's errors less the gauge of their object, and that gauge (rad); NaN for objects that were never valid."""
    number, gauge = series.estimate["object"], np.full(len(off), math.nan)
    for each in np.unique(number):
        mine = number == each
        known = off[mine & series.valid & np.isfinite(off)]
        if len(known):
            about = float(np.angle(np.mean(np.exp(1j * known))))
            about += float(np.median(_wrapped(known - about)))
            gauge[mine] = about + math.tau * round(float(np.median(known - about)) / math.tau)
    return _wrapped(off - gauge), gauge


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + math.pi) % math.tau - math.pi)
