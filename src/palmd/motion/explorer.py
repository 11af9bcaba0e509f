"""Chooses palm motions that show the rest of an outline, by trying many of them on what is known of the object. Pure.

Each decision rolls some two hundred sequences of palm moves forward with the object's likeliest state, weighs what new
normals the palms would touch against the time that takes, and tries the best ones again on samples of what the
object may be besides. The first move of the best sequence that is safe with all of them is the decision; the rest is
kept as one more sequence for the next. Jumps are foreseen like any other motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from palmd.config import ExploreGoal
from palmd.events import FloatArray, Outlook, RigDescription
from palmd.model import shape_map
from palmd.model.named import rig_inputs
from palmd.model.shape import COEFFICIENTS, basis
from palmd.model.stable_poses import normals
from palmd.model.stable_surface import SurfaceLimits, stable_surface
from palmd.motion import candidates
from palmd.motion.foresight import BINS, Bools, Foreseen, Foresight, Moves
from palmd.motion.limits import PHI12_MAX, MotionLimits, problems, ranges
from palmd.motion.segments import Angles, Move

LOOPS, SINGLE_MOVES = 128, 64  # sequences tried
MOVES, HORIZON_S = 5, 8.0  # of each: a round and a bit more, looked at so far ahead
# Each time that so long nothing new has been touched, sequences become longer, what they lead to counts more than how
# soon, and one bin, drawn at random, is headed for: small steps towards the nearest one have led to a corner.
SLOW_S, MORE_MOVES, MORE_S, PATIENCE_S, SLOWEST = 4.0, 3, 4.0, 3.0, 2
CHECKED = 6  # of the best sequences, on all samples
LEAST_FORCE = 0.8  # m/s², of a contact: one that rests has several
MARGIN_M = 3e-3  # of the contacts from a pad's ends
STAND_S = 1.0  # for which it must be safe to stand after a move: the next decision may be late
DOUBTFUL = 0.5  # of these, that samples of the object must keep
DECISION_S = 0.15  # that a decision costs, so that moves are not made ever shorter
# What it is worth to be a bin nearer to what is wanted, against one touched: with the palms where they then are, and
# for palms in the middle of their range, so that turning the object on counts though the palms go back and forth.
APPROACH = 0.25
UPRIGHT = np.radians([45.0, 90.0])
REACH_EVERY_S = 4.0
# As long as the radii at the contacts are not known better, the palms keep to gentle moves far from the pads' ends.
CAREFUL_M = 2.5e-4
CAREFUL_PHI1, CAREFUL_PHI2 = (math.radians(22.0), math.radians(75.0)), (math.radians(66.0), math.radians(118.0))
CAREFUL_RATE = math.radians(100.0)
STUCK_S = 40.0  # without anything new
ANY_PHI1, ANY_PHI2, ANY_LENGTH_M = (0.02, 2.9), (0.1, 2.95), 0.5  # as if there were no limits

_MIDDLES = (np.arange(BINS) + 0.5) * (2 * np.pi / BINS)

Kind = Literal["move", "wait", "unsafe", "done"]


@dataclass(frozen=True, slots=True)
class UnderWay:
    """What the palms are commanded to do: a move, and for how long already (s); at rest when that is its duration."""

    move: Move
    elapsed: float


@dataclass(frozen=True, slots=True)
class Decision:
    """What to do next.

    move: from where the one under way ends, from rest to rest. reason: in words. coverage: the share touched of the
    normals that can be reached; reachable: their share of all.
    """

    kind: Kind
    move: Move | None = None
    reason: str = ""
    coverage: float = math.nan
    reachable: float = math.nan


class Explorer:
    """Decides one move at a time. A decision takes some tenths of a second: for a process beside the loop."""

    def __init__(self, rig: RigDescription, limits: MotionLimits, goal: ExploreGoal, seed: int = 0):
        """Deterministic for given `seed` and calls; takes seconds when its C has to be compiled first."""
        self._limits = limits
        self._goal = goal
        self._careful = replace(
            limits,
            phi1=_within(CAREFUL_PHI1, limits.phi1),
            phi2=_within(CAREFUL_PHI2, limits.phi2),
            rate=min(CAREFUL_RATE, limits.rate),
        )
        self._random = np.random.default_rng(seed)
        self._foresight = Foresight(rig_inputs(rig))
        self._surface_limits = SurfaceLimits(
            limits.phi1, (limits.bounds[1].low, limits.bounds[1].high), PHI12_MAX, limits.pad_length, MARGIN_M
        )
        self._t_begin = math.nan
        self._object_count = 0
        self._kept: Moves | None = None
        self._forget()

    def decide(self, outlook: Outlook, under_way: UnderWay) -> Decision:
        """What the palms shall do after the move under way, or that it must not go on."""
        if outlook.object_count != self._object_count:
            self._object_count = outlook.object_count
            self._forget()
        if math.isnan(self._t_begin):
            self._t_begin = outlook.t
        self._see(outlook)
        coverage, reachable = self._coverage(outlook.touched), float(self._reach.mean())
        ended = self._ended(outlook, coverage)
        if ended:
            return Decision("done", None, ended, coverage, reachable)
        self._t = outlook.t
        self._patience = min(int((outlook.t - self._t_new) / SLOW_S), SLOWEST)
        states, touched, safe = self._after(outlook, under_way)
        if not safe:
            return Decision("unsafe", None, "the move under way would lose a contact", coverage, reachable)
        start = np.array(under_way.move.end)
        careful = _spread(states, start) > CAREFUL_M
        tried = self._tried(start, self._careful if careful else self._limits)
        move = self._choose(states, tried, touched, self._wanted(outlook))
        if move is None:
            return Decision("wait", None, "no safe motion found yet", coverage, reachable)
        return Decision("move", move, "", coverage, reachable)

    # ---- what is known, and what is wanted

    def _forget(self) -> None:
        self._reach: Bools = np.ones(BINS, dtype=np.bool_)
        self._t_seen = self._t_new = -math.inf
        self._most = self._patience = 0
        self._aimed_at = (-1, 0)  # when, and at which bin
        self._kept = None

    def _see(self, outlook: Outlook) -> None:
        if outlook.touched.sum() > self._most or math.isinf(self._t_new):
            self._most, self._t_new = int(outlook.touched.sum()), outlook.t
        if outlook.t - self._t_seen < REACH_EVERY_S:
            return
        self._t_seen = outlook.t
        self._reach = _reach(outlook, self._surface_limits) | outlook.touched

    def _coverage(self, touched: Bools) -> float:
        return float((touched & self._reach).sum() / max(self._reach.sum(), 1))

    def _wanted(self, outlook: Outlook) -> FloatArray:
        """What touching each bin is worth: 1 where nobody has been, less where the outline is not known well enough."""
        worth = np.where(outlook.touched, 0.0, 1.0)
        if self._goal.band_mm is not None:
            over = outlook.h_sd / (self._goal.band_mm * 1e-3) - 1.0
            worth = np.maximum(worth, np.clip(over, 0.0, 1.0))
        return np.where(self._reach, worth, 0.0)

    def _ended(self, outlook: Outlook, coverage: float) -> str:
        band = self._goal.band_mm
        sharp = band is None or bool((outlook.h_sd[self._reach] < band * 1e-3).all())
        if coverage >= self._goal.coverage and sharp:
            return f"{coverage:.0%} of what can be reached is touched{self._told(outlook)}"
        if outlook.t - self._t_begin > self._goal.time_limit_s:
            return f"the time limit of {self._goal.time_limit_s:g} s is over{self._told(outlook)}"
        if outlook.t - self._t_new > STUCK_S and sharp:
            return f"nothing new for {STUCK_S:g} s{self._told(outlook)}"
        return ""

    def _told(self, outlook: Outlook) -> str:
        """Which arcs of the outward normal were not touched, and which cannot be, and why."""
        left = self._reach & ~outlook.touched
        parts = [f"not touched: {_arcs(left)}"] if left.any() else []
        out = ~self._reach
        for limits, why in (
            (replace(self._surface_limits, phi1=ANY_PHI1, phi2=ANY_PHI2), "the limits of the palm angles"),
            (replace(self._surface_limits, pad_length=ANY_LENGTH_M), "the pads' length"),
            (
                SurfaceLimits(ANY_PHI1, ANY_PHI2, PHI12_MAX, ANY_LENGTH_M, 0.0),
                "these limits and the pads' length together",
            ),
        ):
            opened = out & _reach(outlook, limits) if out.any() else out
            if opened.any():
                parts.append(f"out of reach because of {why}: {_arcs(opened)}")
            out = out & ~opened
        if out.any():
            parts.append(f"in no stable pose: {_arcs(out)}")
        return "".join(f"; {part}" for part in parts)

    # ---- what will be

    def _after(self, outlook: Outlook, under_way: UnderWay) -> tuple[FloatArray, Bools, bool]:
        """The states when the move under way has ended, what is touched then, and whether all get there safely."""
        states = outlook.states.copy()
        move, count = under_way.move, len(states)
        if under_way.elapsed >= move.duration:
            return states, outlook.touched, True
        ends, durations = np.tile(np.array(move.end), (count, 1, 1)), np.full((count, 1), move.duration)
        foreseen = self._foresight.of(states, Moves(np.array(move.start), ends, durations), under_way.elapsed)
        states[:, shape_map.Z.PSI], states[:, shape_map.Z.OMEGA0] = foreseen.psi[:, 0], foreseen.omega0[:, 0]
        return states, outlook.touched | foreseen.touched[0, 0], bool((self._goodness(foreseen) > 0.0).all())

    def _choose(self, states: FloatArray, tried: Moves, touched: Bools, worth: FloatArray) -> Move | None:
        wanted = np.where(touched, 0.0, worth) if self._goal.band_mm is None else worth
        foreseen = self._foresight.of(states[0], tried, 0.0, HORIZON_S + self._patience * MORE_S)
        score = self._score(foreseen, tried, states[0], wanted)
        best = np.argsort(-score.max(axis=1), kind="stable")[:CHECKED]
        best = best[np.isfinite(score[best].max(axis=1))]
        for number in best:
            if self._safe_for_all(states, tried, int(number)):
                ends, durations = tried.ends[number], tried.durations[number]
                self._kept = Moves(ends[0], ends[None, 1:], durations[None, 1:])
                return _first_move(tried, int(number))
        self._kept = None
        return self._least_bad(foreseen, tried, states[0])

    def _least_bad(self, foreseen: Foreseen, tried: Moves, state: FloatArray) -> Move | None:
        """The first move that comes nearest to being safe, if standing still is worse."""
        still = Moves(tried.start, tried.start[None, None], np.full((1, 1), STAND_S))
        standing = self._goodness(self._foresight.of(state, still))[0, 0]
        goodness = self._goodness(foreseen)[:, 0]
        for number in np.argsort(-goodness, kind="stable")[:CHECKED]:
            if goodness[number] > standing and self._within_limits(_first_move(tried, int(number))):
                return _first_move(tried, int(number))
        return None

    def _goodness(self, foreseen: Foreseen) -> FloatArray:
        """How safe it is up to the end of each move (N, k): 1 as near to danger as allowed, 0 a contact lost or off."""
        margins = np.minimum(foreseen.nearest, self._limits.pad_length - foreseen.farthest) / MARGIN_M
        goodness: FloatArray = np.minimum(margins, foreseen.least_force / LEAST_FORCE)
        return goodness

    def _tried(self, start: FloatArray, limits: MotionLimits) -> Moves:
        length = MOVES + self._patience * MORE_MOVES
        parts = [
            candidates.loops(self._random, start, LOOPS, length, limits),
            candidates.single_moves(self._random, start, SINGLE_MOVES, length, limits),
        ]
        kept = self._kept
        if (
            kept is not None
            and limits is self._limits
            and np.allclose(kept.start, start)
            and kept.durations.shape[1] == length - 1
        ):
            again = np.concatenate([kept.ends, kept.ends[:, -1:]], axis=1)
            durations = np.concatenate([kept.durations, np.full((1, 1), candidates.SHORTEST_S)], axis=1)
            parts.append(Moves(start, again, durations))
        ends, durations = (np.concatenate([getattr(part, name) for part in parts]) for name in ("ends", "durations"))
        return Moves(start, ends, durations)

    def _score(self, foreseen: Foreseen, tried: Moves, state: FloatArray, wanted: FloatArray) -> FloatArray:
        """What each beginning of each sequence brings in a second (N, k), −inf where it is not safe."""
        gain = foreseen.touched @ wanted
        time_s = np.cumsum(tried.durations, axis=1) + DECISION_S + self._patience * PATIENCE_S
        psi = state[shape_map.Z.PSI]
        nearer = _distance(_normals(tried.start, psi), wanted) - _distance(foreseen.normals, wanted)
        aim = self._aim(wanted) if self._patience else wanted
        turned = _distance(_normals(UPRIGHT, psi), aim) - _distance(_normals(UPRIGHT, foreseen.psi), aim)
        approach = turned if self._patience else nearer + turned
        score = (gain + APPROACH * approach * (BINS / (2 * np.pi))) / time_s
        return np.where(self._goodness(foreseen) > 1.0, score, -np.inf)

    def _aim(self, wanted: FloatArray) -> FloatArray:
        """One of the wanted bins, the same one for `SLOW_S`."""
        now = int((self._t - self._t_new) / SLOW_S)
        if now != self._aimed_at[0] or not wanted[self._aimed_at[1]]:
            self._aimed_at = now, int(self._random.choice(np.flatnonzero(wanted))) if wanted.any() else 0
        aim = np.zeros(BINS)
        aim[self._aimed_at[1]] = wanted[self._aimed_at[1]]
        return aim

    def _safe_for_all(self, states: FloatArray, tried: Moves, number: int) -> bool:
        """Whether no sample of the object loses a contact on the first move, nor if the palms then stand still."""
        first = _first_move(tried, number)
        if not self._within_limits(first):
            return False
        count, end = len(states), np.array(first.end)
        ends, durations = np.tile(end, (count, 2, 1)), np.tile([first.duration, STAND_S], (count, 1))
        goodness = self._goodness(self._foresight.of(states, Moves(tried.start, ends, durations)))[:, -1]
        return bool(goodness[0] > 1.0 and goodness.min() > DOUBTFUL)

    def _within_limits(self, move: Move) -> bool:
        motion = [self._limits.values(move.at(t)) for t in np.linspace(0.0, move.duration, 12)]
        return not problems(self._limits.bounds, ranges(motion))


def _first_move(tried: Moves, number: int) -> Move:
    return Move(_pose(tried.start), _pose(tried.ends[number, 0]), float(tried.durations[number, 0]))


def _spread(states: FloatArray, pose: FloatArray) -> float:
    """How far the states disagree about the radii at the palms' pose (rad): the largest one-sigma (m)."""
    psi = states[:, shape_map.Z.PSI]
    radii = [(basis(theta) * states[:, shape_map.Z.SHAPE :]).sum(axis=1) for theta in _normals(pose, psi).T]
    return float(np.std(radii, axis=1).max())


