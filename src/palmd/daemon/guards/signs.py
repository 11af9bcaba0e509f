"""Are the pads' signs right? Geometry fixes how the contacts move along the palms as these open. Pure.

The centre of mass is r1 and r2 from the palms, so that s1 + s2 = (r1 + r2)/tan(φ2/2) + (h′ terms of either palm): a
line through the origin over x = 1/tan(φ2/2), and what the outline adds. A pad whose sign is wrong reads 2·zero − s
instead. Each combination of signs is a hypothesis about which readings to mirror before the line is fitted; the Laplace
evidence of a line with an unknown variance is −n/2·ln(sum of squares), n being the number of independent readings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palmd.events import FloatArray, PadSample, PalmMotion
from palmd.system.mechanism import OPENING, PALMS

MEMORY_S = 8.0
LOOK_S = 0.05
CORRELATED_S = 0.25
"""Readings nearer to each other are of nearly the same normals of the object: they count as one."""

FRESH_S = 0.05
TURNING_RAD_S = math.radians(2.0)
OUTLINE_M = 1e-3
"""What any outline adds, at the least: a line that fits better than that is no better evidence."""

LOG_ODDS = math.log(1e4)
_HYPOTHESES = ((1, 1), (-1, -1), (1, -1), (-1, 1))


class SignWatch:
    """`wrong` are the numbers of the pads whose sign is wrong, empty as long as nothing speaks for that."""

    def __init__(self, zeros_m: Sequence[float]) -> None:
        """`zeros_m`: where each pad counts 0, which a wrong sign mirrors its readings at."""
        self.wrong: tuple[int, ...] = ()
        self.log_odds = 0.0
        self._zeros = tuple(zeros_m)
        self._last: dict[int, tuple[float, float]] = {}
        self._t = -math.inf
        self._weight = 0.0
        self._moments: FloatArray = np.zeros((4, 4))  # of x, 1 and both places: weighted sums of products

    def feed(self, sample: PadSample) -> None:
        """Take a reading."""
        self._last[sample.pad] = (sample.t_sample, sample.s)

    def look(self, t: float, palms: PalmMotion | None) -> None:
        """Judge anew at `t` (s), once a tick."""
        if t - self._t < LOOK_S or palms is None or len(self._last) < len(PALMS):
            return
        dt, self._t = min(t - self._t, LOOK_S), t
        times, places = zip(*(self._last[pad] for pad in PALMS), strict=True)
        opening = palms.angles[OPENING]
        if t - min(times) > FRESH_S or abs(palms.rates[OPENING]) < TURNING_RAD_S or not 0.0 < opening < math.pi:
            return
        fading = math.exp(-dt / MEMORY_S)
        seen = np.array([1.0 / math.tan(0.5 * opening), 1.0, *places])
        self._moments = self._moments * fading + dt * np.outer(seen, seen)
        self._weight = self._weight * fading + dt
        evidence = [self._evidence(signs) for signs in _HYPOTHESES]
        best = max(range(1, len(_HYPOTHESES)), key=lambda each: evidence[each])
        self.log_odds = evidence[best] - evidence[0]
        if self.log_odds > LOG_ODDS:
            self.wrong = tuple(pad for pad, sign in zip(PALMS, _HYPOTHESES[best], strict=True) if sign < 0)
        elif self.log_odds < -LOG_ODDS:
            self.wrong = ()

    def _evidence(self, signs: tuple[int, int]) -> float:
        """Logarithm, but for what all have in common, of how well a line fits with these readings mirrored."""
        mirrored = sum(2.0 * zero for zero, sign in zip(self._zeros, signs, strict=True) if sign < 0)
        y = self._moments @ np.array([0.0, mirrored, *map(float, signs)])
        total = float(np.array([0.0, mirrored, *map(float, signs)]) @ y)
        slope = max(float(y[0]) / float(self._moments[0, 0]), 0.0)
        left = total - 2.0 * slope * float(y[0]) + slope**2 * float(self._moments[0, 0])
        variance = max(left / self._weight, 0.0) + OUTLINE_M**2
        return -0.5 * self._weight / CORRELATED_S * math.log(variance)
