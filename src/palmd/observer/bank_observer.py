"""The observer that the daemon runs: a bank of filters, from the first contact to a valid estimate and beyond.

When both palms are touched it starts blind from a circle (`session`) or from a known object (`hypotheses`), fuses every
event at the event's own time (`fusion`), takes improvements from a smoother outside the loop (`smoother_link`), and
declares an estimate valid by one rule (`validity`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from palmd.events import (
    Estimate,
    Event,
    Improvement,
    ObjectEstimate,
    PadLift,
    PadSample,
    PalmSample,
    PlanningBelief,
    ShapeEstimate,
    Unexplained,
)
from palmd.model.outputs import NAMED, rig_inputs
from palmd.observer.contacts import GONE_S, Contacts, finite
from palmd.observer.estimates import empty_estimate, make_estimate, outline_estimate, planning_belief
from palmd.observer.filters.base import LONGEST_STEP_S, Filters
from palmd.observer.fusion import Fusion
from palmd.observer.history import EVENTS
from palmd.observer.hypotheses import Hypotheses
from palmd.observer.observability import Observability
from palmd.observer.returning_object import ReturningObject
from palmd.observer.session import ObjectSession
from palmd.observer.smoother_link import SmootherLink
from palmd.observer.smoothing import Session
from palmd.observer.sticking import StickingWatch
from palmd.observer.track import Track
from palmd.observer.validity import (
    CONTRADICTED_M,
    Evidence,
    Thresholds,
    consistent,
    predictable,
    reasons,
    settled,
    unmet,
)
from palmd.system.arcs import MOST_LYING
from palmd.system.description import RigDescription
from palmd.system.mechanism import BENDS, FORCES, PALMS, RADII
from palmd.system.reasons import Code
from palmd.system.rig_constants import declared_exact

SETTLED = Thresholds(age_s=0.4, radius_sd_m=3e-4, disagreement_m=3e-4)
DISTRUSTED_S = 3.5  # no valid estimate for so long after a loss without lift-off: an unexplained object is lost again
RIG_KNOWN_M = 1e-5  # 1σ of a radius due to the rig's constants, below which no smoother has to estimate them first
_FORCES, _BENDS = ([NAMED.index(name) for name in names] for names in (FORCES, BENDS))
_AGREED = [0.0] * len(NAMED)
_RADII = slice(NAMED.index(RADII[0]), NAMED.index(RADII[-1]) + 1)  # adjacent in NAMED


def _no_contact() -> str:
    return "no object is in contact with both pads"


def _why_invalid(evidence: Evidence, nis: float, radius_sd_m: float, safe: bool) -> str:
    """The reasons in words. `radius_sd_m` includes the innovation test's inflation; `safe`: only identity is open."""
    failed = unmet(evidence, SETTLED, nis)
    if not failed and safe:
        failed = ["which stored object it is, is not decided"]
    if not failed and radius_sd_m >= SETTLED.radius_sd_m:
        limit = f"limit {SETTLED.radius_sd_m * 1e3:.2f} mm"
        failed = [f"innovation test failed: with it 1σ of a radius is {radius_sd_m * 1e3:.2f} mm ({limit})"]
    return "; ".join(failed) or "the outline is not convex"


def _largest(values: list[float]) -> float:
    """The maximum, NaN if any value is NaN."""
    return math.nan if any(map(math.isnan, values)) else max(values)


