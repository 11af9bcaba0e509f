"""A hand that swings the palms all over their range, while the arm is in manual mode. Pure."""

from __future__ import annotations

import math

from palmd.config.two_palms import LimitsConfig
from palmd.events import Joints

_MOST_PHI12_DEG = 170.0
_LEAST_OPENING_DEG = 5.0  # that is left to palm 2's swing where palm 1 is steepest
_PERIODS_S = (6.1, 4.3)
_SETTING_IN_S = 3.0


class Hand:
    """From where the palms stand at t = 0 it sets in smoothly; two sines, whose periods have no common multiple."""

    def __init__(self, limits: LimitsConfig, home: Joints) -> None:
        """`home` is where it begins (rad)."""
        self._home = home
        (low, high), self._opening_deg = limits.angles_deg
        self._first_deg = (low, min(high, _MOST_PHI12_DEG - self._opening_deg[0] - _LEAST_OPENING_DEG))

    def at(self, t: float) -> Joints:
        """The joint angles (rad) at t (s) since it began."""
        u = min(t / _SETTING_IN_S, 1.0)
        share = u * u * (3.0 - 2.0 * u)
        swing1, swing2 = (0.5 - 0.5 * math.cos(math.tau * t / period) for period in _PERIODS_S)
        first_deg = _between(self._first_deg, swing1)
        low, high = self._opening_deg
        swung_deg = (first_deg, _between((low, min(high, _MOST_PHI12_DEG - first_deg)), swing2))
        return tuple(
            _between((home, math.radians(deg)), share) for home, deg in zip(self._home, swung_deg, strict=True)
        )


def _between(ends: tuple[float, float], share: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * share
