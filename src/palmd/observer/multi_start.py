"""Multi-start: weights of many initial conditions of the quasistatic system, by the trajectories they lead to.

The paper searches the initial conditions with the least sum of e_f and e_c (3.36, 3.37). But along a solution e_f keeps
its initial value, and e_c is zero up to noise: of the two unknown radii these determine only one combination, and leave
the mean free. The outline determines it: a normal that is touched again must be found at the same place, by either
palm. So each initial condition is weighted by e_f, by how badly one outline fits all its radii and offsets (the
conflict), and by the prior of objects.
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

MEANS, BALANCES = 24, 9  # size of the grid of initial conditions
BLOCKS = 8  # judged one per tick, so that no tick takes long
BALANCE_SD = 1e-3  # m, of e_f: effect of friction and inertia, which the model leaves out; from the emulated rig
# Error of radii and offsets about one outline: 1σ (m), and correlation time (s).
NOTED_SD, ERROR_LASTS_S = 5e-4, 0.3
# Independent readings that a conflict counts as: few, since it is caused by errors of the model, which persist.
INDEPENDENT_READINGS = 4.0
LEAST_CONFLICT = 5e-5  # m, of the right initial condition: smoothed noise of the readings
SOFTENING_M = 1e-3  # effect of the readings' noise on a rate, compared with how fast objects turn
NOTED_EVERY = 5  # steps between two points of the outline
MOST_RADIUS_M = 0.15
_K = shape.COEFFICIENTS


@dataclass(frozen=True, slots=True)
class Spread:
    """Centre and half width of the grid of initial conditions: mean radius and balance e_f (m)."""

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
        readings: qs.QuasistaticReadings,
        psi: float,
        circle: float,
        step_s: float,
        softening: float = SOFTENING_M,
    ):
        """Start all trajectories at `readings` and orientation `psi` (rad), with steps of `step_s` (s).

        circle: radius (m) of a circle with these readings, about which the prior of objects is centred. softening: as
        in `model.quasistatic.turning_rate`.
        """
        self.spread = spread
        self.mean, self.balance = spread.grid()
        radii = qs.radii_of(readings, self.mean, self.balance)
        self.state = np.stack(np.broadcast_arrays(*radii, np.full_like(self.mean, psi), *qs.offsets(readings, *radii)))
        self.steps = 0
        self._diverged = np.zeros(len(self.mean), dtype=np.bool_)
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
        self._information_vector = np.tile(self._prior_information @ self._prior_mean, (n, 1))
        self._squares = np.full(n, float(self._prior_mean @ self._prior_information @ self._prior_mean))
        self.conflict = np.full(n, math.nan)  # RMS (m) of radii and offsets about one outline, as last judged
        self._prior_distance = np.zeros(n)  # squared Mahalanobis distance of the outline from its prior
        self._weight = step_s * NOTED_EVERY / ERROR_LASTS_S / NOTED_SD**2
        self._readings = 0

    def step(self, here: qs.QuasistaticReadings, there: qs.QuasistaticReadings) -> None:
        """Integrate one step, from the readings `here` to those `there`, and add a point of the outline when due."""
        if self.steps % NOTED_EVERY == 0:
            self._add_outline_point(here)
        with np.errstate(all="ignore"):  # a trajectory that diverges is replaced below, permanently
            self.state = self._adams.step(
                self.state,
                lambda y: qs.rates(here, y, self.softening),
                lambda y: qs.rates(there, y, self.softening),
            )
            diverged = ~((self.state[:2] > 0.0) & (self.state[:2] < MOST_RADIUS_M)).all(axis=0)
            diverged |= ~np.isfinite(self.state).all(axis=0)
        self._diverged |= diverged
        self.state[:, diverged] = self._placeholder
        self.steps += 1

    def judge(self) -> None:
        """Update the conflict of the next of `BLOCKS` blocks of initial conditions."""
        n = len(self.mean) // BLOCKS
        block = slice(self._block * n, (self._block + 1) * n)
        fit = np.linalg.solve(self._information[block], self._information_vector[block][..., None])[..., 0]
        deviation = fit - self._prior_mean
        self._prior_distance[block] = ((deviation @ self._prior_information) * deviation).sum(axis=1)
        misfit = (
            self._squares[block] - (self._information_vector[block] * fit).sum(axis=1) - self._prior_distance[block]
        )
        self.conflict[block] = np.sqrt(np.maximum(misfit, 0.0) / (self._weight * self._readings))
        self._block = (self._block + 1) % BLOCKS
        self.judgements += 1

    @property
    def judged(self) -> bool:
        """Whether every initial condition has been judged."""
        return self.judgements >= BLOCKS

    def weights(self) -> FloatArray:
        """Probability of each initial condition, (n,), summing to 1; NaN when all have diverged. Only once `judged`."""
        conflict = np.where(self._diverged, np.inf, np.maximum(self.conflict, LEAST_CONFLICT))
        least = conflict.min()
        if not math.isfinite(least):
            return np.full(len(conflict), math.nan)
        cost = INDEPENDENT_READINGS * (conflict / least) ** 2 + self._prior_distance + (self.balance / BALANCE_SD) ** 2
        weights = np.exp(-0.5 * (cost - cost.min()))
        return np.asarray(weights / weights.sum())

    def outline(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Coefficients (m) and covariance (m²) of the outline of initial condition `number`."""
        covariance = np.linalg.inv(self._information[number])
        return covariance @ self._information_vector[number], covariance

    def _add_outline_point(self, readings: qs.QuasistaticReadings) -> None:
        *radii, psi = self.state[:3]
        theta = np.stack(normal_directions([np.asarray(angle) for angle in readings.joints], psi), axis=1)
        d = np.stack(qs.offsets(readings, *radii), axis=1)
        of_radii = shape.basis(theta.ravel())
        rows = np.concatenate([each.reshape(-1, 2, _K) for each in (of_radii, -shape.slope_of(of_radii))], axis=1)
        values = np.concatenate([np.stack(radii, axis=1), d], axis=1)
        transposed = rows.transpose(0, 2, 1)
        self._information += self._weight * (transposed @ rows)
        self._information_vector += self._weight * (transposed @ values[..., None])[..., 0]
        self._squares += self._weight * (values**2).sum(axis=1)
        self._readings += values.shape[1]