class BankObserver:
    """An `Observer`. `feed`, `improve` and `estimate` take bounded time and are safe inside the loop."""

    def __init__(
        self,
        filters: Filters,
        rig: RigDescription,
        seed: int = 0,
        hypotheses: Hypotheses | None = None,
        link: SmootherLink | None = None,
    ):
        """Deterministic for given `seed`, events, times, and improvements from the smoother behind `link`, if any.

        `hypotheses` are about known objects; by default that the last object has been put back. Their first bank is
        `filters`.
        """
        self.name = filters.name
        self.backend = filters.bank.backend
        self._rig = rig
        self._seed = seed
        self._link = link
        self._hypotheses = hypotheses or ReturningObject(rig, filters)
        self._fusion = Fusion(rig, self._hypotheses.banks)
        self._observability = Observability(rig_inputs(rig), rig.reading_variances)
        self._dry = not rig.vibration.vibrates
        self._exact = declared_exact(rig)
        self._curved = rig.curved
        self.reset()

    def reset(self) -> None:
        """Back to the initial state, as if nothing had been fed."""
        self._hypotheses.reset()
        self._fusion.reset()
        if self._link is not None:
            self._link.reset()
        self._contacts = Contacts()
        self._invalid_text: Callable[[], str] = _no_contact  # formatted on request only: a tick has no time for it
        self._sticking = StickingWatch(self._rig.vibration, self._rig.gravity)
        self._session = ObjectSession(
            self._rig, self._seed, self._fusion, self._contacts, self._hypotheses, self._observability
        )
        self._random = np.random.default_rng([self._seed, 1 << 20])  # for planning beliefs; no estimate depends on it

    def forget_object(self) -> bool:
        """Start a new object with the next readings; nothing of the present one is remembered."""
        self._hypotheses.reset()
        self._session.stop()
        return True

    def warm_up(self) -> None:
        """Pay the costs of first calls (page faults, the linear algebra's work space) now; ends with a `reset`.

        Takes some milliseconds: call it before the loop starts.
        """
        for i in range(2 * EVENTS):
            t = i * 0.01
            self.feed(PalmSample(t, (0.8, 1.6), (0.0, 0.0), (0.0, 0.0)))
            for pad in PALMS:
                self.feed(PadSample(t, pad, 0.02, 1.0))
            self.estimate(t)
            self.shape(t)
        self.reset()

    @property
    def object_count(self) -> int:
        """Number of the present object; increases when a new object is started."""
        return self._session.object_count

    @property
    def late_dropped(self) -> int:
        """Number of events that were too late to be fused, or not finite."""
        return self._fusion.late_dropped

    @property
    def improvements(self) -> int:
        """Number of the smoother's improvements that have been handed over."""
        return 0 if self._link is None else self._link.improvements

    @property
    def start_time(self) -> float:
        """When the present object was started (s), inf while there is none."""
        return self._session.start_time

    # ---- input

    def feed(self, event: Event) -> None:
        """Take one event. A late event is fused at its own time, or counted and dropped if it is too late for that."""
        if isinstance(event, PadLift):
            self._contacts.lift(event.pad)
        elif not finite(event):
            self._fusion.late_dropped += 1
            return
        if self._link is not None:
            self._link.add_event(event)
        if isinstance(event, PadSample):
            self._feed_pad(event if self._link is None else self._link.on_time(event))
        elif isinstance(event, PalmSample):
            self._feed_palms(event)

    def _feed_pad(self, event: PadSample) -> None:
        self._contacts.read(event)
        if self._dry:
            self._sticking.feed(event)
        self._observability.count(event.pad)
        self._fuse(event)

    def _feed_palms(self, event: PalmSample) -> None:
        t, fusion = event.t_sample, self._fusion
        gap, predicted = t - fusion.palms.t, fusion.palms_known(t)
        fusion.add_palm_report(event)
        if self._session.track is not None:
            if gap > GONE_S:
                self._session.stop()
            elif not predicted and fusion.palms_known(t):
                fusion.bridge(t, t - fusion.t)
        self._fuse(event)

    def _fuse(self, event: PadSample | PalmSample) -> None:
        t, fusion, session = event.t_sample, self._fusion, self._session
        if session.track is not None:
            if t - fusion.t > GONE_S:
                session.stop()
            elif fusion.palms_known(t):
                fusion.add(event)
                if isinstance(event, PadSample) and self._link is not None and not self._curved:
                    session.track.flat_side_test.read(event, fusion.palms.motion(t))
        if session.track is None:
            session.try_to_begin(t)

    def improve(self, t: float) -> Improvement | Unexplained | None:
        """Exchange data with the smoother at `t` (s), once a tick before `estimate`; returns each result once."""
        if self._link is None:
            return None
        session, fusion = self._session, self._fusion
        track = session.track
        known = track is not None and track.valid and not fusion.uses_smoothed_filter
        hint = fusion.bank.x[fusion.bank.best()] if known else None
        improvement = self._link.exchange(t, Session(session.object_count, session.start_time, hint))
        self._link.catch_up(track, session.object_count, fusion.t)
        return improvement

    # ---- output

    def estimate(self, t: float) -> Estimate:
        """The most likely filter's estimate for time `t` ≥ the last event (s); never raises, NaN where unknown."""
        fusion, session = self._fusion, self._session
        gone, best = t - fusion.palms.t > GONE_S or self._contacts.gone(t), fusion.bank.best()
        if session.track is not None and (gone or fusion.bank.is_lost(best)):
            session.stop()
        track = session.track
        self._invalid_text = _no_contact if track is None else str
        if track is None:
            palms = fusion.palms.motion(t) if fusion.palms_known(t) else None
            return empty_estimate(t, self.name, session.object_count, palms)
        nis = fusion.bank.nis_of(best)
        y, sd, disagreement = self._named(track, best, t)
        evidence = self._evidence(track, t, y, sd, disagreement, nis)
        track.innovation_test.take(nis, t)
        # `factor` inflates published values only; planning and validity use `sd`: a rig that holds gets no new readings
        factor = track.innovation_test.factor
        published_sd = [each * factor for each in sd]
        safe = (
            settled(evidence, SETTLED)
            and self._slides(t)
            and self._is_precise(published_sd)
            and (fusion.is_convex(best) or fusion.make_convex(best // fusion.bank.block))
        )
        valid = session.judge(t, safe)
        if not valid:
            self._invalid_text = partial(_why_invalid, evidence, nis, _largest(published_sd[_RADII]), safe)
        best = fusion.bank.best()  # the bank may have changed
        track = session.track or track  # another object may have been started
        if valid:
            for pad, force in zip(PALMS, _FORCES, strict=True):
                track.mass.weigh(self._contacts.last(pad), y[force])
            track.coverage.mark(t, best, y, fusion.psi)
            self._hypotheses.keep(track, t)
        recent = session.track is not None and self._contacts.read_lately(t)
        track.valid = valid
        track.confirmed |= valid
        track.predictable = valid or predictable(evidence.finite, recent, track.age(t), evidence.radius_sd_m)
        if track.predictable:
            for pad, force in zip(PALMS, _FORCES, strict=True):
                track.likely_mass.weigh(self._contacts.last(pad), y[force])
        sticks = (Code.STICKS,) if self._dry and not self._sticking.frictionless else ()
        return make_estimate(
            t, valid, self.name, session.object_count, y, published_sd, track.mass,
            fusion.bank.nis_of(best), self._observability.value(), track.coverage.fraction,
            () if valid else (*sticks, *reasons(evidence, SETTLED)),
        )  # fmt: skip

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline of the most likely filter at `t` (s), None while there is no object."""
        fusion, track = self._fusion, self._session.track
        if track is None or fusion.bank.lost():
            return None
        coefficients, cov = fusion.filters.outline(fusion.bank.best())
        radius_sd = 0.0 if fusion.includes_rig_uncertainty else track.radius_sd
        inflation = self._inflation(track, t) * track.innovation_test.factor
        return outline_estimate(t, coefficients, cov, track.coverage.marks, inflation, radius_sd)

    @property
    def has_planning_belief(self) -> bool:
        """Whether the last estimate was good enough for planning motions, though perhaps not valid yet."""
        return self._session.track is not None and self._session.track.predictable

    @property
    def invalid_because(self) -> str:
        """Why the last `estimate` was invalid."""
        return self._invalid_text()

    @property
    def cornered(self) -> bool:
        """Whether a corner has been detected: the object lay on one palm and touched the other with a corner."""
        track = self._session.track
        return track is not None and track.flat_side_test.cornered

    def planning_belief(self, t: float) -> PlanningBelief | None:
        """The belief for planning at `t` (s); None unless `has_planning_belief`."""
        fusion, track = self._fusion, self._session.track
        if track is None or not track.predictable:
            return None
        inflation = self._inflation(track, t)
        marks, count = track.coverage.marks, self._session.object_count
        rig = None if self._link is None else self._link.rig_errors
        mass = track.likely_mass
        return planning_belief(t, fusion.filters, fusion.rivals(), marks, inflation, self._random, count, rig, mass)

    def identify(self, t: float) -> ObjectEstimate | None:
        """Which stored object it is at `t` (s), None while there is no object or if no outlines are stored."""
        if self._session.track is None or self._fusion.bank.lost():
            return None
        return self._hypotheses.identify(t, self._session.object_count)

    def _named(self, track: Track, best: int, t: float) -> tuple[list[float], list[float], list[float]]:
        """Values of `NAMED` at `t` (s), their standard deviations, and the part of these due to rival hypotheses.

        Plain floats: for eighteen numbers they are faster than an array.
        """
        fusion = self._fusion
        dt = min(max(t - fusion.t, 0.0), LONGEST_STEP_S * 4)
        y, variance = fusion.filters.named(best, fusion.t, dt, fusion.palms)
        if self._observability.due(fusion.t):
            state, motion = fusion.filters.as_shape_map(best), fusion.palms.at(fusion.t)
            self._observability.sample(fusion.t, state, motion, fusion.palms.jerk)
        inflation = self._inflation(track, t)
        disagreement = fusion.disagreement(self._hypotheses.one_gauge) or _AGREED
        each = zip(variance, disagreement, strict=True)
        sd = [math.sqrt((0.0 if own < 0.0 else own) + other * other) * inflation for own, other in each]
        if not fusion.includes_rig_uncertainty:
            sd[_RADII] = np.hypot(sd[_RADII], track.radius_sd).tolist()
        return y, sd, disagreement

    def _evidence(
        self, track: Track, t: float, y: list[float], sd: list[float], disagreement: list[float], nis: float
    ) -> Evidence:
        fusion, contacts = self._fusion, self._contacts
        return Evidence(
            touching=contacts.touching(t),
            palms_known=fusion.palms_known(t),
            resumed_for_s=t - contacts.resumed,
            finite=math.isfinite(sum(y) + sum(sd)),  # the sum is finite only if all terms are
            consistent=consistent(nis) and self._rests_on_palms(y),
            age_s=track.age(t),
            radius_sd_m=_largest(sd[_RADII]),
            disagreement_m=_largest(disagreement[_RADII]),
            explained=self._explained(track, t),
            rig_known=self._link is None or fusion.includes_rig_uncertainty or track.radius_sd < RIG_KNOWN_M,
        )

    def _explained(self, track: Track, t: float) -> bool:
        """Whether nothing contradicts the model of a smooth outline: no corner, flat side or second object."""
        if self._link is not None and self._link.rejects(self._session.start_time):
            return False
        if self._may_turn_with_palm(track):
            return False
        return self._fusion.uses_smoothed_filter or not self._session.distrusted or track.age(t) > DISTRUSTED_S

    def _is_precise(self, published_sd: list[float]) -> bool:
        """Whether the inflated 1σ of the radii is below the limit for its source; filter banks are overconfident.

        On an exactly known rig the same limit, a wider one, applies to a confirmed smoother's outline until it is
        established, since it may rest on few readings.
        """
        if self._link is None or self._fusion.uses_smoothed_filter:
            return True
        confirmed = self._link.confirms(self._session.start_time)
        if confirmed and not self._exact:
            return True
        return max(published_sd[_RADII]) < (CONTRADICTED_M if confirmed else SETTLED.radius_sd_m)

    def _may_turn_with_palm(self, track: Track) -> bool:
        """Whether the readings allow that the object turns with a palm (as on a flat side) or is a disc.

        A bank explains such readings by a wrong smooth outline. So may a smoother's result that no second search has
        confirmed or, on an exactly known rig, that has not been compared with an object fixed to a palm. For a disc
        even that comparison does not help, unless the outline is precise and both palms' readings together contradict
        a disc. After a corner has been detected, no smooth-outline estimate is valid.
        """
        if self._link is None or self._curved:
            return False
        side_test = track.flat_side_test
        start_time = self._session.start_time
        estimated = self._link.confirms(start_time) if self._exact else self._fusion.includes_rig_uncertainty
        if side_test.cornered or not estimated:
            return side_test.cornered or not side_test.excluded
        return side_test.disc and not (self._exact and self._link.is_precise(start_time) and not side_test.concentric)

    def _slides(self, t: float) -> bool:
        """Whether the object slides: the palms vibrate, or the forces have shown that friction is negligible."""
        if not self._dry:
            return True
        self._sticking.look(t, self._fusion.palms.motion(t) if self._fusion.palms_known(t) else None)
        return self._sticking.frictionless

    def _rests_on_palms(self, y: list[float]) -> bool:
        """Whether the object is more strongly curved than its concave palms, so that it does not lie in a cradle."""
        if not self._curved:
            return True
        bends = (y[at] for at in _BENDS)
        return all(kappa * v < MOST_LYING for kappa, v in zip(self._rig.curvatures, bends, strict=True))

    def _inflation(self, track: Track, t: float) -> float:
        """The factor for the filters' overconfidence by which to multiply standard deviations at `t` (s)."""
        return self._fusion.filters.overconfidence.factor(track.age(t))
