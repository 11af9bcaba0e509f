"""What is kept of an object when the palms lose it, for re-initialisation when it is put back.

A settled map (outline, ρ, friction, damping, with their covariance) outlives the contact. At the next start most of
the bank begins with it, at the orientations ψ that give the first two readings best; the rest begins blind, and the
readings decide between them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray, PalmMotion
from palmd.model import shape, shape_map
from palmd.model.arcs import contacts_on_arcs
from palmd.model.touch import LEAST_SLACK
from palmd.observer.coverage import Marks
from palmd.observer.mass import MassEstimator
from palmd.system.arcs import tangents
from palmd.system.description import RigDescription
from palmd.system.mechanism import OPENING, normal_directions

KEEP_EVERY_S = 0.5
# What filters have learnt from a blind start is believed with this times its variance, and m of its outline more.
INFLATION, INFLATION_SD_M = 2.0, 1e-5
DIRECTIONS = 120  # orientations looked at
APART = 2  # directions on either side of a chosen one that are not chosen
PSI_SD = 0.06  # rad, of a filter about its orientation
SPIN_SD = 1.0  # rad/s, of an object just put down
# How far the same object's outline strays from what was kept, in one-sigma squared; measured: median 0.7, most 23.
SAME_CHI2 = 25.0
SAME_CHI2_SMOOTHED = 60.0  # where nothing has been widened: up to some 25 directions that are felt for the first time
SAME_MASS = 0.1  # relative, between its mass and the one that resting forces give

_PSI: FloatArray = np.arange(DIRECTIONS, dtype=np.float64) * (2 * math.pi / DIRECTIONS)
_CONSTANTS, _OUTLINE = slice(shape_map.Z.LN_RHO, None), slice(shape_map.Z.SHAPE, None)


@dataclass(frozen=True, slots=True)
class KnownObject:
    """A settled state of `model.shape_map` with its covariance, the normals touched in its gauge, and the mass.

    Where a smoother vouches for it, `spread` is what the rig's constants leave open (`events.Improvement`).
    """

    x: FloatArray
    P: FloatArray
    touched: Marks
    mass: MassEstimator
    spread: FloatArray | None = None

    @property
    def smoothed(self) -> bool:
        """Whether a smoother vouches for it."""
        return self.spread is not None

    def believed(self) -> FloatArray:
        """The covariance of the constants, unless smoothed inflated; ψ, ω0 as of what is put down anyhow."""
        Z = shape_map.Z
        P = np.zeros_like(self.P)
        P[_CONSTANTS, _CONSTANTS] = self.P[_CONSTANTS, _CONSTANTS]
        if not self.smoothed:
            P *= INFLATION
            P[_OUTLINE, _OUTLINE] += np.eye(len(self.x) - shape_map.Z.SHAPE) * INFLATION_SD_M**2
        P[Z.PSI, Z.PSI], P[Z.OMEGA0, Z.OMEGA0] = PSI_SD**2, SPIN_SD**2
        return P

    def orientations(self, contacts: Sequence[float], palms: PalmMotion, rig: RigDescription, count: int) -> FloatArray:
        """The `count` likeliest ψ (rad) apart from each other, given the first readings (m) on a rig."""
        return likely_orientations(self.x[_OUTLINE], self.believed()[_OUTLINE, _OUTLINE], contacts, palms, rig, count)

    def resembles(self, x: FloatArray) -> bool:
        """Whether the outline of state `x`, in the same gauge, is this one within what was believed of it."""
        change = x[_OUTLINE] - self.x[_OUTLINE]
        distance = change @ np.linalg.solve(self.believed()[_OUTLINE, _OUTLINE], change)
        return bool(distance < (SAME_CHI2_SMOOTHED if self.smoothed else SAME_CHI2))

    def weighs(self, mass: float) -> bool:
        """Whether `mass` (kg) may be this object's; NaN, where the pads give no forces, may."""
        return not abs(mass / self.mass.value - 1.0) > SAME_MASS


