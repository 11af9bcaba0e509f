"""The state of one object's track, from its start until it is lost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from palmd.events import FloatArray, PalmMotion
from palmd.observer.contacts import Contacts
from palmd.observer.coverage import Coverage, Marks
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.fixed_mode_test import FixedModeTest
from palmd.observer.forgetting import HIGH_NIS
from palmd.observer.fusion import Fusion
from palmd.observer.mass import MassEstimator
from palmd.observer.prior import BlindStart
from palmd.observer.validity import LOST_NIS

# From simulated runs with fault injection: systematic errors as large as the noise shift a state, which is a mean of
# many readings, by several of its standard deviations, and it takes about DECAY_S (s) to recover.
SIGMAS_PER_NIS, DECAY_S = 8.0, 1.5


@dataclass(slots=True)
class InnovationTest:
    """Inflation of published standard deviations while a filter fails the innovation test; its covariance stays.

    excess: peak excess of the mean NIS over `HIGH_NIS`, decaying with `DECAY_S`, as of `t` (s).
    """

    excess: float = 0.0
    t: float = -math.inf

    def take(self, nis: float, t: float) -> None:
        """Take the leading filter's running mean NIS at `t` (s), which must not be before the last one."""
        decayed = self.excess * math.exp((self.t - t) / DECAY_S)
        self.excess, self.t = max(decayed, min(nis, LOST_NIS) - HIGH_NIS), t

    @property
    def factor(self) -> float:
        """Factor for published standard deviations: 1 + SIGMAS_PER_NIS · excess; 1 for readings as predicted."""
        return 1.0 + SIGMAS_PER_NIS * self.excess


@dataclass(slots=True)
class Track:
    """One object's track; at its start the palms were at `palms` and the pads read `first_contacts` (m).

    likely_mass: as `mass`, from estimates that need not be valid. radius_sd: 1σ of its radius (m) due to the rig's
    constants, until a smoother has estimated them. valid, predictable: of the last estimate. confirmed: an estimate was
    valid. t_unlikely: since when (s) the best filter's NIS has been too high, None while it is not. innovation_test:
    inflates published standard deviations only. flat_side_test: whether the object may have turned with a palm only.
    """

    fusion: Fusion
    contacts: Contacts
    first_contacts: Sequence[float]
    palms: PalmMotion
    start: BlindStart
    radius_sd: float
    mass: MassEstimator
    likely_mass: MassEstimator
    coverage: Coverage
    flat_side_test: FixedModeTest
    valid: bool = False
    predictable: bool = False
    confirmed: bool = False
    t_unlikely: float | None = None
    innovation_test: InnovationTest = field(default_factory=InnovationTest)

    def age(self, t: float) -> float:
        """Time (s) since its filters were started, at `t` (s)."""
        return t - self.fusion.t_start

    def use_single_filter(
        self, filters: ShapeFilters, x: FloatArray, P: FloatArray, nis: float, touched: Marks, spread: FloatArray
    ) -> None:
        """Replace the bank by a single filter from a smoother, in the leader's gauge."""
        filters.spread = spread
        self.innovation_test = InnovationTest()
        self.coverage = Coverage(touched, 0, self.fusion.curvatures)
        self.fusion.use_single_filter(filters, x, P, nis)
