"""Compare a trajectory with a reference: fit clock and frame by least squares, then compute the errors. Pure.

With A the rotation from the source's frame into the reference's, T the translation, m the tracked point in the object's
frame and G the constant rotation between the two body frames:

    t_reference − t_source = offset + drift (t_reference − t_middle)
    p_reference = T + A (p_source + R_source m)      R_reference = A R_source G

The first guess has no drift: candidates of the offset are those at which the angular speeds correlate. Angular
velocities obey ω_reference = A ω_source for every G, so A follows from them by the solution of Kabsch (1976); T and m
are then linear. Rotation about a single axis leaves A undetermined about that axis; positions determine it.
Then all unknowns are fitted together, with standard deviations for correlated residuals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares, minimize_scalar
from scipy.signal import correlate, find_peaks
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
MIN_EXPLAINED = 0.5
"""Smallest explained fraction of the rotation's mean square."""

MIN_TURN_RAD = math.radians(2.0)
DISTINCT_S, MIN_RIVAL_RATIO = 0.3, 2.0
"""An offset that differs by more must leave this many times the mean square error; else the offset is ambiguous."""

MAX_OFFSET_SD_S = 0.1
DRIFT_MIN_S = 20.0
"""Smallest overlap for which a clock drift is estimated."""

CORRELATION_S = 1.0
"""Longest correlation time of the residuals."""

PLANE_FRACTION = 0.98
"""Fraction of the rotation about one axis from which on the motion is treated as planar."""

MAX_ROWS = 2000
_MAX_REFINEMENT_ROWS = 300
_MAX_CANDIDATES = 6
_NOISE = np.repeat([math.radians(0.3), 2e-4], 3)  # first guess of the residuals' standard deviations (rad, m)
_RANK = 1e-6  # smallest singular value of a determined combination of unknowns, over the largest
_UNDETERMINED = 1e-4  # share of an unknown in undetermined combinations from which on it is one

_OFFSET, _DRIFT, _FRAME, _PLACE, _MARK, _GAUGE = 0, 1, slice(2, 5), slice(5, 8), slice(8, 11), slice(11, 14)
_UNKNOWNS = 14


class AlignmentError(Exception):
    """Two trajectories cannot be compared; the text says why."""


@dataclass(frozen=True, slots=True)
class ErrorSpread:
    """RMS, median and largest error; NaN without errors."""

    rms: float
    median: float
    largest: float


@dataclass(frozen=True, slots=True)
class Alignment:
    """The fitted clock and frame, see the module, each with its standard deviation, NaN if it is not determined.

    offset (s), drift (s/s, NaN for a short overlap) about t_middle (s, the reference's clock); frame: rotation vector
    of A (rad); place: T (m); mark: m (m).
    """

    t_middle: float
    offset: float
    offset_sd: float
    drift: float
    drift_sd: float
    frame: FloatArray
    frame_sd: FloatArray
    place: FloatArray
    place_sd: FloatArray
    mark: FloatArray
    mark_sd: FloatArray


@dataclass(frozen=True, slots=True)
class TrajectoryComparison:
    """A source compared with a reference: errors (m, rad) at `t` (s, reference clock), and their statistics.

    `alignment` is None if clock and frame are the same. `outline` is the difference of the support functions after the
    best rotation, on normals touched in the source.
    """

    source: str
    reference: str
    alignment: Alignment | None
    t: FloatArray
    position_error: FloatArray
    rotation_error: FloatArray
    position: ErrorSpread
    rotation: ErrorSpread
    outline: ErrorSpread
    outline_rotation: float
    valid: float


