"""On which side, with which corner opposite, an object with corners lay in each of many rides. Pure, offline.

Each ride by itself tells four numbers (`observer.lying`): how high the centre of mass is over the side, and where the
corner is from both. They are those of one outline, if each ride is given its place on it. Places are sought in order of
time: a ride that follows on the same palm at once is on the same side, any other one on any that is near; what explains
the rides so far best is kept, some in parallel. How many corners there are is sought in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.observer.cornered import beyond, discs, regular, seats, side_normals
from palmd.observer.damped import minimised
from palmd.observer.lying import SEAT, RideReadings
from palmd.observer.outline import wrapped
from palmd.observer.record import IntArray
from palmd.observer.rides import Ride

MOST_ROCKS = 3  # times that what rocks is looked for
HEIGHT, HEIGHT_SD_M, AWAY_SD_M = 0.9, 8e-3, 15e-3  # of one ride: H in mean radii, and what it and a are off by at first
FORM_SD_M = (3e-5, 5e-5, 1.5e-4, 1e-4)  # that Y, ρ, a, H of one ride may be off by besides their noise
CORNERS = (6, 5, 7, 4, 8, 3)  # how many there may be, the likeliest first
STAYS_S = 0.1  # from a ride to the next one on the same side: to tip takes longer
BEAM = 24  # how many are kept
SKIPPED = 40.0  # the price of a ride that is left out, of twice the log-likelihood
MOST_SKIPPED = 0.2  # of the rides' time
MOST_PASSED = 3  # sides between the one that it lies on and the corner opposite
HOPELESS = 100.0  # of it, that a rival may lack
NEAR_M, CLEAR_M = 3e-3, 6e-4  # of Y − ρ: at most where the corner may end the side, at least where it may not
REACH = 0.25  # of the mean radius: one-sigma of the corners' distance
SPREAD_RAD, RADIUS_SD_M, BEYOND_RAD = 0.35, 1e-3, 0.04  # of corners' angles; of radii; of normals that leave a corner
LEAST_TURN_RAD, TURN_SD_RAD = 0.15, 0.05  # between sides
GAUGE_RAD = 1e-4
SAME_TURN_RAD, SAME_CORNER_M = 0.02, 5e-4  # of a side, of a corner, at the same place in two outlines
ITERATIONS, STEP_M, MOST_STEP_M = 6, 1e-7, 6e-3


@dataclass(frozen=True, slots=True)
class Seat:
    """What one ride tells: Y, ρ, a, H (m), a root of its information (SEAT, SEAT), and the readings it is told by."""

    value: FloatArray
    root: FloatArray
    lying: RideReadings

    @property
    def ride(self) -> Ride:
        """Which."""
        return self.lying.ride


def seat_of(lying: RideReadings, shared: FloatArray, shared_sd: FloatArray) -> Seat | None:
    """By the readings of one ride, where it lay still; None where there are too few.

    shared, shared_sd: what is believed of the numbers that all rides share.
    """
    high, radius = lying.ride.corner
    mean = math.exp(shared[0])
    p = np.concatenate([[high, radius, 0.0, HEIGHT * mean], shared])
    believed, sd = p[2:].copy(), np.concatenate([[AWAY_SD_M, HEIGHT_SD_M], shared_sd])
    kept = lying
    for _ in range(MOST_ROCKS):
        if not kept.enough:
            return None

        def at(p: FloatArray, kept: RideReadings = kept) -> tuple[FloatArray, FloatArray]:
            rows = np.concatenate([kept.slopes(p[:SEAT], p[SEAT:]), np.diag(1.0 / sd) @ np.eye(len(p))[2:]])
            return np.concatenate([kept.residuals(p[:SEAT], p[SEAT:]), (p[2:] - believed) / sd]), rows

        found = minimised(at, p)
        p = found.p
        still = lying.still(p[:SEAT], p[SEAT:])
        if still.sum() == len(kept.t):
            break
        kept = lying.only(still)
    if not len(kept.t):
        return None
    try:
        covariance = np.linalg.inv(found.information)[:SEAT, :SEAT] + np.diag(FORM_SD_M) ** 2
        return Seat(p[:SEAT], np.linalg.inv(np.linalg.cholesky(covariance)), kept)
    except np.linalg.LinAlgError:
        return None


@dataclass(frozen=True, slots=True)
class Places:
    """Of each seat its side, its corner, and whether it is used; the outline p.

    cost: twice the negative log-likelihood up to a constant.
    """

    p: FloatArray
    sides: IntArray
    corners: IntArray
    used: IntArray
    cost: float

    @property
    def count(self) -> int:
        """How many corners the outline has."""
        return len(self.p) // 3

    def of(self, used: Sequence[int]) -> Places:
        """The same of these seats alone."""
        return replace(self, used=np.isin(np.arange(len(self.used)), used).astype(np.intp))

    @property
    def labels(self) -> tuple[IntArray, ...]:
        """All that is said of each seat."""
        return self.sides, self.corners, self.used


def believed(p: FloatArray, reach: float, radius: float, gauge: float) -> FloatArray:
    """What outlines p (..., 3n) miss what is likely by, in one-sigmas (..., 4n + 1).

    Corners so far from the centre of mass, and of such a radius (m), about evenly round it, sides that turn one way.
    The first corner is at the angle `gauge` (rad), for certain.
    """
    (centres, radii), normals = discs(p), side_normals(p)
    evenly = math.tau / centres.shape[-1]
    away = wrapped(np.angle(np.roll(centres, -1, axis=-1) / centres) - evenly) / SPREAD_RAD
    hollow = np.minimum(wrapped(np.roll(normals, -1, axis=-1) - normals) - LEAST_TURN_RAD, 0.0) / TURN_SD_RAD
    far = (np.abs(centres) / reach - 1.0) / REACH
    first = np.angle(centres[..., :1] * np.exp(-1j * gauge)) / GAUGE_RAD
    return np.concatenate([away, far, (radii - radius) / RADIUS_SD_M, hollow, first], axis=-1)


def placed(found: Sequence[Seat], doubt: float) -> list[Places]:
    """The likeliest places of seats in order of time, on an outline of any `CORNERS`, best first.

    With all rivals that were found which cost less than `doubt` more.
    """
    rivals = list[Places]()
    for count in CORNERS:
        least = min((each.cost for each in rivals), default=math.inf)
        rivals += PlaceSearch(found, count).best(least + doubt)
    rivals.sort(key=lambda each: each.cost)
    return [each for each in rivals if each.cost < rivals[0].cost + doubt]


def anchor_of(rivals: Sequence[Places], weights: FloatArray | IntArray) -> int | None:
    """The seat of most weight, of those that all rivals use, by whose side their frames are laid on one another."""
    shared = weights * np.min([each.used for each in rivals], axis=0)
    return int(np.argmax(shared)) if shared.any() else None


def certain(rivals: Sequence[Places], lasts: FloatArray) -> IntArray:
    """Which seats, that last so long (s), all rivals have at the same place of the same outline as the first."""
    best = rivals[0]
    on = np.bincount(best.sides, weights=lasts * best.used, minlength=best.count)
    anchor = anchor_of(rivals, lasts * (best.sides == np.argmax(on)))  # a side on which the object lies longest
    if anchor is None:
        return np.zeros_like(best.used)
    used, places = best.used.copy(), list[tuple[FloatArray, IntArray, FloatArray]]()
    for each in rivals:
        normals, (centres, _) = side_normals(each.p), discs(each.p)
        frame = normals[each.sides[anchor]]
        corners = centres[each.corners] * np.exp(-1j * frame)
        places.append((normals[each.sides] - frame, each.used, np.stack([corners.real, corners.imag], axis=1)))
    for normals, there, corners in places[1:]:
        turned = np.abs(wrapped(normals - places[0][0])) > SAME_TURN_RAD
        moved = np.linalg.norm(corners - places[0][2], axis=1) > SAME_CORNER_M
        used[(there == 1) & (turned | moved)] = 0
    return used


class PlaceSearch:
    """Seats in order of time, and an outline of so many corners."""

    def __init__(self, found: Sequence[Seat], count: int):
        self._seats, self.count = found, count
        self._value, self._root = np.array([each.value for each in found]), np.array([each.root for each in found])
        self._lasts = np.array([each.ride.lasts for each in found])
        self._palm = np.array([each.ride.palm for each in found])
        self._openings = np.array([each.lying.openings for each in found])
        height, self._radius = float(np.median(self._value[:, 3])), max(float(np.median(self._value[:, 1])), 0.0)
        self._begin = regular(count, height, self._radius)
        self._reach = float(np.abs(discs(self._begin)[0][0]))

    def best(self, most: float) -> list[Places]:
        """The likeliest places, best first; none where even the best costs more than `most`."""
        none = np.zeros(0, dtype=np.intp)
        kept = [Places(self._begin, none, none, none, 0.0)]
        for i in range(len(self._seats)):
            options = [(each, place) for each in kept for place in self._options(each, i)]
            if not options:
                return []
            p = np.array([each.p for each, _ in options])
            labels = np.array(
                [
                    [np.append(before, new) for before, new in zip(each.labels, place, strict=True)]
                    for each, place in options
                ],
                dtype=np.intp,
            )
            p, cost = self._fitted(p, labels)
            first = np.argsort(cost, kind="stable")[: 2 * BEAM]
            labels = labels[first]
            p, cost = self._fitted(p[first], labels)
            last = [k for k in np.argsort(cost, kind="stable")[:BEAM] if cost[k] < cost.min() + HOPELESS]
            kept = [Places(p[k], labels[k, 0], labels[k, 1], labels[k, 2], float(cost[k])) for k in last]
            if kept[0].cost > most:
                return []
        return kept

    def _options(self, before: Places, i: int) -> Iterator[tuple[int, int, int]]:
        """Side, corner and whether it is used, of the next seat; anywhere after one that is not."""
        ride, (high, radius) = self._seats[i].ride, self._value[i, :2]
        near = high - radius < CLEAR_M
        reach = range(0 if high - radius < NEAR_M else 1, 1 if near else min(MOST_PASSED, self.count - 2) + 1)
        known = np.flatnonzero(before.used)
        for side in range(self.count if len(known) else 1):
            for by in reach:
                corner = (side + (-by, 1 + by)[ride.palm]) % self.count
                if not len(known) or known[-1] < i - 1 or self._leads(before, ride, side, corner):
                    yield side, corner, 1
        left_out = self._lasts[:i][before.used == 0].sum() + self._lasts[i]
        if left_out < MOST_SKIPPED * self._lasts.sum():
            yield 0, 0, 0

    def _leads(self, before: Places, ride: Ride, side: int, corner: int) -> bool:
        """Whether the object comes there from the last place by one tip, or by none.

        From one palm to the other the corner of either place ends the side of the other; on one palm it tips on by a
        side, or not at all.
        """
        last, own, opposite = self._seats[len(before.sides) - 1].ride, int(before.sides[-1]), int(before.corners[-1])
        if ride.palm != last.palm:
            return opposite in self._ends(side) and corner in self._ends(own)
        by = (side - own) % self.count
        stays = ride.start - last.end < STAYS_S
        return by == 0 or (not stays and by in (1, self.count - 1) and corner == opposite)

    def _ends(self, side: int) -> tuple[int, int]:
        return side, (side + 1) % self.count

    def _fitted(self, p: FloatArray, labels: IntArray) -> tuple[FloatArray, FloatArray]:
        """Outlines (B, 3n) of labels (B, 3, r) iterated, and costs (B,): damped Gauss–Newton, all side by side."""
        sides, corners, used = np.moveaxis(labels, 1, 0)
        damping, misses = np.full(len(p), 1e-3), self._misses(p, sides, corners, used)
        cost, own = (misses**2).sum(axis=1), np.arange(p.shape[1])
        for _ in range(ITERATIONS):
            rows = np.stack(
                [
                    (self._misses(p + STEP_M * unit, sides, corners, used) - misses) / STEP_M
                    for unit in np.eye(len(own))
                ],
                axis=2,
            )
            matrix, side = np.swapaxes(rows, 1, 2) @ rows, (misses[:, None, :] @ rows)[:, 0]
            matrix[:, own, own] *= 1.0 + damping[:, None]
            matrix[:, own, own] += 1.0
            step = np.clip(-np.linalg.solve(matrix, side[:, :, None])[:, :, 0], -MOST_STEP_M, MOST_STEP_M)
            there = self._misses(p + step, sides, corners, used)
            new = (there**2).sum(axis=1)
            good = new < cost
            p, misses = np.where(good[:, None], p + step, p), np.where(good[:, None], there, misses)
            cost, damping = np.where(good, new, cost), np.where(good, damping / 5.0, damping * 8.0)
        return p, cost + SKIPPED * (1 - used).sum(axis=1)

    def _misses(self, p: FloatArray, sides: IntArray, corners: IntArray, used: IntArray) -> FloatArray:
        """In one-sigmas (B, …): of the seats' numbers, of normals that are not the corner's, of what is believed."""
        count = sides.shape[1]
        palm, openings = self._palm[:count], self._openings[:count]
        told = self._value[:count] - seats(p, sides, corners, palm)
        told = (self._root[:count] @ told[..., None])[..., 0] * used[..., None]
        out = beyond(p, sides, corners, palm, openings) / BEYOND_RAD * used[..., None]
        parts = told, out, believed(p, self._reach, self._radius, 0.0)
        return np.concatenate([each.reshape(len(p), -1) for each in parts], axis=1)
