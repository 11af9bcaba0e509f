"""Detection of swapped pads from the pressures: statics fixes how the weight moves between the palms. Pure."""

from __future__ import annotations

import math

from palmd.events import PadSample, PalmMotion
from palmd.system.mechanism import PALMS, directions

MEMORY_S = 8.0
ENOUGH_S = 3.0  # of readings from both pads before a verdict
SPREAD_LEAST = 0.1  # standard deviation of the expected log ratio; below it the palms have not moved enough
SLOPE_SWAPPED, SLOPE_RIGHT = -0.3, 0.3
FRESH_S = 0.05


class SwapWatch:
    """Regresses the measured ln(F1/F2) on the ratio of static contact forces, ln(sin φ12 / sin φ1).

    Gains of the pads shift the former by a constant; the object's shape and motion disturb it little; neither changes
    its sign. The slope is about +1 for correct pads and −1 for swapped ones.
    """

    def __init__(self) -> None:
        self.swapped = False
        self._force: dict[int, tuple[float, float]] = {}
        self._t = -math.inf
        self._weight = self._x = self._y = self._xy = self._yy = 0.0

    def feed(self, sample: PadSample) -> None:
        """Add a reading; readings without a force are ignored. Safe in the loop."""
        if sample.force is not None and sample.force > 0.0:
            self._force[sample.pad] = (sample.t_sample, sample.force)

    def look(self, t: float, palms: PalmMotion | None) -> None:
        """Update the verdict at `t` (s); call once a tick."""
        dt, self._t = t - self._t, t
        if palms is None or not 0.0 < dt < 1.0 or len(self._force) < len(PALMS):
            return
        times, (one, two) = zip(*(self._force[pad] for pad in PALMS), strict=True)
        first, second = directions(palms.angles)
        if t - min(times) > FRESH_S or not (0.0 < first < math.pi and 0.0 < second < math.pi):
            return
        x, y = math.log(one / two), math.log(math.sin(second) / math.sin(first))
        # exponentially weighted means and products, normalised so that the number of ticks does not matter
        fading = math.exp(-dt / MEMORY_S)
        self._weight = self._weight * fading + dt
        gain = dt / self._weight
        dx, dy = x - self._x, y - self._y
        self._x += gain * dx
        self._y += gain * dy
        self._xy += gain * ((1.0 - gain) * dx * dy - self._xy)
        self._yy += gain * ((1.0 - gain) * dy * dy - self._yy)
        if self._weight < ENOUGH_S or self._yy < SPREAD_LEAST**2:
            return
        slope = self._xy / self._yy
        if slope < SLOPE_SWAPPED:
            self.swapped = True
        elif slope > SLOPE_RIGHT:
            self.swapped = False
