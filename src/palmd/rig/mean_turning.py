"""The rate at which a body turns, without the ripple that a vibration gives it: means over whole periods."""

from __future__ import annotations

import bisect

_PERIODS = 2  # whose means give a rate and how it changes (derivation: a straight line)
_BESIDE = 2  # angles on either side of a time that the angle is interpolated from (derivation: a cubic takes four)


class MeanTurning:
    """Keeps the angles of the last two periods of the vibration (s)."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self.begin(0.0, 0.0, 0.0)

    def begin(self, t: float, psi: float, rate: float) -> None:
        """The body is put there at `t` (s), turned by `psi` (rad) and turning at `rate` (rad/s)."""
        self._rate = rate
        self._t, self._psi = [t], [psi]

    def take(self, t: float, psi: float) -> None:
        """The body is turned by `psi` (rad) at `t` (s), later than before."""
        self._t.append(t)
        self._psi.append(psi)
        spare = max(bisect.bisect(self._t, t - _PERIODS * self._period_s) - _BESIDE, 0)
        del self._t[:spare], self._psi[:spare]

    @property
    def rate(self) -> float:
        """At the last time (rad/s), from the mean over the last period and how it differs from the one before.

        Off by 0.4 T² ω̈, T the period. Until two periods have passed the rate at which the body was put there.
        """
        t, period = self._t[-1], self._period_s
        if t - _PERIODS * period < self._t[0]:
            return self._rate
        now, before, first = (self._at(t - count * period) for count in range(_PERIODS + 1))
        last, former = (now - before) / period, (before - first) / period
        return 1.5 * last - 0.5 * former

    def _at(self, t: float) -> float:
        """The cubic through the four angles about `t`."""
        right = bisect.bisect_left(self._t, t)
        begin = min(max(right - _BESIDE, 0), max(len(self._t) - 2 * _BESIDE, 0))
        times, angles = (each[begin : begin + 2 * _BESIDE] for each in (self._t, self._psi))
        total = 0.0
        for i, (one, angle) in enumerate(zip(times, angles, strict=True)):
            weight = 1.0
            for j, other in enumerate(times):
                if i != j:
                    weight *= (t - other) / (one - other)
            total += weight * angle
        return total
