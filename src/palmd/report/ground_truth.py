"""Compare a reconstruction with a camera's track of the same run: fit clock and frame, then compute errors. Pure.

CMU-CS-01-107, section 3.5 and figure 3.15. The camera has its own clock and frame, and tracks a mark that is not the
centre of mass (`camera_frame`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.observer.outline import wrapped
from palmd.outlinefile import Outline
from palmd.record.resultfile import Result
from palmd.record.track import MIN_ROWS, CameraTrack
from palmd.report.camera_clock import GroundTruthError, scan_offset
from palmd.report.camera_frame import CameraClock, CameraFit, CameraFrame, rms
from palmd.report.camera_signals import KnownMotion, Signals
from palmd.score import score_outline, support_at

MAX_OFFSET_SD_S = 0.1
REPORTED_GAP_S = 0.2  # longer gaps in the camera's rows are reported


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
    lag = scan_offset(signals)
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
