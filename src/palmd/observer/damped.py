"""Least squares of a few numbers by damped Gauss–Newton steps. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray

GATE = 4.0  # sigmas, from which on a residual counts as its size does
ENOUGH, MOST_DAMPING = 1e-6, 1e9


@dataclass(frozen=True, slots=True)
class Least:
    """Where the cost is least, half its second derivatives there, and whether the last step gained nothing."""

    p: FloatArray
    information: FloatArray
    settled: bool


def minimised(at: Callable[[FloatArray], tuple[FloatArray, FloatArray]], p: FloatArray, iterations: int = 40) -> Least:
    """From p on. at(p): residuals in one-sigmas, and their derivatives by p; far ones count by their size alone."""
    misses, rows = at(p)
    cost, damping = _cost(misses), 1e-3
    settled = False
    for _ in range(iterations):
        weight = 1.0 / np.sqrt(1.0 + (misses / GATE) ** 2)
        information = rows.T @ (weight[:, None] * rows)
        damped = information + damping * np.diag(np.diagonal(information))
        step = -np.linalg.solve(damped, rows.T @ (weight * misses))
        there, there_rows = at(p + step)
        new = _cost(there)
        if new < cost:
            settled = cost - new < ENOUGH * cost
            p, misses, rows, cost, damping = p + step, there, there_rows, new, damping / 5.0
            if settled:
                break
        else:
            damping *= 8.0
            if damping > MOST_DAMPING:
                break
    weight = 1.0 / np.sqrt(1.0 + (misses / GATE) ** 2)
    return Least(p, rows.T @ (weight[:, None] * rows), settled)


def _cost(misses: FloatArray) -> float:
    return float(2.0 * GATE**2 * (np.sqrt(1.0 + (misses / GATE) ** 2) - 1.0).sum())
