"""Published fields as a report writes them: symbol, unit, scale. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Quantity:
    """A published field as it is drawn: how it is written, in which unit, and how many of these are one SI unit."""

    name: str
    symbol: str
    unit: str
    factor: float = 1.0

    @property
    def label(self) -> str:
        """Symbol and unit."""
        return f"{self.symbol} ({self.unit})" if self.unit else self.symbol


_QUANTITIES = (
    Quantity("r1_m", "r₁", "mm", 1e3), Quantity("r2_m", "r₂", "mm", 1e3),
    Quantity("omega0_rad_s", "ω₀", "rad/s"), Quantity("psi_rad", "ψ", "rad"),
    Quantity("s1_m", "s₁", "mm", 1e3), Quantity("s2_m", "s₂", "mm", 1e3),
    Quantity("phi1_rad", "φ₁", "°", math.degrees(1)), Quantity("phi2_rad", "φ₂", "°", math.degrees(1)),
    Quantity("omega1_rad_s", "ω₁", "rad/s"), Quantity("omega2_rad_s", "ω₂", "rad/s"),
    Quantity("rho_m", "ρ", "mm", 1e3), Quantity("mu", "μ", ""),
    Quantity("f1_n", "f₁", "N"), Quantity("f2_n", "f₂", "N"), Quantity("mass_kg", "mass", "g", 1e3),
)  # fmt: skip
QUANTITIES = {quantity.name: quantity for quantity in _QUANTITIES}
