"""A reconstruction against a camera's track of the same run: clock and frame found by fit, then the errors. Pure.

CMU-CS-01-107, section 3.5 and figure 3.15. The camera has a clock and a frame of its own, and tracks a mark that is not
the centre of mass (`camera_frame`).
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
from palmd.report.camera_clock import GroundTruthError, scanned
from palmd.report.camera_frame import CameraClock, CameraFit, CameraFrame, rms
from palmd.report.camera_signals import KnownMotion, Signals
from palmd.score import score_outline, support_at

MOST_OFFSET_SD_S = 0.1
TOLD_GAP_S = 0.2  # of the camera's rows


@dataclass(frozen=True, slots=True)
class CameraErrors:
    """RMS and greatest error, the RMS of the motion itself about its mean, skill = 1 − RMS / that; SI units."""

    rms: float
    greatest: float
    still: float

    @property
    def skill(self) -> float:
        """1 when exact, 0 when no better than an object that stands still."""
        return 1.0 - self.rms / self.still


@dataclass(frozen=True, slots=True)
class CameraOutlineErrors:
    """Errors over touched normals after the best rotation (rad): RMS, greatest, ninetieth percentile (m); their share.

    The estimate's normal θ is the true outline's θ + rotation.
    """

    e_h: float
    greatest: float
    p90: float
    touched: float
    rotation: float


@dataclass(frozen=True, slots=True)
class CameraComparison:
    """What came of it. t (log's, s), psi_camera, psi (rad, the constant between them removed): the compared rows.

    frame, mark are None without a log. left_out: spans in which nothing is compared, one line each.
    """

    clock: CameraClock
    frame: CameraFrame | None
    psi: CameraErrors
    mark: CameraErrors | None
    outline: CameraOutlineErrors | None
    t: FloatArray
    psi_camera: FloatArray
    psi_palmd: FloatArray
    left_out: tuple[str, ...]


def compared(result: Result, motion: KnownMotion, track: CameraTrack, outline: Outline | None) -> CameraComparison:
    """Clock and frame by least squares, then the errors; raises GroundTruthError when no clock or frame can be told.

    First a scan over all offsets of the clock with the angles alone, each against its own constant; then all
    unknowns together. One-sigmas are those of correlated residuals (Newey–West).
    """
    signals = Signals(motion, track)
    lag = scanned(signals)
    log_t = track.t + lag
    rows = signals.seen & signals.known_at(log_t) & (log_t >= motion.t[0]) & (log_t <= motion.t[-1])
    if rows.sum() < MIN_ROWS:
        raise GroundTruthError(f"only {int(rows.sum())} rows of the track fall into the reconstruction")
    fit = CameraFit(signals, rows, lag)
    clock, frame = fit.clock(), fit.frame()
    if clock.offset_sd > MOST_OFFSET_SD_S:
        raise GroundTruthError(f"the clock's offset is told to {clock.offset_sd:.2g} s only: too little moves")
    t = clock.log_time(track.t[rows])
    psi = signals.psi(t)
    error = wrapped(track.angle[rows] - fit.gauge - psi)
    mark = None
    if frame is not None:
        seen, residual = track.mark[rows], fit.place_residual()
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
        left_out=tuple(_left_out(track, signals, clock)),
    )


def _outline_errors(result: Result, outline: Outline) -> CameraOutlineErrors:
    score = score_outline(result.theta, result.h, result.touched, outline.h)
    at = np.mod(result.theta[result.touched] + score.rotation, math.tau)
    error = np.abs(result.h[result.touched] - support_at(outline.h, at))
    p90 = float(np.quantile(error, 0.9)) if len(error) else math.nan
    return CameraOutlineErrors(score.e_h, score.max_error, p90, score.touched, score.rotation)


def _left_out(track: CameraTrack, signals: Signals, clock: CameraClock) -> list[str]:
    t = clock.log_time(track.t[signals.seen])
    first, last = float(signals.motion.t[0]), float(signals.motion.t[-1])
    inside = t[(t >= first) & (t <= last)]
    spans = [("the reconstruction tells nothing", a, b) for a, b in signals.gaps()]
    edges = np.concatenate([[first], inside, [last]])
    spans += [
        ("the camera saw nothing", float(edges[i]), float(edges[i + 1]))
        for i in np.flatnonzero(np.diff(edges) > TOLD_GAP_S)
    ]
    return [
        f"{what} from {a:.2f} to {b:.2f} s (the log's time): left out"
        for what, a, b in sorted(spans, key=lambda s: s[1])
    ]
