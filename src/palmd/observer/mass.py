"""The object's mass from the pads' pressures, once the model knows the forces per unit mass."""

from __future__ import annotations

import math


class MassEstimator:
    """Weighted least squares of F = m f over all readings of both pads; safe inside the loop."""

    def __init__(self, force_scale_std: float, force_resolution: float):
        """`force_scale_std` is relative, `force_resolution` in N; both describe one reading."""
        self._scale_std = force_scale_std
        self._rounding_variance = force_resolution**2 / 12
        self._information = 0.0  # 1/kg²
        self._weighted = 0.0

    def feed(self, force: float, f: float) -> None:
        """Take one reading: `force` in N against the model's `f` in m/s²; f ≤ 0 tells nothing."""
        if f <= 0:
            return
        # the noise grows with the true force, so it is the model's, not the reading's, that must weigh
        expected = (self.value if self._information else force / f) * f
        variance = (self._scale_std * expected) ** 2 + self._rounding_variance
        self._information += f * f / variance
        self._weighted += f * force / variance

    @property
    def value(self) -> float:
        """Mass in kg, NaN before the first reading."""
        return self._weighted / self._information if self._information else math.nan

    @property
    def sd(self) -> float:
        """One-sigma of the mass in kg, NaN before the first reading."""
        return 1.0 / math.sqrt(self._information) if self._information else math.nan
