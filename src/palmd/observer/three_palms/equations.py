"""The linearised least-squares problem of one record: defects of the equations of motion, residuals of the readings.

Between nodes the equations of motion are collocated at both ends and midway (Hermite–Simpson, fourth order, stable
for any stiffness of the friction); their defects are noise of given spectral density. `compiled_equations` computes it.
"""

from __future__ import annotations

from dataclasses import dataclass

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.observer.three_palms.arrow import Arrow
from palmd.observer.three_palms.body import SPIN_NOISE, SPIN_NOISE_BY_SPIN, TURN_NOISE


@dataclass(frozen=True, slots=True)
class Noise:
    """1σ of a reading (m), and spectral densities of the process noise as in `body`."""

    reading: float
    spin: float = SPIN_NOISE
    by_spin: float = SPIN_NOISE_BY_SPIN
    turn: float = TURN_NOISE


@dataclass(frozen=True, slots=True)
class BodyMotion:
    """Rotations R (K + 1, 3, 3) and spins omega (K + 1, 3), and the parameters p (m,)."""

    R: FloatArray
    omega: FloatArray
    p: FloatArray

    def moved(self, nodes: FloatArray, step: FloatArray) -> BodyMotion:
        """Apply a step (K + 1, 6) of the nodes and (m,) of the parameters."""
        return BodyMotion(rotation.exp(nodes[:, :3]) @ self.R, self.omega + nodes[:, 3:], self.p + step)


@dataclass(frozen=True, slots=True)
class SumOfSquares:
    """Normal equations, sum of squares and residuals of the readings (S, 2) (m) at one motion.

    force: (K + 1, 3) the palms' normal forces per unit mass (m/s²) at the nodes.
    """

    arrow: Arrow
    squares: float
    residual: FloatArray
    force: FloatArray
