"""Compare a reconstruction with a camera's track of the same run: fit clock and frame, then compute errors. Pure.

CMU-CS-01-107, section 3.5 and figure 3.15. The camera has its own clock and frame, and tracks a mark that is not the
centre of mass (`camera_frame`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.outline import wrapped
from palmd.outlinefile import Outline
from palmd.record.resultfile import Result
from palmd.record.track import MIN_ROWS, CameraTrack
from palmd.report.camera_frame import CameraClock, CameraFit, CameraFrame, KnownMotion, Signals, rms
from palmd.score import score_outline, support_at

MAX_OFFSET_SD_S = 0.1
REPORTED_GAP_S = 0.2  # longer gaps in the camera's rows are reported
LAG_STEP_S, FINE_LAG_S = 0.02, 1e-3
MIN_OVERLAP_S = 1.0
MIN_OVERLAP_FRACTION = 0.5  # fraction of the shorter record that must overlap
MIN_MOTION_RAD = math.radians(2.0)
# smallest explained fraction of the scatter, with the object's and the palms' angles
MIN_EXPLAINED, MIN_EXPLAINED_BY_PALMS = 0.5, 0.95
DISTINCT_S, MIN_RIVAL_RATIO = 0.3, 2.0  # an offset that differs by more must have a misfit larger by this factor
_MAX_SCANNED_ROWS = 500
_MAX_CANDIDATES = 6
_MISTAKES = (
    (-1.0, "but match with inverted sign: does the camera's y axis point down?"),
    (180.0 / math.pi, "but match when multiplied by 57.3: are they in radians?"),
)


class GroundTruthError(Exception):
    """The two records cannot be compared; the text says why and what to do."""


@dataclass(frozen=True, slots=True)
class CameraErrors:
    """RMS and greatest error, and `static_rms`, the RMS of the motion about its mean; SI units."""

    rms: float
    greatest: float
    static_rms: float

    @property
    def skill(self) -> float:
        """1 − RMS / static RMS: 1 for no error, 0 for an error as large as assuming an object at rest."""
        return 1.0 - self.rms / self.static_rms


@dataclass(frozen=True, slots=True)
class CameraOutlineErrors:
    """Errors on the touched normals after the best rotation (rad): RMS, greatest, 90th percentile (m).

    touched: fraction of touched normals. The estimate's normal θ is the true outline's θ + rotation.
    """

    e_h: float
    greatest: float
    p90: float
    touched: float
    rotation: float


@dataclass(frozen=True, slots=True)
class CameraComparison:
    """Result of the comparison. t (log time, s), psi_camera, psi_palmd (rad, constant offset removed): compared rows.

    frame and mark are None without a log. omitted: spans that were not compared, one line each.
    """

    clock: CameraClock
    frame: CameraFrame | None
    psi: CameraErrors
    mark: CameraErrors | None
    outline: CameraOutlineErrors | None
    t: FloatArray
    psi_camera: FloatArray
    psi_palmd: FloatArray
    omitted: tuple[str, ...]


def compare(result: Result, motion: KnownMotion, track: CameraTrack, outline: Outline | None) -> CameraComparison:
    """Fit clock and frame by least squares and compute the errors; raises GroundTruthError if they are not determined.

    First a scan over all clock offsets with the angles alone, each with a free constant; then all unknowns together.
    Standard deviations account for correlated residuals (Newey–West).
    """
    signals = Signals(motion, track)
    lag = _scan_offset(signals)
    log_t = track.t + lag
    rows = signals.seen & signals.known_at(log_t) & (log_t >= motion.t[0]) & (log_t <= motion.t[-1])
    if rows.sum() < MIN_ROWS:
        raise GroundTruthError(f"only {int(rows.sum())} rows of the track lie within the reconstruction")
    fit = CameraFit(signals, rows, lag)
    clock, frame = fit.clock(), fit.frame()
    if clock.offset_sd > MAX_OFFSET_SD_S:
        raise GroundTruthError(f"the clock offset is uncertain by {clock.offset_sd:.2g} s: there is too little motion")
    t = clock.log_time(track.t[rows])
    psi = signals.psi(t)
    error = wrapped(track.angle[rows] - fit.gauge - psi)
    mark = None
    if frame is not None:
        seen, residual = track.mark[rows], fit.position_residual()
        about = np.hypot(*(seen - seen.mean(axis=0)).T)
        mark = CameraErrors(rms(residual), float(residual.max()), rms(about))
    return CameraComparison(
        clock=clock,
        frame=frame,
        psi=CameraErrors(rms(error), float(np.abs(error).max()), float(np.std(psi + error))),
        mark=mark,
        outline=None if outline is None else _outline_errors(result, outline),
        t=t,
        psi_camera=psi + error,
        psi_palmd=psi,
        omitted=tuple(_omitted(track, signals, clock)),
    )


def _outline_errors(result: Result, outline: Outline) -> CameraOutlineErrors:
    score = score_outline(result.theta, result.h, result.touched, outline.h)
    at = np.mod(result.theta[result.touched] + score.rotation, math.tau)
    error = np.abs(result.h[result.touched] - support_at(outline.h, at))
    p90 = float(np.quantile(error, 0.9)) if len(error) else math.nan
    return CameraOutlineErrors(score.e_h, score.max_error, p90, score.touched, score.rotation)


def _omitted(track: CameraTrack, signals: Signals, clock: CameraClock) -> list[str]:
    t = clock.log_time(track.t[signals.seen])
    first, last = float(signals.motion.t[0]), float(signals.motion.t[-1])
    inside = t[(t >= first) & (t <= last)]
    spans = [("no reconstruction", a, b) for a, b in signals.gaps()]
    edges = np.concatenate([[first], inside, [last]])
    spans += [
        ("the camera saw nothing", float(edges[i]), float(edges[i + 1]))
        for i in np.flatnonzero(np.diff(edges) > REPORTED_GAP_S)
    ]
    return [f"{what} from {a:.2f} to {b:.2f} s (log time): omitted" for what, a, b in sorted(spans, key=lambda s: s[1])]


# ------------------------------------------------------------------------------------------------------------- clock


def _scan_offset(signals: Signals) -> float:
    """The clock offset (s) at which camera and log angles match best, to `FINE_LAG_S`.

    Raises GroundTruthError if no offset matches, or if it is ambiguous.
    """
    track, motion = signals.track, signals.motion
    rows = np.flatnonzero(signals.seen)
    rows = rows[:: max(len(rows) // _MAX_SCANNED_ROWS, 1)]
    if max(np.ptp(log) for _, log in signals.angles(rows)) < MIN_MOTION_RAD:
        raise GroundTruthError("no angle changes by more than 2 degrees: the clock offset cannot be determined")
    t = track.t[rows]
    shorter = min(float(np.ptp(t)), float(np.ptp(motion.t)))
    least = max(MIN_OVERLAP_FRACTION * shorter, MIN_OVERLAP_S)
    if shorter < MIN_OVERLAP_S:
        raise GroundTruthError(f"the shorter record lasts {shorter:.2f} s; {MIN_OVERLAP_S:g} s are needed")
    lags = np.arange(motion.t[0] - t[-1] + least, motion.t[-1] - t[0] - least + LAG_STEP_S, LAG_STEP_S)
    (misfit, lag), *others = _minima(signals, rows, lags, 1.0)
    for scale, hint in _MISTAKES:
        if _minima(signals, rows, lags, scale)[0][0] < misfit / MIN_RIVAL_RATIO:
            raise GroundTruthError(f"the camera's angles do not match the log, {hint}")
    if misfit > 1.0 - (MIN_EXPLAINED if signals.palms is None else MIN_EXPLAINED_BY_PALMS):
        raise GroundTruthError(
            f"the angles match at no clock offset; the best explains {max(1 - misfit, 0):.0%}: "
            "is this the track of this run, and do both overlap in time?"
        )
    for rival, other in others:
        if rival < MIN_RIVAL_RATIO * misfit and abs(other - lag) > DISTINCT_S:
            raise GroundTruthError(
                f"the clock offset is ambiguous: {lag:.2f} s and {other:.2f} s fit equally well; "
                "compare a run with less periodic motion"
            )
    return lag


def _minima(signals: Signals, rows: npt.NDArray[np.intp], lags: FloatArray, scale: float) -> list[tuple[float, float]]:
    """(misfit, offset) at the local minima of the misfit, best first, each refined to `FINE_LAG_S`."""
    coarse = _misfits(signals, rows, lags, scale)
    edges = np.concatenate([[np.inf], coarse, [np.inf]])
    found = np.flatnonzero((coarse <= edges[:-2]) & (coarse <= edges[2:]))
    refined = []
    for i in found[np.argsort(coarse[found])][:_MAX_CANDIDATES]:
        fine = np.arange(lags[i] - LAG_STEP_S, lags[i] + LAG_STEP_S, FINE_LAG_S)
        misfit = _misfits(signals, rows, fine, scale)
        refined.append((float(misfit.min()), float(fine[misfit.argmin()])))
    return sorted(refined)


def _misfits(signals: Signals, rows: npt.NDArray[np.intp], lags: FloatArray, scale: float) -> FloatArray:
    """For each offset the unexplained fraction of the scatter of the camera's angles: 0 for a perfect match, 1 if none.

    The scatter of angles, which are periodic, is 1 − |mean e^{i·angle}|, half the variance if small.
    """
    t, channels = signals.track.t[rows], signals.angles(rows)
    t_log = signals.motion.t
    misfit = np.ones(len(lags))
    for i, lag in enumerate(lags):
        inside = (t + lag >= t_log[0]) & (t + lag <= t_log[-1]) & signals.known_at(t + lag)
        unexplained = total = 0.0
        for camera, log in channels:
            known = inside & np.isfinite(camera)
            if known.sum() > 2:
                angle = scale * camera[known]
                unexplained += _scatter(angle - np.interp(t[known] + lag, t_log, log))
                total += _scatter(angle)
        if total > 0.0:
            misfit[i] = unexplained / total
    return misfit


def _scatter(angles: FloatArray) -> float:
    return 1.0 - float(np.abs(np.mean(np.exp(1j * angles))))


# Digitised from figure 3.15: ψ (rad) and its skill relative to an object at rest, outline (m), touched fraction.
PAPER_PSI_RMS_RAD, PAPER_PSI_SKILL = 0.27, 0.08
PAPER_OUTLINE_RMS_M, PAPER_OUTLINE_P90_M, PAPER_TOUCHED = 1.9e-3, 2.9e-3, 0.54


def report_lines(found: CameraComparison) -> list[str]:
    """One line each on clock, frame, orientation, position, outline, and omitted spans."""
    lines = [_clock_text(found.clock)]
    if found.frame is not None:
        lines.append(_frame_text(found.frame))
    psi = found.psi
    lines.append(
        f"orientation: RMS {psi.rms:.4f} rad, max {psi.greatest:.4f} rad, skill {psi.skill:.1%} relative to no motion"
        f" (paper: {PAPER_PSI_RMS_RAD} rad, {PAPER_PSI_SKILL:.0%})"
    )
    if found.mark is not None:
        mark = found.mark
        lines.append(f"position: RMS {mark.rms * 1e3:.2f} mm, max {mark.greatest * 1e3:.2f} mm, skill {mark.skill:.1%}")
    if found.outline is not None:
        one = found.outline
        lines.append(
            f"outline: RMS {one.e_h * 1e3:.3f} mm, p90 {one.p90 * 1e3:.3f} mm, max {one.greatest * 1e3:.3f} mm on "
            f"{one.touched:.0%} touched (paper: {PAPER_OUTLINE_RMS_M * 1e3} mm, {PAPER_OUTLINE_P90_M * 1e3} mm, "
            f"{PAPER_TOUCHED:.0%})"
        )
    return [*lines, *found.omitted]


def as_line(found: CameraComparison) -> dict[str, Any]:
    """All results, the unit in each name; None for what was not compared, NaN for unknown values."""
    clock = found.clock
    return {
        "rows": len(found.t),
        "clock": {
            "offset_s": clock.offset, "offset_sd_s": clock.offset_sd, "at_camera_s": clock.t_middle,
            "drift_ppm": clock.drift * 1e6, "drift_sd_ppm": clock.drift_sd * 1e6,
        },
        "frame": None if found.frame is None else _frame_line(found.frame),
        "psi": _error_line(found.psi, "rad"),
        "mark": None if found.mark is None else _error_line(found.mark, "m"),
        "outline": None if found.outline is None else _outline_line(found.outline),
        "paper": {
            "psi_rms_rad": PAPER_PSI_RMS_RAD, "psi_skill": PAPER_PSI_SKILL, "e_h_m": PAPER_OUTLINE_RMS_M,
            "p90_m": PAPER_OUTLINE_P90_M, "touched": PAPER_TOUCHED,
        },
        "left_out": list(found.omitted),
    }  # fmt: skip


def _clock_text(clock: CameraClock) -> str:
    drift = "drift not determined, as the record is too short"
    if math.isfinite(clock.drift):
        drift = f"drift {clock.drift * 1e6:.1f} ± {clock.drift_sd * 1e6:.1f} ppm"
    return f"clock: log time = camera time {clock.offset:+.4f} s ± {clock.offset_sd * 1e3:.1f} ms, {drift}"


def _frame_text(frame: CameraFrame) -> str:
    (x, y), (mark_x, mark_y) = frame.place, frame.mark
    return (
        f"frame: world origin at ({x * 1e3:.2f}, {y * 1e3:.2f}) mm, rotated by {math.degrees(frame.angle):.2f} ± "
        f"{math.degrees(frame.angle_sd):.2f}°; the mark at ({mark_x * 1e3:.2f}, {mark_y * 1e3:.2f}) mm from the centre "
        f"of mass, ± {max(frame.mark_sd) * 1e3:.2f} mm"
    )


def _frame_line(frame: CameraFrame) -> dict[str, float]:
    line = {"angle_rad": frame.angle, "angle_sd_rad": frame.angle_sd}
    for name in ("place", "mark"):
        for axis, value, sd in zip("xy", getattr(frame, name), getattr(frame, f"{name}_sd"), strict=True):
            line |= {f"{name}_{axis}_m": value, f"{name}_{axis}_sd_m": sd}
    return line


def _error_line(errors: CameraErrors, unit: str) -> dict[str, float]:
    return {
        f"rms_{unit}": errors.rms, f"max_{unit}": errors.greatest, f"still_rms_{unit}": errors.static_rms,
        "skill": errors.skill,
    }  # fmt: skip


def _outline_line(errors: CameraOutlineErrors) -> dict[str, float]:
    return {
        "e_h_m": errors.e_h, "max_m": errors.greatest, "p90_m": errors.p90, "touched": errors.touched,
        "rotation_rad": errors.rotation,
    }  # fmt: skip
