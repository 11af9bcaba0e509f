"""Compare a trajectory with a reference: fit clock offset and frame, then compute the errors. Pure.

With A the rotation from the source's frame into the reference's, T the translation, m the tracked point in the object's
frame and G the constant rotation between the two body frames:

    t_reference = t_source + offset      p_reference = T + A (p_source + R_source m)      R_reference = A R_source G

Angular velocities obey ω_reference = A ω_source for every G, so A follows from them by the solution of Kabsch (1976);
T and m are then linear. Rotation about a single axis leaves A undetermined about that axis; positions determine it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar
from scipy.signal import correlate
from scipy.spatial.transform import Rotation, Slerp

from palmd.events import FloatArray
from palmd.report.tracks import MIN_ROWS, OutlineShape, PoseTrack
from palmd.score import score_outline, support_at

GAP_S = 0.15
"""Longest gap between rows that is interpolated."""

STEP_S = 0.02
BASELINE_S = 0.25
"""Time over which rotation increments are taken for the frame; longer than a row to reduce the effect of noise."""

MIN_OVERLAP_S = 1.0
MIN_CORRELATION = 0.7
MIN_TURN_RAD = math.radians(2.0)
PLANE_FRACTION = 0.98
"""Fraction of the rotation about one axis from which on the motion is treated as planar."""

MAX_ROWS = 2000
_MAX_REFINEMENT_ROWS = 300


class AlignmentError(Exception):
    """Two trajectories cannot be compared; the text says why."""


@dataclass(frozen=True, slots=True)
class ErrorSpread:
    """RMS, median and largest error; NaN without errors."""

    rms: float
    median: float
    largest: float


@dataclass(frozen=True, slots=True)
class TrajectoryComparison:
    """A source compared with a reference: errors (m, rad) at `t` (s, reference clock), their statistics, clock offset.

    `outline` is the difference of the support functions after the best rotation, on normals touched in the source.
    """

    source: str
    reference: str
    offset_s: float
    fitted: bool
    t: FloatArray
    position_error: FloatArray
    rotation_error: FloatArray
    position: ErrorSpread
    rotation: ErrorSpread
    outline: ErrorSpread
    outline_rotation: float
    valid: float


def compare(reference: PoseTrack, source: PoseTrack, *, fit: bool = True) -> TrajectoryComparison:
    """Compute the errors of a source. With `fit`, clock offset and frame are estimated, else they are assumed equal.

    Raises AlignmentError if clock offset or frame cannot be determined.
    """
    offset = _offset(reference, source) if fit else 0.0
    rows = _common(reference, source, offset)
    if len(rows) < MIN_ROWS:
        raise AlignmentError(
            f"{source.name} and {reference.name} have {len(rows)} times in common; {MIN_ROWS} are needed"
        )
    at = reference.t[rows] - offset
    rotation = Slerp(source.t, source.rotation)(at)
    position = np.stack([np.interp(at, source.t, source.position[:, i]) for i in range(3)], axis=1)
    true_rotation, true_position = reference.rotation[rows], reference.position[rows]
    if fit:
        rotation, position = _in_frame(reference.t[rows], true_rotation, true_position, rotation, position)
    gauge = (rotation.inv() * true_rotation).mean()
    angle = (rotation * gauge * true_rotation.inv()).magnitude()
    distance = np.linalg.norm(position - true_position, axis=1)
    outline, outline_rotation = _outline(reference.body, source.body)
    return TrajectoryComparison(
        source.name, reference.name, offset, fit, reference.t[rows], distance, angle,
        _spread(distance), _spread(angle), outline, outline_rotation, source.valid,
    )  # fmt: skip


# ------------------------------------------------------------------------------------------------------------- clock


def _rates(trajectory: PoseTrack, t: FloatArray) -> FloatArray:
    """Mean angular velocity (n − 1, 3), rad/s, between the times; 0 in gaps and outside the trajectory."""
    inside = (t >= trajectory.t[0]) & (t <= trajectory.t[-1])
    turns = Slerp(trajectory.t, trajectory.rotation)(np.clip(t, trajectory.t[0], trajectory.t[-1]))
    rates = (turns[1:] * turns[:-1].inv()).as_rotvec() / STEP_S
    good = inside & ~_in_gap(trajectory.t, t)
    rates[~(good[1:] & good[:-1])] = 0.0
    return np.asarray(rates)


def _in_gap(times: FloatArray, t: FloatArray) -> npt.NDArray[np.bool_]:
    after = np.clip(np.searchsorted(times, t), 1, len(times) - 1)
    return np.asarray(times[after] - times[after - 1] > GAP_S)


def _grid(trajectory: PoseTrack) -> FloatArray:
    return np.arange(trajectory.t[0], trajectory.t[-1], STEP_S)


def _offset(reference: PoseTrack, source: PoseTrack) -> float:
    """Clock offset (s) with the best correlation of angular speeds, refined by the agreement of the rotations."""
    speeds, grids = [], []
    for each in (reference, source):
        grid = _grid(each)
        if grid[-1] - grid[0] < MIN_OVERLAP_S:
            raise AlignmentError(f"{each.name} lasts {grid[-1] - grid[0]:.2f} s; {MIN_OVERLAP_S:g} s are needed")
        rates = np.linalg.norm(_rates(each, grid), axis=1)
        if rates.sum() * STEP_S < MIN_TURN_RAD:
            raise AlignmentError(f"{each.name} turns by less than 2 degrees: no clock offset can be determined")
        speeds.append(rates)
        grids.append(grid)
    score, shift = _best_shift(*speeds)
    if score < MIN_CORRELATION:
        raise AlignmentError(
            f"at no clock offset does the rotation of {source.name} match that of {reference.name} (best correlation "
            f"{score:.2f}, needed {MIN_CORRELATION}): do both show the same motion?"
        )
    coarse = float(grids[0][0] - grids[1][0]) + shift * STEP_S
    found = minimize_scalar(
        lambda offset: _disagreement(reference, source, offset),
        bounds=(coarse - 2 * STEP_S, coarse + 2 * STEP_S), method="bounded", options={"xatol": 1e-5},
    )  # fmt: skip
    return float(found.x)


def _best_shift(first: FloatArray, second: FloatArray) -> tuple[float, int]:
    """The best correlation coefficient of two series, and the shift (steps) of the second in the first."""
    correlated = partial(correlate, method="fft")
    has_first, has_second = (first > 0).astype(float), (second > 0).astype(float)
    common = np.maximum(np.rint(correlated(has_first, has_second)), 1.0)
    sums = correlated(first, has_second), correlated(has_first, second)
    squares = correlated(first**2, has_second), correlated(has_first, second**2)
    variances = [np.maximum(square - each**2 / common, 1e-12) for each, square in zip(sums, squares, strict=True)]
    covariance = correlated(first, second) - sums[0] * sums[1] / common
    least = max(MIN_OVERLAP_S / STEP_S, 0.5 * min(has_first.sum(), has_second.sum()))
    scores = np.where(common >= least, covariance / np.sqrt(variances[0] * variances[1]), 0.0)
    best = int(np.argmax(scores))
    return float(scores[best]), best - (len(second) - 1)


def _disagreement(reference: PoseTrack, source: PoseTrack, offset: float) -> float:
    """Mean square error (rad²) of the rotations at this offset, in the best frame."""
    rows = _common(reference, source, offset)
    rows = rows[:: max(len(rows) // _MAX_REFINEMENT_ROWS, 1)]
    if len(rows) < MIN_ROWS:
        return math.inf
    rotation, true = Slerp(source.t, source.rotation)(reference.t[rows] - offset), reference.rotation[rows]
    unknown = np.full((len(rows), 3), math.nan)
    rotation, _ = _in_frame(reference.t[rows], true, unknown, rotation, unknown)
    gauge = (rotation.inv() * true).mean()
    return float(np.mean((rotation * gauge * true.inv()).magnitude() ** 2))


def _common(reference: PoseTrack, source: PoseTrack, offset: float) -> npt.NDArray[np.intp]:
    """Rows of the reference (thinned) at which the source has a pose outside its gaps."""
    at = reference.t - offset
    covered = (at >= source.t[0]) & (at <= source.t[-1]) & ~_in_gap(source.t, at)
    rows = np.flatnonzero(covered)
    return rows[:: max(len(rows) // MAX_ROWS, 1)]


# ------------------------------------------------------------------------------------------------------------- frame


def _in_frame(
    t: FloatArray, true_rotation: Rotation, true_position: FloatArray, rotation: Rotation, position: FloatArray
) -> tuple[Rotation, FloatArray]:
    """The source's rotations and tracked points in the reference's frame."""
    stride = max(1, round(BASELINE_S / float(np.median(np.diff(t)))))
    true_increments, increments = (  # rotation vectors between rows `stride` apart, in the world frame
        (each[stride:] * each[:-stride].inv()).as_rotvec() for each in (true_rotation, rotation)
    )
    axes = [_axis(each) for each in (true_increments, increments)]
    if axes[0] is not None and axes[1] is not None:
        frame = _plane_frame(true_increments, increments, axes[0], axes[1], true_position, rotation, position)
    elif axes[0] is None and axes[1] is None:
        frame = Rotation.align_vectors(true_increments, increments)[0]
    else:
        raise AlignmentError("only one of the two rotates about a single axis: they do not show the same motion")
    known = np.isfinite(true_position).all(axis=1) & np.isfinite(position).all(axis=1)
    if known.sum() < MIN_ROWS:
        return frame * rotation, np.full_like(position, math.nan)
    rotated = frame.apply(position)
    columns = np.concatenate([np.tile(np.eye(3), (known.sum(), 1, 1)), (frame * rotation[known]).as_matrix()], axis=2)
    target = (true_position[known] - rotated[known]).reshape(-1)
    solution = np.linalg.lstsq(columns.reshape(-1, 6), target, rcond=None)[0]
    return frame * rotation, rotated + solution[:3] + (frame * rotation).apply(solution[3:])


def _axis(increments: FloatArray) -> FloatArray | None:
    """The rotation axis of a planar motion, None for other motions."""
    values, vectors = np.linalg.eigh(increments.T @ increments)
    return vectors[:, -1] if values[-1] >= PLANE_FRACTION * values.sum() else None


def _plane_frame(
    true_increments: FloatArray, increments: FloatArray, true_axis: FloatArray, axis: FloatArray,
    true_position: FloatArray, rotation: Rotation, position: FloatArray,
) -> Rotation:  # fmt: skip
    """The rotation that aligns the planes of motion and, within the plane, best aligns the positions."""
    if (true_increments @ true_axis) @ (increments @ axis) < 0.0:
        axis = -axis
    tilt = Rotation.align_vectors(true_axis[None], axis[None])[0]
    known = np.isfinite(true_position).all(axis=1) & np.isfinite(position).all(axis=1)
    if known.sum() < MIN_ROWS:
        return tilt
    ex = np.linalg.svd(true_axis[None])[2][1]
    basis = np.stack([ex, np.cross(true_axis, ex)])
    target, tilted = (each[known] @ basis.T @ np.array([1.0, 1j]) for each in (true_position, tilt.apply(position)))
    lever = (tilt * rotation[known]).apply(tilt.inv().apply(ex)) @ basis.T @ np.array([1.0, 1j])
    columns = np.stack([np.ones_like(tilted), tilted, lever], axis=1)
    yaw = np.angle(np.linalg.lstsq(columns, target, rcond=None)[0][1])
    return Rotation.from_rotvec(yaw * true_axis) * tilt


# ----------------------------------------------------------------------------------------------------------- outline


def _outline(reference: OutlineShape | None, source: OutlineShape | None) -> tuple[ErrorSpread, float]:
    if reference is None or source is None or not source.touched.any():
        return ErrorSpread(math.nan, math.nan, math.nan), math.nan
    true_h = support_at(reference.h, np.linspace(0.0, math.tau, len(reference.h), endpoint=False) - reference.theta[0])
    score = score_outline(source.theta, source.h, source.touched > 0.5, true_h)
    return ErrorSpread(score.e_h, math.nan, score.max_error), score.rotation


def _spread(errors: FloatArray) -> ErrorSpread:
    known = errors[np.isfinite(errors)]
    if not len(known):
        return ErrorSpread(math.nan, math.nan, math.nan)
    return ErrorSpread(float(np.sqrt(np.mean(known**2))), float(np.median(known)), float(known.max()))
