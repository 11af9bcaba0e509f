"""The linearised least-squares problem of one record: defects of the equations of motion, residuals of the readings.

Between nodes the equations of motion are collocated at both ends and midway (Hermite–Simpson, fourth order, stable
for any stiffness of the friction); their defects are noise of given spectral density. `compiled_equations` computes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.observer.three_palms.arrow import Arrow
from palmd.observer.three_palms.motion_noise import BY_SPIN, SPIN, TURN
from palmd.observer.three_palms.record import BodyRecord


@dataclass(frozen=True, slots=True)
class Noise:
    """1σ of a reading (m), and spectral densities of the process noise as in `motion_noise`."""

    reading: float
    spin: float = SPIN
    by_spin: float = BY_SPIN
    turn: float = TURN


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


def at_readings(record: BodyRecord, R: FloatArray, omega: FloatArray) -> FloatArray:
    """(S, 3, 3) rotations at the readings' times, interpolated between nodes R, omega (K + 1, …)."""
    return _between(record, R, omega, *_turns(R, omega))


def _turns(R: FloatArray, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(K, 3) rotation vectors from each node to the next, and their rates at the interval's end."""
    phi = rotation.log(R[1:] @ np.swapaxes(R[:-1], 1, 2))
    return phi, omega[1:] - 0.5 * np.cross(phi, omega[1:])


def _between(record: BodyRecord, R: FloatArray, omega: FloatArray, phi: FloatArray, ending: FloatArray) -> FloatArray:
    k, (there, out, back) = record.interval, (each[:, None] for each in _hermite(record.share))
    turned = there * phi[k] + record.spacing * (out * omega[:-1][k] + back * ending[k])
    return rotation.exp(turned) @ R[:-1][k]


def _hermite(share: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Hermite weights of the end value, the initial rate and the end rate of a cubic that begins at 0."""
    return 3 * share**2 - 2 * share**3, share - 2 * share**2 + share**3, share**3 - share**2
