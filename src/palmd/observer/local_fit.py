"""Value and rate of a noisy, irregularly sampled signal by local cubic regression.

About each time a cubic is fitted by weighted least squares to the readings within `HALF_WIDTH_S`. The weights fall to
zero at both ends (tricube), so that the result does not jump as readings enter and leave. In the middle of 100 Hz
readings with noise σ, the 1σ of the value is about 0.25 σ and that of the rate 5 σ per second; motion faster than about
2 Hz is not followed. At the ends of the record the fit is one-sided and several times noisier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray

HALF_WIDTH_S = 0.2
LEAST_READINGS = 6
_POWERS = np.arange(4)


@dataclass(frozen=True, slots=True)
class LocalFit:
    """Value and rate (per s) of each column at one time, and the weighted RMS of the residuals."""

    value: FloatArray
    rate: FloatArray
    misfit: FloatArray


def local_cubic(times: FloatArray, values: FloatArray, t: float) -> LocalFit | None:
    """The fit at `t` (s) to each column of `values` (n, k); None with too few readings about `t`.

    Takes some 30 µs; safe inside the loop.
    """
    u = (times - t) / HALF_WIDTH_S
    near = np.abs(u) < 1.0
    if np.count_nonzero(near) < LEAST_READINGS:
        return None
    u, values = u[near], values[near]
    weight = (1.0 - np.abs(u) ** 3) ** 3
    rows = u[:, None] ** _POWERS
    weighted = rows * weight[:, None]
    try:
        fit = np.linalg.solve(weighted.T @ rows, weighted.T @ values)
    except np.linalg.LinAlgError:  # all readings at two or three instants
        return None
    misfit = np.sqrt(weight @ (values - rows @ fit) ** 2 / weight.sum())
    return LocalFit(fit[0], fit[1] / HALF_WIDTH_S, misfit)


class RecentReadings:
    """The readings of the last seconds, of one or more columns, in order of time."""

    def __init__(self, kept_s: float):
        """Readings that are older than the newest by `kept_s` (s) are dropped."""
        self._kept_s = kept_s
        self._times: list[float] = []
        self._values: list[Sequence[float]] = []

    def add(self, t: float, *values: float) -> None:
        """Insert one reading in order of time; a reading at the same time as an earlier one is dropped."""
        at = len(self._times)
        while at and self._times[at - 1] > t:
            at -= 1
        if at and self._times[at - 1] == t:
            return
        self._times.insert(at, t)
        self._values.insert(at, values)
        while self._times[-1] - self._times[0] > self._kept_s:
            del self._times[0], self._values[0]

    def at(self, t: float) -> LocalFit | None:
        """`local_cubic` of the kept readings."""
        if not self._times:
            return None
        return local_cubic(np.array(self._times), np.array(self._values), t)

    def clear(self) -> None:
        """Drop all readings."""
        self._times.clear()
        self._values.clear()
