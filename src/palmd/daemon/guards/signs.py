"""Test of the pads' signs: geometry fixes how the contacts move along the palms as these open. Pure.

The centre of mass is at distances r1 and r2 from the palms, so that s1 + s2 = (r1 + r2)/tan(φ2/2) + (h′ terms of both
palms). The outline changes r and h′ by similar lengths as the object turns; multiplied by sin(φ2/2), y = (s1 + s2)
sin(φ2/2) is a line through the origin over x = cos(φ2/2) with a residual of one size for narrow and wide V. A pad with
a wrong sign reads 2·c − s instead, where c is its zero, or its middle if zero_mm was set for the wrong end. Each
combination of signs and of c is a hypothesis about which readings to mirror before the line is fitted; the Laplace
evidence of a line with unknown variance is −n/2·ln(sum of squares), n being the number of independent readings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from palmd.events import PadSample, PalmMotion
from palmd.system.mechanism import OPENING, PALMS

MEMORY_S = 8.0
LOOK_S = 0.05
CORRELATED_S = 0.25
"""Readings closer together have nearly the same normals of the object and count as one."""

FRESH_S = 0.05
TURNING_RAD_S = math.radians(2.0)
OUTLINE_M = 4e-3
"""Residual due to an outline; a line that fits better is no better evidence.

Study 2026-11-30: over whole turns of random objects of kind `rig` (16 to 24 mm) its RMS is 1.9 mm in the median and
3.8 mm at most.
"""
CONTRADICTED_M = 5e-3
"""RMS residual from which on the configured signs are contradicted: more than an outline causes.

Study 2026-11-30: a wrong sign causes 10 to 50 mm after ten seconds of an exploration. An outline that turns slowly
causes correlated residuals, whose odds are too high.
"""

LOG_ODDS = math.log(1e4)
Signs = tuple[int, int]
_PRODUCTS = tuple((i, j) for i in range(4) for j in range(i, 4))
_RIGHT: Signs = (1, 1)
_WRONG: tuple[Signs, ...] = ((-1, -1), (1, -1), (-1, 1))


class SignWatch:
    """`wrong` are the numbers of the pads with a wrong sign, empty unless the evidence exceeds `LOG_ODDS`.

    Then also the configured signs must be contradicted by the size of the residual alone.
    """

    def __init__(self, zeros_m: Sequence[float], middles_m: Sequence[float]) -> None:
        """`zeros_m`: position of each pad's count 0; `middles_m`: its middle. A wrong sign mirrors at one of them."""
        self.wrong: tuple[int, ...] = ()
        self.log_odds = 0.0
        self._mirrors = (tuple(zeros_m), tuple(middles_m))
        self._last: dict[int, tuple[float, float]] = {}
        self._t = self._t_judged = -math.inf
        self._weight = 0.0
        self._sums = [0.0] * len(_PRODUCTS)  # weighted sums of products of x, and of sin(φ2/2) by 1 and both contacts

    def feed(self, sample: PadSample) -> None:
        """Take a reading."""
        self._last[sample.pad] = (sample.t_sample, sample.s)

    def look(self, t: float, palms: PalmMotion | None) -> None:
        """Update the verdict at `t` (s); call once a tick."""
        if t - self._t < LOOK_S or palms is None or len(self._last) < len(PALMS):
            return
        dt, self._t = min(t - self._t, LOOK_S), t
        times, places = zip(*(self._last[pad] for pad in PALMS), strict=True)
        opening = palms.angles[OPENING]
        if t - min(times) > FRESH_S or abs(palms.rates[OPENING]) < TURNING_RAD_S or not 0.0 < opening < math.pi:
            return
        fading = math.exp(-dt / MEMORY_S)
        sine = math.sin(0.5 * opening)
        regressors = (math.cos(0.5 * opening), sine, *(sine * place for place in places))
        self._weight = fading * self._weight + dt
        self._sums = [
            fading * before + dt * regressors[i] * regressors[j]
            for before, (i, j) in zip(self._sums, _PRODUCTS, strict=True)
        ]
        if t - self._t_judged >= CORRELATED_S:
            self._t_judged = t
            self._judge()

    def _judge(self) -> None:
        found = [(self._evidence(signs, mirrors), signs) for signs in _WRONG for mirrors in self._mirrors]
        evidence, signs = max(found)
        self.log_odds = evidence - self._evidence(_RIGHT, self._mirrors[0])
        if self.log_odds > LOG_ODDS and self._variance(_RIGHT, self._mirrors[0]) > CONTRADICTED_M**2:
            self.wrong = tuple(pad for pad, sign in zip(PALMS, signs, strict=True) if sign < 0)
        elif self.log_odds < -LOG_ODDS:
            self.wrong = ()

    def _evidence(self, signs: Signs, mirrors: Sequence[float]) -> float:
        """Log evidence, up to a constant, of a line through readings mirrored at `mirrors` where `signs` are −1."""
        variance = self._variance(signs, mirrors) + OUTLINE_M**2
        return -0.5 * self._weight / CORRELATED_S * math.log(variance)

    def _variance(self, signs: Signs, mirrors: Sequence[float]) -> float:
        """Mean square (m²) of the residual of such a line."""
        mirrored = sum(2.0 * mirror for mirror, sign in zip(mirrors, signs, strict=True) if sign < 0)
        row = (0.0, mirrored, *signs)  # coefficients of y in the sums' factors
        sums = dict(zip(_PRODUCTS, self._sums, strict=True))
        xx = sums[0, 0]
        xy = sum(row[j] * sums[0, j] for j in range(1, 4))
        yy = sum((2.0 if i < j else 1.0) * row[i] * row[j] * sums[i, j] for i, j in _PRODUCTS if i)
        slope = max(xy / xx, 0.0)
        return max((yy - 2.0 * slope * xy + slope**2 * xx) / self._weight, 0.0)
