"""What a smoother has found takes part in the fusion: as one more hypothesis, or, once established, alone."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray, Improvement
from palmd.model import shape, shape_map
from palmd.observer.answer import bin_rows
from palmd.observer.coverage import Marks, turned_marks
from palmd.observer.filters.shape_map import ShapeFilters, smoother_outline, smoother_spread
from palmd.observer.fusion import Fusion
from palmd.observer.returning_object import SAME_POSE_RAD, ReturningObject, SmoothedFilters
from palmd.observer.rig_error import RigError
from palmd.observer.track import Track
from palmd.observer.validity import SHARP_M
from palmd.system.description import RigDescription

WORSE_NIS = 0.35  # over some 30 readings: two sigmas
PRIOR_ODDS = 6.0  # nats by which a filter from a smoother leads at first: its readings were weighed together
_SHAPE = slice(shape_map.Z.SHAPE, None)


class Handover:
    """Keeps the published gauge of ψ while the smoother changes its own; safe inside the loop."""

    def __init__(
        self, rig: RigDescription, blind: ShapeFilters, smoothed: SmoothedFilters, hypotheses: ReturningObject
    ):
        """`blind` and `smoothed` are the filters of `hypotheses`; from now on they share one estimate of the rig."""
        self._hypotheses = hypotheses
        self._single = smoothed.single
        self.rig_error = RigError(tuple(pad.length for pad in rig.pads), rig.curvatures)
        for filters in (blind, *smoothed):
            filters.rig_error = self.rig_error
        self.reset()

    def reset(self) -> None:
        """As if nothing had been found."""
        self._frame: tuple[int, int] | None = None  # of which object, and which of the smoother's
        self._turn = 0.0  # from that frame to the published one
        self.rig_error.values[:] = 0.0

    def take_in(
        self, track: Track, object_count: int, answer: Improvement, x: FloatArray, P: FloatArray, nis: float
    ) -> bool:
        """Let a filter that a smoother's `answer` began lead: its state and covariance now, its mean NIS since.

        It joins the bank, in the worst filter's place; once the answer is established it goes on alone. It is turned
        so that ψ goes on without a jump. False when there is nothing to take part in, or the readings surprise it
        more than the present leader.
        """
        fusion, bank, best = track.fusion, track.fusion.bank, track.fusion.bank.best()
        undecided = self._hypotheses.candidate is not None and not answer.established
        if bank.lost() or undecided or nis > bank.nis[best] + WORSE_NIS:
            return False
        frame = (object_count, answer.frame)
        anew = frame != self._frame and (fusion.allows_for_rig or (track.valid and not answer.established))
        if anew and not _as_sharp(P, answer.spread, fusion, track.coverage.marks):
            return False  # it has been found from the latest readings alone, and more is known
        if frame != self._frame:
            self._frame, self._turn = frame, float(bank.x[best, shape_map.Z.PSI] - x[shape_map.Z.PSI])
        x, P, spread = _turned(x, P, answer.spread, self._turn)
        self.rig_error.values[:] = answer.rig
        if answer.established:
            self._hypotheses.accept(track)
            track.lead_with(self._single, x, P, nis, self._touched(track, answer, float(x[shape_map.Z.PSI])), spread)
            return True
        worst = int(np.argmin(np.where(np.arange(bank.size) == best, np.inf, bank.score)))
        narrow = bank.n < len(x)
        bank.x[worst], bank.P[worst] = smoother_outline(x, P) if narrow else (x, P)
        told = outline_sd(answer) < SHARP_M
        fusion.filters.left_open = (smoother_spread(P, spread) if narrow else spread) if told else None
        bank.score[worst], bank.nis[worst] = bank.score[best] + PRIOR_ODDS, nis
        fusion.forgetting.prior_age_s[worst] = 0.0
        fusion.history.clear()
        return True

    def _touched(self, track: Track, answer: Improvement, psi: float) -> Marks:
        """The normals touched up to an answer, and since then unless the answer lies another way round (ψ in rad)."""
        bank = track.fusion.bank
        touched, best = turned_marks(answer.touched, self._turn), bank.best()
        if abs(math.remainder(psi - bank.x[best, shape_map.Z.PSI], math.tau)) > SAME_POSE_RAD:
            return touched
        return touched | track.coverage.since(answer.t, best, track.fusion.psi)


def outline_sd(answer: Improvement) -> float:
    """RMS of the outline's one-sigma (m) where a smoother is sure to have felt it, were the rig known; inf of none."""
    felt = int(answer.touched.sum())
    return math.sqrt(max(_uncertainty(answer.P[_SHAPE, _SHAPE], answer.touched), 0.0) / felt) if felt else math.inf


def _as_sharp(P: FloatArray, spread: FloatArray, fusion: Fusion, touched: Marks) -> bool:
    """Whether covariance `P` tells the outline as well as the leader's does, where it has been touched.

    What the rig's constants leave open, `spread` of P, counts where the leader allows for it too: reading on, its
    filter becomes surer of the outline given these constants, but no surer of them.
    """
    left_open = spread[: len(P)] if fusion.allows_for_rig else np.zeros((len(P), 0))
    answered = (P + left_open @ left_open.T)[_SHAPE, _SHAPE]
    _, led = fusion.filters.outline(fusion.bank.best())
    return _uncertainty(answered, touched) <= _uncertainty(led, touched)


def _uncertainty(outline: FloatArray, touched: Marks) -> float:
    """Of h (m²), added up over the normals touched."""
    rows = bin_rows(len(outline))[touched]
    return float(((rows @ outline) * rows).sum())


def _turned(x: FloatArray, P: FloatArray, spread: FloatArray, turn: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A state of `model.shape_map`, its covariance and its spread in a gauge in which ψ is larger by `turn` (rad)."""
    matrix = np.eye(len(x))
    matrix[_SHAPE, _SHAPE] = shape.turned(turn, (len(x) - shape_map.Z.SHAPE - 1) // 2)
    moved = matrix @ x
    moved[shape_map.Z.PSI] += turn
    return moved, matrix @ P @ matrix.T, np.vstack([matrix @ spread[: len(x)], spread[len(x) :]])
