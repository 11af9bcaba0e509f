"""A trajectory against a reference: clock and frame by fit, then the errors. Pure.

With A the rotation from the source's frame into the reference's, T its place, m the tracked point in the object's frame
and G the constant rotation between the two body frames:

    t_reference = t_source + offset      p_reference = T + A (p_source + R_source m)      R_reference = A R_source G

Angular velocities in the frames obey ω_reference = A ω_source whatever G is, so A follows from them by the solution of
Kabsch (1976); T and m are linear then. A turn about one axis only leaves A open about it: positions determine it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation, Slerp

from palmd.events import FloatArray
from palmd.report.tracks import MIN_ROWS, OutlineShape, PoseTrack
from palmd.score import score_outline, support_at

GAP_S = 0.15
"""Across more nothing is interpolated."""

STEP_S = 0.02
BASELINE_S = 0.25
"""Over which turns are taken for the frame: noise counts less in them than in those of a row."""

LEAST_OVERLAP_S = 1.0
LEAST_CORRELATION = 0.7
LEAST_TURN_RAD = math.radians(2.0)
PLANE_SHARE = 0.98
"""Of the turning that is about one axis: the motion is in a plane from there on."""

MOST_ROWS = 2000
_REFINED_ROWS = 300


class AlignmentError(Exception):
    """Two trajectories cannot be compared; the text says why and what to do."""


@dataclass(frozen=True, slots=True)
class ErrorSpread:
    """RMS, median and largest of errors, NaN without any."""

    rms: float
    median: float
    largest: float


@dataclass(frozen=True, slots=True)
class Compared:
    """A source against a reference: errors (m, rad) at `t` (s, the reference's clock), spreads of them, the clock (s).

    `outline` is the support functions' difference after the best rotation, on normals that the source has touched.
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


def compared(reference: PoseTrack, source: PoseTrack, *, fit: bool = True) -> Compared:
    """The errors of a source; `fit` finds clock and frame, without it both are taken to be the same.

    Raises AlignmentError when no clock offset or frame can be determined.
    """
    offset = _offset(reference, source) if fit else 0.0
    rows = _common(reference, source, offset)
    if len(rows) < MIN_ROWS:
        raise AlignmentError(
            f"{source.name} and {reference.name} have {len(rows)} times in common; {MIN_ROWS} are needed"
        )
    at = reference.t[rows] - offset
    turned = Slerp(source.t, source.rotation)(at)
    place = np.stack([np.interp(at, source.t, source.position[:, i]) for i in range(3)], axis=1)
    true_turn, true_place = reference.rotation[rows], reference.position[rows]
    if fit:
        turned, place = _in_frame(reference.t[rows], true_turn, true_place, turned, place)
    gauge = (turned.inv() * true_turn).mean()
    angle = (turned * gauge * true_turn.inv()).magnitude()
    away = np.linalg.norm(place - true_place, axis=1)
    outline, rotation = _outline(reference.body, source.body)
    return Compared(
        source.name, reference.name, offset, fit, reference.t[rows], away, angle,
        _spread(away), _spread(angle), outline, rotation, source.valid,
    )  # fmt: skip


# ------------------------------------------------------------------------------------------------------------- clock


def _rates(trajectory: PoseTrack, t: FloatArray) -> FloatArray:
    """Mean angular velocity (n − 1, 3), rad/s, between the times; 0 where the trajectory has a gap or ends."""
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
    """The clock's offset (s) at which the speeds of turning correlate best, refined by the rotations' agreement."""
    speeds, grids = [], []
    for each in (reference, source):
        grid = _grid(each)
        if grid[-1] - grid[0] < LEAST_OVERLAP_S:
            raise AlignmentError(f"{each.name} lasts {grid[-1] - grid[0]:.2f} s; {LEAST_OVERLAP_S:g} s are needed")
        rates = np.linalg.norm(_rates(each, grid), axis=1)
        if rates.sum() * STEP_S < LEAST_TURN_RAD:
            raise AlignmentError(f"{each.name} turns by less than 2 degrees: no clock offset can be determined")
        speeds.append(rates)
        grids.append(grid)
    score, shift = _best_shift(*speeds)
    if score < LEAST_CORRELATION:
        raise AlignmentError(
            f"no clock offset makes the turning of {source.name} follow that of {reference.name} (best correlation "
            f"{score:.2f}, needed {LEAST_CORRELATION}): are both of the same motion?"
        )
    coarse = float(grids[0][0] - grids[1][0]) + shift * STEP_S
    found = minimize_scalar(
        lambda offset: _disagreement(reference, source, offset),
        bounds=(coarse - 2 * STEP_S, coarse + 2 * STEP_S), method="bounded", options={"xatol": 1e-5},
    )  # fmt: skip
    return float(found.x)


def _best_shift(first: FloatArray, second: FloatArray) -> tuple[float, int]:
    """The best correlation coefficient of two series, and by how many steps the second is late in the first."""
    size = 1 << (len(first) + len(second)).bit_length()
    shifts = np.arange(-len(second) + 1, len(first))

    def correlated(a: FloatArray, b: FloatArray) -> FloatArray:
        product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        return np.asarray(product[shifts % size])

    has_first, has_second = (first > 0).astype(float), (second > 0).astype(float)
    common = np.maximum(np.rint(correlated(has_first, has_second)), 1.0)
    sums = correlated(first, has_second), correlated(has_first, second)
    squares = correlated(first**2, has_second), correlated(has_first, second**2)
    variances = [np.maximum(square - each**2 / common, 1e-12) for each, square in zip(sums, squares, strict=True)]
    covariance = correlated(first, second) - sums[0] * sums[1] / common
    least = max(LEAST_OVERLAP_S / STEP_S, 0.5 * min(has_first.sum(), has_second.sum()))
    scores = np.where(common >= least, covariance / np.sqrt(variances[0] * variances[1]), 0.0)
    best = int(np.argmax(scores))
    return float(scores[best]), int(shifts[best])


def _disagreement(reference: PoseTrack, source: PoseTrack, offset: float) -> float:
    """Mean square error (rad²) of the rotations at this offset, in the frame that fits them."""
    rows = _common(reference, source, offset)
    rows = rows[:: max(len(rows) // _REFINED_ROWS, 1)]
    if len(rows) < MIN_ROWS:
        return math.inf
    turn, true = Slerp(source.t, source.rotation)(reference.t[rows] - offset), reference.rotation[rows]
    nowhere = np.full((len(rows), 3), math.nan)
    turn, _ = _in_frame(reference.t[rows], true, nowhere, turn, nowhere)
    gauge = (turn.inv() * true).mean()
    return float(np.mean((turn * gauge * true.inv()).magnitude() ** 2))


def _common(reference: PoseTrack, source: PoseTrack, offset: float) -> npt.NDArray[np.intp]:
    """Rows of the reference, thinned, at which the source has a pose without bridging a gap."""
    at = reference.t - offset
    covered = (at >= source.t[0]) & (at <= source.t[-1]) & ~_in_gap(source.t, at)
    rows = np.flatnonzero(covered)
    return rows[:: max(len(rows) // MOST_ROWS, 1)]


# ------------------------------------------------------------------------------------------------------------- frame


def _in_frame(
    t: FloatArray, true_turn: Rotation, true_place: FloatArray, turn: Rotation, place: FloatArray
) -> tuple[Rotation, FloatArray]:
    """The source's rotations and tracked points in the reference's frame."""
    apart = max(1, round(BASELINE_S / float(np.median(np.diff(t)))))
    there, here = (_turning(each, apart) for each in (true_turn, turn))
    axes = [_axis(each) for each in (there, here)]
    if axes[0] is not None and axes[1] is not None:
        frame = _plane_frame(there, here, axes[0], axes[1], true_place, turn, place)
    elif axes[0] is None and axes[1] is None:
        frame = Rotation.align_vectors(there, here)[0]
    else:
        raise AlignmentError("one of the two turns about one axis only, the other does not: not the same motion")
    known = np.isfinite(true_place).all(axis=1) & np.isfinite(place).all(axis=1)
    if known.sum() < MIN_ROWS:
        return frame * turn, np.full_like(place, math.nan)
    rotated = frame.apply(place)
    columns = np.concatenate([np.tile(np.eye(3), (known.sum(), 1, 1)), (frame * turn[known]).as_matrix()], axis=2)
    wanted = (true_place[known] - rotated[known]).reshape(-1)
    solution = np.linalg.lstsq(columns.reshape(-1, 6), wanted, rcond=None)[0]
    return frame * turn, rotated + solution[:3] + (frame * turn).apply(solution[3:])


def _turning(turns: Rotation, apart: int) -> FloatArray:
    """Turns between rows so far apart as rotation vectors (n, 3), in the world frame."""
    return np.asarray((turns[apart:] * turns[:-apart].inv()).as_rotvec())


def _axis(turning: FloatArray) -> FloatArray | None:
    """The axis of a motion in a plane, None for others."""
    values, vectors = np.linalg.eigh(turning.T @ turning)
    return vectors[:, -1] if values[-1] >= PLANE_SHARE * values.sum() else None


def _plane_frame(
    there: FloatArray, here: FloatArray, true_axis: FloatArray, axis: FloatArray,
    true_place: FloatArray, turn: Rotation, place: FloatArray,
) -> Rotation:  # fmt: skip
    """The rotation that brings one plane into the other and, within it, the positions together as well as possible."""
    if (there @ true_axis) @ (here @ axis) < 0.0:
        axis = -axis
    tilt = Rotation.align_vectors(true_axis[None], axis[None])[0]
    known = np.isfinite(true_place).all(axis=1) & np.isfinite(place).all(axis=1)
    if known.sum() < MIN_ROWS:
        return tilt
    ex = np.linalg.svd(true_axis[None])[2][1]
    basis = np.stack([ex, np.cross(true_axis, ex)])
    where, came = (each[known] @ basis.T @ np.array([1.0, 1j]) for each in (true_place, tilt.apply(place)))
    lever = (tilt * turn[known]).apply(tilt.inv().apply(ex)) @ basis.T @ np.array([1.0, 1j])
    columns = np.stack([np.ones_like(came), came, lever], axis=1)
    yaw = np.angle(np.linalg.lstsq(columns, where, rcond=None)[0][1])
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
