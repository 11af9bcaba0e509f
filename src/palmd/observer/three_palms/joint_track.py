"""Where the joints are and have been, for a filter that goes on beside the loop's reports."""

from __future__ import annotations

import numpy as np

from palmd.events import FloatArray, PalmSample
from palmd.system.three_palms import GAP_S, JOINTS, PalmPlanes, palms_at

REPORTS = 4096  # that are kept: some 32 s at least
STEADY = 0.15  # share of a reported angle that corrects the planned way


class JointTrack:
    """Reported angles along the planned way; `times` (N,) and `told` (N, 3, 3) hold the first `count` reports."""

    def __init__(self, sample: PalmSample) -> None:
        self.times: FloatArray = np.empty(REPORTS)
        self.told: FloatArray = np.empty((REPORTS, 3, len(JOINTS)))  # angles, rates, accelerations
        self.count = 0
        self._add(sample, np.array(sample.angles))

    @property
    def t(self) -> float:
        """Of the last report (s)."""
        return float(self.times[self.count - 1])

    def take(self, sample: PalmSample) -> None:
        """A report; one that comes after a later one says nothing."""
        if sample.t_sample <= self.t:
            return
        ahead = self.at(np.array([sample.t_sample]))[0][0]
        gain = 1.0 if sample.rates is None else STEADY
        self._add(sample, ahead + gain * (np.array(sample.angles) - ahead))

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(T, 3) angles, rates and accelerations at times t (T,), each from the report that is nearest."""
        later = np.searchsorted(self.times[: self.count], t)
        before, after = np.maximum(later - 1, 0), np.minimum(later, self.count - 1)
        which = np.where(t - self.times[before] < self.times[after] - t, before, after)
        dt = np.clip(t - self.times[which], -GAP_S, GAP_S)[:, None]
        angle, rate, acceleration = (self.told[which, k] for k in range(3))
        return angle + dt * rate + 0.5 * dt**2 * acceleration, rate + dt * acceleration, acceleration

    def palms(self, t: FloatArray) -> PalmPlanes:
        """The palms at these times."""
        return palms_at(*self.at(t))

    def _add(self, sample: PalmSample, angle: FloatArray) -> None:
        if self.count == REPORTS:
            self.count = REPORTS // 2
            for kept in (self.times, self.told):
                kept[: self.count] = kept[-self.count :].copy()
        still = (0.0,) * len(JOINTS)
        self.times[self.count] = sample.t_sample
        self.told[self.count] = angle, sample.rates or still, sample.accelerations or still
        self.count += 1
