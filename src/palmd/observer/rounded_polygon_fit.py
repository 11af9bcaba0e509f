"""Fit of a rounded polygon to all readings of the associated contact-mode segments. Pure, offline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.observer.data_association import Association, ModeEstimate, prior_residuals
from palmd.observer.gauss_newton import minimise
from palmd.observer.mode_model import MODE_PARAMETERS, SHARED, SegmentReadings
from palmd.observer.record import IntArray
from palmd.observer.rounded_polygon import discs, mode_parameters

ROUNDS = 3  # fits; after each one the readings while the object rocks are left out
STEP_M = 1e-7  # for difference quotients


@dataclass(frozen=True, slots=True)
class SharedPrior:
    """Prior mean and 1σ of the numbers that all segments share (`mode_model.SHARED`)."""

    mean: FloatArray
    sd: FloatArray


@dataclass(frozen=True, slots=True)
class RoundedPolygonFit:
    """Fitted outline p and shared numbers with their joint covariance, associations, and residuals of each segment."""

    association: Association
    segments: tuple[SegmentReadings, ...]
    residuals: tuple[FloatArray, ...]
    p: FloatArray
    shared: FloatArray
    covariance: FloatArray
    settled: bool

    @property
    def chi2(self) -> float:
        """Mean squared normalised residual of the readings."""
        return float(np.mean(np.concatenate(self.residuals) ** 2))

    @property
    def sides(self) -> IntArray:
        """The side on which the object lies, for each segment."""
        sides: IntArray = self.association.sides[self.association.used == 1]
        return sides

    @property
    def corners(self) -> IntArray:
        """The corner on the other palm, for each segment."""
        corners: IntArray = self.association.corners[self.association.used == 1]
        return corners

    def parameters(self, which: int) -> FloatArray:
        """Mode parameters Y, ρ, a, H (m) of a segment."""
        side, corner = (each[[which]] for each in (self.sides, self.corners))
        parameters: FloatArray = mode_parameters(self.p, side, corner, [self.segments[which].segment.palm])[0]
        return parameters


class _PolygonProblem:
    """Least-squares problem of all segments."""

    def __init__(self, segments: Sequence[SegmentReadings], association: Association, shared: SharedPrior):
        used = np.flatnonzero(association.used)
        self.segments, self._shared = segments, shared
        self.sides, self.corners = association.sides[used], association.corners[used]
        self._palms = [each.segment.palm for each in segments]
        self._own = len(association.p)
        centres, radii = discs(association.p)
        self._reach, self._radius = float(np.abs(centres).mean()), float(np.median(radii))
        self._gauge = float(np.angle(centres[0]))

    def mode_parameters(self, p: FloatArray) -> FloatArray:
        return mode_parameters(p[: self._own], self.sides, self.corners, self._palms)

    def at(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (readings, then prior) and their derivatives."""
        parameters, own = self.mode_parameters(p), np.eye(len(p))[: self._own]
        slopes_by_p = np.stack(
            [(self.mode_parameters(p + STEP_M * unit) - parameters) / STEP_M for unit in own], axis=2
        )
        misses, rows = list[FloatArray](), list[FloatArray]()
        for mode, by_p, readings in zip(parameters, slopes_by_p, self.segments, strict=True):
            slopes = readings.slopes(mode, p[self._own :])
            misses.append(readings.residuals(mode, p[self._own :]))
            rows.append(np.concatenate([slopes[:, :MODE_PARAMETERS] @ by_p, slopes[:, MODE_PARAMETERS:]], axis=1))
        prior_misses = self._prior_residuals(p)
        steps = STEP_M * np.eye(len(p))
        misses.append(prior_misses)
        rows.append(np.stack([(self._prior_residuals(p + step) - prior_misses) / STEP_M for step in steps], axis=1))
        return np.concatenate(misses), np.concatenate(rows)

    def _prior_residuals(self, p: FloatArray) -> FloatArray:
        shared_misses = (p[self._own :] - self._shared.mean) / self._shared.sd
        return np.concatenate([prior_residuals(p[: self._own], self._reach, self._radius, self._gauge), shared_misses])


def fit_rounded_polygon(
    estimates: Sequence[ModeEstimate],
    segments: Sequence[SegmentReadings],
    association: Association,
    shared: SharedPrior,
) -> RoundedPolygonFit | None:
    """Fit to all readings of the associated segments while the object lies still; None where it is undetermined.

    segments: all readings of each segment, including those while it rocks.
    """
    used = np.flatnonzero(association.used).tolist()
    used_segments, p = [estimates[i].readings for i in used], np.concatenate([association.p, shared.mean])
    try:
        for _ in range(ROUNDS):
            problem = _PolygonProblem(used_segments, association.of(used), shared)
            p = minimise(problem.at, p).p
            used_segments = [
                segments[i].only(segments[i].still(mode, p[-SHARED:]))
                for i, mode in zip(used, problem.mode_parameters(p), strict=True)
            ]
            used = [i for i, each in zip(used, used_segments, strict=True) if each.enough]
            used_segments = [each for each in used_segments if each.enough]
            if not used:
                return None
        problem = _PolygonProblem(used_segments, association.of(used), shared)
        least = minimise(problem.at, p)
        covariance = np.asarray(np.linalg.inv(least.information), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    shared_values = least.p[-SHARED:]
    residuals = tuple(
        each.residuals(mode, shared_values)
        for each, mode in zip(used_segments, problem.mode_parameters(least.p), strict=True)
    )
    return RoundedPolygonFit(
        association.of(used), tuple(used_segments), residuals, least.p[:-SHARED], shared_values, covariance,
        least.settled,
    )  # fmt: skip
