"""An emulated pad's smooth position error, drawn from the prior of `observer.pad_map`. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

STEPS_PER_LENGTH = (
    12  # grid steps per correlation length (derivation: linear interpolation errs by 1/1000 of the error)
)


@dataclass(frozen=True, slots=True)
class SmoothError:
    """Position error (m) at evenly spaced places from the hinge to the pad's end; zero everywhere if empty."""

    values: tuple[float, ...] = ()
    length: float = 0.0

    def at(self, s: float) -> float:
        """The error (m) at distance `s` (m) from the hinge; constant beyond the pad's ends."""
        if not self.values:
            return 0.0
        step = self.length / (len(self.values) - 1)
        return float(np.interp(s / step, np.arange(len(self.values)), self.values))


NO_ERROR = SmoothError()


def drawn_error(sd: float, correlation: float, length: float, rng: np.random.Generator) -> SmoothError:
    """Draw a Gaussian process with standard deviation `sd` and squared-exponential `correlation` length on a pad (m).

    Its constant and linear parts are removed: these are the pad's zero and scale.
    """
    if sd == 0.0:
        return NO_ERROR
    s = np.linspace(0.0, length, 1 + max(2, int(np.ceil(STEPS_PER_LENGTH * length / correlation))))
    covariance = np.exp(-0.5 * np.subtract.outer(s, s) ** 2 / correlation**2)
    eigenvalues, eigenvectors = np.linalg.eigh(covariance)
    drawn = sd * eigenvectors @ (np.sqrt(np.maximum(eigenvalues, 0.0)) * rng.standard_normal(len(s)))
    trend, _ = np.linalg.qr(np.stack([np.ones_like(s), s], axis=1))
    return SmoothError(tuple((drawn - trend @ (trend.T @ drawn)).tolist()), length)
