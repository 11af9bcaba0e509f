"""The fourth-order Adams–Bashforth–Moulton predictor–corrector, with which CMU-CS-01-107 integrates (section 3.3)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from palmd.events import FloatArray

# Weights, newest derivative first; the early steps, which have no past yet, use what there is.
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
    """Integrates any array on even steps `h` (s): predict, evaluate, correct, evaluate. Safe inside the loop."""

    def __init__(self, h: float):
        """`h` is the step (s)."""
        self._h = h
        self._past: list[FloatArray] = []  # derivatives, newest first

    def step(self, y: FloatArray, here: Derivative, there: Derivative) -> FloatArray:
        """y one step on; `here` and `there` give dy/dt at its beginning and its end."""
        self._past = [here(y), *self._past[: len(_BASHFORTH) - 1]]
        order = len(self._past)
        predicted = y + self._h * _weighted(_BASHFORTH[order - 1], self._past)
        weights = _MOULTON[min(order, len(_MOULTON)) - 1]
        return y + self._h * _weighted(weights, [there(predicted), *self._past])


def _weighted(weights: tuple[float, ...], values: list[FloatArray]) -> FloatArray:
    total = np.zeros_like(values[0])
    for weight, value in zip(weights, values, strict=False):
        total += weight * value
    return total
