"""Memory of the last object, for re-initialisation when it is put back on the palms.

A valid map (outline, ρ, friction, damping, with their covariance) is kept after contact is lost. At the next start most
filters of the bank start from it, at the orientations ψ that best explain the first two readings; the rest start blind,
and the readings decide between them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palmd.events import FloatArray, PalmMotion
from palmd.model import shape, shape_map
from palmd.model.arcs import contacts_on_arcs
from palmd.model.touch import LEAST_CURVATURE_MARGIN
from palmd.observer.coverage import Marks
from palmd.observer.fixed_mode_test import FixedModeTest
from palmd.observer.mass import MassEstimator
from palmd.system.arcs import tangents
from palmd.system.description import RigDescription
from palmd.system.mechanism import OPENING, normal_directions

KEEP_EVERY_S = 0.5
# Factor on the variance of a map from filters that started blind, and 1σ (m) added to its outline.
INFLATION, INFLATION_SD_M = 2.0, 1e-5
DIRECTIONS = 120  # candidate orientations
EXCLUDED = 2  # candidates on either side of a chosen one that are not chosen
PSI_SD = 0.06  # rad, 1σ of a filter's initial orientation
SPIN_SD = 1.0  # rad/s, 1σ of the initial rate of an object just put down
# Gate for the squared Mahalanobis distance of the same object's outline from the map; measured: median 0.7, largest 23.
SAME_CHI2 = 25.0
SAME_CHI2_SMOOTHED = 60.0  # the same without inflation: up to some 25 directions are touched for the first time
SAME_MASS = 0.1  # largest relative difference between the mass and that from resting forces

_PSI: FloatArray = np.arange(DIRECTIONS, dtype=np.float64) * (2 * math.pi / DIRECTIONS)
_CONSTANTS, _OUTLINE = slice(shape_map.Z.LN_RHO, None), slice(shape_map.Z.SHAPE, None)


@dataclass(frozen=True, slots=True)
class KnownObject:
    """A valid state of `model.shape_map` with its covariance, the normals touched in its gauge, and the mass.

    `spread`: the uncertainty due to the rig's constants (`events.Improvement`) if a smoother confirmed the state, else
    None. flat_side_test: test whether the object may be fixed to a palm, as of its readings.
    """

    x: FloatArray
    P: FloatArray
    touched: Marks
    mass: MassEstimator
    spread: FloatArray | None = None
    flat_side_test: FixedModeTest | None = None

    @property
    def smoothed(self) -> bool:
        """Whether a smoother confirmed it."""
        return self.spread is not None

    def prior_covariance(self) -> FloatArray:
        """Covariance for a new start: of the constants, inflated unless `smoothed`; of ψ and ω0 as for any object."""
        Z = shape_map.Z
        P = np.zeros_like(self.P)
        P[_CONSTANTS, _CONSTANTS] = self.P[_CONSTANTS, _CONSTANTS]
        if not self.smoothed:
            P *= INFLATION
            P[_OUTLINE, _OUTLINE] += np.eye(len(self.x) - shape_map.Z.SHAPE) * INFLATION_SD_M**2
        P[Z.PSI, Z.PSI], P[Z.OMEGA0, Z.OMEGA0] = PSI_SD**2, SPIN_SD**2
        return P

    def orientations(self, contacts: Sequence[float], palms: PalmMotion, rig: RigDescription, count: int) -> FloatArray:
        """The `count` likeliest distinct ψ (rad), given the first readings (m) on a rig."""
        return likely_orientations(
            self.x[_OUTLINE], self.prior_covariance()[_OUTLINE, _OUTLINE], contacts, palms, rig, count
        )

    def matches_outline(self, x: FloatArray) -> bool:
        """Whether the outline of state `x`, in the same gauge, agrees with this one within its prior covariance."""
        change = x[_OUTLINE] - self.x[_OUTLINE]
        distance = change @ np.linalg.solve(self.prior_covariance()[_OUTLINE, _OUTLINE], change)
        return bool(distance < (SAME_CHI2_SMOOTHED if self.smoothed else SAME_CHI2))

    def matches_mass(self, mass: float) -> bool:
        """Whether `mass` (kg) may be this object's; True for NaN, i.e. pads without forces."""
        return not abs(mass / self.mass.value - 1.0) > SAME_MASS


def likely_orientations(
    coefficients: FloatArray,
    P: FloatArray,
    contacts: Sequence[float],
    palms: PalmMotion,
    rig: RigDescription,
    count: int,
) -> FloatArray:
    """The `count` likeliest distinct ψ (rad) of an outline; arguments as of `orientation_likelihood`."""
    likelihood = orientation_likelihood(coefficients, P, contacts, palms, rig)
    chosen = []
    for _ in range(count):
        best = int(np.argmax(likelihood))
        chosen.append(_PSI[best])
        likelihood[np.arange(best - EXCLUDED, best + EXCLUDED + 1) % DIRECTIONS] -= 1e6
    return np.array(chosen)


