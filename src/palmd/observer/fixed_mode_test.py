"""Test whether an object may lie on a flat side and only turn with that palm, from the other palm's readings. Pure.

An object that lies on a flat side turns with that palm. It touches the other palm with a corner, or with a round part,
whose centre is at a constant height over the supporting palm (Y) and over the other (ρ) while the object slides along.
So the other palm reads

    s = (Y + ρ cos φ2) / sin φ2,

for either supporting palm. Nothing else is assumed of the object. While the readings agree with that, the contact on
the supporting palm may be where a side's torques balance, and need not belong to an outline that rolls.

Of the rig's constants those matter that bend the curve: a pad's zero, lag and compliance under force, and the error of
the opening. Scale and standoffs are absorbed by Y and ρ.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from palmd.events import FloatArray, PadSample, PalmMotion
from palmd.observer.palms import RESTING_RAD_S
from palmd.system.description import RigDescription
from palmd.system.mechanism import OPENING, PALMS

SIGMAS, MODEL_SHARE = 3.0, 0.02  # of χ², beyond which readings contradict the mode; and a share of it for model error
FIT_EVERY = 5  # readings of a pad
LEAST_RANGE_RAD = 0.25  # range of φ2 needed to determine a corner
# largest ρ of a corner: smooth objects of the studies have 15 mm or more, corners 1 and 3 mm, determined to 0.1 mm
CORNER_M = 4e-3
ROUND_M = 15e-3  # typical ρ, which multiplies the error of the opening


class FixedModeTest:
    """Test of both supporting palms for one object on flat palms, by least squares; safe inside the loop."""

    def __init__(self, rig: RigDescription):
        """`rig`: uncertainty of readings and constants."""
        self._noise = np.sqrt(rig.reading_variances).tolist()
        self._rig_sds = [
            [math.hypot(pad.zero_sd, ROUND_M * rig.angle_sd), rig.angle_sd, pad.lag_sd, pad.force_sd]
            for pad in rig.pads
        ]
        # the prior of the normalised rig constants counts as one reading each
        prior_information = [[0.0] * 3 + [1.0] * np.count_nonzero(sds) for sds in self._rig_sds]
        self._sums: dict[int, FloatArray] = dict(zip(PALMS, map(np.diag, prior_information), strict=True))
        self._rows: dict[int, list[list[float]]] = {pad: [] for pad in PALMS}
        self._standoff_sd = max(pad.standoff_sd for pad in rig.pads)
        self._readings = dict.fromkeys(PALMS, 0)
        self._fits: dict[int, _ModeFit | None] = dict.fromkeys(PALMS)
        self._least_opening, self._most_opening = math.inf, -math.inf
        self.cornered = False  # the mode was not contradicted, and a corner touched the other palm

    def read(self, sample: PadSample, palms: PalmMotion) -> None:
        """Add a reading with the palms' motion; without effect at rest."""
        if max(map(abs, palms.rates)) < RESTING_RAD_S:
            return
        opening, rate, i = palms.angles[OPENING], palms.rates[OPENING], sample.pad - 1
        cos, sin, force = math.cos(opening), math.sin(opening), sample.force or 0.0
        rig_effects = sin, -sample.s * cos, -sample.s * rate * sin, force * sin
        of_rig = [sd * by for sd, by in zip(self._rig_sds[i], rig_effects, strict=True) if sd]
        weight, rows = 1.0 / (sin * self._noise[i]), self._rows[sample.pad]
        rows.append([each * weight for each in (1.0, cos, sample.s * sin, *of_rig)])
        self._readings[sample.pad] += 1
        self._least_opening, self._most_opening = min(self._least_opening, opening), max(self._most_opening, opening)
        if len(rows) == FIT_EVERY:  # several at a time: the cost is that of creating an array
            new_rows = np.array(rows)
            rows.clear()
            self._sums[sample.pad] += new_rows.T @ new_rows
            self._fits[sample.pad] = _solved(_without_rig(self._sums[sample.pad]), self._readings[sample.pad])
            determined = self._most_opening - self._least_opening > LEAST_RANGE_RAD
            self.cornered = self.cornered or (determined and self._touches_corner(sample.pad))

    @property
    def excluded(self) -> bool:
        """Whether the readings contradict the mode on both palms."""
        return all(self._contradicted(pad) for pad in PALMS)

    @property
    def disc(self) -> bool:
        """Whether the readings contradict the mode on neither palm, as is the case for a disc."""
        return not any(self._contradicted(pad) for pad in PALMS)

    @property
    def concentric(self) -> bool:
        """Whether the readings of both palms together are those of a disc, on an exactly known rig.

        Its centre is at the same height over a palm for either palm's readings: one reads with Y = ρ2, the other with Y
        = ρ1.
        """
        one, other = (_without_rig(self._sums[pad]) for pad in PALMS)
        swapped = (1, 0, 2)
        sums = [[one[j][k] + other[row][column] for column, k in enumerate(swapped)] for row, j in enumerate(swapped)]
        fit = _solved(sums, sum(self._readings.values()))
        return fit is None or not fit.contradicted

    def _contradicted(self, pad: int) -> bool:
        fit = self._fits[pad]
        return fit is not None and fit.contradicted

    def _touches_corner(self, pad: int) -> bool:
        fit = self._fits[pad]
        if fit is None or fit.contradicted:
            return False
        return fit.rho + SIGMAS * math.hypot(fit.sd, self._standoff_sd) < CORNER_M


class _ModeFit(NamedTuple):
    """The likeliest ρ (m) with its 1σ, and whether the readings contradict the mode."""

    rho: float
    sd: float
    contradicted: bool


def _without_rig(sums: FloatArray) -> list[list[float]]:
    """Sums of products of (1, cos φ2, s sin φ2), with the rig's normalised constants, which follow them, eliminated."""
    left: list[list[float]] = sums.tolist()  # few numbers: plain Python takes a third of NumPy's time
    while len(left) > 3:
        *left, pivot = left
        left = [[x - row[-1] / pivot[-1] * y for x, y in zip(row[:-1], pivot[:-1], strict=True)] for row in left]
    return left


def _solved(sums: list[list[float]], readings: int) -> _ModeFit | None:
    """Fit from a pad's sums of products of (1, cos φ2, s sin φ2); None with too few readings."""
    (a, b, p), (_, c, q), (*_, total) = sums
    determinant = a * c - b * b
    if not determinant > 0.0:
        return None
    chi2 = total - (c * p * p - 2.0 * b * p * q + a * q * q) / determinant
    most = readings * (1.0 + MODEL_SHARE) + SIGMAS * math.sqrt(2.0 * readings)
    return _ModeFit((a * q - b * p) / determinant, math.sqrt(a / determinant), chi2 > most)