def likely_orientations(
    coefficients: FloatArray,
    P: FloatArray,
    contacts: Sequence[float],
    palms: PalmMotion,
    rig: RigDescription,
    count: int,
) -> FloatArray:
    """The `count` likeliest ψ (rad) apart from each other of an outline; arguments as of `orientation_likelihood`."""
    if rig.curved:
        predicted, rows = readings_on_arcs(palms, coefficients, rig.curvatures)
        likelihood = _likelihood(list(predicted), P, contacts, rows, rig.reading_variances)
    else:
        rows = reading_rows(palms, (len(coefficients) - 1) // 2)
        likelihood = orientation_likelihood(coefficients, P, contacts, rows, rig.reading_variances)
    chosen = []
    for _ in range(count):
        best = int(np.argmax(likelihood))
        chosen.append(_PSI[best])
        likelihood[np.arange(best - APART, best + APART + 1) % DIRECTIONS] -= 1e6
    return np.array(chosen)


def reading_rows(palms: PalmMotion, order: int = shape.HARMONICS) -> tuple[FloatArray, FloatArray]:
    """Rows that map coefficients to each pad's reading at each of `DIRECTIONS` orientations ψ, evenly from 0."""
    theta1, theta2 = normal_directions([np.asarray(angle) for angle in palms.angles], _PSI)
    one, two = shape.basis(theta1, order), shape.basis(theta2, order)
    cos, sin = math.cos(palms.angles[OPENING]), math.sin(palms.angles[OPENING])
    rows1 = (one * cos + two) / sin - shape.tangential_basis(theta1, order)  # (3.13)
    rows2 = (two * cos + one) / sin + shape.tangential_basis(theta2, order)  # (3.14)
    return rows1, rows2


def orientation_likelihood(
    coefficients: FloatArray,
    P: FloatArray,
    contacts: Sequence[float],
    rows: tuple[FloatArray, FloatArray],
    variances: FloatArray,
) -> FloatArray:
    """Log-likelihood (DIRECTIONS) of two readings (m) of one instant, with `rows` of `reading_rows`.

    The outline's coefficients (m) have the covariance `P`, ψ is within `PSI_SD` of each orientation, the
    readings' `variances` are in m².
    """
    return _likelihood([each @ coefficients for each in rows], P, contacts, rows, variances)


def readings_on_arcs(
    palms: PalmMotion, coefficients: FloatArray, curvatures: Sequence[float]
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Each curved palm's readings of an outline (2, DIRECTIONS), and rows as of `reading_rows` for small changes."""
    order = (len(coefficients) - 1) // 2
    phi1, phi2 = (np.full(DIRECTIONS, angle) for angle in palms.angles)
    s = contacts_on_arcs(coefficients, phi1, phi2, _PSI, curvatures)
    beta1, opening = tangents((phi1, phi2), s, curvatures)
    theta = normal_directions((beta1, opening), _PSI)
    (one, two), (d1, d2) = ([each(angle, order) for angle in theta] for each in (shape.basis, shape.tangential_basis))
    bend = 1.0 - shape.harmonic_of_coefficient(order) ** 2
    slack = [
        np.maximum(1.0 - kappa * (each @ (bend * coefficients)), LEAST_SLACK)[:, None]
        for kappa, each in zip(curvatures, (one, two), strict=True)
    ]
    cos, sin = np.cos(opening)[:, None], np.sin(opening)[:, None]
    return s, (((one * cos + two) / sin - d1) / slack[0], ((two * cos + one) / sin + d2) / slack[1])


def _likelihood(
    predicted: Sequence[FloatArray],
    P: FloatArray,
    contacts: Sequence[float],
    rows: tuple[FloatArray, FloatArray],
    variances: FloatArray,
) -> FloatArray:
    rows1, rows2 = rows
    error1, error2 = (s - each for s, each in zip(contacts, predicted, strict=True))
    slope1, slope2 = _slope(error1), _slope(error2)
    S11 = ((rows1 @ P) * rows1).sum(axis=1) + (slope1 * PSI_SD) ** 2 + variances[0]
    S22 = ((rows2 @ P) * rows2).sum(axis=1) + (slope2 * PSI_SD) ** 2 + variances[1]
    S12 = ((rows1 @ P) * rows2).sum(axis=1) + slope1 * slope2 * PSI_SD**2
    det = S11 * S22 - S12**2
    misfit = (S22 * error1**2 - 2 * S12 * error1 * error2 + S11 * error2**2) / det
    likelihood: FloatArray = -0.5 * (misfit + np.log(det))
    return likelihood


def _slope(values: FloatArray) -> FloatArray:
    """d/dψ of values on the circle of `_PSI` (1/rad), by central differences."""
    slope: FloatArray = (np.roll(values, -1) - np.roll(values, 1)) * (DIRECTIONS / (4 * math.pi))
    return slope


class ObjectMemory:
    """The last settled map but one: the very last may have been taken while the object was being taken away."""

    def __init__(self) -> None:
        self._older: KnownObject | None = None
        self._newer: KnownObject | None = None
        self._t = -math.inf

    def due(self, t: float) -> bool:
        """Whether the settled map at `t` (s) is to be kept."""
        return t - self._t >= KEEP_EVERY_S

    def keep(self, t: float, known: KnownObject) -> None:
        """Keep the settled map at `t` (s)."""
        self._older, self._newer, self._t = self._newer or known, known, t

    def recall(self) -> KnownObject | None:
        """What is known of the last object, None if none ever settled."""
        return self._older

    def forget(self) -> None:
        """The last object is another one, or was not known well."""
        self._older = self._newer = None
