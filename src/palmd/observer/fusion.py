"""Fusion of one object's events into the bank in use, each at its own time; late events are fused retroactively."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray, PadSample, PalmSample
from palmd.model.outputs import NAMED
from palmd.observer.bank import Bank, Belief
from palmd.observer.compiled_fusion import CompiledBank, CompiledHistory
from palmd.observer.filters.base import Filters
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.forgetting import HIGH_NIS, Forgetting
from palmd.observer.history import Fused, History
from palmd.observer.pad_map import shared_readings
from palmd.observer.prior import BlindStart
from palmd.system.description import RigDescription

PALMS_UNKNOWN_S = 0.15  # longest age of a report by which palm motion is known; without tracking one comes each 0.1 s
UNPLANNED_S = 0.025  # the same without a plan (cycle 16 ms): a stop turns palms by degrees within 0.1 s
# The first readings are linearised about a blind guess: their variance is inflated by 1 + EARLY_NOISE at first.
EARLY_NOISE, EARLY_S = 20.0, 0.3
PLAUSIBLE = 12.0  # nats below the best score, within which a filter is a rival
_PSI = NAMED.index("psi")


@dataclass(frozen=True, slots=True)
class Pruning:
    """Filters are dropped if their score is `margin` nats below the best, once the track is `age_s` old."""

    margin: float
    age_s: float


class Beliefs(Protocol):
    """What fusion needs to know of the hypotheses about the object's identity."""

    @property
    def pruning(self) -> Pruning:
        """Which filters are dropped."""

    def constants(self) -> Belief:
        """The prior of each filter's constants at the start."""

    def renumber(self, kept: npt.NDArray[np.intp]) -> None:
        """Adapt to a pruned bank; `kept`: former indices of the remaining filters."""


