"""The object's mass from the pads' pressures, once the model knows the forces per unit mass."""

from __future__ import annotations

import math
from collections.abc import Sequence

from palmd.events import FloatArray, PadSample
from palmd.system.description import PadSensor
from palmd.system.mechanism import OPENING


def resting_forces(gravity: float, palms: Sequence[float] | FloatArray) -> tuple[float, float]:
    """g sin φ12 / sin φ2 and g sin φ1 / sin φ2 (m/s²): the forces on any object at rest without friction.

    `palms` begins with the joint angles (rad), on curved palms those of the tangents
    (`system.arcs`). In motion and with friction right to several percent. Safe in the loop.
    """
    first, opening = float(palms[0]), float(palms[OPENING])
    return gravity * math.sin(first + opening) / math.sin(opening), gravity * math.sin(first) / math.sin(opening)


class MassEstimator:
    """Weighted least squares of F = m f over all readings of all pads; safe inside the loop."""

    def __init__(self, pads: Sequence[PadSensor]):
        """How well each palm's pad tells forces."""
        self._pads = tuple(pads)
        self._gain_variance = sum(pad.force_gain_std**2 for pad in pads) / len(pads) ** 2  # of the mean of all pads
        self._information = 0.0  # 1/kg²
        self._weighted = 0.0
        self._t_sample: dict[int, float] = {}  # of each pad's last reading weighed

    def weigh(self, sample: PadSample | None, f: float) -> None:
        """Take a pad's last reading, once, against the model's `f` (m/s²) of the same moment."""
        if sample is None or sample.force is None or self._t_sample.get(sample.pad) == sample.t_sample:
            return
        self._t_sample[sample.pad] = sample.t_sample
        self.feed(sample.pad, sample.force, f)

    def feed(self, pad: int, force: float, f: float) -> None:
        """Take one reading of `pad`: `force` in N against the model's `f` in m/s²; f ≤ 0 tells nothing."""
        if f <= 0:
            return
        # the noise grows with the true force, so it is the model's, not the reading's, that must weigh
        expected = (self.value if self._information else force / f) * f
        variance = float(self._pads[pad - 1].force_variance(expected))
        self._information += f * f / variance
        self._weighted += f * force / variance

    @property
    def value(self) -> float:
        """Mass in kg, NaN before the first reading."""
        return self._weighted / self._information if self._information else math.nan

    @property
    def sd(self) -> float:
        """One-sigma of the mass in kg, NaN before the first reading."""
        if not self._information:
            return math.nan
        return math.sqrt(1.0 / self._information + self._gain_variance * self.value**2)
