"""History of the joint angles, for a filter that fuses readings at their own times."""

from __future__ import annotations

import numpy as np

from palmd.events import FloatArray, PalmSample
from palmd.system.three_palms import GAP_S, JOINTS, PalmPlanes, palms_at

CAPACITY = 4096  # reports kept, at least half of them: 32 s or more
REPORT_GAIN = 0.15  # gain with which reported angles correct the planned motion


class JointTrack:
    """Joint angles: the planned motion corrected by reported angles.

    The first `count` rows of `times` (N,) (s) and `reports` (N, 3, 3) are valid: angles, rates and accelerations.
    """

    def __init__(self, sample: PalmSample) -> None:
        self.times: FloatArray = np.empty(CAPACITY)
        self.reports: FloatArray = np.empty((CAPACITY, 3, len(JOINTS)))  # angles, rates, accelerations
        self.count = 0
        self._add(sample, np.array(sample.angles))

    @property
    def t(self) -> float:
        """Time of the last report (s)."""
        return float(self.times[self.count - 1])

    def take(self, sample: PalmSample) -> None:
        """Take a report; one that is older than the last is ignored."""
        if sample.t_sample <= self.t:
            return
        ahead = self.at(np.array([sample.t_sample]))[0][0]
        gain = 1.0 if sample.rates is None else REPORT_GAIN
        self._add(sample, ahead + gain * (np.array(sample.angles) - ahead))

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(T, 3) angles, rates and accelerations at times t (T,), extrapolated from the nearest report."""
        later = np.searchsorted(self.times[: self.count], t)
        before, after = np.maximum(later - 1, 0), np.minimum(later, self.count - 1)
        which = np.where(t - self.times[before] < self.times[after] - t, before, after)
        dt = np.clip(t - self.times[which], -GAP_S, GAP_S)[:, None]
        angle, rate, acceleration = (self.reports[which, k] for k in range(3))
        return angle + dt * rate + 0.5 * dt**2 * acceleration, rate + dt * acceleration, acceleration

    def palms(self, t: FloatArray) -> PalmPlanes:
        """The palms at these times."""
        return palms_at(*self.at(t))

    def _add(self, sample: PalmSample, angle: FloatArray) -> None:
        if self.count == CAPACITY:
            self.count = CAPACITY // 2
            for kept in (self.times, self.reports):
                kept[: self.count] = kept[-self.count :].copy()
        still = (0.0,) * len(JOINTS)
        self.times[self.count] = sample.t_sample
        self.reports[self.count] = angle, sample.rates or still, sample.accelerations or still
        self.count += 1
