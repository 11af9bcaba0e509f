"""Objects whose outlines are stored: where one lies and how it moves, and which of them it is, if any.

The case of Jia & Erdmann, in which the shape is known and pose and motion are sought. The bank's filters begin with
the stored outlines, at the orientations that fit the first two readings. By Bayes' rule the likelihood of all readings
since then, summed over the filters of an outline, gives its probability. "None of these" is another object of the
same sort: once the likeliest filters have found their pose, each gets a twin that believes the same except that its
outline may deviate. A twin foresees worse as long as it does not need that freedom, and better from when it does. So
is a filter whose outline the readings have bent beyond what is believed of it. ψ is that of the stored outline's own
frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray, ObjectEstimate
from palmd.model.compiled import LANES
from palmd.observer.bank import Bank, Belief
from palmd.observer.filters.base import Filters
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.fusion import PLAUSIBLE, Pruning
from palmd.observer.hypotheses import Verdict
from palmd.observer.outline_prior import MOST_STARTS, deviation_variance, stored
from palmd.observer.track import Track
from palmd.observer.validity import identified, surprised
from palmd.outlinefile import Outline
from palmd.system.description import RigDescription

BANK = 96  # filters at most: what a tick has time for
TWINS, TWIN_AGE_S = 16, 0.6
NONE = 0.2  # the probability of "none of these" before anything is felt


class Recogniser:
    """Hypotheses of an observer with stored outlines: a bank of shape maps that begins with them.

    An estimate is valid only once it is all but sure which of the outlines it is, and never when it is none.
    """

    pruning = Pruning(margin=40.0, age_s=0.3)  # all filters begin with the truth, if it is in them: they part soon
    one_gauge = True

    def __init__(self, outlines: Sequence[Outline], rig: RigDescription):
        """Raises ValueError when there is no outline."""
        self._stored = stored(outlines)
        self._rig = rig
        size = min(BANK, math.ceil(MOST_STARTS * len(outlines) / LANES) * LANES)
        self.filters = ShapeFilters(rig, size, memory_s=math.inf)
        self.reset()

    @property
    def banks(self) -> Sequence[Filters]:
        """The only one."""
        return [self.filters]

    def reset(self) -> None:
        """As if no object had ever been felt."""
        self._twinned = self._sure = False
        self._which = np.zeros(self.filters.bank.full_size, dtype=np.intp)  # of each filter, its outline
        self._twin = np.zeros(self.filters.bank.full_size, dtype=np.bool_)

    def choose(self) -> Filters:
        """The only bank."""
        return self.filters

    def begin(self, track: Track, t: float) -> bool:
        """Let all filters begin with stored outlines; always a new object."""
        self.reset()
        bank = self.filters.bank
        starts = self._stored.starts(track.first_contacts, track.palms, self._rig, bank.size)
        self.filters.start_known(starts.x, starts.P, starts.psi, track.fusion.palms, t)
        bank.drop(np.arange(bank.size) >= len(starts.which))
        self._which = np.resize(starts.which, bank.size)
        track.fusion.forgetting.begin(t, everywhere=True)
        return True

    def constants(self, track: Track) -> Belief:
        """What is stored, and of twins how far they may deviate."""
        belief = self.filters.constants(track.start)
        variance = np.diagonal(self._stored.P, axis1=1, axis2=2)[self._which]
        variance = variance + np.outer(self._twin, deviation_variance(track.start.mean_radius))
        return Belief(belief.which, self._stored.x[self._which], np.sqrt(variance))

    def renumber(self, kept: npt.NDArray[np.intp]) -> None:
        """The bank has been pruned: the former numbers of the filters that stay."""
        self._which, self._twin = self._which[kept], self._twin[kept]

    def decide(self, track: Track, t: float, settled: bool) -> Verdict:
        """Decided once it is all but sure which outline the likeliest filter has."""
        del settled  # sure or not, whatever the estimate is like
        if not self._twinned:
            if track.age(t) > TWIN_AGE_S:
                self._begin_twins(track)
            return Verdict.OPEN
        bank = self.filters.bank
        best = bank.best()
        probability = 0.0 if self._other(bank)[best] else float(self._probability(bank)[self._which[best]])
        self._sure = identified(probability, self._sure)
        return Verdict.DECIDED if self._sure else Verdict.OPEN

    def keep(self, track: Track, t: float) -> None:
        """There is nothing to remember: what is known is stored."""

    def lost(self, track: Track) -> None:
        """It is begun with what is stored again."""

    def identify(self, t: float, object_count: int) -> ObjectEstimate | None:
        """Which object it is at `t` (s)."""
        probability = self._probability(self.filters.bank)
        return ObjectEstimate(t, self._stored.names, probability[:-1], float(probability[-1]), object_count)

    def _begin_twins(self, track: Track) -> None:
        """The likeliest filters' twins take the places of the least likely."""
        bank = self.filters.bank
        order = np.argsort(-bank.score, kind="stable")
        likely = order[bank.score[order] > bank.score[order[0]] - PLAUSIBLE][: min(TWINS, bank.size // 2)]
        places = order[::-1][: len(likely)]
        bank.x[places] = bank.x[likely]
        bank.P[places] = bank.P[likely] + np.diag(deviation_variance(track.start.mean_radius))
        bank.score[places], bank.nis[places] = bank.score[likely], bank.nis[likely]
        self._which[places], self._twin[places] = self._which[likely], True
        self._twinned = True
        track.fusion.history.clear()

    def _probability(self, bank: Bank) -> FloatArray:
        """Of each outline, and of none of them (count + 1); sums to 1."""
        count = len(self._stored.names)
        if surprised(float(bank.nis[bank.best()])):
            return np.append(np.zeros(count), 1.0)
        likelihood = np.exp(bank.score - bank.score.max())
        other = self._other(bank)
        own, others = np.where(other, 0.0, likelihood), np.where(other, likelihood, 0.0)
        if not self._twinned:
            own = others = likelihood  # what is still to part says nothing of none
        weighted = np.append((1.0 - NONE) * np.bincount(self._which, own, count), NONE * others.sum())
        probability: FloatArray = weighted / weighted.sum()
        return probability

    def _other(self, bank: Bank) -> npt.NDArray[np.bool_]:
        """Which filters are of none of the outlines: twins, and those whose outline has strayed from what is stored."""
        return self._twin | self._stored.contradicts(self._which, bank.x)