def reading_rows(palms: PalmMotion, order: int = shape.HARMONICS) -> tuple[FloatArray, FloatArray]:
    """Rows that map coefficients to each pad's reading at each of `DIRECTIONS` orientations ψ, evenly spaced from 0."""
    theta = normal_directions([np.asarray(angle) for angle in palms.angles], _PSI)
    cos, sin = math.cos(palms.angles[OPENING]), math.sin(palms.angles[OPENING])
    return _reading_rows(theta, cos, sin, order)


def _reading_rows(theta: Sequence[FloatArray], cos: Any, sin: Any, order: int) -> tuple[FloatArray, FloatArray]:
    """(3.13) and (3.14) for contacts with normals `theta`, for the cosine and sine of the palms' opening."""
    one, two = (shape.basis(each, order) for each in theta)
    before, after = (shape.tangential_basis(each, order) for each in theta)
    return (one * cos + two) / sin - before, (two * cos + one) / sin + after


def orientation_likelihood(
    coefficients: FloatArray, P: FloatArray, contacts: Sequence[float], palms: PalmMotion, rig: RigDescription
) -> FloatArray:
    """Log-likelihood (DIRECTIONS) of two simultaneous readings (m) for each orientation, palms at rest or moving.

    The outline's coefficients (m) have covariance `P`; ψ has 1σ `PSI_SD` about each orientation.
    """
    if rig.curved:
        predicted, rows = readings_on_arcs(palms, coefficients, rig.curvatures)
        return _likelihood(list(predicted), P, contacts, rows, rig.reading_variances)
    rows = reading_rows(palms, (len(coefficients) - 1) // 2)
    return _likelihood([each @ coefficients for each in rows], P, contacts, rows, rig.reading_variances)


def readings_on_arcs(
    palms: PalmMotion, coefficients: FloatArray, curvatures: Sequence[float]
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Readings of an outline on curved palms (2, DIRECTIONS), and rows as of `reading_rows` for small changes of it."""
    order = (len(coefficients) - 1) // 2
    joints = [np.full(DIRECTIONS, angle) for angle in palms.angles]
    s = contacts_on_arcs(coefficients, joints[0], joints[1], _PSI, curvatures)
    touched = tangents(joints, s, curvatures)
    theta = normal_directions(touched, _PSI)
    bend = (1.0 - shape.harmonic_of_coefficient(order) ** 2) * coefficients
    margin = [
        np.maximum(1.0 - kappa * (shape.basis(each, order) @ bend), LEAST_CURVATURE_MARGIN)[:, None]
        for kappa, each in zip(curvatures, theta, strict=True)
    ]
    cos, sin = np.cos(touched[OPENING])[:, None], np.sin(touched[OPENING])[:, None]
    one, two = _reading_rows(theta, cos, sin, order)
    return s, (one / margin[0], two / margin[1])


def _likelihood(
    predicted: Sequence[FloatArray],
    P: FloatArray,
    contacts: Sequence[float],
    rows: tuple[FloatArray, FloatArray],
    variances: FloatArray,
) -> FloatArray:
    one, two = rows
    innovation, innovation_too = (s - each for s, each in zip(contacts, predicted, strict=True))
    slope, slope_too = _slope(innovation), _slope(innovation_too)
    S11 = ((one @ P) * one).sum(axis=1) + (slope * PSI_SD) ** 2 + variances[0]
    S22 = ((two @ P) * two).sum(axis=1) + (slope_too * PSI_SD) ** 2 + variances[1]
    S12 = ((one @ P) * two).sum(axis=1) + slope * slope_too * PSI_SD**2
    det = S11 * S22 - S12**2
    misfit = (S22 * innovation**2 - 2 * S12 * innovation * innovation_too + S11 * innovation_too**2) / det
    likelihood: FloatArray = -0.5 * (misfit + np.log(det))
    return likelihood


def _slope(values: FloatArray) -> FloatArray:
    """d/dψ of values on the circle of `_PSI` (1/rad), by central differences."""
    slope: FloatArray = (np.roll(values, -1) - np.roll(values, 1)) * (DIRECTIONS / (4 * math.pi))
    return slope


class ObjectMemory:
    """The valid map before the last one: the last may have been stored while the object was being taken away."""

    def __init__(self) -> None:
        self._older: KnownObject | None = None
        self._newer: KnownObject | None = None
        self._t = -math.inf

    def due(self, t: float) -> bool:
        """Whether a valid map at `t` (s) has to be stored."""
        return t - self._t >= KEEP_EVERY_S

    def keep(self, t: float, known: KnownObject) -> None:
        """Store the valid map at `t` (s)."""
        self._older, self._newer, self._t = self._newer or known, known, t

    def recall(self) -> KnownObject | None:
        """The map of the last object, None if no estimate was ever valid."""
        return self._older

    def forget(self) -> None:
        """Drop the maps: the object is another one, or was not known well."""
        self._older = self._newer = None
