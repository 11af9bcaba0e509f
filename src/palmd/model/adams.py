"""Fourth-order Adams–Bashforth–Moulton predictor–corrector, the integrator of CMU-CS-01-107 (section 3.3)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from palmd.events import FloatArray

# Weights, newest derivative first; the first steps use lower orders until there are enough past derivatives.
_BASHFORTH = (
    (1.0,),
    (3 / 2, -1 / 2),
    (23 / 12, -16 / 12, 5 / 12),
    (55 / 24, -59 / 24, 37 / 24, -9 / 24),
)
_MOULTON = (
    (1 / 2, 1 / 2),
    (5 / 12, 8 / 12, -1 / 12),
    (9 / 24, 19 / 24, -5 / 24, 1 / 24),
)

Derivative = Callable[[FloatArray], FloatArray]


class AdamsBashforthMoulton:
    """Integrates an array with a fixed step (predict, evaluate, correct, evaluate). Safe inside the loop."""

    def __init__(self, h: float):
        """`h`: step (s)."""
        self._h = h
        self._past: list[FloatArray] = []  # derivatives, newest first

    def step(self, y: FloatArray, start_derivative: Derivative, end_derivative: Derivative) -> FloatArray:
        """Return y after one step; the callables give dy/dt at the start and at the end of the step."""
        self._past = [start_derivative(y), *self._past[: len(_BASHFORTH) - 1]]
        order = len(self._past)
        predicted = y + self._h * _weighted(_BASHFORTH[order - 1], self._past)
        weights = _MOULTON[min(order, len(_MOULTON)) - 1]
        return y + self._h * _weighted(weights, [end_derivative(predicted), *self._past])


def _weighted(weights: tuple[float, ...], values: list[FloatArray]) -> FloatArray:
    total = np.zeros_like(values[0])
    for weight, value in zip(weights, values, strict=False):
        total += weight * value
    return total
