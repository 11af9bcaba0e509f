"""The observer that the daemon runs: a bank of filters, from the first touch to a settled estimate and beyond.

It starts blind from a circle when both palms feel the object, fuses every event at its own time (going back for
a late one), and says `valid` only when the most likely filter is settled, consistent with the readings and in
agreement with its plausible rivals. It starts again when the object is lifted or the readings say it is lost, then with
most of the bank from what it knew of the last object (`observer.object_memory`).
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from palmd.events import (
    Estimate,
    Event,
    FloatArray,
    Improvement,
    Outlook,
    PadLift,
    PadSample,
    PalmMotion,
    PalmSample,
    ShapeEstimate,
)
from palmd.model import shape, shape_map
from palmd.model.outputs import NAMED, rig_inputs
from palmd.observer.answer import answer, no_answer
from palmd.observer.bank import Bank, Belief, Snapshot
from palmd.observer.coverage import NORMAL_BINS, Coverage, Marks, contact_bins, turned_marks
from palmd.observer.filters import LONGEST_STEP_S, Filters, ShapeFilters, carry, smoother_outline
from palmd.observer.mass import MassEstimator, resting_forces
from palmd.observer.object_memory import KnownObject, ObjectMemory
from palmd.observer.observability import Observability
from palmd.observer.outline import gauge_free_sd
from palmd.observer.palms import PalmTracker
from palmd.observer.prior import blind_start, shape_map_sd
from palmd.observer.rig_error import RigError, circle_spread
from palmd.system.description import RigDescription
from palmd.system.mechanism import PALMS

SILENCE_S = 0.1  # a pad silent for longer does not vouch for a contact
HEARD_AGAIN_S = 0.05  # of readings after such a silence, by which it shows whether they are of the same object
GONE_S = 0.4  # a pad silent for longer: the object has left the palms
# Palms not reported for longer are not known: a controller that does not track is asked each 0.1 s only.
PALMS_UNKNOWN_S = 0.15
HISTORY = 24  # events that can be undone for a late one
SETTLED_SD = 3e-4  # m, of r1 and r2
AGREEMENT = 3e-4  # m, among plausible filters
PLAUSIBLE = 12.0  # nats below the best
HOPELESS, PRUNE_AGE_S = 100.0, 4.0  # nats below the best, from which no filter comes back once so old
MIN_AGE_S = 0.4
LOST_NIS = 3.0
LOST_FOR_S = 0.4
NIS_RANGE = (0.2, 2.0)  # of the running mean, to be called consistent
# The first readings are fused about a blind guess: they weigh little at first, …
CAUTION, CAUTION_S = 20.0, 0.3
# … and all readings fade as a power of their age, so that the first do not bend the answer for ever.
FADE, FADE_AGE_S, FADE_EVERY_S, FADE_AT_LEAST_EVERY_S = 1.5, 0.2, 0.2, 0.5
# A filter that began from a known object fades as if so much older.
FROM_KNOWN, EXPERIENCE_S = 0.75, 4.0  # share of the bank; s
LOOKED_AT_S, UNDECIDED_S = 0.5, 3.0  # after which what is not the known object, or may not be, is begun as a new one
OTHERWISE_RAD = 0.1  # from which on an object lies another way round
CLEAR = 3.0  # nats by which blind filters lead when it is not
WORSE_NIS = 0.35  # over some 30 readings: two sigmas
WELCOME = 6.0  # nats by which a filter from elsewhere leads at first: its readings were weighed together
# Readings that keep surprising the best filter make it forget faster.
SURPRISING_NIS, FADE_BY_SURPRISE = 1.4, 20.0

DIRECTIONS = 180  # of the published outline
_THETA = np.linspace(0.0, 2 * np.pi, DIRECTIONS, endpoint=False)
_BINS = np.linspace(0.0, 2 * np.pi, NORMAL_BINS, endpoint=False) + np.pi / NORMAL_BINS
_SHAPE = slice(shape_map.Z.SHAPE, None)
SAMPLES, RIVALS = 6, 3  # in an outlook: of what the object may be besides, and how many of them rivals at most
ROUGH_SD, ROUGH_AGE_S = 3e-3, 0.6  # m, of r1 and r2; s
_BIN_OF_THETA = (_THETA / (2 * np.pi) * NORMAL_BINS).astype(np.intp)
_RADII, _FORCES = ([NAMED.index(f"{what}{palm}") for palm in PALMS] for what in "rf")
_PSI = NAMED.index("psi")


@dataclass(slots=True)
class _Fused:
    """An event in the order of its own time, and the bank as it was before it."""

    t: float
    event: PadSample | PalmSample
    t_before: float
    t_faded: FloatArray
    before: Snapshot


class SmoothedFilters(NamedTuple):
    """Filters for what a smoother has told of an object: a bank to know it `again`, and `one` that carries it on."""

    again: ShapeFilters
    one: ShapeFilters


class BankObserver:
    """Events in, estimates out. `feed` and `estimate` take bounded time and are safe inside the loop."""

    def __init__(self, filters: Filters, rig: RigDescription, seed: int = 0, smoothed: SmoothedFilters | None = None):
        """Deterministic for given `seed`, events and times. `smoothed`: for an observer with a smoother at its side."""
        self.name = filters.name
        self._filters = self._blind = filters
        self._smoothed = smoothed
        self._rig = rig
        self._rig_error = RigError(tuple(pad.length for pad in rig.pads))
        if smoothed is not None:
            assert isinstance(filters, ShapeFilters)
            for each in (filters, *smoothed):
                each.rig_error = self._rig_error
        self._seed = seed
        self._pad_variances = rig.reading_variances
        self._observability = Observability(rig_inputs(rig), self._pad_variances)
        everyone = [filters, *(smoothed or ())]
        self._blank = {id(each): [each.bank.blank() for _ in range(HISTORY)] for each in everyone}
        self._use(filters)
        self.reset()

    def reset(self) -> None:
        """Back to the very beginning, as if nothing had been fed."""
        self.object_count = 0
        self.late_dropped = 0
        self._starts = 0
        self._memory = ObjectMemory()
        self._palms = PalmTracker(self._rig.palm_angle_noise)
        self._last: dict[int, PadSample] = {}
        self._heard_again = -math.inf  # when a pad spoke after a silence
        self._lifted: set[int] = set()
        self._t = -math.inf  # up to which the bank has been moved
        self._candidate: KnownObject | None = None  # what lies on the palms may be that again
        self._t_begun = math.inf
        self._frame: int | None = None  # of the smoother's answers, and by how much it is turned from the published one
        self._turn = 0.0
        self._rig_error.values[:] = 0.0
        self._running = self._foresees = self._valid = False
        self._draws = np.random.default_rng([self._seed, 1 << 20])  # of outlooks: estimates do not depend on them
        self._begin_fresh()

    def warm_up(self) -> None:
        """Pay the costs of first calls (page faults, the linear algebra's work space) now; ends with a `reset`.

        For before the loop begins: it takes some milliseconds.
        """
        for i in range(2 * HISTORY):
            t = i * 0.01
            self.feed(PalmSample(t, (0.8, 1.6), (0.0, 0.0), (0.0, 0.0)))
            for pad in PALMS:
                self.feed(PadSample(t, pad, 0.02, 1.0))
            self.estimate(t)
            self.shape(t)
        self.reset()

    @property
    def backend(self) -> str:
        """What runs the models: "c" or "vm"."""
        return self._filters.bank.backend

    @property
    def t(self) -> float:
        """Up to when events have been fused (s), -inf before the first."""
        return self._t

    @property
    def begun(self) -> float:
        """When the present object was begun (s), inf while there is none."""
        return self._t_begun if self._running else math.inf

    @property
    def hint(self) -> FloatArray | None:
        """For a smoother that has not found the object yet: the state of a bank that has settled, None otherwise."""
        return None if self._carrying or not self._valid else self._bank.x[self._bank.best()]

    def take_in(self, answer: Improvement, x: FloatArray, P: FloatArray, nis: float) -> bool:
        """Let a filter that a smoother's `answer` began lead: its state and covariance at `t`, its mean NIS since.

        It joins the bank, in the worst filter's place; once the answer is established it goes on alone. It is turned
        so that ψ goes on without a jump. False when there is nothing to take part in, or the readings surprise it
        more than the present leader. Safe inside the loop.
        """
        bank, best = self._bank, self._bank.best()
        undecided = self._candidate is not None and not answer.established
        if self._smoothed is None or not self._running or bank.lost() or undecided or nis > bank.nis[best] + WORSE_NIS:
            return False
        if self._carrying and not (answer.frame == self._frame or self._as_sharp(P)):
            return False  # it has been found anew, from the latest readings alone
        if answer.frame != self._frame:
            self._frame, self._turn = answer.frame, float(bank.x[best, shape_map.Z.PSI] - x[shape_map.Z.PSI])
        x, P, spread = _turned(x, P, answer.spread, self._turn)
        self._rig_error.values[:] = answer.rig
        if answer.established:
            known, self._candidate = self._candidate, None
            if known is not None:  # the smoother has known it again
                self._mass = known.mass
            self._lead_with(x, P, nis, self._touched(answer, float(x[shape_map.Z.PSI])), spread)
        else:
            worst = int(np.argmin(np.where(np.arange(bank.size) == best, np.inf, bank.score)))
            bank.x[worst], bank.P[worst] = smoother_outline(x, P) if bank.n < len(x) else (x, P)
            bank.score[worst], bank.nis[worst] = bank.score[best] + WELCOME, nis
            self._experience[worst] = 0.0
            self._forget_history()
        return True

    def _as_sharp(self, P: FloatArray) -> bool:
        """Whether covariance `P` tells the outline as well as the leader's does, where it has been touched."""
        rows = _bin_rows(P.shape[-1] - shape_map.Z.SHAPE)[self._marks.marks]
        own = self._bank.P[self._bank.best()]
        variance = [((rows @ each[_SHAPE, _SHAPE]) * rows).sum() for each in (P, own)]
        return bool(variance[0] <= variance[1])

    def _touched(self, answer: Improvement, psi: float) -> Marks:
        """The normals touched up to an answer, and since then unless the answer lies another way round (ψ in rad)."""
        touched, best = turned_marks(answer.touched, self._turn), self._bank.best()
        if abs(math.remainder(psi - self._bank.x[best, shape_map.Z.PSI], math.tau)) > OTHERWISE_RAD:
            return touched
        return touched | self._marks.since(answer.t, best, self._all_psi)

    def _lead_with(self, x: FloatArray, P: FloatArray, nis: float, touched: Marks, spread: FloatArray) -> None:
        """One filter takes the place of all others; it has the leader's gauge."""
        assert self._smoothed is not None
        self._smoothed.one.spread = spread
        self._marks = Coverage(touched, 0)
        self._use(self._smoothed.one)
        bank = self._bank
        bank.refill()
        bank.x[0], bank.P[0], bank.nis[0] = x, P, nis
        self._experience, self._t_faded = np.zeros(1), np.full(1, math.inf)

    @property
    def _bank(self) -> Bank:
        return self._filters.bank

    def feed(self, event: Event) -> None:
        """Take one event. A late one is fused at its own time; one too late for that is counted and dropped."""
        if isinstance(event, PadLift):
            self._lifted.add(event.pad)
            return
        if not finite(event):
            self.late_dropped += 1
            return
        if isinstance(event, PadSample):
            event = self._rig_error.on_time(event)
        if isinstance(event, PalmSample):
            gap = event.t_sample - self._palms.t
            self._palms.feed(event)
            if self._running and gap > PALMS_UNKNOWN_S:
                self._bridge(event.t_sample, gap)
        else:
            previous = self._last.get(event.pad)
            if previous is None or event.t_sample >= previous.t_sample:
                if event.t_sample - self._last_seen(event.pad) > SILENCE_S:
                    self._heard_again = event.t_sample
                self._last[event.pad] = event
                self._lifted.discard(event.pad)
            self._observability.count(event.pad)
        if self._running:
            if event.t_sample - self._t > GONE_S:
                self._stop()
            elif self._palms_known(event.t_sample) and (isinstance(event, PadSample) or self._filters.fuses_palms):
                self._fuse_in_order(event)
        if not self._running:
            self._try_to_start(event.t_sample)

    def estimate(self, t: float) -> Estimate:
        """The most likely filter's answer for time `t` ≥ the last event (s); never raises, NaN where unknown."""
        gone = t - min(self._palms.t, *map(self._last_seen, PALMS)) > GONE_S
        if self._running and (gone or self._bank.lost()):
            self._stop()
        if not self._running:
            palms = self._palms.motion(t) if self._palms_known(t) else None
            return no_answer(t, self.name, self.object_count, palms)
        best = self._bank.best()
        dt = min(max(t - self._t, 0.0), LONGEST_STEP_S * 4)
        y, cov = self._filters.named(best, self._t, dt, self._palms)
        if self._observability.due(self._t):
            state, motion = self._filters.as_shape_map(best), self._palms.at(self._t)
            self._observability.sample(self._t, state, motion, self._palms.jerk)
        spread = self._rivals_spread(best)
        sd = np.sqrt(np.maximum(np.diagonal(cov), 0.0) + spread**2)
        sd *= self._too_sure(t)
        if not self._carrying:
            sd[_RADII] = np.hypot(sd[_RADII], self._blind_radius_sd)
        finite = bool(np.isfinite(y).all() and np.isfinite(sd).all())
        settled = finite and self._settled(t, best, sd, spread)
        if settled and (self._filters.curvature @ self._bank.x[best]).min() < 0.0:
            settled = self._convex(best // self._bank.block)
        self._watch_for_loss(t, best)
        if self._running:
            settled = self._decided(t, best, settled)
            best = self._bank.best()  # another bank may have taken over
        if settled:
            for pad, force in zip(PALMS, _FORCES, strict=True):
                self._mass.weigh(self._last.get(pad), float(y[force]))
            self._marks.mark(t, best, y, self._all_psi)
            self._keep(t, best)
        self._valid = settled
        self._foresees = settled or (finite and self._rough(t, sd))
        return answer(
            t, settled, self.name, self.object_count, y, sd, self._mass,
            float(self._bank.nis[best]), self._observability.value(), self._marks.fraction,
        )  # fmt: skip

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline of the most likely filter on `DIRECTIONS` normals, None before anything is felt."""
        if not self._running or self._bank.lost():
            return None
        coefficients, cov = self._filters.outline(self._bank.best())
        touched = self._marks.marks[_BIN_OF_THETA]
        h_sd = gauge_free_sd(_THETA, _THETA[touched], coefficients, cov) * self._too_sure(t)
        if not self._carrying:
            h_sd = np.hypot(h_sd, self._blind_radius_sd)
        return ShapeEstimate(t, _THETA, _rows(len(coefficients)) @ coefficients, h_sd, touched)

    @property
    def foresees(self) -> bool:
        """Whether the last estimate was good enough to choose motions by, though perhaps not valid yet."""
        return self._foresees

    def outlook(self, t: float) -> Outlook | None:
        """What is known of the object at `t` (s), for choosing motions; None unless it `foresees`.

        The leader's state, its plausible rivals', and draws from its belief. Takes a fraction of a millisecond.
        """
        if not self._foresees or not isinstance(self._filters, ShapeFilters):
            return None
        bank, best = self._bank, self._bank.best()
        state, P = self._filters.as_shape_map(best), bank.P[best]
        try:
            root = np.linalg.cholesky(P + np.diag(np.full(len(P), 1e-16)))[: shape_map.N, : shape_map.N]
        except np.linalg.LinAlgError:
            return None
        rivals = [number for number in bank.plausible(PLAUSIBLE) if number != best][:RIVALS]
        too_sure = self._too_sure(t)
        drawn = state + too_sure * self._draws.standard_normal((SAMPLES - len(rivals), len(state))) @ root.T
        others = np.vstack([*(self._filters.as_shape_map(rival) for rival in rivals), drawn])
        for constant in (shape_map.Z.MU, shape_map.Z.DAMPING):
            others[:, constant] = np.abs(others[:, constant])
        outline = P[_SHAPE, _SHAPE]
        rows = _bin_rows(len(outline))
        h_sd = too_sure * np.sqrt(np.maximum(((rows @ outline) * rows).sum(axis=1), 0.0))
        return Outlook(t, np.vstack([state, others]), self._marks.marks.copy(), h_sd, self.object_count)

    # ---- starting and stopping

    def _begin_fresh(self) -> None:
        self._mass = self._new_mass()
        self._marks = Coverage()
        self._candidate = None
        self._rough_mass = self._new_mass()
        self._forget_history()
        self._t_start = math.inf
        self._t_unlikely: float | None = None

    def _new_mass(self) -> MassEstimator:
        return MassEstimator(self._rig.pads)

    def _try_to_start(self, t: float) -> None:
        fresh = all(abs(t - self._last_seen(pad)) < SILENCE_S for pad in PALMS)
        if fresh and self._palms_known(t):
            self._t_begun = t
            self._begin(t)

    def _begin(self, t: float) -> None:
        """Begin with what lies on the palms since `begun`, as what is remembered or blind."""
        self._begin_fresh()
        self._starts += 1
        one, two, palms = self._last[1], self._last[2], self._palms.motion(t)
        random = np.random.default_rng([self._seed, self._starts])
        known = self._memory.recall()
        self._use(self._smoothed.again if self._smoothed and known and known.smoothed else self._blind)
        size, order = self._bank.full_size, self._filters.order
        self._blind_radius_sd = circle_spread(self._rig, (one.s, two.s), palms.angles[1])
        self._start = blind_start((one.s, two.s), palms, size, self._starts == 1, random, order)
        self._bank.refill()
        self._filters.start(self._start, self._palms, t)
        self._experience = np.zeros(self._bank.size)
        self._start_known(one.s, two.s, palms, t)
        self._observability.begin(t, shape_map_sd(self._start))
        # what a smoother vouches for has been linearised well: only what begins blind has to forget
        blind = self._experience.reshape(self._bank.blocks, -1).min(axis=1) == 0.0
        self._t_faded = np.where(blind | (self._filters is self._blind), t, math.inf)
        self._t = self._t_start = t
        self._running = True

    def _start_known(self, s1: float, s2: float, palms: PalmMotion, t: float) -> None:
        """Let the bank's first filters begin from what is known beforehand; all are blind so far."""
        count = int(self._bank.full_size // self._bank.block * FROM_KNOWN) * self._bank.block
        known = self._candidate = self._memory.recall() if count else None
        if known is None:
            self.object_count += 1
            self._frame = None
            return
        psi = known.orientations((s1, s2), palms, self._pad_variances, count)
        self._filters.start_known(known.x, known.believed(), psi, self._palms, t)
        self._experience[:count] = EXPERIENCE_S

    def _decided(self, t: float, best: int, settled: bool) -> bool:
        """Whether the answer is settled and it is decided which object it is of: the known one, or a new one.

        Until then nothing is valid, so that nobody sees the count of objects change to and fro.
        """
        known, score, blind = self._candidate, self._bank.score, self._experience == 0.0
        if known is None:
            return settled
        for pad, f in zip(PALMS, resting_forces(self._rig.gravity, self._palms.at(t)), strict=True):
            self._rough_mass.weigh(self._last.get(pad), f)
        likely = not blind[best]
        alike = known.weighs(self._rough_mass.value) and (not likely or known.resembles(self._filters.belief(best)[0]))
        if likely and alike and (not known.smoothed or self._where_felt(known, best)):
            if not settled or (known.smoothed and not (self._lies_one_way(best) or t - self._t_start > UNDECIDED_S)):
                return False
            self._candidate, self._mass = None, known.mass
            if known.smoothed:
                assert known.spread is not None
                self._lead_with(*self._filters.belief(best), float(self._bank.nis[best]), known.touched, known.spread)
            else:
                self._marks = Coverage(known.touched, best)
                self._bank.drop(blind)
            return True
        clear = not alike or score[blind].max() - score[~blind].max() > CLEAR
        if t - self._t_start > (LOOKED_AT_S if clear else UNDECIDED_S):
            self._memory.forget()
            self._begin(t)
        return False

    def _where_felt(self, known: KnownObject, best: int) -> bool:
        """Whether the likeliest filter touches the known outline where that was felt: elsewhere any outline fits."""
        y = self._filters.all_named(self._t, self._palms)[best]
        return bool(known.touched[contact_bins(y)].all())

    def _lies_one_way(self, best: int) -> bool:
        """Whether the plausible filters that began from what is known agree on how it lies."""
        rivals = [number for number in self._bank.plausible(PLAUSIBLE) if self._experience[number] > 0.0]
        psi = self._filters.all_named(self._t, self._palms)[:, _PSI]
        apart = np.remainder(psi[rivals] - psi[best] + math.pi, math.tau) - math.pi
        return bool(np.abs(apart).max() < OTHERWISE_RAD)

    def _keep(self, t: float, best: int) -> None:
        """Remember the settled map, for when the object is lost and put back."""
        if self._memory.due(t):
            x, P = self._filters.belief(best)
            spread = self._smoothed.one.spread if self._smoothed and self._carrying else None
            self._memory.keep(t, KnownObject(x, P, self._marks.marks.copy(), self._mass, spread))

    def _stop(self) -> None:
        self._running = self._foresees = self._valid = False
        self._last.clear()

    @property
    def _carrying(self) -> bool:
        """Whether one filter carries to the present what a smoother knows; else a bank looks for the object."""
        return self._smoothed is not None and self._filters is self._smoothed.one

    def _too_sure(self, t: float) -> float:
        """What to multiply one-sigmas with at `t` (s)."""
        return 1.0 if self._filters is not self._blind else self._filters.optimism.factor(t - self._t_start)

    def _use(self, filters: Filters) -> None:
        self._filters = filters
        self._fused: list[_Fused] = []
        self._spare = self._blank[id(filters)].copy()

    def _palms_known(self, t: float) -> bool:
        return t - self._palms.t < PALMS_UNKNOWN_S

    def _bridge(self, t: float, gap: float) -> None:
        """The palms are reported again after `gap` seconds: go on from a guess of what was between, or begin anew."""
        if gap > GONE_S:
            self._stop()
            return
        self._forget_history()
        if t > self._t:
            self._move_to(t)
        self._filters.doubt(gap)

    def _last_seen(self, pad: int) -> float:
        sample = self._last.get(pad)
        return -math.inf if sample is None else sample.t_sample

    def _watch_for_loss(self, t: float, best: int) -> None:
        if t - self._t_start < MIN_AGE_S or self._bank.nis[best] < LOST_NIS:
            self._t_unlikely = None
        elif self._t_unlikely is None:
            self._t_unlikely = t
        elif t - self._t_unlikely > LOST_FOR_S:
            if self._experience.any() or (self._smoothed and not self._carrying):
                self._memory.forget()  # what was known of the object has led astray
            self._stop()

    # ---- fusing in the order of the samples' own times

    def _fuse_in_order(self, event: PadSample | PalmSample) -> None:
        if event.t_sample < self._t_start:
            return
        if event.t_sample >= self._t:
            self._fuse(event)
            return
        at = bisect_right([entry.t for entry in self._fused], event.t_sample)
        undone = self._fused[at:]
        if not undone or event.t_sample < undone[0].t_before:
            self.late_dropped += 1
            return
        self._bank.restore(undone[0].before)
        self._t, self._t_faded = undone[0].t_before, undone[0].t_faded
        del self._fused[at:]
        self._spare += [entry.before for entry in undone]
        for each in (event, *(entry.event for entry in undone)):
            self._fuse(each)

    def _forget_history(self) -> None:
        """What came before can no longer be undone."""
        self._spare += [entry.before for entry in self._fused]
        self._fused.clear()

    def _fuse(self, event: PadSample | PalmSample) -> None:
        before = self._spare.pop() if self._spare else self._fused.pop(0).before
        self._bank.remember(before)
        self._fused.append(_Fused(event.t_sample, event, self._t, self._t_faded.copy(), before))
        self._move_to(event.t_sample)
        self._forget_some()
        if isinstance(event, PadSample):
            age = event.t_sample - self._t_start
            caution = 1.0 if self._carrying else 1.0 + CAUTION * math.exp(-age / CAUTION_S)
            self._filters.fuse_pad(event, caution * float(self._pad_variances[event.pad - 1]), self._palms)
        else:
            self._filters.fuse_palms(event, self._rig.palm_angle_noise**2)

    def _forget_some(self) -> None:
        block = int(self._t_faded[: self._bank.blocks].argmin())  # one at a time, so that no tick pays for all
        since = self._t - self._t_faded[block]
        age = self._t - self._t_start
        if since < min(max(FADE_EVERY_S, age / 10), FADE_AT_LEAST_EVERY_S):
            return
        surprise = max(0.0, self._bank.nis[self._bank.best()] - SURPRISING_NIS)
        learnt = age + float(self._experience[self._bank.members(block)].min())
        fraction = FADE * since / (FADE_AGE_S + learnt) * (1.0 + FADE_BY_SURPRISE * surprise)
        self._bank.fade(block, min(fraction, 1.0), self._constants())
        self._convex(block)
        self._t_faded[block] = self._t
        kept = self._prune(age)
        if kept is not None:
            self._forget_history()
            self._experience = self._experience[kept]
            self._marks.renumber(kept)

    def _constants(self) -> Belief:
        """What was believed of each filter's constants at the start."""
        return self._filters.constants(self._start)

    def _prune(self, age: float) -> npt.NDArray[np.intp] | None:
        """Drop the hopeless at `age` (s); the former indices of those that stay, None if none went."""
        return self._bank.prune(HOPELESS) if age > PRUNE_AGE_S else None

    def _convex(self, block: int) -> bool:
        """Whether the outlines of a block's filters are; those that are not are bent towards it."""
        return self._bank.lift(block, self._filters.curvature)

    def _move_to(self, t: float) -> None:
        carry(self._filters, self._t, t, self._palms)
        self._t = t

    # ---- reading off

    def _rivals_spread(self, best: int) -> FloatArray:
        """One-sigma of the plausible rivals' answers about the best one's, weighted by likelihood."""
        rivals = self._bank.plausible(PLAUSIBLE)
        if len(rivals) == 1:
            return np.zeros(len(NAMED))
        answers = self._filters.all_named(self._t, self._palms)
        weights = np.exp(self._bank.score[rivals] - self._bank.score[best])
        spread: FloatArray = np.sqrt(weights @ self._apart(answers[rivals] - answers[best]) ** 2 / weights.sum())
        return spread

    def _apart(self, differences: FloatArray) -> FloatArray:
        """Differences of `NAMED` between filters (count, len(NAMED)), as far as they mean anything."""
        differences[:, _PSI] = 0.0  # each filter has its own gauge
        return differences

    def _settled(self, t: float, best: int, sd: FloatArray, spread: FloatArray) -> bool:
        touching = not self._lifted and all(t - self._last_seen(pad) < SILENCE_S for pad in PALMS)
        felt = touching and self._palms_known(t) and t - self._heard_again > HEARD_AGAIN_S
        consistent = NIS_RANGE[0] < self._bank.nis[best] < NIS_RANGE[1]
        sharp = sd[_RADII].max() < SETTLED_SD and spread[_RADII].max() < AGREEMENT
        return bool(felt and consistent and sharp and t - self._t_start > MIN_AGE_S)

    def _rough(self, t: float, sd: FloatArray) -> bool:
        """Whether the answer, rivals included, is known well enough to foresee what a motion will do."""
        old, touching = t - self._t_start > ROUGH_AGE_S, all(t - self._last_seen(pad) < SILENCE_S for pad in PALMS)
        return bool(self._running and old and touching and sd[_RADII].max() < ROUGH_SD)

    def _all_psi(self) -> FloatArray:
        return self._filters.all_named(self._t, self._palms)[:, _PSI]


def _turned(x: FloatArray, P: FloatArray, spread: FloatArray, turn: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A state of `model.shape_map`, its covariance and its spread in a gauge in which ψ is larger by `turn` (rad)."""
    matrix = np.eye(len(x))
    matrix[_SHAPE, _SHAPE] = shape.turned(turn, (len(x) - shape_map.Z.SHAPE - 1) // 2)
    moved = matrix @ x
    moved[shape_map.Z.PSI] += turn
    return moved, matrix @ P @ matrix.T, matrix @ spread


@cache
def _rows(coefficients: int) -> FloatArray:
    """Values of the outline's harmonics on the published directions."""
    return shape.basis(_THETA, (coefficients - 1) // 2)


@cache
def _bin_rows(coefficients: int) -> FloatArray:
    """The same in the middles of the bins of normals."""
    return shape.basis(_BINS, (coefficients - 1) // 2)


def finite(event: PadSample | PalmSample) -> bool:
    """Whether every number that the event tells is one."""
    values: tuple[float, ...]
    if isinstance(event, PadSample):
        values = (event.t_sample, event.s, event.force or 0.0)
    else:
        values = (event.t_sample, *event.told)
    return all(map(math.isfinite, values))