class Fusion:
    """See the module; `add` takes bounded time and is safe inside the loop.

    Shape maps fuse events in C (`compiled_fusion.CompiledHistory`), other filters here, by the same rules.
    """

    def __init__(self, rig: RigDescription, banks: Sequence[Filters]):
        """`banks`: all banks that will be used; the first is used first."""
        self._rig = rig
        self._variances = rig.reading_variances
        self.curvatures = rig.curvatures
        self._first = banks[0]
        compiled = [filters.bank for filters in banks if isinstance(filters.bank, CompiledBank)]
        self.history: History | CompiledHistory = (
            CompiledHistory(compiled, self._variances, shared_readings(rig))
            if compiled
            else History([filters.bank for filters in banks])
        )
        self.reset()

    def reset(self) -> None:
        """Back to the initial state, as if nothing had been fed."""
        self.palms = self._first.tracker(self._rig.palm_angle_noise)
        self._predictable_s = 0.0
        self.late_dropped = 0
        self.t, self.t_start = -math.inf, math.inf
        self._use(self._first)

    @property
    def t(self) -> float:
        """Time of the bank's state (s)."""
        return self.history.now.t

    @t.setter
    def t(self, t: float) -> None:
        self.history.now.t = t

    @property
    def t_start(self) -> float:
        """When the present track was started (s)."""
        return self.history.now.t_start

    @t_start.setter
    def t_start(self, t: float) -> None:
        self.history.now.t_start = t

    @property
    def bank(self) -> Bank:
        """The bank in use."""
        return self.filters.bank

    @property
    def uses_smoothed_filter(self) -> bool:
        """Whether a single filter propagates an established smoother's estimate to the present, instead of a bank."""
        return self.filters.spread is not None

    @property
    def includes_rig_uncertainty(self) -> bool:
        """Whether outputs include the uncertainty due to the rig's constants, as estimated by a smoother."""
        return self.uses_smoothed_filter or self.filters.provisional_spread is not None

    def palms_known(self, t: float) -> bool:
        """Whether the last report of the palms is recent enough to predict their motion at `t` (s)."""
        return t - self.palms.t < self._predictable_s

    def add_palm_report(self, report: PalmSample) -> None:
        """Take a report of the palms. Their motion can be predicted from a plan, or from two reports in a row."""
        consecutive = 0.0 <= report.t_sample - self.palms.t < UNPLANNED_S
        if report.t_sample >= self.palms.t:
            planned = report.accelerations is not None
            self._predictable_s = PALMS_UNKNOWN_S if planned else UNPLANNED_S if consecutive else 0.0
        self.palms.feed(report)

    # ---- initial states

    def begin(self, filters: Filters, start: BlindStart, beliefs: Beliefs, t: float) -> None:
        """Start a new track at `t` (s) with blind filters; the hypotheses may re-initialise some of them afterwards."""
        self._use(filters)
        self._beliefs = beliefs
        filters.start(start, self.palms, t)
        self.t = self.t_start = t

    def use_single_filter(self, filters: Filters, x: FloatArray, P: FloatArray, nis: float) -> None:
        """Replace the bank by a single filter with this state, covariance and mean NIS."""
        self._use(filters)
        bank = filters.bank
        bank.x[0], bank.P[0], bank.nis[0] = x, P, nis

    def _use(self, filters: Filters) -> None:
        self.filters = filters
        filters.bank.refill()
        self.forgetting = Forgetting(filters.bank)
        if isinstance(self.history, History):
            self.history.use(filters.bank)
        else:
            assert isinstance(filters.bank, CompiledBank)
            self.history.use(filters.bank, self.forgetting.t_faded, not self.uses_smoothed_filter)

    # ---- events

    def bridge(self, t: float, gap: float) -> None:
        """Continue at `t` (s) after `gap` seconds without a report of the palms, whose motion is guessed in between."""
        self.history.clear()
        if t > self.t:
            self._move_to(t, self._repeated)
        self.filters.inflate(gap)

    def add(self, event: PadSample | PalmSample) -> None:
        """Fuse one event. If it is too late it is counted and dropped; if it is from before the track it is ignored."""
        if isinstance(event, PalmSample) and not self.filters.fuses_palms:
            return
        if event.t_sample < self.t_start:
            return
        if isinstance(self.history, History):
            added = self._add(event, self.history)
        else:
            assert isinstance(event, PadSample)
            assert isinstance(self.filters, ShapeFilters)
            added = self.history.add(event, self.filters.compiled_rig, self.palms, self._forget)
        self.late_dropped += not added

    def _add(self, event: PadSample | PalmSample, history: History) -> bool:
        if event.t_sample >= self.t:
            self._fuse(event, history)
            return True
        undone = history.undo(event.t_sample, self.bank)
        if undone is None:
            return False
        self.t, self.forgetting.t_faded[:] = undone[0].t_before, undone[0].t_faded
        for each in (event, *(entry.event for entry in undone)):
            self._fuse(each, history)
        return True

    def _fuse(self, event: PadSample | PalmSample, history: History) -> None:
        before = history.snapshot()
        self.bank.remember(before)
        history.add(Fused(event.t_sample, event, self.t, self.forgetting.t_faded.copy(), before))
        repeated = self._repeated
        self._move_to(event.t_sample, repeated)
        block = self.forgetting.due(self.bank, self.t, self.t - self.t_start)
        if block is not None:
            self._forget(block, repeated)
        if isinstance(event, PadSample):
            age = event.t_sample - self.t_start
            inflation = 1.0 if self.uses_smoothed_filter else 1.0 + EARLY_NOISE * math.exp(-age / EARLY_S)
            self.filters.fuse_pad(event, inflation * float(self._variances[event.pad - 1]), self.palms, repeated)
        else:
            self.filters.fuse_palms(event, self._rig.palm_angle_noise**2)

    def _forget(self, block: int, repeated: float) -> None:
        age = self.t - self.t_start
        self.forgetting.forget(self.bank, block, self.t, age, repeated, self._beliefs.constants())
        self.make_convex(block)
        kept = self.bank.prune(self._beliefs.pruning.margin) if age > self._beliefs.pruning.age_s else None
        if kept is not None:
            self.history.clear()
            self.forgetting.prior_age_s = self.forgetting.prior_age_s[kept]
            self._beliefs.renumber(kept)

    def _move_to(self, t: float, repeated: float) -> None:
        self.filters.propagate(self.t, t, self.palms, repeated)
        self.t = t

    @property
    def _repeated(self) -> float:
        """How many readings share one error; 1 if the NIS is high, since then the object has been moved."""
        moved = self.bank.nis[self.bank.best()] > HIGH_NIS
        return 1.0 if moved else self.palms.repeated

    def make_convex(self, block: int) -> bool:
        """Impose convexity on the outlines of a block's filters; returns whether all were convex already."""
        return self.bank.impose_nonnegative(block, self.filters.curvature)

    # ---- outputs

    def is_convex(self, member: int) -> bool:
        """Whether one filter's outline is convex."""
        return not self.bank.falls_below(member, self.filters.curvature)

    def named(self) -> FloatArray:
        """Values of `NAMED` of every filter at `t`, (size, len(NAMED)); overwritten by the next call."""
        return self.filters.all_named(self.t, self.palms)

    def disagreement(self, one_gauge: bool) -> list[float] | None:
        """RMS difference of the rivals' values of `NAMED` from the best filter's, weighted by likelihood.

        None if there is no rival. ψ is compared (modulo 2π) only if all filters have `one_gauge`.
        """
        filters = self.filters
        if filters.bank.size == 1:
            return None
        if isinstance(filters, ShapeFilters) and isinstance(filters.bank, CompiledBank):
            return filters.bank.disagreement(filters.compiled_rig, self.palms, self.t, PLAUSIBLE, one_gauge)
        rivals, best, score = self.rivals(), self.bank.best(), self.bank.score
        if len(rivals) == 1:
            return None
        values = self.named()
        difference, weights = values[rivals] - values[best], np.exp(score[rivals] - score[best])
        turned = difference[:, _PSI]
        difference[:, _PSI] = np.remainder(turned + math.pi, math.tau) - math.pi if one_gauge else 0.0
        rms: list[float] = np.sqrt(weights @ difference**2 / weights.sum()).tolist()
        return rms

    def psi(self) -> FloatArray:
        """ψ of every filter (rad)."""
        return self.named()[:, _PSI]

    def rivals(self) -> npt.NDArray[np.intp]:
        """Indices of the filters within `PLAUSIBLE` nats of the best, which is among them."""
        return self.bank.plausible(PLAUSIBLE)
