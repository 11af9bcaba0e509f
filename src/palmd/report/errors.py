"""Errors of a recorded run against an emulated rig's truth: of the estimates over time, and of the outlines. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize_scalar

from palmd.events import FloatArray
from palmd.observer.outline import wrapped
from palmd.quantities import ESTIMATE, TRUTH
from palmd.report.series import CONSTANTS, SD, SDS, OutlineAt, Series, TrueBody
from palmd.score import OutlineScore, score_outline, support_at
from palmd.system.mechanism import JOINTS, RADII
from palmd.topics import truth_of

STATE = tuple(quantity.name for quantity in ESTIMATE.quantities if quantity.role == "named")
"""The published fields of the named state, including ψ."""

HIDDEN_STATE = (*(f"{name}_m" for name in RADII), "omega0_rad_s")
"""The fields of the state that neither pads nor arm measure."""

_STATE_FIELDS = tuple(quantity.name for quantity in ESTIMATE.quantities if truth_of(quantity) is TRUTH)
_MAX_SCORES = 60
_ROTATION_STEPS = 360
_MIN_SD_M = 1e-7  # lower bound, for an outline that was given a priori


@dataclass(frozen=True, slots=True)
class Errors:
    """Truth, and estimate minus truth, at the times of the estimates, by field name; NaN without truth.

    psi_rad is without its gauge, the median difference over the valid ticks of each object.
    """

    true: Mapping[str, FloatArray]
    error: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True)
class OutlineErrors:
    """The true outline `h` (m) on the estimate's normals, and `error` (m), estimate minus truth.

    The truth is rotated so that Σ (error / sd)² is minimal. `touched_score` is for the touched normals, `whole_score`
    for all of them, each after the rotation that minimises its own unweighted sum of squares.
    """

    h: FloatArray
    error: FloatArray
    touched_score: OutlineScore
    whole_score: OutlineScore


def errors_of(series: Series) -> Errors | None:
    """The errors of the estimates; None without the rig's truth. Angles are compared modulo 2π."""
    truth, t = series.truth, series.estimate.t
    known = np.isfinite(truth["psi_rad"] + truth["omega0_rad_s"]) & (np.diff(truth.t, prepend=-math.inf) > 0.0)
    if known.sum() < 2:
        return None
    t_true = truth.t[known]
    outside = (t < t_true[0]) | (t > t_true[-1])
    true: dict[str, FloatArray] = {}
    for name in _STATE_FIELDS:
        if name == "psi_rad":  # the error of linear interpolation would be as large as that of a good estimate
            psi = CubicHermiteSpline(t_true, truth[name][known], truth["omega0_rad_s"][known])
            true[name] = np.where(outside, math.nan, psi(np.clip(t, t_true[0], t_true[-1])))
        else:
            true[name] = np.interp(t, t_true, truth[name][known], math.nan, math.nan)
    if series.bodies:
        number = np.maximum(np.searchsorted([body.t for body in series.bodies], t, side="right") - 1, 0)
        for name in CONSTANTS:
            true[name] = np.array([body.constants[name] for body in series.bodies])[number]
    error = {name: series.estimate[name] - values for name, values in true.items()}
    for name in (f"{joint}_rad" for joint in JOINTS):
        error[name] = wrapped(error[name])
    error["psi_rad"], gauge = remove_gauge(series, error["psi_rad"])
    true["psi_rad"] = true["psi_rad"] + gauge
    return Errors(true, error)


def count_within_band(series: Series, errors: Errors, name: str) -> tuple[int, int]:
    """Number of valid ticks with an error within ± `SDS` standard deviations, and of valid ticks with an error."""
    error, sd = errors.error[name], series.estimate[SD + name]
    judged = series.valid & np.isfinite(error) & np.isfinite(sd)
    return int(np.sum(np.abs(error[judged]) <= SDS * sd[judged])), int(judged.sum())


def normalised_errors(series: Series, errors: Errors) -> FloatArray:
    """Mean of (error / sd)² over `HIDDEN_STATE`, 1 on average if consistent; NaN where the estimate is not valid.

    Runs hold no covariances between fields, so this is not the NEES of the joint state.
    """
    squares = [(errors.error[name] / series.estimate[SD + name]) ** 2 for name in HIDDEN_STATE]
    return np.where(series.valid, np.mean(squares, axis=0), math.nan)


def last_outlines(series: Series) -> tuple[OutlineAt, ...]:
    """The last valid outline of each object that has one; without any, the last outline."""
    last = {outline.number: outline for outline in series.outlines if outline.valid}
    return tuple(last.values()) or series.outlines[-1:]


def body_at(series: Series, t: float) -> TrueBody | None:
    """The true object on the palms at `t` (s), None if unknown."""
    before = [body for body in series.bodies if body.t <= t]
    return before[-1] if before else next(iter(series.bodies), None)


def outline_errors(outline: OutlineAt, body: TrueBody) -> OutlineErrors:
    """Compare an outline with the true one: errors and scores."""
    theta, h = outline.theta, outline.h
    whole_score = score_outline(theta, h, None, body.h)
    touched_score = score_outline(theta, h, outline.touched, body.h)
    rotation = _best_rotation(outline, body)
    true_h = support_at(body.h, theta + rotation)
    return OutlineErrors(true_h, h - true_h, touched_score, whole_score)


def scores_over_time(series: Series) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (s) of up to `_MAX_SCORES` valid outlines; their e_h and largest error over all normals (m)."""
    valid = [outline for outline in series.outlines if outline.valid]
    chosen = valid[:: -(-len(valid) // _MAX_SCORES) or 1]
    rows = []
    for outline in chosen:
        body = body_at(series, outline.t)
        if body is not None:
            score = score_outline(outline.theta, outline.h, None, body.h)
            rows.append((outline.t, score.e_h, score.max_error))
    t, e_h, largest = np.array(rows).reshape(-1, 3).T
    return t, e_h, largest


def _best_rotation(outline: OutlineAt, body: TrueBody) -> float:
    """The rotation (rad) of the true outline that minimises Σ (error / sd)²."""

    def misfit(true_h: FloatArray) -> float:
        return float(np.sum(((outline.h - true_h) / np.maximum(outline.h_sd, _MIN_SD_M)) ** 2))

    normals = np.arange(len(body.h)) * (math.tau / len(body.h))
    rotations = np.arange(_ROTATION_STEPS) * (math.tau / _ROTATION_STEPS)
    coarse = [misfit(np.interp(outline.theta + rotation, normals, body.h, period=math.tau)) for rotation in rotations]
    nearest, step = float(rotations[np.argmin(coarse)]), math.tau / _ROTATION_STEPS
    fine = minimize_scalar(
        lambda rotation: misfit(support_at(body.h, outline.theta + rotation)),
        bounds=(nearest - step, nearest + step),
        method="bounded",
    )
    return float(fine.x)


def remove_gauge(series: Series, error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """ψ's errors minus the gauge of their object, and that gauge (rad); NaN for objects that were never valid."""
    number, gauge = series.estimate["object"], np.full(len(error), math.nan)
    for each in np.unique(number):
        mine = number == each
        known = error[mine & series.valid & np.isfinite(error)]
        if len(known):
            centre = float(np.angle(np.mean(np.exp(1j * known))))
            centre += float(np.median(wrapped(known - centre)))
            gauge[mine] = centre + math.tau * round(float(np.median(known - centre)) / math.tau)
    return wrapped(error - gauge), gauge
