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

from palmd.events import DECIDED, FloatArray, ObjectEstimate, PalmMotion
from palmd.model.compiled import BLOCK
from palmd.model.outputs import NAMED
from palmd.observer.bank import Belief
from palmd.observer.bank_observer import NIS_RANGE, PLAUSIBLE, BankObserver
from palmd.observer.filters import ShapeFilters
from palmd.observer.outline_prior import MOST_STARTS, kin_variance, stored
from palmd.outlinefile import Outline
from palmd.system.description import RigDescription

BANK = 96  # filters at most: what a tick has time for
TWINS, TWIN_AGE_S = 16, 0.6
NONE = 0.2  # the probability of "none of these" before anything is felt
SURE = 0.99  # the probability from which on an estimate may be valid, until it falls below `DECIDED`
HOPELESS, PRUNE_AGE_S = 40.0, 0.3  # all filters begin with the truth, if it is in them: they part soon
_PSI = NAMED.index("psi")


class Recogniser(BankObserver):
    """A bank of shape maps that begins with stored outlines; as safe inside the loop as its base.

    An estimate is valid only once it is all but sure which of the outlines it is, and never when it is none.
    """

    def __init__(self, outlines: Sequence[Outline], rig: RigDescription, seed: int = 0):
        """Raises ValueError when there is no outline."""
        self._stored = stored(outlines)
        size = min(BANK, math.ceil(MOST_STARTS * len(outlines) / BLOCK) * BLOCK)
        super().__init__(ShapeFilters(rig, size, memory_s=math.inf), rig, seed)

    def identify(self, t: float) -> ObjectEstimate | None:
        """Which object it is at `t` (s), None while there is none."""
        if not self._running or self._bank.lost():
            return None
        probability = self._probability()
        return ObjectEstimate(t, self._stored.names, probability[:-1], float(probability[-1]), self.object_count)

    # ---- how it begins

    def _begin_fresh(self) -> None:
        super()._begin_fresh()
        self._twinned = self._sure = False

    def _start_known(self, s1: float, s2: float, palms: PalmMotion, t: float) -> None:
        self.object_count += 1
        starts = self._stored.starts((s1, s2), palms, self._pad_variances, self._bank.size)
        self._filters.start_known(starts.x, starts.P, starts.psi, self._palms, t)
        self._bank.drop(np.arange(self._bank.size) >= len(starts.which))
        self._which = np.resize(starts.which, self._bank.size)
        self._twin = np.zeros(self._bank.size, dtype=np.bool_)

    def _begin_twins(self) -> None:
        """The likeliest filters' twins take the places of the least likely."""
        bank = self._bank
        order = np.argsort(-bank.score, kind="stable")
        likely = order[bank.score[order] > bank.score[order[0]] - PLAUSIBLE][: min(TWINS, bank.size // 2)]
        places = order[::-1][: len(likely)]
        bank.x[places] = bank.x[likely]
        bank.P[places] = bank.P[likely] + np.diag(kin_variance(self._start.mean_radius))
        bank.score[places], bank.nis[places] = bank.score[likely], bank.nis[likely]
        self._which[places], self._twin[places] = self._which[likely], True
        self._twinned = True
        self._forget_history()

    # ---- which it is

    def _probability(self) -> FloatArray:
        """Of each outline, and of none of them (count + 1); sums to 1."""
        bank, count = self._bank, len(self._stored.names)
        if bank.nis[bank.best()] > NIS_RANGE[1]:
            return np.append(np.zeros(count), 1.0)  # nothing here foresees the readings
        likelihood = np.exp(bank.score - bank.score.max())
        other = self._other()
        own, others = np.where(other, 0.0, likelihood), np.where(other, likelihood, 0.0)
        if not self._twinned:
            own = others = likelihood  # what is still to part says nothing of none
        weighted = np.append((1.0 - NONE) * np.bincount(self._which, own, count), NONE * others.sum())
        probability: FloatArray = weighted / weighted.sum()
        return probability

    def _other(self) -> npt.NDArray[np.bool_]:
        """Which filters are of none of the outlines: twins, and those whose outline has strayed from what is stored."""
        return self._twin | self._stored.strayed(self._which, self._bank.x)

    def _decided(self, t: float, best: int, settled: bool) -> bool:
        if not self._twinned:
            if t - self._t_start > TWIN_AGE_S:
                self._begin_twins()
            return False
        probability = 0.0 if self._other()[best] else float(self._probability()[self._which[best]])
        self._sure = probability >= (DECIDED if self._sure else SURE)
        return settled and self._sure

    # ---- what is believed of it all along

    def _constants(self) -> Belief:
        belief = super()._constants()
        variance = np.diagonal(self._stored.P, axis1=1, axis2=2)[self._which]
        variance = variance + np.outer(self._twin, kin_variance(self._start.mean_radius))
        return Belief(belief.which, self._stored.x[self._which], np.sqrt(variance))

    def _prune(self, age: float) -> npt.NDArray[np.intp] | None:
        kept = self._bank.prune(HOPELESS) if age > PRUNE_AGE_S else None
        if kept is not None:
            self._which, self._twin = self._which[kept], self._twin[kept]
        return kept

    def _keep(self, t: float, best: int) -> None:
        """There is nothing to remember: what is known is stored."""

    def _apart(self, differences: FloatArray) -> FloatArray:
        differences[:, _PSI] = np.remainder(differences[:, _PSI] + math.pi, math.tau) - math.pi
        return differences
