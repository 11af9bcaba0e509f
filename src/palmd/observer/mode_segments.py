"""Find contact-mode segments, in which an object lies with a flat side on a palm, from the readings alone. Pure.

As in `observer.fixed_mode_test`, the other palm then touches a corner whose centre is at a constant height over the
supporting palm (Y) and over the other (ρ), and reads s = (Y + ρ cos φ2) / sin φ2: two numbers, determined by least
squares. Where Y and ρ recur, so do side and corner. Not for use inside the loop: a second of readings takes some 10 ms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.record import IntArray, Record
from palmd.system.mechanism import OPENING, PALMS

LEAST_S, LEAST_READINGS = 0.5, 10  # of a segment
SIGMAS, MODEL_SHARE = 3.5, 0.02  # of χ², beyond which a segment has ended; and a share of it for model error
EXCLUDES_SIGMAS = 10.0  # of χ², beyond which readings certainly contradict a segment
EVERY = 4  # readings of a pad between two candidate starts of a segment
# difference of Y and ρ of the same mode, besides their noise; squared Mahalanobis distance
SAME_MODE_M, SAME_MODE_CHI2 = 2e-5, 16.0
CORNER_M = 5e-3  # largest ρ of a corner
TRIM_S = 0.1  # at both ends of a segment, where the object tips or still rocks
WINDOW_S = 0.2  # over which the χ² of a pad's readings is tested


@dataclass(frozen=True, slots=True)
class ModeSegment:
    """A stretch of time (s) in which the object is fixed to a palm (0, 1); Y and ρ (m) with their covariance.

    excludes_disc: the supporting palm's readings contradict that the object is fixed to the other palm. Those of a disc
    do not contradict either.
    """

    palm: int
    start: float
    end: float
    corner: FloatArray
    covariance: FloatArray
    excludes_disc: bool

    @property
    def lasts(self) -> float:
        """Duration (s)."""
        return self.end - self.start

    def same_mode_as(self, other: ModeSegment) -> bool:
        """Whether both are on the same palm, side and corner, within their uncertainty."""
        difference = self.corner - other.corner
        covariance = self.covariance + other.covariance + SAME_MODE_M**2 * np.eye(2)
        return self.palm == other.palm and float(difference @ np.linalg.solve(covariance, difference)) < SAME_MODE_CHI2


class _PadTrace:
    """The readings of one pad, with cumulative sums of squares of s sin φ2 = Y + ρ cos φ2."""

    def __init__(self, record: Record, pad: int):
        of_pad = record.contact_pad == pad
        opening = record.contact_palms[of_pad, OPENING]
        self.t = record.contact_t[of_pad]
        root = 1.0 / (np.sqrt(record.contact_variance[of_pad]) * np.sin(opening))
        row = np.stack([root, root * np.cos(opening), root * np.sin(opening) * record.contact_value[of_pad]], axis=1)
        squares = row[:, :, None] * row[:, None, :]
        self._sums = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(squares, axis=0)])

    def fitted(self, first: int, last: IntArray | int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """χ², (Y, ρ) and their covariance, of the readings from `first` until before each of `last`."""
        sums = self._sums[last] - self._sums[first]
        a, b, c = sums[..., 0, 0], sums[..., 0, 1], sums[..., 1, 1]
        p, q, total = sums[..., 0, 2], sums[..., 1, 2], sums[..., 2, 2]
        determinant = a * c - b * b
        determined = determinant > 1e-9 * a * c
        inverse = 1.0 / np.where(determined, determinant, 1.0)
        chi2 = np.where(determined, total - (c * p * p - 2.0 * b * p * q + a * q * q) * inverse, np.inf)
        corner = np.stack([(c * p - b * q) * inverse, (a * q - b * p) * inverse], axis=-1)
        covariance = (
            np.stack([np.stack([c, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2) * inverse[..., None, None]
        )
        return chi2, corner, covariance

    def agreeing_until(self, first: int) -> int:
        """Number of the reading up to which those from `first` on agree with one segment."""
        last: IntArray = np.arange(first + LEAST_READINGS, len(self.t) + 1)
        failing = np.flatnonzero(_contradicted(self.fitted(first, last)[0], last - first, SIGMAS))
        return int(last[failing[0]]) - 1 if len(failing) else len(self.t)

    def contradicted_in(self, start: float, end: float) -> bool:
        """Whether the readings from `start` to `end` (s) certainly contradict one segment."""
        first, last = np.searchsorted(self.t, (start, end)).tolist()
        chi2 = self.fitted(first, last)[0]
        return bool(np.isfinite(chi2) and _contradicted(chi2, last - first, EXCLUDES_SIGMAS))


def _contradicted(chi2: FloatArray, readings: IntArray | int, sigmas: float) -> npt.NDArray[np.bool_]:
    contradicted: npt.NDArray[np.bool_] = chi2 > readings * (1.0 + MODEL_SHARE) + sigmas * np.sqrt(2.0 * readings)
    return contradicted


def find_mode_segments(record: Record) -> list[ModeSegment]:
    """The contact-mode segments of an object with corners, longest first; each reading of a pad is in one at most."""
    pads, found = [_PadTrace(record, pad) for pad in PALMS], list[ModeSegment]()
    for support, other in enumerate(reversed(pads)):
        for first, last in _disjoint(other):
            _, corner, covariance = other.fitted(first, last)
            start, end = float(other.t[first]), float(other.t[last - 1])
            if abs(corner[1]) < CORNER_M:
                found.append(
                    ModeSegment(support, start, end, corner, covariance, pads[support].contradicted_in(start, end))
                )
    return sorted(found, key=lambda segment: -segment.lasts)


def _disjoint(pad: _PadTrace) -> list[tuple[int, int]]:
    """First and last reading of each segment: the longest first, then the longest of what is left, and so on."""
    t, taken = pad.t, list[tuple[int, int]]()
    spans = [(first, pad.agreeing_until(first)) for first in range(0, len(t) - LEAST_READINGS, EVERY)]
    while spans:
        first, last = max(spans, key=lambda span: t[span[1] - 1] - t[span[0]])
        if t[last - 1] - t[first] < LEAST_S:
            break
        taken.append((first, last))
        untouched = [span for span in spans if not first <= span[0] < last]
        shortened = [(start, min(end, first) if start < first else end) for start, end in untouched]
        spans = [(start, end) for start, end in shortened if end - start >= LEAST_READINGS]
    return taken


def group_by_mode(segments: Sequence[ModeSegment]) -> list[list[ModeSegment]]:
    """Segments grouped by palm, side and corner, each group in order of time; the longest group comes first."""
    groups: list[list[ModeSegment]] = []
    for segment in segments:
        group_found = next((group for group in groups if segment.same_mode_as(group[0])), None)
        if group_found is None:
            groups.append([segment])
        else:
            group_found.append(segment)
    groups.sort(key=lambda group: -sum(segment.lasts for segment in group))
    return [sorted(group, key=lambda segment: segment.start) for group in groups]


def combined_corner(segments: Sequence[ModeSegment]) -> FloatArray:
    """Y and ρ (m) of these segments together."""
    weights = [np.linalg.inv(segment.covariance) for segment in segments]
    weighted = [weight @ segment.corner for weight, segment in zip(weights, segments, strict=True)]
    corner: FloatArray = np.linalg.solve(np.sum(weights, axis=0), np.sum(weighted, axis=0))
    return corner


def rejected_windows(t: FloatArray, squares: FloatArray, sigmas: float) -> list[tuple[float, float]]:
    """Time spans (s) of windows in which a pad's readings fail the χ² test, extended by `TRIM_S`.

    t, squares: time (s) and squared normalised residual of each reading. sigmas: gate of their sum.
    """
    sums = np.concatenate([[0.0], np.cumsum(squares)])
    first, last = np.arange(len(t)), np.searchsorted(t, t + WINDOW_S)
    count = last - first
    failing = sums[last] - sums[first] > count + sigmas * np.sqrt(2.0 * count)
    return list(zip((t[failing] - TRIM_S).tolist(), (t[last[failing] - 1] + TRIM_S).tolist(), strict=True))
