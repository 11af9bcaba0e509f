"""Whether an object may lie on a flat side, and only turn with that palm: a test by the readings of the other. Pure.

What rides on a palm turns as that does. The other palm it touches with a corner, or with a part that is round, whose
centre stays as high over the ridden palm (Y) as over the other (ρ), while the object slides along. So the other reads

    s = (Y + ρ cos φ2) / sin φ2,

the same for either palm to ride on. Nothing else is assumed of the object. While readings agree with that, the ridden
palm's own may be where a side's torques balance, and need tell nothing of an outline that rolls.

Of the rig's constants those count that bend the curve: a pad's zero, lag and give under force, and the opening's
error. Scale and standoffs are a matter of Y and ρ.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from palmd.events import FloatArray, PadSample, PalmMotion
from palmd.observer.palms import RESTING_RAD_S
from palmd.system.description import RigDescription
from palmd.system.mechanism import OPENING, PALMS

SIGMAS, SLACK = 3.0, 0.02  # of χ², from which on readings contradict a ride; a share of it for what is no noise
FIT_EVERY = 5  # of a pad's readings
TELLING_RAD = 0.25  # of φ2, over which a corner is told
CORNER_M = 4e-3  # of ρ: smooth objects of the studies have 15 mm and more, corners of 1 and 3 mm are told to 0.1 mm
ROUND_M = 15e-3  # of ρ, about, where it multiplies a constant of the rig


class Riding:
    """Both rides of one object on flat palms, by least squares; safe inside the loop."""

    def __init__(self, rig: RigDescription):
        """`rig` says how well readings and its constants are known."""
        self._noise = np.sqrt(rig.reading_variances).tolist()
        self._off = [
            [math.hypot(pad.zero_sd, ROUND_M * rig.angle_sd), rig.angle_sd, pad.lag_sd, pad.force_sd]
            for pad in rig.pads
        ]
        # of constants in one-sigmas the first reading is what is believed of them
        believed = [[0.0] * 3 + [1.0] * np.count_nonzero(off) for off in self._off]
        self._sums: dict[int, FloatArray] = dict(zip(PALMS, map(np.diag, believed), strict=True))
        self._rows: dict[int, list[list[float]]] = {pad: [] for pad in PALMS}
        self._standoff_sd = max(pad.standoff_sd for pad in rig.pads)
        self._readings = dict.fromkeys(PALMS, 0)
        self._ride: dict[int, _Ride | None] = dict.fromkeys(PALMS)
        self._least, self._most = math.inf, -math.inf
        self.cornered = False  # it has ridden, and touched the other palm with a corner

    def read(self, sample: PadSample, palms: PalmMotion) -> None:
        """Take a reading, the palms moving like that; at rest it tells nothing."""
        if max(map(abs, palms.rates)) < RESTING_RAD_S:
            return
        opening, rate, i = palms.angles[OPENING], palms.rates[OPENING], sample.pad - 1
        cos, sin, force = math.cos(opening), math.sin(opening), sample.force or 0.0
        moved = sin, -sample.s * cos, -sample.s * rate * sin, force * sin
        of_rig = [sd * by for sd, by in zip(self._off[i], moved, strict=True) if sd]
        weight, rows = 1.0 / (sin * self._noise[i]), self._rows[sample.pad]
        rows.append([each * weight for each in (1.0, cos, sample.s * sin, *of_rig)])
        self._readings[sample.pad] += 1
        self._least, self._most = min(self._least, opening), max(self._most, opening)
        if len(rows) == FIT_EVERY:  # together: what a few numbers cost is an array's being there
            told_by = np.array(rows)
            rows.clear()
            self._sums[sample.pad] += told_by.T @ told_by
            self._ride[sample.pad] = _solved(_without_rig(self._sums[sample.pad]), self._readings[sample.pad])
            told = self._most - self._least > TELLING_RAD
            self.cornered = self.cornered or (told and self._sharp(sample.pad))

    @property
    def excluded(self) -> bool:
        """Whether the readings of each palm contradict a ride on the other."""
        return all(self._contradicted(pad) for pad in PALMS)

    @property
    def disc(self) -> bool:
        """Whether neither palm's readings contradict a ride on the other, as those of a disc do not."""
        return not any(self._contradicted(pad) for pad in PALMS)

    @property
    def concentric(self) -> bool:
        """Whether the readings of both palms together are those of a disc, for all that is known of an exact rig.

        Its centre is as high over a palm for either palm's readings: one reads with Y = ρ2, the other with Y = ρ1.
        """
        one, other = (_without_rig(self._sums[pad]) for pad in PALMS)
        turned = (1, 0, 2)
        sums = [[one[j][k] + other[row][column] for column, k in enumerate(turned)] for row, j in enumerate(turned)]
        ride = _solved(sums, sum(self._readings.values()))
        return ride is None or not ride.contradicted

    def _contradicted(self, pad: int) -> bool:
        ride = self._ride[pad]
        return ride is not None and ride.contradicted

    def _sharp(self, pad: int) -> bool:
        ride = self._ride[pad]
        if ride is None or ride.contradicted:
            return False
        return ride.rho + SIGMAS * math.hypot(ride.sd, self._standoff_sd) < CORNER_M


class _Ride(NamedTuple):
    """The likeliest ρ (m) and its one-sigma, and whether the readings contradict it all the same."""

    rho: float
    sd: float
    contradicted: bool


def _without_rig(sums: FloatArray) -> list[list[float]]:
    """Sums of products of (1, cos φ2, s sin φ2), constants of the rig in one-sigmas, behind them, eliminated."""
    left: list[list[float]] = sums.tolist()  # a few numbers: plainly it takes a third of the time
    while len(left) > 3:
        *left, pivot = left
        left = [[x - row[-1] / pivot[-1] * y for x, y in zip(row[:-1], pivot[:-1], strict=True)] for row in left]
    return left


def _solved(sums: list[list[float]], readings: int) -> _Ride | None:
    """From a pad's sums of products of (1, cos φ2, s sin φ2); None of too few."""
    (a, b, p), (_, c, q), (*_, total) = sums
    determinant = a * c - b * b
    if not determinant > 0.0:
        return None
    chi2 = total - (c * p * p - 2.0 * b * p * q + a * q * q) / determinant
    most = readings * (1.0 + SLACK) + SIGMAS * math.sqrt(2.0 * readings)
    return _Ride((a * q - b * p) / determinant, math.sqrt(a / determinant), chi2 > most)
