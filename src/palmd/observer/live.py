"""The observer that the daemon runs: a bank of filters, from the first touch to a settled estimate and beyond.

It starts blind from a circle when both palms feel the object, fuses every event at its own time (going back for
a late one), and says `valid` only when the most likely filter is settled, consistent with the readings and in
agreement with its plausible rivals. It starts again when the object is lifted or the readings say it is lost.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from palmd.events import (
    Estimate,
    Event,
    FloatArray,
    PadLift,
    PadSample,
    PalmSample,
    RigDescription,
    ShapeEstimate,
)
from palmd.model import shape
from palmd.model.named import NAMED
from palmd.observer.bank import Bank, Snapshot
from palmd.observer.filters import Filters
from palmd.observer.mass import MassEstimator
from palmd.observer.palms import PalmTracker
from palmd.observer.prior import blind_start

LONGEST_STEP_S = 0.0061  # of one integration step: readings of one pad come every 10 ms
SILENCE_S = 0.1  # a pad silent for longer does not vouch for a contact
GONE_S = 0.4  # a pad silent for longer: the object has left the palms
HISTORY = 24  # events that can be undone for a late one
SETTLED_SD = 3e-4  # m, of r1 and r2
AGREEMENT = 3e-4  # m, among plausible filters
PLAUSIBLE = 12.0  # nats below the best
HOPELESS, PRUNE_AGE_S = 100.0, 4.0  # nats below the best, from which no filter comes back once so old
MIN_AGE_S = 0.4
LOST_NIS = 3.0
LOST_FOR_S = 0.4
NIS_RANGE = (0.2, 2.0)  # of the running mean, to be called consistent
NORMAL_BINS = 72
# The first readings are fused about a blind guess: they weigh little at first, …
CAUTION, CAUTION_S = 20.0, 0.3
# … and all readings fade as a power of their age, so that the first do not bend the answer for ever.
FADE, FADE_AGE_S, FADE_EVERY_S, FADE_AT_LEAST_EVERY_S = 1.5, 0.2, 0.2, 0.5
# Readings that keep surprising the best filter make it forget faster.
SURPRISING_NIS, FADE_BY_SURPRISE = 1.4, 20.0

DIRECTIONS = 180  # of the published outline
_THETA = np.linspace(0.0, 2 * np.pi, DIRECTIONS, endpoint=False)
_ROWS = shape.basis(_THETA)
_BIN_OF_THETA = (_THETA / (2 * np.pi) * NORMAL_BINS).astype(np.intp)
_R1, _R2, _F1, _F2 = (NAMED.index(name) for name in ("r1", "r2", "f1", "f2"))
_PUBLISHED = tuple(name for name in NAMED if name not in ("f1", "f2"))


@dataclass(slots=True)
class _Fused:
    """An event in the order of its own time, and the bank as it was before it."""

    t: float
    event: PadSample | PalmSample
    t_before: float
    t_faded: FloatArray
    before: Snapshot


class BankObserver:
    """Events in, estimates out. `feed` and `estimate` take bounded time and are safe inside the loop."""

    def __init__(self, filters: Filters, rig: RigDescription, seed: int = 0):
        """Deterministic for given `seed`, events and times."""
        self.name = filters.name
        self._filters = filters
        self._rig = rig
        self._seed = seed
        self._pad_variance = rig.pad_noise**2 + rig.pad_resolution**2 / 12
        self._fused: list[_Fused] = []
        self._spare = [self._bank.blank() for _ in range(HISTORY)]
        self.reset()

    def reset(self) -> None:
        """Back to the very beginning, as if nothing had been fed."""
        self.object_count = 0
        self.late_dropped = 0
        self._palms = PalmTracker(self._rig.palm_angle_noise)
        self._last: dict[int, PadSample] = {}
        self._lifted: set[int] = set()
        self._t = -math.inf  # up to which the bank has been moved
        self._running = False
        self._begin_fresh()

    def warm_up(self) -> None:
        """Pay the costs of first calls (page faults, the linear algebra's work space) now; ends with a `reset`.

        For before the loop begins: it takes some milliseconds.
        """
        for i in range(2 * HISTORY):
            t = i * 0.01
            self.feed(PalmSample(t, 0.8, 1.6, 0.0, 0.0, 0.0, 0.0))
            self.feed(PadSample(t, 1, 0.02, 1.0))
            self.feed(PadSample(t, 2, 0.02, 1.0))
            self.estimate(t)
            self.shape(t)
        self.reset()

    @property
    def backend(self) -> str:
        """What runs the models: "c" or "vm"."""
        return self._filters.bank.backend

    @property
    def _bank(self) -> Bank:
        return self._filters.bank

    def feed(self, event: Event) -> None:
        """Take one event. A late one is fused at its own time; one too late for that is counted and dropped."""
        if isinstance(event, PadLift):
            self._lifted.add(event.pad)
            return
        if not _finite(event):
            self.late_dropped += 1
            return
        if isinstance(event, PalmSample):
            self._palms.feed(event)
        else:
            previous = self._last.get(event.pad)
            if previous is None or event.t_sample >= previous.t_sample:
                self._last[event.pad] = event
                self._lifted.discard(event.pad)
        if self._running:
            if event.t_sample - self._t > GONE_S:
                self._stop()
            elif isinstance(event, PadSample) or self._filters.fuses_palms:
                self._fuse_in_order(event)
        if not self._running:
            self._try_to_start(event.t_sample)

    def estimate(self, t: float) -> Estimate:
        """The most likely filter's answer for time `t` ≥ the last event (s); never raises, NaN where unknown."""
        if self._running and (self._bank.lost() or any(t - self._last_seen(pad) > GONE_S for pad in (1, 2))):
            self._stop()
        if not self._running:
            return self._nothing(t)
        best = self._bank.best()
        dt = min(max(t - self._t, 0.0), LONGEST_STEP_S * 4)
        y, cov = self._filters.named(best, self._t, dt, self._palms)
        spread = self._rivals_spread(best)
        sd = np.sqrt(np.maximum(np.diagonal(cov), 0.0) + spread**2)
        sd *= self._filters.optimism.factor(t - self._t_start)
        finite = bool(np.isfinite(y).all() and np.isfinite(sd).all())
        settled = finite and self._settled(t, best, sd, spread)
        self._watch_for_loss(t, best)
        if settled:
            self._mark_touched(best, y)
            self._weigh(y)
        return self._assemble(t, settled, best, y, sd)

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline of the most likely filter on `DIRECTIONS` normals, None before anything is felt."""
        if not self._running or self._bank.lost():
            return None
        coefficients, cov = self._filters.outline(self._bank.best())
        h_sd = np.sqrt(np.maximum(((_ROWS @ cov) * _ROWS).sum(axis=1), 0.0))
        h_sd *= self._filters.optimism.factor(t - self._t_start)
        return ShapeEstimate(t, _THETA, _ROWS @ coefficients, h_sd, self._touched[_BIN_OF_THETA])

    # ---- starting and stopping

    def _begin_fresh(self) -> None:
        self._mass = MassEstimator(self._rig.force_scale_std, self._rig.force_resolution)
        self._weighed: dict[int, float] = {}
        self._touched = np.zeros(NORMAL_BINS, dtype=np.bool_)
        self._last_normals: tuple[float, float] | None = None
        self._marked = -1
        self._forget_history()
        self._t_start = math.inf
        self._t_unlikely: float | None = None

    def _try_to_start(self, t: float) -> None:
        fresh = all(abs(t - self._last_seen(pad)) < SILENCE_S for pad in (1, 2))
        if not (fresh and self._palms.known):
            return
        self._begin_fresh()
        self.object_count += 1
        one, two = self._last[1], self._last[2]
        random = np.random.default_rng([self._seed, self.object_count])
        at_rest = self.object_count == 1
        start = blind_start(one.s, two.s, self._palms.motion(t), self._bank.full_size, at_rest, random)
        self._bank.refill()
        self._filters.start(start, self._palms, t)
        self._start = start
        self._t_faded = np.full(self._bank.blocks, t)
        self._t = self._t_start = t
        self._running = True

    def _stop(self) -> None:
        self._running = False
        self._last.clear()

    def _last_seen(self, pad: int) -> float:
        sample = self._last.get(pad)
        return -math.inf if sample is None else sample.t_sample

    def _watch_for_loss(self, t: float, best: int) -> None:
        if t - self._t_start < MIN_AGE_S or self._bank.nis[best] < LOST_NIS:
            self._t_unlikely = None
        elif self._t_unlikely is None:
            self._t_unlikely = t
        elif t - self._t_unlikely > LOST_FOR_S:
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
            caution = 1.0 + CAUTION * math.exp(-age / CAUTION_S)
            self._filters.fuse_pad(event, caution * self._pad_variance, self._palms)
        else:
            self._filters.fuse_palms(event, self._rig.palm_angle_noise**2)

    def _forget_some(self) -> None:
        block = int(self._t_faded[: self._bank.blocks].argmin())  # one at a time, so that no tick pays for all
        since = self._t - self._t_faded[block]
        age = self._t - self._t_start
        if since < min(max(FADE_EVERY_S, age / 10), FADE_AT_LEAST_EVERY_S):
            return
        surprise = max(0.0, self._bank.nis[self._bank.best()] - SURPRISING_NIS)
        fraction = FADE * since / (FADE_AGE_S + age) * (1.0 + FADE_BY_SURPRISE * surprise)
        self._bank.fade(block, min(fraction, 1.0), self._filters.constants(self._start))
        self._t_faded[block] = self._t
        kept = self._bank.prune(HOPELESS) if age > PRUNE_AGE_S else None
        if kept is not None:
            self._forget_history()
            self._marked = int(np.flatnonzero(kept == self._marked)[0]) if self._marked in kept else -1

    def _move_to(self, t: float) -> None:
        gap = t - self._t
        steps = max(1, math.ceil(gap / LONGEST_STEP_S))
        for _ in range(steps):
            self._filters.predict(self._t, gap / steps, self._palms)
            self._t += gap / steps
        self._t = t

    # ---- reading off

    def _rivals_spread(self, best: int) -> FloatArray:
        """One-sigma of the plausible rivals' answers about the best one's, weighted by likelihood."""
        rivals = self._bank.plausible(PLAUSIBLE)
        if len(rivals) == 1:
            return np.zeros(len(NAMED))
        answers = self._filters.all_named(self._t, self._palms)
        weights = np.exp(self._bank.score[rivals] - self._bank.score[best])
        spread: FloatArray = np.sqrt(weights @ (answers[rivals] - answers[best]) ** 2 / weights.sum())
        spread[NAMED.index("psi")] = 0.0  # each filter has its own gauge
        return spread

    def _settled(self, t: float, best: int, sd: FloatArray, spread: FloatArray) -> bool:
        touching = not self._lifted and all(t - self._last_seen(pad) < SILENCE_S for pad in (1, 2))
        consistent = NIS_RANGE[0] < self._bank.nis[best] < NIS_RANGE[1]
        sharp = max(sd[_R1], sd[_R2]) < SETTLED_SD and max(spread[_R1], spread[_R2]) < AGREEMENT
        return bool(touching and consistent and sharp and t - self._t_start > MIN_AGE_S)

    def _mark_touched(self, best: int, y: FloatArray) -> None:
        if best != self._marked:
            self._turn_marks(best)
        at = dict(zip(NAMED, y, strict=True))
        normals = (
            at["phi1"] - at["psi"] - math.pi / 2,
            at["phi1"] + at["phi2"] - at["psi"] - 3 * math.pi / 2,
        )
        for now, before in zip(normals, self._last_normals or normals, strict=True):
            first, last = sorted((now, before))
            width = 2 * math.pi / NORMAL_BINS
            for bin_ in range(math.floor(first / width), math.floor(last / width) + 1):
                self._touched[bin_ % NORMAL_BINS] = True
        self._last_normals = normals

    def _turn_marks(self, best: int) -> None:
        """Another filter has taken the lead: what was touched before has other names in its gauge."""
        if self._marked >= 0:
            psi = self._filters.all_named(self._t, self._palms)[:, NAMED.index("psi")]
            turn = psi[best] - psi[self._marked]
            self._touched = np.roll(self._touched, -round(turn / (2 * math.pi) * NORMAL_BINS))
        else:
            self._touched[:] = False
        self._last_normals = None
        self._marked = best

    def _weigh(self, y: FloatArray) -> None:
        for pad, f in ((1, y[_F1]), (2, y[_F2])):
            sample = self._last.get(pad)
            if sample is None or sample.force is None or self._weighed.get(pad) == sample.t_sample:
                continue
            self._weighed[pad] = sample.t_sample
            self._mass.feed(sample.force, float(f))

    def _assemble(self, t: float, valid: bool, best: int, y: FloatArray, sd: FloatArray) -> Estimate:
        values = dict(zip(NAMED, (float(v) for v in y), strict=True))
        sds = dict(zip(NAMED, (float(v) for v in sd), strict=True))
        mass, mass_sd = self._mass.value, self._mass.sd
        forces = {name: values.pop(name) for name in ("f1", "f2")}
        newtons = {name: mass * f for name, f in forces.items()}
        newtons_sd = {name: math.hypot(mass * sds[name], mass_sd * f) for name, f in forces.items()}
        return Estimate(
            t=t, valid=valid, observer=self.name, object_count=self.object_count,
            mass=mass, nis=float(self._bank.nis[best]), observability=math.nan,
            touched=float(self._touched.mean()),
            sd={**{name: sds[name] for name in _PUBLISHED}, **newtons_sd, "mass": mass_sd},
            **values, **newtons,
        )  # fmt: skip

    def _nothing(self, t: float) -> Estimate:
        unknown = dict.fromkeys((*NAMED, "mass", "nis", "observability"), math.nan)
        if self._palms.known:
            palms = self._palms.motion(t)
            unknown |= {name: getattr(palms, name) for name in ("phi1", "phi2", "omega1", "omega2")}
        return Estimate(
            t=t, valid=False, observer=self.name, object_count=self.object_count, touched=0.0,
            sd=dict.fromkeys((*NAMED, "mass"), math.nan), **unknown,
        )  # fmt: skip


def _finite(event: PadSample | PalmSample) -> bool:
    values: tuple[float, ...]
    if isinstance(event, PadSample):
        values = (event.t_sample, event.s, event.force or 0.0)
    else:
        told = (event.omega1, event.omega2, event.alpha1, event.alpha2)
        values = (event.t_sample, event.phi1, event.phi2, *(v or 0.0 for v in told))
    return all(map(math.isfinite, values))
