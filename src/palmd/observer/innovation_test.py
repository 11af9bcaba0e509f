"""Inflation of published standard deviations while a filter fails the innovation test; its covariance does not grow."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.observer.forgetting import HIGH_NIS
from palmd.observer.validity import LOST_NIS

# From simulated runs with fault injection: systematic errors as large as the noise shift a state, which is a mean of
# many readings, by several of its standard deviations, and it takes about DECAY_S (s) to recover.
SIGMAS_PER_NIS, DECAY_S = 8.0, 1.5


@dataclass(slots=True)
class InnovationTest:
    """Peak excess of the mean NIS over `HIGH_NIS`, decaying with `DECAY_S`: `excess`, as of `t` (s)."""

    excess: float = 0.0
    t: float = -math.inf

    def take(self, nis: float, t: float) -> None:
        """Take the leading filter's running mean NIS at `t` (s), which must not be before the last one."""
        decayed = self.excess * math.exp((self.t - t) / DECAY_S)
        self.excess, self.t = max(decayed, min(nis, LOST_NIS) - HIGH_NIS), t

    @property
    def factor(self) -> float:
        """Factor for published standard deviations: 1 + SIGMAS_PER_NIS · excess; 1 for readings as predicted."""
        return 1.0 + SIGMAS_PER_NIS * self.excess
