"""A marble that a hand rolls over one pad and lifts now and then. Pure."""

from __future__ import annotations

import math

import numpy as np

from palmd.rig.pads import WIDTH_M, Press

_RIM_M = 1.5e-3  # distance that the marble keeps from the rim
_SHARES = (0.65, 0.35)
_ROLL_HZ = ((0.25, 0.40), (0.50, 0.80))  # at most 110 mm/s on a pad of 55.5 mm
_PRESS_HZ = ((0.20, 0.30), (0.35, 0.50))
_MEAN_N, _SWING_N = 0.8, 1.2  # at most 2 N; the marble is lifted where the sum is negative


class _Sway:
    """A slow random curve within −1…1, the sum of two sines."""

    def __init__(self, bands_hz: tuple[tuple[float, float], ...], rng: np.random.Generator) -> None:
        self._waves = [
            (share, math.tau * float(rng.uniform(*band_hz)), float(rng.uniform(0.0, math.tau)))
            for share, band_hz in zip(_SHARES, bands_hz, strict=True)
        ]

    def at(self, t: float) -> float:
        return sum(share * math.sin(rate * t + phase) for share, rate, phase in self._waves)


class Marble:
    """Rolls along a smooth random curve over most of the pad, pressed with a smoothly varying force of up to 2 N."""

    def __init__(self, length_m: float, rng: np.random.Generator) -> None:
        """`length_m`: the pad's active length. The generator's state determines the curve."""
        self._middle = 0.5 * length_m
        self._along, self._across, self._force = (_Sway(bands, rng) for bands in (_ROLL_HZ, _ROLL_HZ, _PRESS_HZ))

    def presses(self, t: float) -> list[Press]:
        """The marble's press on the pad at t (s); empty while it is lifted."""
        force = _MEAN_N + _SWING_N * self._force.at(t)
        if force <= 0.0:
            return []
        s = self._middle + (self._middle - _RIM_M) * self._along.at(t)
        return [Press(s, force, (0.5 * WIDTH_M - _RIM_M) * self._across.at(t))]
