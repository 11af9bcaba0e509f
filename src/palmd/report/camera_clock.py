"""By how much a camera's clock is off, from the angles alone: a scan over all offsets. Pure."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.report.camera_signals import Signals

LAG_STEP_S, FINE_LAG_S = 0.02, 1e-3
LEAST_OVERLAP_S = 1.0
LEAST_SHARE = 0.5  # of the shorter record, that both must cover
LEAST_MOTION_RAD = math.radians(2.0)
FOLLOWS, PALMS_FOLLOW = 0.5, 0.95  # share of the scatter that the right clock explains at least, by what tells it
RIVAL_S, RIVAL = 0.3, 2.0  # a clock this far away must leave so many times the scatter
_SCANNED_ROWS = 500
_CANDIDATES = 6
_MISTAKES = (
    (-1.0, "but do with their sign changed: is the camera's y axis pointing down?"),
    (180.0 / math.pi, "but do when multiplied by 57.3: are they in radians?"),
)


class GroundTruthError(Exception):
    """The two records cannot be compared; the text says why and what to do."""


def scanned(signals: Signals) -> float:
    """The offset of the clock with which the angles follow best (s), to `FINE_LAG_S`.

    Raises GroundTruthError when none does, or another one as well.
    """
    track, motion = signals.track, signals.motion
    rows = np.flatnonzero(signals.seen)
    rows = rows[:: max(len(rows) // _SCANNED_ROWS, 1)]
    if max(np.ptp(log) for _, log in signals.angles(rows)) < LEAST_MOTION_RAD:
        raise GroundTruthError("no angle changes by more than 2 degrees: no clock can be found")
    t = track.t[rows]
    shorter = min(float(np.ptp(t)), float(np.ptp(motion.t)))
    least = max(LEAST_SHARE * shorter, LEAST_OVERLAP_S)
    if shorter < LEAST_OVERLAP_S:
        raise GroundTruthError(f"the shorter record lasts {shorter:.2f} s; {LEAST_OVERLAP_S:g} s are needed")
    lags = np.arange(motion.t[0] - t[-1] + least, motion.t[-1] - t[0] - least + LAG_STEP_S, LAG_STEP_S)
    (misfit, lag), *others = _minima(signals, rows, lags, 1.0)
    for scale, what in _MISTAKES:
        if _minima(signals, rows, lags, scale)[0][0] < misfit / RIVAL:
            raise GroundTruthError(f"the camera's angles do not follow, {what}")
    if misfit > 1.0 - (FOLLOWS if signals.palms is None else PALMS_FOLLOW):
        raise GroundTruthError(
            f"no offset of the clock makes the angles follow, the best explains {max(1 - misfit, 0):.0%}: "
            "is this the track of this run, and do both overlap in time?"
        )
    for rival, other in others:
        if rival < RIVAL * misfit and abs(other - lag) > RIVAL_S:
            raise GroundTruthError(
                f"the clock is ambiguous: offsets of {lag:.2f} s and {other:.2f} s fit alike; "
                "compare a run that repeats itself less"
            )
    return lag


def _minima(signals: Signals, rows: npt.NDArray[np.intp], lags: FloatArray, scale: float) -> list[tuple[float, float]]:
    """(misfit, offset) where the misfit is least, best first, each refined to `FINE_LAG_S`."""
    coarse = _misfits(signals, rows, lags, scale)
    edges = np.concatenate([[np.inf], coarse, [np.inf]])
    found = np.flatnonzero((coarse <= edges[:-2]) & (coarse <= edges[2:]))
    refined = []
    for i in found[np.argsort(coarse[found])][:_CANDIDATES]:
        fine = np.arange(lags[i] - LAG_STEP_S, lags[i] + LAG_STEP_S, FINE_LAG_S)
        misfit = _misfits(signals, rows, fine, scale)
        refined.append((float(misfit.min()), float(fine[misfit.argmin()])))
    return sorted(refined)


def _misfits(signals: Signals, rows: npt.NDArray[np.intp], lags: FloatArray, scale: float) -> FloatArray:
    """For each offset, what the log leaves of the camera's angles, both about their mean: 0 nothing, 1 all of it.

    Angles have branches, so that their scatter is 1 − |mean e^{i·angle}|, half the variance when small.
    """
    t, channels = signals.track.t[rows], signals.angles(rows)
    t_log = signals.motion.t
    misfit = np.ones(len(lags))
    for i, lag in enumerate(lags):
        inside = (t + lag >= t_log[0]) & (t + lag <= t_log[-1]) & signals.known_at(t + lag)
        left = all_of_it = 0.0
        for camera, log in channels:
            told = inside & np.isfinite(camera)
            if told.sum() > 2:
                still = scale * camera[told]
                left += _scatter(still - np.interp(t[told] + lag, t_log, log))
                all_of_it += _scatter(still)
        if all_of_it > 0.0:
            misfit[i] = left / all_of_it
    return misfit


def _scatter(angles: FloatArray) -> float:
    return 1.0 - float(np.abs(np.mean(np.exp(1j * angles))))
