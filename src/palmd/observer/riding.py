"""Whether an object may lie on a flat side, and only turn with that palm: a test by the readings of the other. Pure.

What rides on a palm turns as that does. The other palm it touches with a corner, or with a part that is round, whose
centre stays as high over the ridden palm (Y) as over the other (ρ), while the object slides along. So the other reads

    s = (Y + ρ cos φ2) / sin φ2,

the same for either palm to ride on. Nothing else is assumed of the object. While readings agree with that, the ridden
palm's own may be where a side's torques balance, and need tell nothing of an outline that rolls.
"""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray, PadSample
from palmd.system.mechanism import PALMS

SIGMAS, SLACK = 3.0, 0.02  # of χ², from which on readings contradict a ride; a share of it for what is no noise

TELLING_RAD = 0.25  # of φ2, over which what rolls contradicts a ride mostly
CORNER_M = 4e-3  # of ρ: smooth objects of the studies have 15 mm and more, corners of 1 and 3 mm are told to 0.1 mm


class Riding:
    """Both rides of one object on flat palms, by least squares; safe inside the loop."""

    def __init__(self) -> None:
        self._sums: dict[int, FloatArray] = {pad: np.zeros((3, 3)) for pad in PALMS}
        self._readings = dict.fromkeys(PALMS, 0)
        self._least, self._most = math.inf, -math.inf
        self.cornered = False  # it has ridden, and touched the other palm with a corner

    def read(self, sample: PadSample, opening: float, variance: float) -> None:
        """Take a reading of `variance` (m²), φ2 being `opening` (rad)."""
        row = np.array([1.0, math.cos(opening), sample.s * math.sin(opening)])
        row /= math.sin(opening) * math.sqrt(variance)
        self._sums[sample.pad] += np.outer(row, row)
        self._readings[sample.pad] += 1
        self._least, self._most = min(self._least, opening), max(self._most, opening)
        self.cornered = self.cornered or (self._told and self._sharp(sample.pad))

    @property
    def likely(self) -> bool:
        """Whether a ride is not `excluded` by palms that have turned far enough against each other to exclude most."""
        return self._told and not self.excluded

    @property
    def _told(self) -> bool:
        return self._most - self._least > TELLING_RAD

    @property
    def excluded(self) -> bool:
        """Whether the readings of each palm contradict a ride on the other."""
        return all(self._contradicted(pad) for pad in PALMS)

    def _contradicted(self, pad: int) -> bool:
        (a, b, p), (_, c, q), (*_, total) = self._sums[pad].tolist()
        n, determinant = self._readings[pad], a * c - b * b
        if n < 3 or not determinant > 0.0:
            return False
        chi2: float = total - (c * p * p - 2.0 * b * p * q + a * q * q) / determinant
        return chi2 > n * (1.0 + SLACK) + SIGMAS * math.sqrt(2.0 * n)

    def _sharp(self, pad: int) -> bool:
        (a, b, p), (_, c, q), _ = self._sums[pad].tolist()
        determinant = a * c - b * b
        if not determinant > 0.0 or self._contradicted(pad):
            return False
        return bool((a * q - b * p) / determinant + SIGMAS * math.sqrt(a / determinant) < CORNER_M)