def _within(wish: tuple[float, float], limit: tuple[float, float]) -> tuple[float, float]:
    """The part of the wished-for range that is allowed, the whole of what is allowed if there is none."""
    low, high = max(wish[0], limit[0]), min(wish[1], limit[1])
    return (low, high) if low < high else limit


def _normals(pose: FloatArray, psi: FloatArray | float) -> FloatArray:
    """Both outward normals (…, 2) of an object at ψ (rad) between palms at `pose` (rad)."""
    return np.stack(normals(pose[0], pose[1], np.asarray(psi)), axis=-1)


def _distance(theta: FloatArray, wanted: FloatArray) -> FloatArray:
    """From the nearer of both normals (…, 2) to the nearest bin that is wanted (rad), (…); 0 where nothing is."""
    middles = _MIDDLES[wanted > 0.0]
    if not len(middles):
        return np.zeros(theta.shape[:-1])
    apart = np.abs(np.remainder(theta[..., None] - middles + np.pi, 2 * np.pi) - np.pi)
    distance: FloatArray = apart.min(axis=(-1, -2))
    return distance


def _reach(outlook: Outlook, limits: SurfaceLimits) -> Bools:
    """The bins of normals that a palm touches in some stable pose of the likeliest outline."""
    surface = stable_surface(outlook.states[0, -COEFFICIENTS:], limits, bins=BINS)
    return np.asarray(surface.reach.any(axis=0))


def _arcs(marks: Bools) -> str:
    """The marked bins as arcs `from–to°` of the normal."""
    if marks.all():
        return "0–360°"
    width = 360 / BINS
    begins = np.flatnonzero(marks & ~np.roll(marks, 1))
    arcs = []
    for begin in begins:
        length = int(np.argmin(np.roll(marks, -begin)))
        arcs.append(f"{begin * width:.0f}–{(begin + length) % BINS * width:.0f}°")
    return ", ".join(arcs)


def _pose(angles: FloatArray) -> Angles:
    return float(angles[0]), float(angles[1])