def compare(reference: PoseTrack, source: PoseTrack, *, fit: bool = True) -> TrajectoryComparison:
    """Compute the errors of a source. With `fit`, clock and frame are estimated, else they are assumed equal.

    Raises AlignmentError if clock or frame cannot be determined.
    """
    offset = _offset(reference, source) if fit else 0.0
    rows = _common(reference, source, offset)
    if len(rows) < MIN_ROWS:
        raise AlignmentError(
            f"{source.name} and {reference.name} have {len(rows)} times in common; {MIN_ROWS} are needed"
        )
    problem = _AlignmentProblem(reference, source, rows, offset)
    guess = problem.first_guess() if fit else problem.same_frame()
    residuals, alignment = problem.solve(guess) if fit else (problem.residuals(guess), None)
    if alignment is not None and alignment.offset_sd > MAX_OFFSET_SD_S:
        raise AlignmentError(
            f"the clock offset is uncertain by {alignment.offset_sd:.2g} s: there is too little motion"
        )
    angle, distance = (np.linalg.norm(part, axis=1) for part in (residuals[:, :3], residuals[:, 3:]))
    outline, outline_rotation = _outline(reference.body, source.body)
    return TrajectoryComparison(
        source.name, reference.name, alignment, reference.t[rows], distance, angle,
        _spread(distance), _spread(angle), outline, outline_rotation, source.valid,
    )  # fmt: skip


# ----------------------------------------------------------------------------------------------------- least squares


