"""An equation of the paper beside what palmd derives for it, to be compared at a point.

Both sides are CasADi expressions; symbols are told apart by their names alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from palmd.events import FloatArray
from palmd.model.symbolic import SX


@dataclass(frozen=True, slots=True)
class EquationCheck:
    """What the paper prints for an equation, and what follows from the model; same shape, SI."""

    equation: str
    printed: SX
    derived: SX

    def names(self) -> list[str]:
        """Of all symbols that either side depends on."""
        return sorted({symbol.name() for symbol in self._symbols()})

    def values(self, point: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
        """(printed, derived), row by row, where the symbols have the values of `point`; KeyError when one has none."""
        symbols = self._symbols()
        function = ca.Function("claim", symbols, [ca.densify(self.printed), ca.densify(self.derived)])
        printed, derived = function.call([point[symbol.name()] for symbol in symbols])
        return np.asarray(printed).ravel(), np.asarray(derived).ravel()

    def _symbols(self) -> list[SX]:
        symbols: list[SX] = ca.symvar(ca.veccat(self.printed, self.derived))
        return symbols
