"""Errors of the rig's constants, as estimated by a smoother; readings are corrected before a filter takes them."""

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
    """Estimates in the order of `model.smoothing.R`; zeros change nothing. Safe inside the loop."""

    pad_lengths: tuple[float, ...]
    curvatures: tuple[float, ...] = FLAT
    values: FloatArray = field(default_factory=lambda: np.zeros(RIG_CONSTANTS))
    s: FloatArray = field(default_factory=lambda: np.zeros(len(PALMS)))  # each pad's last contact, corrected (m)
    most: FloatArray = field(default_factory=lambda: np.zeros(len(PALMS)))  # largest force measured by each pad (N)

    def angles(self) -> tuple[float, float]:
        """Differences (rad) of φ1 and φ2 of the touched surfaces from those reported."""
        one, two = self.bows(self.values)
        return float(self.values[R.TILT] + one), float(self.values[R.TURN] + two)

    def bows(self, values: FloatArray) -> FloatArray:
        """Increase of φ1 and φ2 by bowed surfaces at the last contacts (rad), for constants (RIG, …)."""
        one, two = (
            4.0 * values[R.SAGITTA + i] / length * (1.0 - 2.0 * self._u(i)) for i, length in enumerate(self.pad_lengths)
        )
        return np.array([one, -one - two])

    def heights(self, values: FloatArray) -> FloatArray:
        """Height of both surfaces over the hinge line at the last contacts (m), for constants (RIG, …)."""
        return np.array([values[R.STANDOFF + k] + 4.0 * values[R.SAGITTA + k] * self._u(k) ** 2 for k in range(2)])

    def lifts(self, palm: int, opening: float, radius: float) -> FloatArray:
        """Shift of a contact on `palm` (0, 1) away from the hinge, per metre by which each surface is higher.

        opening: φ2 as in `angles`. radius (m): approximate, of the object; on a curved palm a contact is shifted 1/(1 −
        κ·radius) times as far as on a flat one.
        """
        margin = 1.0
        if any(self.curvatures):
            opening -= sum(each * at for each, at in zip(self.curvatures, self.s, strict=True))
            margin = max(1.0 - self.curvatures[palm] * radius, LEAST_CURVATURE_MARGIN)
        shift = np.full(len(PALMS), 1.0 / math.sin(opening) / margin)
        shift[palm] = math.cos(opening) / math.sin(opening) / margin
        return shift

    def on_time(self, sample: PadSample) -> PadSample:
        """The reading, with its time corrected for the pad's lag."""
        lag = float(self.values[R.LAG + sample.pad - 1])
        return PadSample(sample.t_sample - lag, sample.pad, sample.s, sample.force) if lag else sample

    def pressing(self, sample: PadSample) -> float:
        """Force (N) on the pad at the reading; beyond the pad's scale, its largest force so far."""
        if sample.force is not None:
            self.most[sample.pad - 1] = max(self.most[sample.pad - 1], sample.force)
            return sample.force
        return float(self.most[sample.pad - 1])

    def corrected(self, sample: PadSample, opening: float, radius: float) -> float:
        """The distance (m) that a pad without errors on the hinge line would read; other arguments as in `lifts`."""
        i, v = sample.pad - 1, self.values
        compliance = v[R.FORCE + i] * self.pressing(sample)
        self.s[i] = s = float((sample.s - v[R.ZERO + i] - compliance) / (1.0 + v[R.SCALE + i]))
        return float(s - self.lifts(i, opening, radius) @ self.heights(v))

    def _u(self, pad: int) -> float:
        return float(self.s[pad]) / self.pad_lengths[pad]


def circle_spread(rig: RigDescription, contacts: Sequence[float], opening: float) -> float:
    """1σ (m) that the rig's constants leave of a circle's radius r = s · tan(φ2/2), s the mean of both contacts.

    Used before a smoother has estimated their correlation with the outline.
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
