"""The observer that the daemon runs: a bank of filters, from the first touch to a settled estimate and beyond.

It begins blind from a circle when both palms feel the object (`session`), or from what was known before it was felt
(`hypotheses`), fuses every event at its own time (`fusion`), lets a smoother outside the loop improve it
(`smoother_link`), and says `valid` only when one rule allows it (`validity`).
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
from palmd.observer.answer import answer, no_answer, outline_answer, planning_belief
from palmd.observer.contacts import GONE_S, Contacts, finite
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
from palmd.observer.validity import VAGUE_M, Evidence, Thresholds, consistent, predictable, reasons, settled, unmet
from palmd.system.arcs import MOST_LYING
from palmd.system.description import RigDescription
from palmd.system.mechanism import BENDS, FORCES, PALMS, RADII
from palmd.system.rig_constants import declared_exact

SETTLED = Thresholds(age_s=0.4, radius_sd_m=3e-4, disagreement_m=3e-4)
DISTRUSTED_S = 3.5  # after an object was lost where it lay: what the model does not explain is lost again before long
RIG_KNOWN_M = 1e-5  # of a radius: what the rig's constants may leave open that no smoother has told of yet
_FORCES, _BENDS = ([NAMED.index(name) for name in names] for names in (FORCES, BENDS))
_AGREED = [0.0] * len(NAMED)
_RADII = slice(NAMED.index(RADII[0]), NAMED.index(RADII[-1]) + 1)  # one beside the other


def _no_contact() -> str:
    return "no object is in contact with both pads"


def _why_invalid(evidence: Evidence, nis: float, radius_sd_m: float, safe: bool) -> str:
    """`radius_sd_m` includes what the innovation test added; `safe`: all but the object's identity is decided."""
    failed = unmet(evidence, SETTLED, nis)
    if not failed and safe:
        failed = ["which stored object it is, is not decided"]
    if not failed and radius_sd_m >= SETTLED.radius_sd_m:
        limit = f"limit {SETTLED.radius_sd_m * 1e3:.2f} mm"
        failed = [f"innovation test failed: with it 1σ of a radius is {radius_sd_m * 1e3:.2f} mm ({limit})"]
    return "; ".join(failed) or "the outline is not convex"


def _largest(values: list[float]) -> float:
    """NaN where one is."""
    return math.nan if any(map(math.isnan, values)) else max(values)


