"""Stored outlines as beliefs about a shape map, and likely poses on the palms.

The file's h becomes Fourier coefficients, its 1σ their covariance. What the file does not contain (friction, vibration,
damping, spin) has the prior of any object. The frame is that of the file: ψ is absolute.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray, PalmMotion
from palmd.model import shape, shape_map
from palmd.observer import prior
from palmd.observer.object_memory import (
    DIRECTIONS,
    EXCLUDED,
    PSI_SD,
    SAME_CHI2,
    SPIN_SD,
    orientation_likelihood,
)
from palmd.outlinefile import Outline
from palmd.system.description import RigDescription
from palmd.system.vibration import INDEPENDENT

LEAST_SD = 5e-6  # m, of each coefficient: no file is better than that
LEAST_RHO_SD = 5e-3  # relative
# An object that slides and one that sticks move too differently for one filter: each pose starts with either.
FRICTIONS = ((0.0, 0.02), (0.12, 0.08))  # mean and one-sigma
MOST_STARTS = DIRECTIONS // (EXCLUDED + 1) * len(FRICTIONS)  # of one outline
DEVIATION = (
    0.1  # how far another object deviates at least, of what is believed of any: more, and small ones go unnoticed
)
DEVIATION_OF_RADIUS = 3e-3  # relative
_OUTLINE = slice(shape_map.Z.SHAPE, None)


@dataclass(frozen=True, slots=True)
class Starts:
    """Initial filters: number of each one's object, mean states (count, 21), covariances (count, 21, 21), ψ (rad)."""

    which: npt.NDArray[np.intp]
    x: FloatArray
    P: FloatArray
    psi: FloatArray


@dataclass(frozen=True, slots=True)
class OutlinePrior:
    """Outlines as beliefs: mean states x (count, 21) of `model.shape_map` at ψ = 0, covariances P (count, 21, 21)."""

    names: tuple[str, ...]
    x: FloatArray
    P: FloatArray
    information: FloatArray  # of the coefficients alone (count, 15, 15): the inverse of their part of P

    def contradicts(self, which: npt.NDArray[np.intp], x: FloatArray) -> npt.NDArray[np.bool_]:
        """Whether the outline of each state `x` (size, 21) contradicts the belief about object `which` (size)."""
        change = x[:, _OUTLINE] - self.x[which, _OUTLINE]
        distance = np.einsum("fi,fij,fj->f", change, self.information[which], change)
        contradicts: npt.NDArray[np.bool_] = distance > SAME_CHI2
        return contradicts

    def starts(self, contacts: Sequence[float], palms: PalmMotion, rig: RigDescription, count: int) -> Starts:
        """The likeliest poses, each with both kinds of friction; at most `count` filters in all.

        contacts: the first readings (m) on the palms of `rig`. Poses of one object are distinct. Takes some
        milliseconds for twenty objects, once after an object has been put down.
        """
        which, psi = self._poses(contacts, palms, rig, count // len(FRICTIONS))
        mu, mu_sd = np.repeat(FRICTIONS, len(which), axis=0).T
        which, psi = np.tile(which, len(FRICTIONS)), np.tile(psi, len(FRICTIONS))
        x, P, Z = self.x[which], self.P[which], shape_map.Z
        x[:, Z.MU], P[:, Z.MU, Z.MU] = mu, mu_sd**2
        return Starts(which, x, P, psi)

    def _poses(
        self, contacts: Sequence[float], palms: PalmMotion, rig: RigDescription, count: int
    ) -> tuple[npt.NDArray[np.intp], FloatArray]:
        likelihood = np.stack(
            [
                orientation_likelihood(x[_OUTLINE], P[_OUTLINE, _OUTLINE], contacts, palms, rig)
                for x, P in zip(self.x, self.P, strict=True)
            ]
        )
        poses: list[tuple[int, int]] = []
        while len(poses) < count and likelihood.max() > -math.inf:
            which, direction = divmod(int(np.argmax(likelihood)), DIRECTIONS)
            poses.append((which, direction))
            likelihood[which, np.arange(direction - EXCLUDED, direction + EXCLUDED + 1) % DIRECTIONS] = -math.inf
        chosen = np.array(poses, dtype=np.intp)
        psi: FloatArray = chosen[:, 1].astype(np.float64) * (2 * math.pi / DIRECTIONS)
        return chosen[:, 0], psi


def stored(outlines: Sequence[Outline]) -> OutlinePrior:
    """The outlines as beliefs; raises ValueError when there is none."""
    if not outlines:
        raise ValueError("no outline")
    x, P = zip(*map(_belief, outlines), strict=True)
    information = np.linalg.inv(np.stack(P)[:, _OUTLINE, _OUTLINE])
    return OutlinePrior(tuple(outline.name for outline in outlines), np.stack(x), np.stack(P), information)


def _belief(outline: Outline) -> tuple[FloatArray, FloatArray]:
    Z = shape_map.Z
    x, P = np.zeros(shape_map.N), np.zeros((shape_map.N, shape_map.N))
    x[Z.LN_RHO], x[Z.MU] = math.log(outline.rho), prior.FRICTION
    ln_dither, ln_dither_sd = prior.ln_dither_of(INDEPENDENT)
    x[Z.LN_DITHER], x[Z.DAMPING] = ln_dither, prior.DAMPING
    x[_OUTLINE] = shape.coefficients_of(outline.h)
    P[Z.PSI, Z.PSI], P[Z.OMEGA0, Z.OMEGA0] = PSI_SD**2, SPIN_SD**2
    P[Z.LN_RHO, Z.LN_RHO] = max(outline.rho_sd / outline.rho, LEAST_RHO_SD) ** 2
    P[Z.MU, Z.MU], P[Z.LN_DITHER, Z.LN_DITHER] = prior.FRICTION_SD**2, ln_dither_sd**2
    P[Z.DAMPING, Z.DAMPING] = prior.DAMPING_SD**2
    P[_OUTLINE, _OUTLINE] = outline_covariance(outline)
    return x, P


def outline_covariance(outline: Outline) -> FloatArray:
    """Covariance (15, 15) in m² of the coefficients of h, from its 1σ on 360 normals.

    The error is modelled as h_sd(θ)·z(θ), z smooth of unit variance: white in the coefficients that the map has. The
    part of h beyond harmonic `HARMONICS` counts as an error of h, too.
    """
    rows = shape.basis(np.arange(len(outline.h), dtype=np.float64) * (2 * math.pi / len(outline.h)))
    left_out = outline.h - rows @ shape.coefficients_of(outline.h)
    sd = np.sqrt(outline.h_sd**2 + np.mean(left_out**2))
    spread = np.column_stack([shape.coefficients_of(sd * row) for row in rows.T])
    cov: FloatArray = spread @ spread.T / (shape.HARMONICS + 1) + LEAST_SD**2 * np.eye(shape.COEFFICIENTS)
    return cov


def deviation_variance(mean_radius: float) -> FloatArray:
    """Variance by which each state of another object of the same sort may differ (21), SI; `mean_radius` in m."""
    variance = np.zeros(shape_map.N)
    variance[_OUTLINE] = (DEVIATION * shape.prior_sd(mean_radius)) ** 2
    variance[shape_map.Z.SHAPE] = (DEVIATION_OF_RADIUS * mean_radius) ** 2
    return variance
