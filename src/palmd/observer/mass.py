"""The object's mass from the pads' forces and the model's forces per unit mass."""

from __future__ import annotations

import math
from collections.abc import Sequence

from palmd.events import FloatArray, PadSample
from palmd.system.description import PadSensor
from palmd.system.mechanism import OPENING


def resting_forces(gravity: float, palms: Sequence[float] | FloatArray) -> tuple[float, float]:
    """Forces per unit mass on any object at rest without friction: g sin φ12 / sin φ2 and g sin φ1 / sin φ2 (m/s²).

    `palms` begins with the joint angles (rad), for curved palms those of the tangents (`system.arcs`). In motion and
    with friction accurate to several percent. Safe inside the loop.
    """
    first, opening = float(palms[0]), float(palms[OPENING])
    return gravity * math.sin(first + opening) / math.sin(opening), gravity * math.sin(first) / math.sin(opening)


CLIPPED_S = 1.0
"""Time (s) after a saturated reading in which forces are not used: those below full scale are a biased selection."""


class MassEstimator:
    """Weighted least squares of F = m f over all readings of all pads; safe inside the loop.

    Saturated readings are not used, and there is no mass from the first of them until `CLIPPED_S` after the last.
    """

    def __init__(self, pads: Sequence[PadSensor]):
        """`pads`: the force noise of each palm's pad."""
        self._pads = tuple(pads)
        self._gain_variance = sum(pad.force_gain_std**2 for pad in pads) / len(pads) ** 2  # of the mean of all pads
        self._information = 0.0  # 1/kg²
        self._weighted = 0.0
        self._t_sample: dict[int, float] = {}  # time of each pad's last reading used
        self._t, self._t_clipped = -math.inf, -math.inf

    def weigh(self, sample: PadSample | None, f: float) -> None:
        """Take a pad's last reading, once, with the model's `f` (m/s²) at the same time."""
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
        """Take one reading of `pad`: `force` in N with the model's `f` in m/s²; f ≤ 0 is ignored."""
        if f <= 0:
            return
        # the noise grows with the true force, so the weight must come from the model's force, not from the reading
        expected = (self._weighted / self._information if self._information else force / f) * f
        variance = float(self._pads[pad - 1].force_variance(expected))
        self._information += f * f / variance
        self._weighted += f * force / variance

    @property
    def clipped(self) -> bool:
        """Whether a reading was saturated within the last `CLIPPED_S`."""
        return self._t - self._t_clipped < CLIPPED_S

    @property
    def value(self) -> float:
        """Mass in kg, NaN before the first reading and while readings are saturated."""
        return self._weighted / self._information if self._information and not self.clipped else math.nan

    @property
    def sd(self) -> float:
        """1σ of the mass in kg, NaN if `value` is."""
        if not self._information or self.clipped:
            return math.nan
        return math.sqrt(1.0 / self._information + self._gain_variance * self.value**2)