STICKS = ("sticks",)
"""Why an estimate is not valid: palms that do not vibrate hold the object by dry friction, or may."""


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
        """Deterministic for given `seed`, events, times, and answers of the smoother that `link` leads to, if any.

        `hypotheses` are about objects that are not new; by default that it is the last one, put back. Their first bank
        is `filters`.
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
        """Back to the very beginning, as if nothing had been fed."""
        self._hypotheses.reset()
        self._fusion.reset()
        if self._link is not None:
            self._link.reset()
        self._contacts = Contacts()
        self._because: Callable[[], str] = _no_contact  # in words only when asked: a tick has no time for them
        self._sticking = StickingWatch(self._rig.vibration, self._rig.gravity)
        self._session = ObjectSession(
            self._rig, self._seed, self._fusion, self._contacts, self._hypotheses, self._observability
        )
        self._draws = np.random.default_rng([self._seed, 1 << 20])  # of outlooks: estimates do not depend on them

    def forget_object(self) -> bool:
        """Begin a new object with the next readings; nothing of the present one is remembered."""
        self._hypotheses.reset()
        self._session.stop()
        return True

    def warm_up(self) -> None:
        """Pay the costs of first calls (page faults, the linear algebra's work space) now; ends with a `reset`.

        For before the loop begins: it takes some milliseconds.
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
        """Counts up when a new object is begun."""
        return self._session.object_count

    @property
    def late_dropped(self) -> int:
        """Events too late to be fused, or not finite."""
        return self._fusion.late_dropped

    @property
    def improvements(self) -> int:
        """How many of the smoother's answers have been taken in."""
        return 0 if self._link is None else self._link.improvements

    @property
    def begun(self) -> float:
        """When the present object was begun (s), inf while there is none."""
        return self._session.begun

    # ---- what comes in

    def feed(self, event: Event) -> None:
        """Take one event. A late one is fused at its own time; one too late for that is counted and dropped."""
        if isinstance(event, PadLift):
            self._contacts.lift(event.pad)
        elif not finite(event):
            self._fusion.late_dropped += 1
            return
        if self._link is not None:
            self._link.hear(event)
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
        gap, foreseen = t - fusion.palms.t, fusion.palms_known(t)
        fusion.hear_palms(event)
        if self._session.track is not None:
            if gap > GONE_S:
                self._session.stop()
            elif not foreseen and fusion.palms_known(t):
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
                    session.track.riding.read(event, fusion.palms.motion(t))
        if session.track is None:
            session.try_to_begin(t)

    def improve(self, t: float) -> Improvement | Unexplained | None:
        """Exchange with the smoother at `t` (s), once a tick before `estimate`; what it answers, each answer once."""
        if self._link is None:
            return None
        session, fusion = self._session, self._fusion
        track = session.track
        known = track is not None and track.valid and not fusion.carries
        hint = fusion.bank.x[fusion.bank.best()] if known else None
        improvement = self._link.exchange(t, Session(session.object_count, session.begun, hint))
        self._link.catch_up(track, session.object_count, fusion.t)
        return improvement

    # ---- what goes out

    def estimate(self, t: float) -> Estimate:
        """The most likely filter's answer for time `t` ≥ the last event (s); never raises, NaN where unknown."""
        fusion, session = self._fusion, self._session
        gone, best = t - fusion.palms.t > GONE_S or self._contacts.gone(t), fusion.bank.best()
        if session.track is not None and (gone or fusion.bank.is_lost(best)):
            session.stop()
        track = session.track
        self._because = _no_contact if track is None else str
        if track is None:
            palms = fusion.palms.motion(t) if fusion.palms_known(t) else None
            return no_answer(t, self.name, session.object_count, palms)
        nis = fusion.bank.nis_of(best)
        y, sd, disagreement = self._named(track, best, t)
        evidence = self._evidence(track, t, y, sd, disagreement, nis)
        track.innovation_test.take(nis, t)
        factor = track.innovation_test.factor  # what is acted on, validity too, goes by `sd`: who holds learns no more
        told_sd = [each * factor for each in sd]
        safe = (
            settled(evidence, SETTLED)
            and self._slides(t)
            and self._foreseen(told_sd)
            and (fusion.is_convex(best) or fusion.make_convex(best // fusion.bank.block))
        )
        valid = session.judge(t, safe)
        if not valid:
            self._because = partial(_why_invalid, evidence, nis, _largest(told_sd[_RADII]), safe)
        best = fusion.bank.best()  # another bank may have taken over
        track = session.track or track  # another object may have been begun
        if valid:
            for pad, force in zip(PALMS, _FORCES, strict=True):
                track.mass.weigh(self._contacts.last(pad), y[force])
            track.coverage.mark(t, best, y, fusion.psi)
            self._hypotheses.keep(track, t)
        lately = session.track is not None and self._contacts.read_lately(t)
        track.valid = valid
        track.confirmed |= valid
        track.predictable = valid or predictable(evidence.finite, lately, track.age(t), evidence.radius_sd_m)
        if track.predictable:
            for pad, force in zip(PALMS, _FORCES, strict=True):
                track.likely_mass.weigh(self._contacts.last(pad), y[force])
        return answer(
            t, valid, self.name, session.object_count, y, told_sd, track.mass,
            fusion.bank.nis_of(best), self._observability.value(), track.coverage.fraction,
            () if valid else (*self._sticks(), *reasons(evidence, SETTLED)),
        )  # fmt: skip

    def _sticks(self) -> tuple[str, ...]:
        """The code of dry friction that holds the object, or may."""
        return STICKS if self._dry and not self._sticking.frictionless else ()

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline of the most likely filter at `t` (s), None before anything is felt."""
        fusion, track = self._fusion, self._session.track
        if track is None or fusion.bank.lost():
            return None
        coefficients, cov = fusion.filters.outline(fusion.bank.best())
        radius_sd = 0.0 if fusion.allows_for_rig else track.radius_sd
        inflation = self._inflation(track, t) * track.innovation_test.factor
        return outline_answer(t, coefficients, cov, track.coverage.marks, inflation, radius_sd)

    @property
    def foresees(self) -> bool:
        """Whether the last estimate was good enough to choose motions by, though perhaps not valid yet."""
        return self._session.track is not None and self._session.track.predictable

    @property
    def invalid_because(self) -> str:
        """As of the last `estimate`."""
        return self._because()

    @property
    def cornered(self) -> bool:
        """Whether it has lain on a palm and touched the other one with a corner (`FixedModeTest`)."""
        track = self._session.track
        return track is not None and track.riding.cornered

    def planning_belief(self, t: float) -> PlanningBelief | None:
        """What is known of the object at `t` (s), for choosing motions; None unless it `foresees`."""
        fusion, track = self._fusion, self._session.track
        if track is None or not track.predictable:
            return None
        inflation = self._inflation(track, t)
        marks, count = track.coverage.marks, self._session.object_count
        rig = None if self._link is None else self._link.rig_off
        mass = track.likely_mass
        return planning_belief(t, fusion.filters, fusion.rivals(), marks, inflation, self._draws, count, rig, mass)

    def identify(self, t: float) -> ObjectEstimate | None:
        """Which stored object it is at `t` (s), None before anything is felt or where none are stored."""
        if self._session.track is None or self._fusion.bank.lost():
            return None
        return self._hypotheses.identify(t, self._session.object_count)

    def _named(self, track: Track, best: int, t: float) -> tuple[list[float], list[float], list[float]]:
        """Of `NAMED` at `t` (s): values, one-sigmas, and the share of these that rival hypotheses make.

        Plain numbers: of eighteen arithmetic takes less time than of an array.
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
        if not fusion.allows_for_rig:
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
            finite=math.isfinite(sum(y) + sum(sd)),  # as are all its terms
            consistent=consistent(nis) and self._lies_on(y),
            age_s=track.age(t),
            radius_sd_m=_largest(sd[_RADII]),
            disagreement_m=_largest(disagreement[_RADII]),
            explained=self._explained(track, t),
            rig_known=self._link is None or fusion.allows_for_rig or track.radius_sd < RIG_KNOWN_M,
        )

    def _explained(self, track: Track, t: float) -> bool:
        """Whether nothing speaks against the model itself: a corner, a flat side, two objects."""
        if self._link is not None and self._link.refuses(self._session.begun):
            return False
        if self._may_ride(track):
            return False
        return self._fusion.carries or not self._session.distrusted or track.age(t) > DISTRUSTED_S

    def _foreseen(self, told_sd: list[float]) -> bool:
        """Whether what is told, surprises and all, is as sharp as who tells it must be: a bank may take all in.

        So may what a smoother has vouched for on few readings, on a rig that is known exactly, until it is established.
        """
        if self._link is None or self._fusion.carries:
            return True
        vouched = self._link.vouches(self._session.begun)
        if vouched and not self._exact:
            return True
        return max(told_sd[_RADII]) < (VAGUE_M if vouched else SETTLED.radius_sd_m)

    def _may_ride(self, track: Track) -> bool:
        """Whether it may only turn with a palm, as what lies on a flat side does, or be a disc, for all that is known.

        A bank takes that for a smooth object, however far off, and so may a smoother that no second search has agreed
        with or, on a rig that is known exactly, that has not weighed its answer against a ride: of a disc it may all
        the same, unless that is told sharply and both palms' readings together are not those of a disc. What has been
        felt to have a corner no smooth outline is of, whoever tells it.
        """
        if self._link is None or self._curved:
            return False
        riding = track.riding
        begun = self._session.begun
        told = self._link.vouches(begun) if self._exact else self._fusion.allows_for_rig
        if riding.cornered or not told:
            return riding.cornered or not riding.excluded
        return riding.disc and not (self._exact and self._link.sure(begun) and not riding.concentric)

    def _slides(self, t: float) -> bool:
        """Whether palms break friction by vibrating, or forces have shown that there is next to none to break."""
        if not self._dry:
            return True
        self._sticking.look(t, self._fusion.palms.motion(t) if self._fusion.palms_known(t) else None)
        return self._sticking.frictionless

    def _lies_on(self, y: list[float]) -> bool:
        """Whether the object lies on its palms rather than in one that is as concave as it is round there."""
        if not self._curved:
            return True
        bends = (y[at] for at in _BENDS)
        return all(kappa * v < MOST_LYING for kappa, v in zip(self._rig.curvatures, bends, strict=True))

    def _inflation(self, track: Track, t: float) -> float:
        """What to multiply one-sigmas with at `t` (s)."""
        return self._fusion.filters.overconfidence.factor(track.age(t))
