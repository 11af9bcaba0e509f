"""The object on the palms, from when it is begun until it is lost: what it began with, what has been found of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from palmd.events import FloatArray, PalmMotion
from palmd.observer.contacts import Contacts
from palmd.observer.coverage import Coverage, Marks
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.fusion import Fusion
from palmd.observer.innovation_test import InnovationTest
from palmd.observer.mass import MassEstimator
from palmd.observer.prior import BlindStart
from palmd.observer.riding import Riding


@dataclass(slots=True)
class Track:
    """One object, on palms at `palms` when it was begun, with the pads' readings `first_contacts` (m).

    likely_mass: as `mass`, by estimates that need not be valid.
    radius_sd: what the rig's constants leave of its radius (m) until a smoother has told more. valid, predictable: of
    the last estimate. t_unlikely: since when (s) all filters have been surprised, None while they are not.
    surprise: what its readings have lately said of the published one-sigmas; what is acted on does not ask.
    riding: whether it may only have turned with a palm since.
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
    riding: Riding
    valid: bool = False
    predictable: bool = False
    confirmed: bool = False
    t_unlikely: float | None = None
    innovation_test: InnovationTest = field(default_factory=InnovationTest)

    def age(self, t: float) -> float:
        """How long ago its filters began, at `t` (s)."""
        return t - self.fusion.t_start

    def use_single_filter(
        self, filters: ShapeFilters, x: FloatArray, P: FloatArray, nis: float, touched: Marks, spread: FloatArray
    ) -> None:
        """One filter, which a smoother vouches for, takes the place of all others; it has the leader's gauge."""
        filters.spread = spread
        self.innovation_test = InnovationTest()
        self.coverage = Coverage(touched, 0, self.fusion.curvatures)
        self.fusion.use_single_filter(filters, x, P, nis)
