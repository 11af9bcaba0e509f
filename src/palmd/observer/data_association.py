"""Data association of contact-mode segments: the side and the opposite corner of an object with corners. Pure, offline.

Each segment alone determines four numbers (`observer.mode_model`): how high the centre of mass is over the side, and
where the corner is relative to both. With a side and a corner assigned to each segment, they are those of one outline.
The assignment is searched by a beam search in order of time: a segment that follows at once on the same palm is on the
same side, any other one on any side that is within reach; the assignments that explain the segments so far best are
kept. The number of corners is searched in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.observer.gauss_newton import minimise
from palmd.observer.mode_model import MODE_PARAMETERS, SegmentReadings
from palmd.observer.mode_segments import ModeSegment
from palmd.observer.outline import wrapped
from palmd.observer.record import IntArray
from palmd.observer.rounded_polygon import discs, mode_parameters, normal_violation, regular, side_normals

ROUNDS = 3  # fits, after each of which the readings while the object rocks are left out
HEIGHT, HEIGHT_SD_M, AWAY_SD_M = 0.9, 8e-3, 15e-3  # initial H, in radii of gyration; 1σ of the priors of H and a
FORM_SD_M = (3e-5, 5e-5, 1.5e-4, 1e-4)  # model error of Y, ρ, a, H of one segment, besides their noise
CORNERS = (6, 5, 7, 4, 8, 3)  # numbers of corners, the likeliest first
STAYS_S = 0.1  # between two segments on the same side; tipping takes longer
BEAM = 24  # assignments that are kept
SKIPPED = 40.0  # cost of leaving out a segment, in twice the log-likelihood
MOST_SKIPPED = 0.2  # of the segments' time
MOST_PASSED = 3  # sides between that on which it lies and the opposite corner
HOPELESS = 100.0  # cost above the best, at which a rival is dropped
NEAR_M, CLEAR_M = 3e-3, 6e-4  # Y − ρ: largest where the corner may end the side, least where it may be another corner
REACH = 0.25  # 1σ of the corners' distance, in mean radii
# 1σ of the corners' angles; of radii; of normals outside a corner's range
SPREAD_RAD, RADIUS_SD_M, BEYOND_RAD = 0.35, 1e-3, 0.04
LEAST_TURN_RAD, TURN_SD_RAD = 0.15, 0.05  # between adjacent sides
GAUGE_RAD = 1e-4
SAME_TURN_RAD, SAME_CORNER_M = 0.02, 5e-4  # tolerance of a side's normal and of a corner's position in two outlines
ITERATIONS, STEP_M, MOST_STEP_M = 6, 1e-7, 6e-3


@dataclass(frozen=True, slots=True)
class ModeEstimate:
    """What one segment determines: mode parameters Y, ρ, a, H (m), a root of their information, the readings used."""

    value: FloatArray
    root: FloatArray
    readings: SegmentReadings

    @property
    def segment(self) -> ModeSegment:
        """The segment."""
        return self.readings.segment


def mode_estimate(readings: SegmentReadings, shared: FloatArray, shared_sd: FloatArray) -> ModeEstimate | None:
    """The mode parameters from the readings of one segment while the object lay still; None where there are too few.

    shared, shared_sd: prior of the numbers that all segments share.
    """
    height, radius = readings.segment.corner
    radius_of_gyration = math.exp(shared[0])
    p = np.concatenate([[height, radius, 0.0, HEIGHT * radius_of_gyration], shared])
    prior_mean, sd = p[2:].copy(), np.concatenate([[AWAY_SD_M, HEIGHT_SD_M], shared_sd])
    used = readings
    for _ in range(ROUNDS):
        if not used.enough:
            return None

        def residuals_at(p: FloatArray, used: SegmentReadings = used) -> tuple[FloatArray, FloatArray]:
            rows = np.concatenate(
                [used.slopes(p[:MODE_PARAMETERS], p[MODE_PARAMETERS:]), np.diag(1.0 / sd) @ np.eye(len(p))[2:]]
            )
            return np.concatenate(
                [used.residuals(p[:MODE_PARAMETERS], p[MODE_PARAMETERS:]), (p[2:] - prior_mean) / sd]
            ), rows

        minimum = minimise(residuals_at, p)
        p = minimum.p
        still = readings.still(p[:MODE_PARAMETERS], p[MODE_PARAMETERS:])
        if still.sum() == len(used.t):
            break
        used = readings.only(still)
    if not len(used.t):
        return None
    try:
        covariance = np.linalg.inv(minimum.information)[:MODE_PARAMETERS, :MODE_PARAMETERS] + np.diag(FORM_SD_M) ** 2
        return ModeEstimate(p[:MODE_PARAMETERS], np.linalg.inv(np.linalg.cholesky(covariance)), used)
    except np.linalg.LinAlgError:
        return None


@dataclass(frozen=True, slots=True)
class Association:
    """An association: the side and the corner of each segment, whether the segment is used, and the outline p.

    cost: twice the negative log-likelihood, up to a constant.
    """

    p: FloatArray
    sides: IntArray
    corners: IntArray
    used: IntArray
    cost: float

    @property
    def count(self) -> int:
        """Number of corners of the outline."""
        return len(self.p) // 3

    def of(self, used: Sequence[int]) -> Association:
        """The association of these segments only."""
        return replace(self, used=np.isin(np.arange(len(self.used)), used).astype(np.intp))

    @property
    def labels(self) -> tuple[IntArray, ...]:
        """Sides, corners and use of all segments."""
        return self.sides, self.corners, self.used


def prior_residuals(p: FloatArray, reach: float, radius: float, gauge: float) -> FloatArray:
    """Normalised residuals (..., 4n + 1) of the prior of outlines p (..., 3n).

    reach, radius (m): expected distance of the corners from the centre of mass, and their radius. Corners are about
    evenly distributed, and sides turn one way. The first corner is at the angle `gauge` (rad).
    """
    (centres, radii), normals = discs(p), side_normals(p)
    evenly = math.tau / centres.shape[-1]
    away = wrapped(np.angle(np.roll(centres, -1, axis=-1) / centres) - evenly) / SPREAD_RAD
    hollow = np.minimum(wrapped(np.roll(normals, -1, axis=-1) - normals) - LEAST_TURN_RAD, 0.0) / TURN_SD_RAD
    far = (np.abs(centres) / reach - 1.0) / REACH
    first = np.angle(centres[..., :1] * np.exp(-1j * gauge)) / GAUGE_RAD
    return np.concatenate([away, far, (radii - radius) / RADIUS_SD_M, hollow, first], axis=-1)


def associated(estimates: Sequence[ModeEstimate], doubt: float) -> list[Association]:
    """The likeliest associations of segments in order of time, with any number of `CORNERS`, best first.

    With all rivals found whose cost is less than `doubt` above the best.
    """
    rivals = list[Association]()
    for count in CORNERS:
        least = min((each.cost for each in rivals), default=math.inf)
        rivals += AssociationSearch(estimates, count).best(least + doubt)
    rivals.sort(key=lambda each: each.cost)
    return [each for each in rivals if each.cost < rivals[0].cost + doubt]


def anchor_of(rivals: Sequence[Association], weights: FloatArray | IntArray) -> int | None:
    """The segment of most weight among those that all rivals use, or None; its side aligns their frames."""
    shared = weights * np.min([each.used for each in rivals], axis=0)
    return int(np.argmax(shared)) if shared.any() else None


def certain(rivals: Sequence[Association], durations: FloatArray) -> IntArray:
    """Which segments all rivals associate with the same part of the same outline as the first one does.

    durations: of the segments (s).
    """
    best = rivals[0]
    time_on_side = np.bincount(best.sides, weights=durations * best.used, minlength=best.count)
    # the side on which the object lies longest
    anchor = anchor_of(rivals, durations * (best.sides == np.argmax(time_on_side)))
    if anchor is None:
        return np.zeros_like(best.used)
    used, positions = best.used.copy(), list[tuple[FloatArray, IntArray, FloatArray]]()
    for each in rivals:
        normals, (centres, _) = side_normals(each.p), discs(each.p)
        frame = normals[each.sides[anchor]]
        corners = centres[each.corners] * np.exp(-1j * frame)
        positions.append((normals[each.sides] - frame, each.used, np.stack([corners.real, corners.imag], axis=1)))
    for normals, used_there, corners in positions[1:]:
        turned = np.abs(wrapped(normals - positions[0][0])) > SAME_TURN_RAD
        moved = np.linalg.norm(corners - positions[0][2], axis=1) > SAME_CORNER_M
        used[(used_there == 1) & (turned | moved)] = 0
    return used


class AssociationSearch:
    """Beam search of the associations of segments in order of time, with an outline of `count` corners."""

    def __init__(self, estimates: Sequence[ModeEstimate], count: int):
        self._estimates, self.count = estimates, count
        self._value, self._root = (
            np.array([each.value for each in estimates]),
            np.array([each.root for each in estimates]),
        )
        self._durations = np.array([each.segment.lasts for each in estimates])
        self._palm = np.array([each.segment.palm for each in estimates])
        self._openings = np.array([each.readings.openings for each in estimates])
        height, self._radius = float(np.median(self._value[:, 3])), max(float(np.median(self._value[:, 1])), 0.0)
        self._initial = regular(count, height, self._radius)
        self._reach = float(np.abs(discs(self._initial)[0][0]))

    def best(self, most: float) -> list[Association]:
        """The likeliest associations, best first; none where even the best costs more than `most`."""
        none = np.zeros(0, dtype=np.intp)
        kept = [Association(self._initial, none, none, none, 0.0)]
        for number in range(len(self._estimates)):
            options = [(each, label) for each in kept for label in self._options(each, number)]
            if not options:
                return []
            p = np.array([each.p for each, _ in options])
            labels = np.array(
                [
                    [np.append(before, new) for before, new in zip(each.labels, label, strict=True)]
                    for each, label in options
                ],
                dtype=np.intp,
            )
            p, cost = self._fitted(p, labels)
            first = np.argsort(cost, kind="stable")[: 2 * BEAM]
            labels = labels[first]
            p, cost = self._fitted(p[first], labels)
            last = [k for k in np.argsort(cost, kind="stable")[:BEAM] if cost[k] < cost.min() + HOPELESS]
            kept = [Association(p[k], labels[k, 0], labels[k, 1], labels[k, 2], float(cost[k])) for k in last]
            if kept[0].cost > most:
                return []
        return kept

    def _options(self, before: Association, i: int) -> Iterator[tuple[int, int, int]]:
        """Side, corner and use of the next segment; any side and corner after a segment that is left out."""
        segment, (height, radius) = self._estimates[i].segment, self._value[i, :2]
        near = height - radius < CLEAR_M
        reach = range(0 if height - radius < NEAR_M else 1, 1 if near else min(MOST_PASSED, self.count - 2) + 1)
        used_so_far = np.flatnonzero(before.used)
        for side in range(self.count if len(used_so_far) else 1):
            for offset in reach:
                corner = (side + (-offset, 1 + offset)[segment.palm]) % self.count
                if not len(used_so_far) or used_so_far[-1] < i - 1 or self._is_reachable(before, segment, side, corner):
                    yield side, corner, 1
        left_out = self._durations[:i][before.used == 0].sum() + self._durations[i]
        if left_out < MOST_SKIPPED * self._durations.sum():
            yield 0, 0, 0

    def _is_reachable(self, before: Association, segment: ModeSegment, side: int, corner: int) -> bool:
        """Whether the object reaches this side and corner from the last ones by one tip, or by none.

        From one palm to the other, the corner of each segment ends the side of the other; on one palm the object tips
        by one side, or not at all.
        """
        last, last_side, last_corner = (
            self._estimates[len(before.sides) - 1].segment,
            int(before.sides[-1]),
            int(before.corners[-1]),
        )
        if segment.palm != last.palm:
            return last_corner in self._ends(side) and corner in self._ends(last_side)
        offset = (side - last_side) % self.count
        stays = segment.start - last.end < STAYS_S
        return offset == 0 or (not stays and offset in (1, self.count - 1) and corner == last_corner)

    def _ends(self, side: int) -> tuple[int, int]:
        return side, (side + 1) % self.count

    def _fitted(self, p: FloatArray, labels: IntArray) -> tuple[FloatArray, FloatArray]:
        """Outlines (B, 3n) fitted to labels (B, 3, r) by damped Gauss–Newton steps in parallel, and costs (B,)."""
        sides, corners, used = np.moveaxis(labels, 1, 0)
        damping, misses = np.full(len(p), 1e-3), self._residuals(p, sides, corners, used)
        cost, diagonal = (misses**2).sum(axis=1), np.arange(p.shape[1])
        for _ in range(ITERATIONS):
            rows = np.stack(
                [
                    (self._residuals(p + STEP_M * unit, sides, corners, used) - misses) / STEP_M
                    for unit in np.eye(len(diagonal))
                ],
                axis=2,
            )
            matrix, side = np.swapaxes(rows, 1, 2) @ rows, (misses[:, None, :] @ rows)[:, 0]
            matrix[:, diagonal, diagonal] *= 1.0 + damping[:, None]
            matrix[:, diagonal, diagonal] += 1.0
            step = np.clip(-np.linalg.solve(matrix, side[:, :, None])[:, :, 0], -MOST_STEP_M, MOST_STEP_M)
            new_misses = self._residuals(p + step, sides, corners, used)
            new_cost = (new_misses**2).sum(axis=1)
            improved = new_cost < cost
            p, misses = np.where(improved[:, None], p + step, p), np.where(improved[:, None], new_misses, misses)
            cost, damping = np.where(improved, new_cost, cost), np.where(improved, damping / 5.0, damping * 8.0)
        return p, cost + SKIPPED * (1 - used).sum(axis=1)

    def _residuals(self, p: FloatArray, sides: IntArray, corners: IntArray, used: IntArray) -> FloatArray:
        """Normalised residuals (B, …): of mode parameters, of normals outside the corners' ranges, of the prior."""
        count = sides.shape[1]
        palm, openings = self._palm[:count], self._openings[:count]
        mode_misses = self._value[:count] - mode_parameters(p, sides, corners, palm)
        mode_misses = (self._root[:count] @ mode_misses[..., None])[..., 0] * used[..., None]
        normal_misses = normal_violation(p, sides, corners, palm, openings) / BEYOND_RAD * used[..., None]
        parts = mode_misses, normal_misses, prior_residuals(p, self._reach, self._radius, 0.0)
        return np.concatenate([each.reshape(len(p), -1) for each in parts], axis=1)
