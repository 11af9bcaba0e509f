"""Multi-start: which initial conditions of the quasistatic system are right, by what each of many leads to.

The paper searches the initial conditions with the least sum of e_f and e_c (3.36, 3.37). But along a solution e_f keeps
its first value, and e_c is zero up to noise: of the two unknown radii these two tell only one, and leave the mean free.
What tells it is the outline: a normal that is touched again must be found where it was, by either palm. So each is
judged by e_f, by how badly one outline fits all its radii and offsets (the conflict), and by what is believed of
objects beforehand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model import quasistatic as qs
from palmd.model import shape
from palmd.model.adams import AdamsBashforthMoulton
from palmd.observer.prior import RADIUS_SD
from palmd.system.mechanism import normal_directions

MEANS, BALANCES = 24, 9  # of the grid of initial conditions
BLOCKS = 8  # judged one at a time, so that no tick pays for all
BALANCE_SD = 1e-3  # m, of e_f: what friction and inertia make of a model without them, from the emulated rig
# How sharply one outline is asked for, against what is believed of it: m, and s for which an error keeps its sign.
NOTED_SD, ERROR_LASTS_S = 5e-4, 0.3
# How many independent readings a conflict is worth: few, since what causes it is the model, all along.
WORTH = 4.0
LEAST_CONFLICT = 5e-5  # m, of a right initial condition: the readings' noise, smoothed
SOFTENING_M = 1e-3  # what the readings' noise makes of a rate, against how fast objects turn
NOTED_EVERY = 5  # steps
MOST_RADIUS_M = 0.15
_K = shape.COEFFICIENTS


@dataclass(frozen=True, slots=True)
class Spread:
    """What a set of initial conditions is drawn over: mean radius and balance e_f, about a centre (m)."""

    mean: float
    mean_width: float
    balance: float
    balance_width: float

    def grid(self) -> tuple[FloatArray, FloatArray]:
        """Mean radius and balance of each initial condition, evenly over centre ± width: (MEANS · BALANCES,) both."""
        means = self.mean + np.linspace(-self.mean_width, self.mean_width, MEANS)
        balances = self.balance + np.linspace(-self.balance_width, self.balance_width, BALANCES)
        a, b = np.meshgrid(means, balances, indexing="ij")
        return a.ravel(), b.ravel()


class MultiStart:
    """Trajectories from a grid of initial conditions. Every call takes bounded time and is safe inside the loop."""

    def __init__(
        self,
        spread: Spread,
        felt: qs.QuasistaticReadings,
        psi: float,
        circle: float,
        step_s: float,
        softening: float = SOFTENING_M,
    ):
        """All begin at what is `felt` first, at orientation `psi` (rad), and go on in steps of `step_s` (s).

        `circle` is the radius (m) that a circle would have, about which objects are believed to lie; `softening` as in
        `model.quasistatic.turning_rate`.
        """
        self.spread = spread
        self.mean, self.balance = spread.grid()
        radii = qs.radii_of(felt, self.mean, self.balance)
        self.state = np.stack(np.broadcast_arrays(*radii, np.full_like(self.mean, psi), *qs.offsets(felt, *radii)))
        self.steps = 0
        self._away = np.zeros(len(self.mean), dtype=np.bool_)
        self._placeholder = np.array([[circle], [circle], [psi], [0.0], [0.0]])
        self.softening = softening
        self._adams = AdamsBashforthMoulton(step_s)
        self.judgements = 0
        self._block = 0
        prior_sd = shape.prior_sd(circle)
        prior_sd[0] = RADIUS_SD * circle
        self._prior_information = np.diag(1 / prior_sd**2)
        self._prior_mean = np.zeros(_K)
        self._prior_mean[0] = circle
        n = len(self.mean)
        self._information = np.tile(self._prior_information, (n, 1, 1))
        self._told = np.tile(self._prior_information @ self._prior_mean, (n, 1))
        self._squares = np.full(n, float(self._prior_mean @ self._prior_information @ self._prior_mean))
        self.conflict = np.full(n, math.nan)  # RMS (m) of radii and offsets about one outline, when last judged
        self._unlikely = np.zeros(n)  # the outline, in one-sigmas squared
        self._weight = step_s * NOTED_EVERY / ERROR_LASTS_S / NOTED_SD**2
        self._readings = 0

    def step(self, here: qs.QuasistaticReadings, there: qs.QuasistaticReadings) -> None:
        """Integrate one step, from what is felt `here` to what is felt `there`, and take note of the outline."""
        if self.steps % NOTED_EVERY == 0:
            self._note(here)
        with np.errstate(all="ignore"):  # an initial condition that runs away is put back below, for good
            self.state = self._adams.step(
                self.state,
                lambda y: qs.rates(here, y, self.softening),
                lambda y: qs.rates(there, y, self.softening),
            )
            away = ~((self.state[:2] > 0.0) & (self.state[:2] < MOST_RADIUS_M)).all(axis=0)
            away |= ~np.isfinite(self.state).all(axis=0)
        self._away |= away
        self.state[:, away] = self._placeholder
        self.steps += 1

    def judge(self) -> None:
        """Renew the conflict of the next of `BLOCKS` blocks of initial conditions."""
        n = len(self.mean) // BLOCKS
        block = slice(self._block * n, (self._block + 1) * n)
        fit = np.linalg.solve(self._information[block], self._told[block][..., None])[..., 0]
        off = fit - self._prior_mean
        self._unlikely[block] = ((off @ self._prior_information) * off).sum(axis=1)
        misfit = self._squares[block] - (self._told[block] * fit).sum(axis=1) - self._unlikely[block]
        self.conflict[block] = np.sqrt(np.maximum(misfit, 0.0) / (self._weight * self._readings))
        self._block = (self._block + 1) % BLOCKS
        self.judgements += 1

    @property
    def judged(self) -> bool:
        """Whether every start has been judged."""
        return self.judgements >= BLOCKS

    def weights(self) -> FloatArray:
        """How likely each initial condition is, (n,), summing to 1; NaN when all have run away. Only once `judged`."""
        conflict = np.where(self._away, np.inf, np.maximum(self.conflict, LEAST_CONFLICT))
        least = conflict.min()
        if not math.isfinite(least):
            return np.full(len(conflict), math.nan)
        cost = WORTH * (conflict / least) ** 2 + self._unlikely + (self.balance / BALANCE_SD) ** 2
        weights = np.exp(-0.5 * (cost - cost.min()))
        return np.asarray(weights / weights.sum())

    def outline(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Coefficients (m) and covariance (m²) of the outline of initial condition `number`."""
        covariance = np.linalg.inv(self._information[number])
        return covariance @ self._told[number], covariance

    def _note(self, felt: qs.QuasistaticReadings) -> None:
        *radii, psi = self.state[:3]
        theta = np.stack(normal_directions([np.asarray(angle) for angle in felt.joints], psi), axis=1)
        d = np.stack(qs.offsets(felt, *radii), axis=1)
        of_radii = shape.basis(theta.ravel())
        rows = np.concatenate([each.reshape(-1, 2, _K) for each in (of_radii, -shape.slope_of(of_radii))], axis=1)
        values = np.concatenate([np.stack(radii, axis=1), d], axis=1)
        turned = rows.transpose(0, 2, 1)
        self._information += self._weight * (turned @ rows)
        self._told += self._weight * (turned @ values[..., None])[..., 0]
        self._squares += self._weight * (values**2).sum(axis=1)
        self._readings += values.shape[1]
