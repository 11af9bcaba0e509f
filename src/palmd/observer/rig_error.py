"""Errors of the rig's constants, as estimated by a smoother; readings are corrected before a filter takes them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palmd.events import FloatArray, PadSample
from palmd.model.smoothing import RIG_CONSTANTS, R
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
        one, two = (
            4.0 * self.values[R.SAGITTA + i] / length * (1.0 - 2.0 * (float(self.s[i]) / length))
            for i, length in enumerate(self.pad_lengths)
        )
        return float(self.values[R.TILT] + one), float(self.values[R.TURN] + (-one - two))

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
