"""When an object on the palms is begun, lost, and begun again."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from palmd.observer.bank import Belief
from palmd.observer.contacts import GONE_S, Contacts
from palmd.observer.coverage import Coverage
from palmd.observer.fusion import Fusion, Pruning
from palmd.observer.hypotheses import Hypotheses, Verdict
from palmd.observer.mass import MassEstimator
from palmd.observer.observability import Observability
from palmd.observer.prior import blind_start, shape_map_sd
from palmd.observer.riding import Riding
from palmd.observer.rig_error import circle_spread
from palmd.observer.track import Track
from palmd.observer.validity import LOST_NIS
from palmd.system.arcs import tangents
from palmd.system.description import RigDescription
from palmd.system.mechanism import OPENING, PALMS

LOSS_AGE_S, LOST_FOR_S = 0.4, 0.4


class ObjectSession:
    """The present `track`, None while no object lies on both palms; safe inside the loop.

    `object_count` counts up when a new object is begun.
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
        """`seed` draws where blind filters start."""
        self._rig = rig
        self._seed = seed
        self._fusion = fusion
        self._contacts = contacts
        self._hypotheses = hypotheses
        self._observability = observability
        self.track: Track | None = None
        self.distrusted = False  # it was begun where the one before had just been lost: it may be the same
        self._t_lost = -math.inf
        self.object_count = 0
        self._starts = 0
        self._t_begun = math.inf

    @property
    def begun(self) -> float:
        """Since when the present object has been on the palms (s), inf while there is none.

        What a bank loses where it lay may be the same object.
        """
        return self._t_begun

    def try_to_begin(self, t: float) -> None:
        """Begin at `t` (s) if both pads and the palms are told of then."""
        if self._contacts.read_about(t) and self._fusion.palms_known(t):
            self.distrusted = t - self._t_lost < GONE_S
            self._t_begun = min(self._t_begun, t) if self.distrusted else t
            self._begin(t)

    def _begin(self, t: float) -> None:
        """Begin with what lies on the palms since `begun`, as the hypotheses say or blind."""
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
            riding=Riding(rig),
        )  # fmt: skip
        self.object_count += self._hypotheses.begin(track, t)
        self._observability.begin(t, shape_map_sd(start))

    def stop(self) -> None:
        """The object has left the palms, or what is on them must be sought again."""
        self.track, self._t_begun = None, math.inf
        self._contacts.clear()

    def judge(self, t: float, settled: bool) -> bool:
        """Whether the answer at `t` (s), `settled` or not, is valid: not lost, and decided which object it is of."""
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
            begun = self._t_begun if self._still_the_same(track) else math.inf
            self.stop()
            self._t_lost, self._t_begun = t, begun
        return self.track is None

    def _still_the_same(self, track: Track) -> bool:
        """Whether what a smoother has of the object that a bank has just lost where it lay is of the next one too.

        A bank that never knew the object cannot tell that there is another now, and on a busy machine it may be lost
        again and again before the smoother's first answers come.
        """
        return not self._fusion.uses_smoothed_filter and (self._rig.unequal_friction or not track.confirmed)

    # ---- what fusion asks

    @property
    def pruning(self) -> Pruning:
        """Which filters are dropped."""
        return self._hypotheses.pruning

    def constants(self) -> Belief:
        """What was believed of each filter's constants at the start."""
        assert self.track is not None
        return self._hypotheses.constants(self.track)

    def renumber(self, kept: npt.NDArray[np.intp]) -> None:
        """The bank has been pruned: the former numbers of the filters that stay."""
        assert self.track is not None
        self.track.coverage.renumber(kept)
        self._hypotheses.renumber(kept)
