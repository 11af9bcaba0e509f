"""One object's events fused into the bank in use, each at its own time; a late one goes back for its place."""

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
from palmd.observer.compiled_fusion import CompiledHistory, CompiledPalms
from palmd.observer.filters.base import Filters
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.forgetting import SURPRISING_NIS, Forgetting
from palmd.observer.history import Fused, History
from palmd.observer.prior import BlindStart
from palmd.system.description import RigDescription

# Palms not reported for longer are not known: a controller that does not track is asked each 0.1 s only.
PALMS_UNKNOWN_S = 0.15
UNTOLD_S = 0.025  # of a cycle of 16 ms: where no plan is told, a stop turns palms by degrees in a tenth of a second
# The first readings are fused about a blind guess: they weigh little at first.
EARLY_NOISE, EARLY_S = 20.0, 0.3
PLAUSIBLE = 12.0  # nats below the best
_PSI = NAMED.index("psi")


@dataclass(frozen=True, slots=True)
class Pruning:
    """Which hypotheses are dropped: those so many nats behind the best, once the track is so old."""

    margin: float
    age_s: float


class Beliefs(Protocol):
    """What fusion asks of the hypotheses about which object it is."""

    @property
    def pruning(self) -> Pruning:
        """Which filters are dropped."""

    def constants(self) -> Belief:
        """What was believed of each filter's constants at the start."""

    def renumber(self, kept: npt.NDArray[np.intp]) -> None:
        """The bank has been pruned: the former numbers of the filters that stay."""


