"""A hand that swings the palms over their whole range while the arm is in manual mode. Pure."""

from __future__ import annotations

import math

from palmd.config.two_palms import LimitsConfig
from palmd.events import Joints

_MAX_PHI12_DEG = 170.0
_MIN_SWING_DEG = 5.0  # palm 2's range where palm 1 is steepest
_PERIODS_S = (6.1, 4.3)
_FADE_IN_S = 3.0


class Hand:
    """Two sines with incommensurable periods, faded in smoothly from the palms' pose at t = 0."""

    def __init__(self, limits: LimitsConfig, home: Joints) -> None:
        """`home`: initial joint angles (rad)."""
        self._home = home
        (low, high), self._opening_deg = limits.angles_deg
        self._first_deg = (low, min(high, _MAX_PHI12_DEG - self._opening_deg[0] - _MIN_SWING_DEG))

    def at(self, t: float) -> Joints:
        """The joint angles (rad) at t (s) after the start."""
        u = min(t / _FADE_IN_S, 1.0)
        fraction = u * u * (3.0 - 2.0 * u)
        swing1, swing2 = (0.5 - 0.5 * math.cos(math.tau * t / period) for period in _PERIODS_S)
        first_deg = _interpolated(self._first_deg, swing1)
        low, high = self._opening_deg
        swung_deg = (first_deg, _interpolated((low, min(high, _MAX_PHI12_DEG - first_deg)), swing2))
        return tuple(
            _interpolated((home, math.radians(deg)), fraction) for home, deg in zip(self._home, swung_deg, strict=True)
        )


def _interpolated(ends: tuple[float, float], fraction: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * fraction
