"""Forgetting: readings lose weight as a power of their age, so that the first ones do not bias the estimate."""

from __future__ import annotations

import numpy as np

from palmd.events import FloatArray
from palmd.observer.bank import Bank, Belief

STRENGTH, FIRST_AGE_S, EVERY_S, AT_LEAST_EVERY_S = 1.5, 0.2, 0.2, 0.5
# A mean NIS of the best filter above HIGH_NIS makes its block forget faster.
HIGH_NIS, STRENGTH_PER_NIS = 1.4, 20.0


class Forgetting:
    """Times at which the blocks of a bank last forgot, and extra age of filters that started from prior knowledge.

    `t_faded`: (blocks,) in s, inf for a block that never forgets. `prior_age_s`: (size,), 0 for a filter that started
    blind.
    """

    def __init__(self, bank: Bank):
        self.t_faded: FloatArray = np.full(bank.blocks, np.inf)
        self.prior_age_s: FloatArray = np.zeros(bank.size)

    def begin(self, t: float, everywhere: bool) -> None:
        """Forget from `t` (s) on: in all blocks, or only in those with a filter that started blind."""
        blind = self.prior_age_s.reshape(len(self.t_faded), -1).min(axis=1) == 0.0
        self.t_faded[:] = np.where(blind | everywhere, t, np.inf)  # in place: C reads this array

    def due(self, bank: Bank, t: float, age_s: float) -> int | None:
        """The block that has to forget at `t` (s), None if none has; one at a time, so that no tick pays for all."""
        block = int(self.t_faded[: bank.blocks].argmin())
        wait = t - self.t_faded[block] < min(max(EVERY_S, age_s / 10), AT_LEAST_EVERY_S)
        return None if wait else block

    def forget(self, bank: Bank, block: int, t: float, age_s: float, repeated: float, constants: Belief) -> None:
        """Let a block forget at `t` (s).

        Readings that share their error with `repeated` others discount earlier ones by as much less. `constants`: the
        prior of the filters' constants at the start.
        """
        since = t - self.t_faded[block]
        excess_nis = max(0.0, bank.nis[bank.best()] - HIGH_NIS)
        total_age = age_s + float(self.prior_age_s[bank.members(block)].min())
        fraction = STRENGTH * since / repeated / (FIRST_AGE_S + total_age) * (1.0 + STRENGTH_PER_NIS * excess_nis)
        bank.fade(block, min(fraction, 1.0), constants)
        self.t_faded[block] = t