class _AlignmentProblem:
    """Residuals on the given rows as a function of p: offset, drift, rotations of A and G about the guess, T, m."""

    def __init__(self, reference: PoseTrack, source: PoseTrack, rows: npt.NDArray[np.intp], offset: float) -> None:
        self._t = reference.t[rows] - reference.t[rows[0]]
        self._middle = 0.5 * float(self._t[-1])
        self._t_first, self._offset = float(reference.t[rows[0]]), offset
        self._lag = self._t_first - offset - float(source.t[0])
        self._true_rotation, self._true_position = reference.rotation[rows], reference.position[rows]
        self._source_t = source.t - source.t[0]
        self._turned, self._position = Slerp(self._source_t, source.rotation), source.position
        self._drifts = bool(self._t[-1] >= DRIFT_MIN_S)
        self._frame = self._gauge = Rotation.identity()

    def first_guess(self) -> FloatArray:
        """Set A and G; returns p with the linear solution for T and m."""
        rotation, position = self._source_at(np.zeros(_UNKNOWNS))
        self._frame, place, mark = _in_frame(self._t, self._true_rotation, self._true_position, rotation, position)
        self._gauge = ((self._frame * rotation).inv() * self._true_rotation).mean()
        return np.concatenate([np.zeros(5), place, mark, np.zeros(3)])

    def same_frame(self) -> FloatArray:
        """Set G, the only unknown in one frame; returns p."""
        rotation, _ = self._source_at(np.zeros(_UNKNOWNS))
        self._gauge = (rotation.inv() * self._true_rotation).mean()
        return np.zeros(_UNKNOWNS)

    def residuals(self, p: FloatArray) -> FloatArray:
        """Errors of rotation (rad) and position (m), (n, 6); NaN where unknown."""
        rotation, position = self._source_at(p)
        frame = Rotation.from_rotvec(p[_FRAME]) * self._frame
        turned = frame * rotation
        angle = turned * self._gauge * Rotation.from_rotvec(p[_GAUGE]) * self._true_rotation.inv()
        place = p[_PLACE] + frame.apply(position) + turned.apply(p[_MARK])
        return np.concatenate([angle.as_rotvec(), place - self._true_position], axis=1)

    def solve(self, p: FloatArray) -> tuple[FloatArray, Alignment]:
        """Minimise the residuals from p on; returns them and the result."""
        noise = _NOISE
        for _ in range(3):  # from the second time on with the noise estimated before
            found = least_squares(self._whitened, p, x_scale="jac", args=(noise,))
            p, residuals = found.x, self.residuals(found.x)
            rms = [np.sqrt(np.nanmean(part**2)) if np.isfinite(part).any() else 1.0
                   for part in (residuals[:, :3], residuals[:, 3:])]  # fmt: skip
            noise = np.repeat(np.maximum(rms, 1e-9), 3)
        sd = self._sds(found.jac, found.fun)
        drift, drift_sd = (-p[_DRIFT], sd[_DRIFT]) if self._drifts else (math.nan, math.nan)
        frame = (Rotation.from_rotvec(p[_FRAME]) * self._frame).as_rotvec()
        return residuals, Alignment(
            self._t_first + self._middle, self._offset - float(p[_OFFSET]), float(sd[_OFFSET]), float(drift),
            float(drift_sd), frame, sd[_FRAME], p[_PLACE], sd[_PLACE], p[_MARK], sd[_MARK],
        )  # fmt: skip

    def _source_at(self, p: FloatArray) -> tuple[Rotation, FloatArray]:
        """The source's poses at the reference's times."""
        drift = p[_DRIFT] * (self._t - self._middle) if self._drifts else 0.0
        at = np.clip(self._t + self._lag + p[_OFFSET] + drift, 0.0, self._source_t[-1])
        position = [np.interp(at, self._source_t, self._position[:, i]) for i in range(3)]
        return self._turned(at), np.stack(position, axis=1)

    def _whitened(self, p: FloatArray, noise: FloatArray) -> FloatArray:
        return np.asarray(np.nan_to_num(self.residuals(p) / noise).ravel())

    def _sds(self, jacobian: FloatArray, residual: FloatArray) -> FloatArray:
        """Standard deviations of p for residuals correlated over up to `CORRELATION_S` (Newey–West).

        (JᵀJ)⁻¹ S (JᵀJ)⁻¹ with S = Γ0 + Σ w_l (Γ_l + Γ_lᵀ), Γ_l the products of scores l rows apart, w decreasing
        linearly; never less than with Γ0 alone.
        """
        sizes = np.linalg.norm(jacobian, axis=0)
        free = sizes > 0.0
        slopes = jacobian[:, free] / sizes[free]
        _, values, vectors = np.linalg.svd(slopes, full_matrices=False)
        known = values > _RANK * values[0]
        bread = vectors[known].T / values[known] ** 2 @ vectors[known]
        n = len(self._t)
        scores = (slopes * residual[:, None]).reshape(n, -1, slopes.shape[1]).sum(axis=1)
        uncorrelated = scores.T @ scores
        meat = uncorrelated.copy()
        lags = min(round(CORRELATION_S / float(np.median(np.diff(self._t)))), n // 4)
        for lag in range(1, lags + 1):
            product = scores[lag:].T @ scores[:-lag]
            meat += (1 - lag / (lags + 1)) * (product + product.T)
        both = [np.diagonal(bread @ each @ bread) for each in (uncorrelated, meat)]
        variances = np.maximum(np.max(both, axis=0), 0.0)  # rounding may make zeros negative
        variances = np.where((vectors[~known] ** 2).sum(axis=0) > _UNDETERMINED, math.nan, variances)
        sd = np.full(_UNKNOWNS, math.nan)
        sd[free] = np.sqrt(variances) / sizes[free]
        return sd


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
    """Clock offset (s) at which the rotations agree best, of those at which the angular speeds correlate."""
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
    scores = _correlations(*speeds)
    if scores.max() < MIN_CORRELATION:
        raise AlignmentError(
            f"at no clock offset does the rotation of {source.name} match that of {reference.name} (best correlation "
            f"{scores.max():.2f}, needed {MIN_CORRELATION}): do both show the same motion?"
        )
    peaks = find_peaks(np.pad(scores, 1))[0] - 1
    candidates = peaks[np.argsort(-scores[peaks])][:_MAX_CANDIDATES]
    first = float(grids[0][0] - grids[1][0]) - (len(speeds[1]) - 1) * STEP_S
    (error, offset), *others = sorted(_refined(reference, source, first + float(i) * STEP_S) for i in candidates)
    if error > 1.0 - MIN_EXPLAINED:
        raise AlignmentError(
            f"the rotation of {source.name} explains {max(1.0 - error, 0.0):.0%} of that of {reference.name}: do both"
            " show the same motion, with angles in degrees?"
        )
    for rival, other in others:
        if rival < MIN_RIVAL_RATIO * error and abs(other - offset) > DISTINCT_S:
            raise AlignmentError(
                f"the clock offset is ambiguous: {offset:.2f} s and {other:.2f} s fit equally well; compare a run with"
                " less periodic motion"
            )
    return offset


def _correlations(first: FloatArray, second: FloatArray) -> FloatArray:
    """Correlation coefficients of two series, from the second shifted by 1 − its length (steps) on; 0 if too short."""
    correlated = partial(correlate, method="fft")
    has_first, has_second = (first > 0).astype(float), (second > 0).astype(float)
    common = np.maximum(np.rint(correlated(has_first, has_second)), 1.0)
    sums = correlated(first, has_second), correlated(has_first, second)
    squares = correlated(first**2, has_second), correlated(has_first, second**2)
    variances = [np.maximum(square - each**2 / common, 1e-12) for each, square in zip(sums, squares, strict=True)]
    covariance = correlated(first, second) - sums[0] * sums[1] / common
    least = max(MIN_OVERLAP_S / STEP_S, 0.5 * min(has_first.sum(), has_second.sum()))
    return np.asarray(np.where(common >= least, covariance / np.sqrt(variances[0] * variances[1]), 0.0))


def _refined(reference: PoseTrack, source: PoseTrack, offset: float) -> tuple[float, float]:
    """The least disagreement of the rotations near an offset (s), and where it is."""
    found = minimize_scalar(
        lambda offset: _disagreement(reference, source, offset),
        bounds=(offset - 2 * STEP_S, offset + 2 * STEP_S), method="bounded", options={"xatol": 1e-5},
    )  # fmt: skip
    return float(found.fun), float(found.x)


def _disagreement(reference: PoseTrack, source: PoseTrack, offset: float) -> float:
    """Mean square error of the rotations at this offset, in the best frame, over that of no motion."""
    rows = _common(reference, source, offset)
    rows = rows[:: max(len(rows) // _MAX_REFINEMENT_ROWS, 1)]
    if len(rows) < MIN_ROWS:
        return math.inf
    rotation, true = Slerp(source.t, source.rotation)(reference.t[rows] - offset), reference.rotation[rows]
    unknown = np.full((len(rows), 3), math.nan)
    rotation = _in_frame(reference.t[rows], true, unknown, rotation, unknown)[0] * rotation
    gauge = (rotation.inv() * true).mean()
    errors, motion = (rotation * gauge * true.inv()).magnitude(), (true.mean().inv() * true).magnitude()
    return float(np.mean(errors**2) / np.mean(motion**2))


def _common(reference: PoseTrack, source: PoseTrack, offset: float) -> npt.NDArray[np.intp]:
    """Rows of the reference (thinned) at which the source has a pose outside its gaps."""
    at = reference.t - offset
    covered = (at >= source.t[0]) & (at <= source.t[-1]) & ~_in_gap(source.t, at)
    rows = np.flatnonzero(covered)
    return rows[:: max(len(rows) // MAX_ROWS, 1)]


# ------------------------------------------------------------------------------------------------------------- frame


def _in_frame(
    t: FloatArray, true_rotation: Rotation, true_position: FloatArray, rotation: Rotation, position: FloatArray
) -> tuple[Rotation, FloatArray, FloatArray]:
    """A, T and m of a known clock; T and m are 0 if positions are unknown."""
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
        return frame, np.zeros(3), np.zeros(3)
    columns = np.concatenate([np.tile(np.eye(3), (known.sum(), 1, 1)), (frame * rotation[known]).as_matrix()], axis=2)
    target = (true_position[known] - frame.apply(position[known])).reshape(-1)
    solution = np.linalg.lstsq(columns.reshape(-1, 6), target, rcond=None)[0]
    return frame, solution[:3], solution[3:]


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
