"""What the rig's constants are off by, as a smoother has told it: applied to readings before a filter takes them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palmd.events import FloatArray, PadSample
from palmd.model.smoothing import RIG_CONSTANTS, R
from palmd.model.touch import LEAST_CURVATURE_MARGIN
from palmd.system.arcs import FLAT
from palmd.system.description import RigDescription
from palmd.system.mechanism import PALMS


@dataclass(slots=True)
class RigError:
    """Estimates in the order of `model.smoothing.R`; zeros leave everything as it is. Safe inside the loop."""

    pad_lengths: tuple[float, ...]
    curvatures: tuple[float, ...] = FLAT
    values: FloatArray = field(default_factory=lambda: np.zeros(RIG_CONSTANTS))
    s: FloatArray = field(default_factory=lambda: np.zeros(len(PALMS)))  # of each pad's last contact, corrected (m)
    most: FloatArray = field(default_factory=lambda: np.zeros(len(PALMS)))  # that each pad has told (N)

    def angles(self) -> tuple[float, float]:
        """By how much φ1 and φ2 of the surfaces that are touched exceed those that are reported (rad)."""
        one, two = self.bows(self.values)
        return float(self.values[R.TILT] + one), float(self.values[R.TURN] + two)

    def bows(self, values: FloatArray) -> FloatArray:
        """By how much bowed surfaces make φ1 and φ2 larger at the last contacts (rad), of constants (RIG, …)."""
        one, two = (
            4.0 * values[R.SAGITTA + i] / length * (1.0 - 2.0 * self._u(i)) for i, length in enumerate(self.pad_lengths)
        )
        return np.array([one, -one - two])

    def heights(self, values: FloatArray) -> FloatArray:
        """How far both surfaces lie above the hinge line at the last contacts (m), of constants (RIG, …)."""
        return np.array([values[R.STANDOFF + k] + 4.0 * values[R.SAGITTA + k] * self._u(k) ** 2 for k in range(2)])

    def lifts(self, palm: int, opening: float, radius: float) -> FloatArray:
        """By how much a contact on `palm` (0, 1) is farther from the hinge for each metre that a surface is higher.

        opening: φ2 as in `angles`. radius (m): of the object, about; a curved palm's contact goes by 1/(1 − κ·radius)
        farther than a flat one's.
        """
        slack = 1.0
        if any(self.curvatures):
            opening -= sum(each * at for each, at in zip(self.curvatures, self.s, strict=True))
            slack = max(1.0 - self.curvatures[palm] * radius, LEAST_CURVATURE_MARGIN)
        by = np.full(len(PALMS), 1.0 / math.sin(opening) / slack)
        by[palm] = math.cos(opening) / math.sin(opening) / slack
        return by

    def on_time(self, sample: PadSample) -> PadSample:
        """The reading at the time of what it tells."""
        lag = float(self.values[R.LAG + sample.pad - 1])
        return PadSample(sample.t_sample - lag, sample.pad, sample.s, sample.force) if lag else sample

    def pressing(self, sample: PadSample) -> float:
        """The force (N) that it was read under; pressed beyond its scale a pad tells none, but did tell the most."""
        if sample.force is not None:
            self.most[sample.pad - 1] = max(self.most[sample.pad - 1], sample.force)
            return sample.force
        return float(self.most[sample.pad - 1])

    def corrected(self, sample: PadSample, opening: float, radius: float) -> float:
        """The distance (m) that the pad would tell, had it no error and lay on the hinge line; others as in `lifts`."""
        i, v = sample.pad - 1, self.values
        pushed = v[R.FORCE + i] * self.pressing(sample)
        self.s[i] = s = float((sample.s - v[R.ZERO + i] - pushed) / (1.0 + v[R.SCALE + i]))
        return float(s - self.lifts(i, opening, radius) @ self.heights(v))

    def _u(self, pad: int) -> float:
        return float(self.s[pad]) / self.pad_lengths[pad]


def circle_spread(rig: RigDescription, contacts: Sequence[float], opening: float) -> float:
    """One-sigma (m) that the rig's constants leave of a circle's radius r = s · tan(φ2/2), s the mean of both contacts.

    For before a smoother has told how they and the outline hang together.
    """
    (one, two), (first, second) = rig.pads, contacts
    tangent = float(np.tan(opening / 2))
    of_s = np.hypot([one.zero_sd, one.scale_sd * first], [two.scale_sd * second, two.zero_sd]) * tangent / 2
    of_angle = (first + second) / 4 * (1 + tangent**2) * rig.angle_sd
    standoff, sagitta = (
        math.sqrt((a * a + b * b) / 2)
        for a, b in ((one.standoff_sd, two.standoff_sd), (one.sagitta_sd, two.sagitta_sd))
    )
    return float(np.linalg.norm([*of_s, of_angle, standoff / np.sqrt(2.0), sagitta]))
