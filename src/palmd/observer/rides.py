"""Parts of a record in which an object lies on a palm with a flat side, and rides: read off the readings alone. Pure.

As in `observer.riding` the other palm then feels a corner whose centre stays as high over the ridden palm (Y) as over
the other (ρ), and reads s = (Y + ρ cos φ2) / sin φ2: two numbers, by least squares. Where Y and ρ come again, so do
side and corner. Not for use inside the loop: a second of readings takes some 10 ms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.record import IntArray, Record
from palmd.system.mechanism import OPENING, PALMS

LEAST_S, LEAST_READINGS = 0.5, 10  # of a ride
SIGMAS, SLACK = 3.5, 0.02  # of χ², beyond which a ride has ended, and a share of it for what is no noise
ROLLS_SIGMAS = 10.0  # of χ², beyond which readings contradict a ride for certain
EVERY = 4  # of a pad's readings, from which on a ride is looked for
SAME_M, SAME = 2e-5, 16.0  # what Y and ρ of the same ride differ by besides their noise, and its squared distance
CORNER_M = 5e-3  # of ρ, at most, of a corner
TRIM_S = 0.1  # of both ends of a ride, where the object tips or still rocks
WINDOW_S = 0.2  # in which the χ² of a pad's readings tells that nothing explains them


@dataclass(frozen=True, slots=True)
class Ride:
    """On which palm (0, 1) from when to when (s); Y and ρ (m) with their covariance.

    rolls: the ridden palm's readings contradict that the object rides on the other, as those of a disc would not.
    """

    palm: int
    start: float
    end: float
    corner: FloatArray
    covariance: FloatArray
    rolls: bool

    @property
    def lasts(self) -> float:
        """How long (s)."""
        return self.end - self.start

    def is_as(self, other: Ride) -> bool:
        """Whether it is on the same palm, side and corner, as far as is told."""
        away = self.corner - other.corner
        spread = self.covariance + other.covariance + SAME_M**2 * np.eye(2)
        return self.palm == other.palm and float(away @ np.linalg.solve(spread, away)) < SAME


class _Trace:
    """The readings of one pad, and sums of squares of s sin φ2 = Y + ρ cos φ2 over any of them in a row."""

    def __init__(self, record: Record, pad: int):
        mine = record.contact_pad == pad
        opening = record.contact_palms[mine, OPENING]
        self.t = record.contact_t[mine]
        root = 1.0 / (np.sqrt(record.contact_variance[mine]) * np.sin(opening))
        row = np.stack([root, root * np.cos(opening), root * np.sin(opening) * record.contact_value[mine]], axis=1)
        squares = row[:, :, None] * row[:, None, :]
        self._sums = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(squares, axis=0)])

    def fitted(self, first: int, last: IntArray | int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """χ², (Y, ρ), and their covariance, of the readings from `first` until before each of `last`."""
        sums = self._sums[last] - self._sums[first]
        a, b, c = sums[..., 0, 0], sums[..., 0, 1], sums[..., 1, 1]
        p, q, total = sums[..., 0, 2], sums[..., 1, 2], sums[..., 2, 2]
        determinant = a * c - b * b
        told = determinant > 1e-9 * a * c
        one = 1.0 / np.where(told, determinant, 1.0)
        chi2 = np.where(told, total - (c * p * p - 2.0 * b * p * q + a * q * q) * one, np.inf)
        corner = np.stack([(c * p - b * q) * one, (a * q - b * p) * one], axis=-1)
        covariance = np.stack([np.stack([c, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2) * one[..., None, None]
        return chi2, corner, covariance

    def agree(self, first: int) -> int:
        """Up to which reading those from `first` on agree with one ride."""
        last: IntArray = np.arange(first + LEAST_READINGS, len(self.t) + 1)
        wrong = np.flatnonzero(_contradicted(self.fitted(first, last)[0], last - first, SIGMAS))
        return int(last[wrong[0]]) - 1 if len(wrong) else len(self.t)

    def roll(self, start: float, end: float) -> bool:
        """Whether the readings in between (s) contradict one ride for certain."""
        first, last = np.searchsorted(self.t, (start, end)).tolist()
        chi2 = self.fitted(first, last)[0]
        return bool(np.isfinite(chi2) and _contradicted(chi2, last - first, ROLLS_SIGMAS))


def _contradicted(chi2: FloatArray, readings: IntArray | int, sigmas: float) -> npt.NDArray[np.bool_]:
    wrong: npt.NDArray[np.bool_] = chi2 > readings * (1.0 + SLACK) + sigmas * np.sqrt(2.0 * readings)
    return wrong


def rides_of(record: Record) -> list[Ride]:
    """The rides of an object with corners, longest first; each reading of a pad is of one at most."""
    felt, found = [_Trace(record, pad) for pad in PALMS], list[Ride]()
    for ridden, other in enumerate(reversed(felt)):
        for first, last in _apart(other):
            _, corner, covariance = other.fitted(first, last)
            start, end = float(other.t[first]), float(other.t[last - 1])
            if abs(corner[1]) < CORNER_M:
                found.append(Ride(ridden, start, end, corner, covariance, felt[ridden].roll(start, end)))
    return sorted(found, key=lambda ride: -ride.lasts)


def _apart(felt: _Trace) -> list[tuple[int, int]]:
    """First and last of the readings of each ride: the longest, then the longest in what is left, and so on."""
    t, taken = felt.t, list[tuple[int, int]]()
    spans = [(first, felt.agree(first)) for first in range(0, len(t) - LEAST_READINGS, EVERY)]
    while spans:
        first, last = max(spans, key=lambda span: t[span[1] - 1] - t[span[0]])
        if t[last - 1] - t[first] < LEAST_S:
            break
        taken.append((first, last))
        free = [span for span in spans if not first <= span[0] < last]
        cut = [(begin, min(end, first) if begin < first else end) for begin, end in free]
        spans = [(begin, end) for begin, end in cut if end - begin >= LEAST_READINGS]
    return taken


def same(rides: Sequence[Ride]) -> list[list[Ride]]:
    """Those on the same palm, side and corner, each in order of time; what lasts longest comes first."""
    groups: list[list[Ride]] = []
    for ride in rides:
        mine = next((group for group in groups if ride.is_as(group[0])), None)
        if mine is None:
            groups.append([ride])
        else:
            mine.append(ride)
    groups.sort(key=lambda group: -sum(ride.lasts for ride in group))
    return [sorted(group, key=lambda ride: ride.start) for group in groups]


def corner_of(rides: Sequence[Ride]) -> FloatArray:
    """Y and ρ (m) by all of these together."""
    weights = [np.linalg.inv(ride.covariance) for ride in rides]
    sides = [weight @ ride.corner for weight, ride in zip(weights, rides, strict=True)]
    corner: FloatArray = np.linalg.solve(np.sum(weights, axis=0), np.sum(sides, axis=0))
    return corner


def unexplained(t: FloatArray, squares: FloatArray, sigmas: float) -> list[tuple[float, float]]:
    """From when to when (s) a pad's readings contradict what explains them in a window, and `TRIM_S` about it.

    t, squares: of each, its time (s) and its residual squared, in one-sigmas; sigmas: of their sum, that contradict.
    """
    sums = np.concatenate([[0.0], np.cumsum(squares)])
    first, last = np.arange(len(t)), np.searchsorted(t, t + WINDOW_S)
    count = last - first
    bad = sums[last] - sums[first] > count + sigmas * np.sqrt(2.0 * count)
    return list(zip((t[bad] - TRIM_S).tolist(), (t[last[bad] - 1] + TRIM_S).tolist(), strict=True))
