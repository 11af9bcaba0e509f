"""The outline of an object with corners by all readings of all rides, each at its place on it. Pure, offline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.observer.cornered import discs, seats
from palmd.observer.damped import minimised
from palmd.observer.lying import SEAT, SHARED, RideReadings
from palmd.observer.places import Places, Seat, believed
from palmd.observer.record import IntArray

ROUNDS = 3  # in which is looked for what rocks
STEP_M = 1e-7


@dataclass(frozen=True, slots=True)
class Shared:
    """What is believed of the numbers that all rides share (`lying.SHARED`), and its one-sigmas."""

    mean: FloatArray
    sd: FloatArray


@dataclass(frozen=True, slots=True)
class CorneredFit:
    """The outline p, the shared numbers, where each ride has its place, and how it is explained."""

    places: Places
    lyings: tuple[RideReadings, ...]
    residuals: tuple[FloatArray, ...]
    p: FloatArray
    shared: FloatArray
    covariance: FloatArray
    settled: bool

    @property
    def chi2(self) -> float:
        """Of each reading."""
        return float(np.mean(np.concatenate(self.residuals) ** 2))

    @property
    def sides(self) -> IntArray:
        """Of each ride, on which it lies."""
        sides: IntArray = self.places.sides[self.places.used == 1]
        return sides

    @property
    def corners(self) -> IntArray:
        """Of each ride, which is opposite."""
        corners: IntArray = self.places.corners[self.places.used == 1]
        return corners

    def seat(self, which: int) -> FloatArray:
        """Y, ρ, a, H (m) of a ride."""
        side, corner = (each[[which]] for each in (self.sides, self.corners))
        seat: FloatArray = seats(self.p, side, corner, [self.lyings[which].ride.palm])[0]
        return seat


class _AllRides:
    """What is to be least squared."""

    def __init__(self, lyings: Sequence[RideReadings], places: Places, shared: Shared):
        used = np.flatnonzero(places.used)
        self.lyings, self._shared = lyings, shared
        self.sides, self.corners = places.sides[used], places.corners[used]
        self._palms = [each.ride.palm for each in lyings]
        self._own = len(places.p)
        centres, radii = discs(places.p)
        self._reach, self._radius = float(np.abs(centres).mean()), float(np.median(radii))
        self._gauge = float(np.angle(centres[0]))

    def seats(self, p: FloatArray) -> FloatArray:
        return seats(p[: self._own], self.sides, self.corners, self._palms)

    def at(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals, of what is believed last, and their derivatives."""
        there, own = self.seats(p), np.eye(len(p))[: self._own]
        moved = np.stack([(self.seats(p + STEP_M * unit) - there) / STEP_M for unit in own], axis=2)
        misses, rows = list[FloatArray](), list[FloatArray]()
        for seat, by, lying in zip(there, moved, self.lyings, strict=True):
            slopes = lying.slopes(seat, p[self._own :])
            misses.append(lying.residuals(seat, p[self._own :]))
            rows.append(np.concatenate([slopes[:, :SEAT] @ by, slopes[:, SEAT:]], axis=1))
        believed = self._believed(p)
        steps = STEP_M * np.eye(len(p))
        misses.append(believed)
        rows.append(np.stack([(self._believed(p + step) - believed) / STEP_M for step in steps], axis=1))
        return np.concatenate(misses), np.concatenate(rows)

    def _believed(self, p: FloatArray) -> FloatArray:
        shared = (p[self._own :] - self._shared.mean) / self._shared.sd
        return np.concatenate([believed(p[: self._own], self._reach, self._radius, self._gauge), shared])


def fitted(found: Sequence[Seat], whole: Sequence[RideReadings], places: Places, shared: Shared) -> CorneredFit | None:
    """By all readings of the rides that have a place, where they lie still; None where nothing is told.

    whole: the readings of each, rocking and all.
    """
    used = np.flatnonzero(places.used).tolist()
    lyings, p = [found[i].lying for i in used], np.concatenate([places.p, shared.mean])
    try:
        for _ in range(ROUNDS):
            problem = _AllRides(lyings, places.of(used), shared)
            p = minimised(problem.at, p).p
            lyings = [
                whole[i].only(whole[i].still(seat, p[-SHARED:])) for i, seat in zip(used, problem.seats(p), strict=True)
            ]
            used = [i for i, each in zip(used, lyings, strict=True) if each.enough]
            lyings = [each for each in lyings if each.enough]
            if not used:
                return None
        problem = _AllRides(lyings, places.of(used), shared)
        least = minimised(problem.at, p)
        covariance = np.asarray(np.linalg.inv(least.information), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    told = least.p[-SHARED:]
    residuals = tuple(each.residuals(seat, told) for each, seat in zip(lyings, problem.seats(least.p), strict=True))
    return CorneredFit(
        places.of(used), tuple(lyings), residuals, least.p[:-SHARED], told, covariance, least.settled
    )  # fmt: skip
