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


CLIPPED_S = 1.0
"""So long after a saturated reading forces are not weighed: those below full scale are a biased choice of all."""


class MassEstimator:
    """Weighted least squares of F = m f over all readings of all pads; safe inside the loop.

    Saturated readings do not enter, and no mass is told from the first of them until `CLIPPED_S` after the last.
    """

    def __init__(self, pads: Sequence[PadSensor]):
        """How well each palm's pad tells forces."""
        self._pads = tuple(pads)
        self._gain_variance = sum(pad.force_gain_std**2 for pad in pads) / len(pads) ** 2  # of the mean of all pads
        self._information = 0.0  # 1/kg²
        self._weighted = 0.0
        self._t_sample: dict[int, float] = {}  # of each pad's last reading weighed
        self._t, self._t_clipped = -math.inf, -math.inf

    def weigh(self, sample: PadSample | None, f: float) -> None:
        """Take a pad's last reading, once, against the model's `f` (m/s²) of the same moment."""
        if sample is None or self._t_sample.get(sample.pad) == sample.t_sample:
            return
        self._t_sample[sample.pad] = sample.t_sample
        self._t = max(self._t, sample.t_sample)
        if sample.at_least is not None:
            self._t_clipped = max(self._t_clipped, sample.t_sample)
        if sample.force is None or self.clipped:
            return
        self.feed(sample.pad, sample.force, f)

    def feed(self, pad: int, force: float, f: float) -> None:
        """Take one reading of `pad`: `force` in N against the model's `f` in m/s²; f ≤ 0 tells nothing."""
        if f <= 0:
            return
        # the noise grows with the true force, so it is the model's, not the reading's, that must weigh
        expected = (self._weighted / self._information if self._information else force / f) * f
        variance = float(self._pads[pad - 1].force_variance(expected))
        self._information += f * f / variance
        self._weighted += f * force / variance

    @property
    def clipped(self) -> bool:
        """Whether readings are, or were a moment ago, beyond a pad's full scale."""
        return self._t - self._t_clipped < CLIPPED_S

    @property
    def value(self) -> float:
        """Mass in kg, NaN before the first reading and while readings are saturated."""
        return self._weighted / self._information if self._information and not self.clipped else math.nan

    @property
    def sd(self) -> float:
        """One-sigma of the mass in kg, NaN where that is."""
        if not self._information or self.clipped:
            return math.nan
        return math.sqrt(1.0 / self._information + self._gain_variance * self.value**2)
