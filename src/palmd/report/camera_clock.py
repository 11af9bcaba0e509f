"""Offset of a camera's clock from the angles alone, by a scan over all offsets. Pure."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.report.camera_signals import Signals

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


def scan_offset(signals: Signals) -> float:
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
