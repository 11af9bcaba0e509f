"""Robust least squares in a few unknowns by damped Gauss–Newton steps. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray

ITERATIONS = 40
GATE = 4.0  # σ, beyond which a residual's cost grows linearly
# relative fall of the cost at which the iteration ends; damping at which it gives up
SMALL_FALL, MOST_DAMPING = 1e-6, 1e9


@dataclass(frozen=True, slots=True)
class Minimum:
    """A minimum: p, half the cost's second derivatives there, and whether the last step gained nothing."""

    p: FloatArray
    information: FloatArray
    settled: bool


def minimise(at: Callable[[FloatArray], tuple[FloatArray, FloatArray]], p: FloatArray) -> Minimum:
    """Minimise the cost from p on.

    at(p): residuals, normalised by their 1σ, and their derivatives. The cost of a residual is quadratic within `GATE`,
    linear beyond.
    """
    misses, rows = at(p)
    cost, damping = _cost(misses), 1e-3
    settled = False
    for _ in range(ITERATIONS):
        weight = 1.0 / np.sqrt(1.0 + (misses / GATE) ** 2)
        information = rows.T @ (weight[:, None] * rows)
        damped = information + damping * np.diag(np.diagonal(information))
        step = -np.linalg.solve(damped, rows.T @ (weight * misses))
        new_misses, new_rows = at(p + step)
        new_cost = _cost(new_misses)
        if new_cost < cost:
            settled = cost - new_cost < SMALL_FALL * cost
            p, misses, rows, cost, damping = p + step, new_misses, new_rows, new_cost, damping / 5.0
            if settled:
                break
        else:
            damping *= 8.0
            if damping > MOST_DAMPING:
                break
    weight = 1.0 / np.sqrt(1.0 + (misses / GATE) ** 2)
    return Minimum(p, rows.T @ (weight[:, None] * rows), settled)


def _cost(misses: FloatArray) -> float:
    return float(2.0 * GATE**2 * (np.sqrt(1.0 + (misses / GATE) ** 2) - 1.0).sum())
