"""Decision whether the object on the palms is the last one, put back, or a new one.

Most filters of the bank start from the stored map of the last object, the rest blind, and the readings decide between
them. Until then no estimate is valid, so that the published object count does not change back and forth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.bank import Belief
from palmd.observer.coverage import Coverage, contact_bins
from palmd.observer.filters.base import Filters
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.fusion import Fusion, Pruning
from palmd.observer.hypotheses import Verdict
from palmd.observer.mass import MassEstimator, resting_forces
from palmd.observer.object_memory import KnownObject, ObjectMemory
from palmd.observer.track import Track
from palmd.system.arcs import tangents
from palmd.system.description import RigDescription
from palmd.system.mechanism import PALMS

KNOWN_SHARE = 0.75  # share of the bank that starts from the stored object
PRIOR_AGE_S = 4.0  # added age of these filters, for slower forgetting
LOOKED_AT_S, UNDECIDED_S = 0.5, 3.0  # age of the track at which the candidate is rejected: clear case, open case
BAYES_FACTOR = 3.0  # nats by which blind filters must lead for a clear case
SAME_POSE_RAD = 0.1  # largest difference of ψ in the same pose


class SmoothedFilters(NamedTuple):
    """Filters for objects confirmed by a smoother: a bank to find a `known` object, and a `single` one to track it."""

    known: ShapeFilters
    single: ShapeFilters


class ReturningObject:
    """Hypotheses of an observer that remembers the last object; `candidate`: that object, while it may be back."""

    pruning = Pruning(margin=100.0, age_s=4.0)  # no filter recovers from there
    one_gauge = False

    def __init__(self, rig: RigDescription, blind: Filters, smoothed: SmoothedFilters | None = None):
        """`smoothed`: for an observer with a smoother."""
        self._rig = rig
        self._blind = blind
        self._smoothed = smoothed
        self.reset()

    @property
    def banks(self) -> Sequence[Filters]:
        """All banks that are used; the one for unknown objects first."""
        return [self._blind, *(self._smoothed or ())]

    def reset(self) -> None:
        """Back to the initial state, as if there had been no object."""
        self.memory = ObjectMemory()
        self.candidate: KnownObject | None = None

    def choose(self) -> Filters:
        """The bank for the next object."""
        known = self.memory.recall()
        return self._smoothed.known if self._smoothed and known and known.smoothed else self._blind

    def begin(self, track: Track, t: float) -> bool:
        """Start the bank's first filters from the stored map, at the likeliest orientations; False if there is one."""
        rig, fusion, bank = self._rig, track.fusion, track.fusion.bank
        self._rough_mass = MassEstimator(rig.pads)
        count = int(bank.full_size // bank.block * KNOWN_SHARE) * bank.block
        known = self.candidate = self.memory.recall() if count else None
        if known is not None:
            psi = known.orientations(track.first_contacts, track.palms, rig, count)
            fusion.filters.start_known(known.x, known.prior_covariance(), psi, fusion.palms, t)
            fusion.forgetting.prior_age_s[:count] = PRIOR_AGE_S
        # a map confirmed by a smoother has been linearised well: only blind filters have to forget
        fusion.forgetting.begin(t, everywhere=known is None or not known.smoothed)
        return known is None

    def constants(self, track: Track) -> Belief:
        """The prior of each filter's constants at the start."""
        return track.fusion.filters.constants(track.start)

    def renumber(self, kept: npt.NDArray[np.intp]) -> None:
        """Nothing to do: a filter's prior age identifies its hypothesis."""

    def decide(self, track: Track, t: float, settled: bool) -> Verdict:
        """Accept or reject that the object is the candidate; decided at once without a candidate."""
        known, fusion, bank = self.candidate, track.fusion, track.fusion.bank
        if known is None:
            return Verdict.DECIDED
        joints: Sequence[float] = fusion.palms.at(t)[: len(PALMS)].tolist()
        if self._rig.curved:
            joints = tangents(joints, track.first_contacts, self._rig.curvatures)
        for pad, f in zip(PALMS, resting_forces(self._rig.gravity, joints), strict=True):
            self._rough_mass.weigh(track.contacts.last(pad), f)
        best, blind = bank.best(), fusion.forgetting.prior_age_s == 0.0
        likely = not blind[best]
        x, P = fusion.filters.belief(best)
        matches = known.matches_mass(self._rough_mass.value) and (not likely or known.matches_outline(x))
        if likely and matches and (not known.smoothed or _touches_known_part(known, fusion, best)):
            if not settled or (known.smoothed and not (_one_pose(fusion, best) or track.age(t) > UNDECIDED_S)):
                return Verdict.OPEN
            self.accept(track)
            if known.spread is not None and self._smoothed is not None:
                track.use_single_filter(self._smoothed.single, x, P, float(bank.nis[best]), known.touched, known.spread)
            else:
                track.coverage = Coverage(known.touched, best, self._rig.curvatures)
                bank.drop(blind)
            return Verdict.DECIDED
        clear = not matches or _largest(bank.score[blind]) - _largest(bank.score[~blind]) > BAYES_FACTOR
        if track.age(t) <= (LOOKED_AT_S if clear else UNDECIDED_S):
            return Verdict.OPEN
        self.memory.forget()
        return Verdict.REJECTED

    def accept(self, track: Track) -> None:
        """Take the candidate, if there is one, for the present object."""
        if self.candidate is not None:
            track.mass, track.flat_side_test = (
                self.candidate.mass,
                self.candidate.flat_side_test or track.flat_side_test,
            )
            self.candidate = None

    def keep(self, track: Track, t: float) -> None:
        """Store the map, for when the object is lost and put back."""
        if self.memory.due(t):
            filters = track.fusion.filters
            x, P = filters.belief(filters.bank.best())
            touched = track.coverage.marks.copy()
            self.memory.keep(t, KnownObject(x, P, touched, track.mass, filters.spread, track.flat_side_test))

    def lost(self, track: Track) -> None:
        """Drop the stored map if the lost track started from it, or if no smoother confirmed the track."""
        if track.fusion.forgetting.prior_age_s.any() or (self._smoothed and not track.fusion.uses_smoothed_filter):
            self.memory.forget()

    def identify(self, t: float, object_count: int) -> None:
        """None: there are no stored outlines."""


def _largest(scores: FloatArray) -> float:
    """The maximum; −∞ where pruning has left no filter of the kind."""
    return float(scores.max(initial=-math.inf))


def _touches_known_part(known: KnownObject, fusion: Fusion, best: int) -> bool:
    """Whether the likeliest filter's contacts are where the known outline was touched; elsewhere any outline fits."""
    return bool(known.touched[contact_bins(fusion.named()[best], fusion.curvatures)].all())


def _one_pose(fusion: Fusion, best: int) -> bool:
    """Whether the plausible filters that started from the stored map agree on the orientation."""
    rivals = [member for member in fusion.rivals() if fusion.forgetting.prior_age_s[member] > 0.0]
    psi = fusion.psi()
    difference = np.remainder(psi[rivals] - psi[best] + math.pi, math.tau) - math.pi
    return bool(np.abs(difference).max() < SAME_POSE_RAD)
