"""What is kept of an object when the palms lose it, for re-initialisation when it is put back.

A settled map (outline, ρ, friction, damping, with their covariance) outlives the contact. At the next start most of
the bank begins with it, at the orientations ψ that give the first two readings best; the rest begins blind, and the
readings decide between them.
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
    riding: what its readings have said of that.
    """

    x: FloatArray
    P: FloatArray
    touched: Marks
    mass: MassEstimator
    spread: FloatArray | None = None
    riding: FixedModeTest | None = None

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
    likelihood = orientation_likelihood(coefficients, P, contacts, palms, rig)
    chosen = []
    for _ in range(count):
        best = int(np.argmax(likelihood))
        chosen.append(_PSI[best])
        likelihood[np.arange(best - APART, best + APART + 1) % DIRECTIONS] -= 1e6
    return np.array(chosen)


def reading_rows(palms: PalmMotion, order: int = shape.HARMONICS) -> tuple[FloatArray, FloatArray]:
    """Rows that map coefficients to each pad's reading at each of `DIRECTIONS` orientations ψ, evenly from 0."""
    theta = normal_directions([np.asarray(angle) for angle in palms.angles], _PSI)
    cos, sin = math.cos(palms.angles[OPENING]), math.sin(palms.angles[OPENING])
    return _reading_rows(theta, cos, sin, order)


def _reading_rows(theta: Sequence[FloatArray], cos: Any, sin: Any, order: int) -> tuple[FloatArray, FloatArray]:
    """(3.13) and (3.14) for contacts whose normals are `theta`, on palms that open with this cosine and sine."""
    one, two = (shape.basis(each, order) for each in theta)
    before, after = (shape.tangential_basis(each, order) for each in theta)
    return (one * cos + two) / sin - before, (two * cos + one) / sin + after


def orientation_likelihood(
    coefficients: FloatArray, P: FloatArray, contacts: Sequence[float], palms: PalmMotion, rig: RigDescription
) -> FloatArray:
    """Log-likelihood (DIRECTIONS) of two readings (m) of one instant, the palms of `rig` at rest or moving.

    The outline's coefficients (m) have the covariance `P`, ψ is within `PSI_SD` of each orientation.
    """
    if rig.curved:
        predicted, rows = readings_on_arcs(palms, coefficients, rig.curvatures)
        return _likelihood(list(predicted), P, contacts, rows, rig.reading_variances)
    rows = reading_rows(palms, (len(coefficients) - 1) // 2)
    return _likelihood([each @ coefficients for each in rows], P, contacts, rows, rig.reading_variances)


def readings_on_arcs(
    palms: PalmMotion, coefficients: FloatArray, curvatures: Sequence[float]
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Each curved palm's readings of an outline (2, DIRECTIONS), and rows as of `reading_rows` for small changes."""
    order = (len(coefficients) - 1) // 2
    joints = [np.full(DIRECTIONS, angle) for angle in palms.angles]
    s = contacts_on_arcs(coefficients, joints[0], joints[1], _PSI, curvatures)
    touched = tangents(joints, s, curvatures)
    theta = normal_directions(touched, _PSI)
    bend = (1.0 - shape.harmonic_of_coefficient(order) ** 2) * coefficients
    slack = [
        np.maximum(1.0 - kappa * (shape.basis(each, order) @ bend), LEAST_CURVATURE_MARGIN)[:, None]
        for kappa, each in zip(curvatures, theta, strict=True)
    ]
    cos, sin = np.cos(touched[OPENING])[:, None], np.sin(touched[OPENING])[:, None]
    one, two = _reading_rows(theta, cos, sin, order)
    return s, (one / slack[0], two / slack[1])


def _likelihood(
    predicted: Sequence[FloatArray],
    P: FloatArray,
    contacts: Sequence[float],
    rows: tuple[FloatArray, FloatArray],
    variances: FloatArray,
) -> FloatArray:
    one, two = rows
    off, off_too = (s - each for s, each in zip(contacts, predicted, strict=True))
    slope, slope_too = _slope(off), _slope(off_too)
    S11 = ((one @ P) * one).sum(axis=1) + (slope * PSI_SD) ** 2 + variances[0]
    S22 = ((two @ P) * two).sum(axis=1) + (slope_too * PSI_SD) ** 2 + variances[1]
    S12 = ((one @ P) * two).sum(axis=1) + slope * slope_too * PSI_SD**2
    det = S11 * S22 - S12**2
    misfit = (S22 * off**2 - 2 * S12 * off * off_too + S11 * off_too**2) / det
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
