"""What readings that a filter did not foresee say of its one-sigmas: these do not know of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.observer.forgetting import SURPRISING_NIS
from palmd.observer.validity import LOST_NIS

# Over simulated runs with mischief: readings that are off by as much as their noise pull a state, which is the mean of
# many, off by several of its one-sigmas, and it takes about as long to come back.
SIGMAS_PER_NIS, LASTS_S = 8.0, 1.5


@dataclass(slots=True)
class InnovationTest:
    """By how much the mean NIS was above `SURPRISING_NIS`, the worst of late fading away: `excess`, as of `t` (s)."""

    excess: float = 0.0
    t: float = -math.inf

    def take(self, nis: float, t: float) -> None:
        """The leading filter's running mean of the normalised innovation squared at `t` (s), never before the last."""
        left = self.excess * math.exp((self.t - t) / LASTS_S)
        self.excess, self.t = max(left, min(nis, LOST_NIS) - SURPRISING_NIS), t

    @property
    def factor(self) -> float:
        """What to multiply published one-sigmas with: 1 + SIGMAS_PER_NIS · excess, 1 of what was foreseen."""
        return 1.0 + SIGMAS_PER_NIS * self.excess