class Fusion:
    """See the module; `add` takes bounded time and is safe inside the loop.

    Events of compiled shape maps are fused in C (`compiled_fusion.CompiledHistory`), others here, by the same rules.
    """

    def __init__(self, rig: RigDescription, banks: Sequence[Filters]):
        """`banks` are all that will ever be used, the first one at first."""
        self._rig = rig
        self._variances = rig.reading_variances
        self.curvatures = rig.curvatures
        self._first = banks[0]
        compiled = [each.compiled for each in banks if isinstance(each, ShapeFilters) and each.compiled is not None]
        self.history: History | CompiledHistory = (
            CompiledHistory(compiled, self._variances)
            if len(compiled) == len(banks)
            else History([filters.bank for filters in banks])
        )
        self.reset()

    def reset(self) -> None:
        """As if nothing had been fed."""
        self.palms = self._first.tracker(self._rig.palm_angle_noise)
        self._foreseen_s = 0.0
        self.late_dropped = 0
        self.t, self.t_start = -math.inf, math.inf
        self._use(self._first)

    @property
    def t(self) -> float:
        """Up to when the bank has been moved (s)."""
        return self.history.now.t

    @t.setter
    def t(self, t: float) -> None:
        self.history.now.t = t

    @property
    def t_start(self) -> float:
        """When the present track was begun (s)."""
        return self.history.now.t_start

    @t_start.setter
    def t_start(self, t: float) -> None:
        self.history.now.t_start = t

    @property
    def bank(self) -> Bank:
        """The bank in use."""
        return self.filters.bank

    @property
    def carries(self) -> bool:
        """Whether one filter carries to the present what a smoother knows; else a bank looks for the object."""
        return self.filters.spread is not None

    @property
    def allows_for_rig(self) -> bool:
        """Whether a smoother has told what the rig's constants leave open, and what is read off has it."""
        return self.carries or self.filters.left_open is not None

    def palms_known(self, t: float) -> bool:
        """Whether the palms were reported so shortly before `t` (s) that their motion is foreseen."""
        return t - self.palms.t < self._foreseen_s

    def hear_palms(self, report: PalmSample) -> None:
        """A report of the palms: foreseen is what their plan tells, or what one report soon after another does."""
        follows = 0.0 <= report.t_sample - self.palms.t < UNTOLD_S
        if report.t_sample >= self.palms.t:
            told = report.accelerations is not None
            self._foreseen_s = PALMS_UNKNOWN_S if told else UNTOLD_S if follows else 0.0
        self.palms.feed(report)

    # ---- what the filters begin with

    def begin(self, filters: Filters, start: BlindStart, beliefs: Beliefs, t: float) -> None:
        """A new track at `t` (s): every filter blind, until `beliefs` begins some of them otherwise."""
        self._use(filters)
        self._beliefs = beliefs
        filters.start(start, self.palms, t)
        self.t = self.t_start = t

    def lead_with(self, filters: Filters, x: FloatArray, P: FloatArray, nis: float) -> None:
        """One filter takes the place of all others."""
        self._use(filters)
        bank = filters.bank
        bank.x[0], bank.P[0], bank.nis[0] = x, P, nis

    def _use(self, filters: Filters) -> None:
        self.filters = filters
        filters.bank.refill()
        self.forgetting = Forgetting(filters.bank)
        if isinstance(self.history, History):
            self.history.use(filters.bank)
        elif isinstance(filters, ShapeFilters) and filters.compiled is not None:
            self.history.use(filters.compiled, self.forgetting.t_faded, not self.carries)

    # ---- events

    def bridge(self, t: float, gap: float) -> None:
        """The palms are reported again at `t` (s) after `gap` seconds: go on from a guess of what was between."""
        self.history.clear()
        if t > self.t:
            self._move_to(t, self._repeated)
        self.filters.inflate(gap)

    def add(self, event: PadSample | PalmSample) -> None:
        """Fuse one event; one too late for that is counted and dropped, and so is one from before the track."""
        if isinstance(event, PalmSample) and not self.filters.fuses_palms:
            return
        if event.t_sample < self.t_start:
            return
        if not (self._add(event, self.history) if isinstance(self.history, History) else self._add_compiled(event)):
            self.late_dropped += 1

    def _add_compiled(self, event: PadSample | PalmSample) -> bool:
        filters, palms, history = self.filters, self.palms, self.history
        assert isinstance(event, PadSample)
        assert isinstance(filters, ShapeFilters)
        assert isinstance(palms, CompiledPalms)
        assert isinstance(history, CompiledHistory)
        return history.add(event, filters.compiled_rig, palms, self._forget)

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
            inflation = 1.0 if self.carries else 1.0 + EARLY_NOISE * math.exp(-age / EARLY_S)
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
        self.filters.carry(self.t, t, self.palms, repeated)
        self.t = t

    @property
    def _repeated(self) -> float:
        """Of how many readings of the present place one is; of 1 where they surprise: the object has been moved."""
        surprised = self.bank.nis[self.bank.best()] > SURPRISING_NIS
        return 1.0 if surprised else self.palms.repeated

    def make_convex(self, block: int) -> bool:
        """Whether the outlines of a block's filters are; those that are not are bent towards it."""
        return self.bank.lift(block, self.filters.curvature)

    # ---- reading off

    def is_convex(self, member: int) -> bool:
        """Whether one filter's outline is."""
        return not self.bank.falls_below(member, self.filters.curvature)

    def named(self) -> FloatArray:
        """Values of `NAMED` of every filter at `t`, (size, len(NAMED)); overwritten by the next call."""
        return self.filters.all_named(self.t, self.palms)

    def disagreement(self, one_gauge: bool) -> list[float] | None:
        """One-sigma of the answers of `NAMED` of the best filter's rivals about its own, weighted by likelihood.

        None where it has no rival. ψ counts, the short way round, of filters that have `one_gauge` alone.
        """
        filters, palms = self.filters, self.palms
        if filters.bank.size == 1:
            return None
        if isinstance(filters, ShapeFilters) and filters.compiled is not None and isinstance(palms, CompiledPalms):
            return filters.compiled.disagreement(filters.compiled_rig, palms, self.t, PLAUSIBLE, one_gauge)
        rivals, best, score = self.rivals(), self.bank.best(), self.bank.score
        if len(rivals) == 1:
            return None
        answers = self.named()
        apart, weights = answers[rivals] - answers[best], np.exp(score[rivals] - score[best])
        turned = apart[:, _PSI]
        apart[:, _PSI] = np.remainder(turned + math.pi, math.tau) - math.pi if one_gauge else 0.0
        spread: list[float] = np.sqrt(weights @ apart**2 / weights.sum()).tolist()
        return spread

    def psi(self) -> FloatArray:
        """ψ of every filter (rad)."""
        return self.named()[:, _PSI]

    def rivals(self) -> npt.NDArray[np.intp]:
        """The filters that are not much less likely than the best, which is among them."""
        return self.bank.plausible(PLAUSIBLE)
