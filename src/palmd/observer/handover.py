"""Hand-over of a smoother's improvement to the fusion: as one more hypothesis or, once established, as the only one."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray, Improvement
from palmd.model import shape, shape_map
from palmd.observer.coverage import Marks, turned_marks
from palmd.observer.estimates import bin_rows
from palmd.observer.filters.shape_map import ShapeFilters, smoother_outline, smoother_spread
from palmd.observer.fusion import Fusion
from palmd.observer.returning_object import SAME_POSE_RAD, ReturningObject, SmoothedFilters
from palmd.observer.rig_error import RigError
from palmd.observer.track import Track
from palmd.observer.validity import SHARP_M
from palmd.system.description import RigDescription

WORSE_NIS = 0.35  # allowed excess of the mean NIS over the best filter's: 2σ over some 30 readings
PRIOR_ODDS = 6.0  # nats by which a filter from a smoother leads at first: it comes from all readings at once
_SHAPE = slice(shape_map.Z.SHAPE, None)


class Handover:
    """Keeps the published gauge of ψ when the smoother changes its gauge; safe inside the loop."""

    def __init__(
        self, rig: RigDescription, blind: ShapeFilters, smoothed: SmoothedFilters, hypotheses: ReturningObject
    ):
        """`blind` and `smoothed` are the filters of `hypotheses`; from now on they share one `rig_error`."""
        self._hypotheses = hypotheses
        self._single = smoothed.single
        self.rig_error = RigError(tuple(pad.length for pad in rig.pads), rig.curvatures)
        for filters in (blind, *smoothed):
            filters.rig_error = self.rig_error
        self.reset()

    def reset(self) -> None:
        """Back to the initial state, as if nothing had been handed over."""
        self._frame: tuple[int, int] | None = None  # object count, and frame of the smoother
        self._turn = 0.0  # from that frame to the published one (rad)
        self.rig_error.values[:] = 0.0

    def hand_over(
        self, track: Track, object_count: int, improvement: Improvement, x: FloatArray, P: FloatArray, nis: float
    ) -> bool:
        """Let a filter that started from a smoother's `improvement` lead; x, P, nis: its present state and mean NIS.

        It replaces the worst filter of the bank; an established improvement replaces the whole bank. The filter is
        turned so that ψ continues without a jump. Returns False if the bank is lost, if the object's identity is still
        open, if the filter explains the readings worse than the present leader, or if it knows less of the outline.
        """
        fusion, bank, best = track.fusion, track.fusion.bank, track.fusion.bank.best()
        undecided = self._hypotheses.candidate is not None and not improvement.established
        if bank.lost() or undecided or nis > bank.nis[best] + WORSE_NIS:
            return False
        frame = (object_count, improvement.frame)
        renewed = frame != self._frame and (
            fusion.includes_rig_uncertainty or (track.valid and not improvement.established)
        )
        if renewed and not _as_precise(P, improvement.spread, fusion, track.coverage.marks):
            return False  # a new search that used the latest readings only knows less than the bank
        if frame != self._frame:
            self._frame, self._turn = frame, float(bank.x[best, shape_map.Z.PSI] - x[shape_map.Z.PSI])
        x, P, spread = _turned(x, P, improvement.spread, self._turn)
        self.rig_error.values[:] = improvement.rig
        if improvement.established:
            self._hypotheses.accept(track)
            track.use_single_filter(
                self._single, x, P, nis, self._touched(track, improvement, float(x[shape_map.Z.PSI])), spread
            )
            return True
        worst = int(np.argmin(np.where(np.arange(bank.size) == best, np.inf, bank.score)))
        narrow = bank.n < len(x)
        bank.x[worst], bank.P[worst] = smoother_outline(x, P) if narrow else (x, P)
        precise = outline_sd(improvement) < SHARP_M
        fusion.filters.provisional_spread = (smoother_spread(P, spread) if narrow else spread) if precise else None
        bank.score[worst], bank.nis[worst] = bank.score[best] + PRIOR_ODDS, nis
        fusion.forgetting.prior_age_s[worst] = 0.0
        fusion.history.clear()
        return True

    def _touched(self, track: Track, improvement: Improvement, psi: float) -> Marks:
        """The normals touched up to an improvement, and those since then unless its pose is another one (ψ in rad)."""
        bank = track.fusion.bank
        touched, best = turned_marks(improvement.touched, self._turn), bank.best()
        if abs(math.remainder(psi - bank.x[best, shape_map.Z.PSI], math.tau)) > SAME_POSE_RAD:
            return touched
        return touched | track.coverage.since(improvement.t, best, track.fusion.psi)


def outline_sd(found: Improvement) -> float:
    """RMS 1σ of the outline (m) over the normals touched, given the rig's constants; inf if none was touched."""
    count = int(found.touched.sum())
    return math.sqrt(max(_uncertainty(found.P[_SHAPE, _SHAPE], found.touched), 0.0) / count) if count else math.inf


def _as_precise(P: FloatArray, spread: FloatArray, fusion: Fusion, touched: Marks) -> bool:
    """Whether covariance `P` determines the outline as precisely as the leader's does, where it has been touched.

    The uncertainty due to the rig's constants, `spread` of P, counts if the leader includes it too: with more readings
    its filter becomes more certain of the outline given these constants, but not of the constants.
    """
    rig_part = spread[: len(P)] if fusion.includes_rig_uncertainty else np.zeros((len(P), 0))
    improved = (P + rig_part @ rig_part.T)[_SHAPE, _SHAPE]
    _, leading = fusion.filters.outline(fusion.bank.best())
    return _uncertainty(improved, touched) <= _uncertainty(leading, touched)


def _uncertainty(outline: FloatArray, touched: Marks) -> float:
    """Variance of h (m²), summed over the normals touched."""
    rows = bin_rows(len(outline))[touched]
    return float(((rows @ outline) * rows).sum())


def _turned(x: FloatArray, P: FloatArray, spread: FloatArray, turn: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A state of `model.shape_map`, its covariance and its spread in a gauge in which ψ is larger by `turn` (rad)."""
    matrix = np.eye(len(x))
    matrix[_SHAPE, _SHAPE] = shape.turned(turn, (len(x) - shape_map.Z.SHAPE - 1) // 2)
    moved = matrix @ x
    moved[shape_map.Z.PSI] += turn
    return moved, matrix @ P @ matrix.T, np.vstack([matrix @ spread[: len(x)], spread[len(x) :]])
