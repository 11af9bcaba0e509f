"""Recognition of objects with stored outlines: pose, motion, and which of the outlines the object has, if any.

The case of Jia & Erdmann, in which the shape is known, and pose and motion are estimated. The bank's filters start with
the stored outlines, at the orientations that fit the first two readings. By Bayes' rule the likelihood of all readings
since then, summed over the filters of an outline, gives its probability. "None of these" is an unknown object of the
same sort: once the likeliest filters have converged to a pose, each gets a twin with the same state whose outline may
deviate. A twin predicts worse as long as it does not need that freedom, and better when it does. A filter whose outline
has moved beyond its prior also counts as "none". ψ refers to the stored outline's own frame.
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
from palmd.observer.validity import fails_innovation_test, identified
from palmd.outlinefile import Outline
from palmd.system.description import RigDescription

BANK = 96  # filters at most, limited by the time of a tick
TWINS, TWIN_AGE_S = 16, 0.6  # number of twins, and age of the track (s) when they are made
NONE = 0.2  # prior probability of "none of these"


class Recogniser:
    """Hypotheses of an observer with stored outlines: a bank of shape maps that starts from them.

    An estimate is valid only once the outline is identified, and never if it is none of the stored ones.
    """

    pruning = Pruning(margin=40.0, age_s=0.3)  # filters start from exact outlines, so that wrong ones fall behind soon
    one_gauge = True

    def __init__(self, outlines: Sequence[Outline], rig: RigDescription):
        """Raises ValueError if there is no outline."""
        self._stored = stored(outlines)
        self._rig = rig
        size = min(BANK, math.ceil(MOST_STARTS * len(outlines) / LANES) * LANES)
        self.filters = ShapeFilters(rig, size, memory_s=math.inf)
        self.reset()

    @property
    def banks(self) -> Sequence[Filters]:
        """The only bank."""
        return [self.filters]

    def reset(self) -> None:
        """Back to the initial state, as if there had been no object."""
        self._twinned = self._identified = False
        self._which = np.zeros(self.filters.bank.full_size, dtype=np.intp)  # index of each filter's outline
        self._twin = np.zeros(self.filters.bank.full_size, dtype=np.bool_)

    def choose(self) -> Filters:
        """The only bank."""
        return self.filters

    def begin(self, track: Track, t: float) -> bool:
        """Start all filters from stored outlines; returns True: always a new object."""
        self.reset()
        bank = self.filters.bank
        starts = self._stored.starts(track.first_contacts, track.palms, self._rig, bank.size)
        self.filters.start_known(starts.x, starts.P, starts.psi, track.fusion.palms, t)
        bank.drop(np.arange(bank.size) >= len(starts.which))
        self._which = np.resize(starts.which, bank.size)
        track.fusion.forgetting.begin(t, everywhere=True)
        return True

    def constants(self, track: Track) -> Belief:
        """The stored outlines as priors; those of twins with the variance of their deviation."""
        belief = self.filters.constants(track.start)
        variance = np.diagonal(self._stored.P, axis1=1, axis2=2)[self._which]
        variance = variance + np.outer(self._twin, deviation_variance(track.start.mean_radius))
        return Belief(belief.which, self._stored.x[self._which], np.sqrt(variance))

    def renumber(self, kept: npt.NDArray[np.intp]) -> None:
        """Adapt to a pruned bank; `kept`: former indices of the remaining filters."""
        self._which, self._twin = self._which[kept], self._twin[kept]

    def decide(self, track: Track, t: float, settled: bool) -> Verdict:
        """Decided once the outline of the likeliest filter is identified."""
        del settled  # identification does not depend on it
        if not self._twinned:
            if track.age(t) > TWIN_AGE_S:
                self._begin_twins(track)
            return Verdict.OPEN
        bank = self.filters.bank
        best = bank.best()
        probability = 0.0 if self._other(bank)[best] else float(self._probability(bank)[self._which[best]])
        self._identified = identified(probability, self._identified)
        return Verdict.DECIDED if self._identified else Verdict.OPEN

    def keep(self, track: Track, t: float) -> None:
        """Nothing to do: the outlines are stored."""

    def lost(self, track: Track) -> None:
        """Nothing to do: the next track starts from the stored outlines again."""

    def identify(self, t: float, object_count: int) -> ObjectEstimate | None:
        """Probabilities of the stored objects at `t` (s)."""
        probability = self._probability(self.filters.bank)
        return ObjectEstimate(t, self._stored.names, probability[:-1], float(probability[-1]), object_count)

    def _begin_twins(self, track: Track) -> None:
        """Replace the least likely filters by twins of the likeliest."""
        bank = self.filters.bank
        order = np.argsort(-bank.score, kind="stable")
        likely = order[bank.score[order] > bank.score[order[0]] - PLAUSIBLE][: min(TWINS, bank.size // 2)]
        slots = order[::-1][: len(likely)]
        bank.x[slots] = bank.x[likely]
        bank.P[slots] = bank.P[likely] + np.diag(deviation_variance(track.start.mean_radius))
        bank.score[slots], bank.nis[slots] = bank.score[likely], bank.nis[likely]
        self._which[slots], self._twin[slots] = self._which[likely], True
        self._twinned = True
        track.fusion.history.clear()

    def _probability(self, bank: Bank) -> FloatArray:
        """Probability of each outline, and of none of them (count + 1); sums to 1."""
        count = len(self._stored.names)
        if fails_innovation_test(float(bank.nis[bank.best()])):
            return np.append(np.zeros(count), 1.0)
        likelihood = np.exp(bank.score - bank.score.max())
        other = self._other(bank)
        own, others = np.where(other, 0.0, likelihood), np.where(other, likelihood, 0.0)
        if not self._twinned:
            own = others = likelihood  # before there are twins, nothing is known about "none"
        weighted = np.append((1.0 - NONE) * np.bincount(self._which, own, count), NONE * others.sum())
        probability: FloatArray = weighted / weighted.sum()
        return probability

    def _other(self, bank: Bank) -> npt.NDArray[np.bool_]:
        """Which filters have none of the outlines: twins, and those whose outline has left its prior."""
        return self._twin | self._stored.contradicts(self._which, bank.x)
