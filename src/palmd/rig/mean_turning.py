"""The rate at which a body turns, without the ripple of a vibration: from means over whole periods."""

from __future__ import annotations

import bisect

_PERIODS = 2  # whose means give the rate and its change (derivation: a straight line)
_SIDE_NODES = 2  # samples on either side from which an angle is interpolated (derivation: a cubic takes four)


class MeanTurning:
    """Keeps the angles over the last two periods of the vibration."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self.reset(0.0, 0.0, 0.0)

    def reset(self, t: float, psi: float, rate: float) -> None:
        """Start again with the body placed at `t` (s), turned by `psi` (rad), turning at `rate` (rad/s)."""
        self._rate = rate
        self._t, self._psi = [t], [psi]

    def take(self, t: float, psi: float) -> None:
        """Add the body's angle `psi` (rad) at `t` (s), later than the last."""
        self._t.append(t)
        self._psi.append(psi)
        spare = max(bisect.bisect(self._t, t - _PERIODS * self._period_s) - _SIDE_NODES, 0)
        del self._t[:spare], self._psi[:spare]

    @property
    def rate(self) -> float:
        """Rate (rad/s) at the last time, extrapolated from the means over the last two periods.

        Its error is 0.4 T² ω̈, T the period. Until two periods have passed it is the rate given to `reset`.
        """
        t, period = self._t[-1], self._period_s
        if t - _PERIODS * period < self._t[0]:
            return self._rate
        last, middle, first = (self._at(t - count * period) for count in range(_PERIODS + 1))
        last_rate, former_rate = (last - middle) / period, (middle - first) / period
        return 1.5 * last_rate - 0.5 * former_rate

    def _at(self, t: float) -> float:
        """The angle at `t` (s) from the cubic through the four samples around it."""
        after = bisect.bisect_left(self._t, t)
        begin = min(max(after - _SIDE_NODES, 0), max(len(self._t) - 2 * _SIDE_NODES, 0))
        times, angles = (each[begin : begin + 2 * _SIDE_NODES] for each in (self._t, self._psi))
        total = 0.0
        for i, (node, angle) in enumerate(zip(times, angles, strict=True)):
            weight = 1.0
            for j, other_node in enumerate(times):
                if i != j:
                    weight *= (t - other_node) / (node - other_node)
            total += weight * angle
        return total
