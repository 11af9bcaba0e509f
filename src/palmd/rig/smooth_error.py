"""An emulated pad's smooth error of place, drawn as `observer.pad_map` believes it to be. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

STEPS = 12  # of the grid in a correlation length (derivation: linear interpolation is then off by 1/1000 of the error)


@dataclass(frozen=True, slots=True)
class SmoothError:
    """What a pad reads more (m) at so many even places from the hinge to its end (m); none: nothing anywhere."""

    values: tuple[float, ...] = ()
    length: float = 0.0

    def at(self, s: float) -> float:
        """At the distance `s` (m) from the hinge; beyond the pad's ends as there."""
        if not self.values:
            return 0.0
        step = self.length / (len(self.values) - 1)
        return float(np.interp(s / step, np.arange(len(self.values)), self.values))


NO_ERROR = SmoothError()


def drawn_error(sd: float, correlation: float, length: float, random: np.random.Generator) -> SmoothError:
    """A Gaussian process over a pad of this `length`, of a squared-exponential `correlation` length and one-sigma `sd`.

    All in m. Without its constant and linear part, which are the pad's zero and scale.
    """
    if sd == 0.0:
        return NO_ERROR
    places = np.linspace(0.0, length, 1 + max(2, int(np.ceil(STEPS * length / correlation))))
    alike = np.exp(-0.5 * np.subtract.outer(places, places) ** 2 / correlation**2)
    powers, shapes = np.linalg.eigh(alike)
    found = sd * shapes @ (np.sqrt(np.maximum(powers, 0.0)) * random.standard_normal(len(places)))
    linear, _ = np.linalg.qr(np.stack([np.ones_like(places), places], axis=1))
    return SmoothError(tuple((found - linear @ (linear.T @ found)).tolist()), length)
