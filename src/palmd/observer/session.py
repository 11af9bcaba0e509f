"""Life cycle of the object on the palms: when a track is started, lost, and started again."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from palmd.observer.bank import Belief
from palmd.observer.contacts import GONE_S, Contacts
from palmd.observer.coverage import Coverage
from palmd.observer.fixed_mode_test import FixedModeTest
from palmd.observer.fusion import Fusion, Pruning
from palmd.observer.hypotheses import Hypotheses, Verdict
from palmd.observer.mass import MassEstimator
from palmd.observer.observability import Observability
from palmd.observer.prior import blind_start, shape_map_sd
from palmd.observer.rig_error import circle_spread
from palmd.observer.track import Track
from palmd.observer.validity import LOST_NIS
from palmd.system.arcs import tangents
from palmd.system.description import RigDescription
from palmd.system.mechanism import OPENING, PALMS

LOSS_AGE_S, LOST_FOR_S = 0.4, 0.4  # s: least age of a track that can be lost, and time of high NIS after which it is


class ObjectSession:
    """The present `track`, None while there is no object on both palms; safe inside the loop.

    `object_count` increases when a new object is started.
    """

    def __init__(
        self,
        rig: RigDescription,
        seed: int,
        fusion: Fusion,
        contacts: Contacts,
        hypotheses: Hypotheses,
        observability: Observability,
    ):
        """`seed`: for the starts of blind filters."""
        self._rig = rig
        self._seed = seed
        self._fusion = fusion
        self._contacts = contacts
        self._hypotheses = hypotheses
        self._observability = observability
        self.track: Track | None = None
        self.distrusted = False  # the track started just after a loss without lift-off: it may be the same object
        self._t_lost = -math.inf
        self.object_count = 0
        self._starts = 0
        self._t_begun = math.inf

    @property
    def start_time(self) -> float:
        """Since when the present object has been on the palms (s), inf while there is none.

        May be before the present track's start: after a loss without lift-off it may be the same object.
        """
        return self._t_begun

    def try_to_begin(self, t: float) -> None:
        """Start a track at `t` (s) if both pads and the palms were read then."""
        if self._contacts.read_about(t) and self._fusion.palms_known(t):
            self.distrusted = t - self._t_lost < GONE_S
            self._t_begun = min(self._t_begun, t) if self.distrusted else t
            self._begin(t)

    def _begin(self, t: float) -> None:
        """Start a track of the object on the palms, from the hypotheses or blind."""
        self._starts += 1
        rig, fusion, filters = self._rig, self._fusion, self._hypotheses.choose()
        palms = fusion.palms.motion(t)
        contacts = [sample.s for sample in self._contacts.all()]
        start = blind_start(
            contacts, palms, filters.bank.full_size, self._starts == 1,
            np.random.default_rng([self._seed, self._starts]), filters.order, rig.curvatures, rig.vibration,
        )  # fmt: skip
        fusion.begin(filters, start, self, t)
        track = self.track = Track(
            fusion, self._contacts, contacts, palms, start,
            radius_sd=circle_spread(rig, contacts, tangents(palms.angles, contacts, rig.curvatures)[OPENING]),
            mass=MassEstimator(rig.pads),
            likely_mass=MassEstimator(rig.pads),
            coverage=Coverage(curvatures=rig.curvatures),
            flat_side_test=FixedModeTest(rig),
        )  # fmt: skip
        self.object_count += self._hypotheses.begin(track, t)
        self._observability.begin(t, shape_map_sd(start))

    def stop(self) -> None:
        """End the track: the object has left the palms, or has to be searched for again."""
        self.track, self._t_begun = None, math.inf
        self._contacts.clear()

    def judge(self, t: float, settled: bool) -> bool:
        """Whether the estimate at `t` (s) is valid: `settled`, not lost, and the object's identity decided."""
        track = self.track
        if track is None or self._is_lost(track, t):
            return False
        verdict = self._hypotheses.decide(track, t, settled)
        if verdict is Verdict.REJECTED and len(self._contacts.all()) == len(PALMS):
            self._begin(t)
        return settled and verdict is Verdict.DECIDED

    def _is_lost(self, track: Track, t: float) -> bool:
        bank = self._fusion.bank
        if track.age(t) < LOSS_AGE_S or bank.nis[bank.best()] < LOST_NIS:
            track.t_unlikely = None
        elif track.t_unlikely is None:
            track.t_unlikely = t
        elif t - track.t_unlikely > LOST_FOR_S:
            self._hypotheses.lost(track)
            start_time = self._t_begun if self._may_be_same_object(track) else math.inf
            self.stop()
            self._t_lost, self._t_begun = t, start_time
        return self.track is None

    def _may_be_same_object(self, track: Track) -> bool:
        """Whether the smoother keeps the readings of the object that a bank has just lost without lift-off.

        A bank that never had a valid estimate of the object cannot detect that it was exchanged, and on a busy machine
        it may be lost repeatedly before the smoother's first results arrive.
        """
        return not self._fusion.uses_smoothed_filter and (self._rig.unequal_friction or not track.confirmed)

    # ---- `fusion.Beliefs`

    @property
    def pruning(self) -> Pruning:
        """Which filters are dropped."""
        return self._hypotheses.pruning

    def constants(self) -> Belief:
        """The prior of each filter's constants at the start."""
        assert self.track is not None
        return self._hypotheses.constants(self.track)

    def renumber(self, kept: npt.NDArray[np.intp]) -> None:
        """Adapt to a pruned bank; `kept`: former indices of the remaining filters."""
        assert self.track is not None
        self.track.coverage.renumber(kept)
        self._hypotheses.renumber(kept)
