"""Chooses palm motions that show the rest of an outline, by trying many of them on what is known of the object. Pure.

Each decision rolls some two hundred sequences of palm moves forward with the object's likeliest state, weighs what new
normals the palms would touch against the time that takes, and tries the best ones again on samples of what the
object may be besides. The first move of the best sequence that is safe with all of them is the decision; the rest is
kept as one more sequence for the next. Jumps are foreseen like any other motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.config.plans import ExploreGoal
from palmd.events import FloatArray, PlanningBelief
from palmd.model import shape_map
from palmd.model.arcs import touched_normals
from palmd.model.outputs import rig_inputs
from palmd.model.shape import basis
from palmd.motion import candidates
from palmd.motion.decisions import Decision, UnderWay
from palmd.motion.limits import MotionLimits, problems, ranges
from palmd.motion.reach import arcs, reach, surface_limits, why_not
from palmd.motion.rig_information import RigCost, RigInformation, rig_cost
from palmd.motion.roadmap import HOP_S, NEVER_S, Roadmap, TimeToGo
from palmd.motion.rollout_predictor import (
    BINS,
    Bools,
    MostForces,
    Moves,
    Prediction,
    RolloutPredictor,
    goodness,
    may_hop,
    most_forces,
)
from palmd.motion.segments import Angles, Move
from palmd.system.arcs import joints_of
from palmd.system.description import RigDescription
from palmd.system.mechanism import normal_directions

LOOPS, SINGLE_MOVES, MUTATED = 104, 56, 32  # sequences tried
MOVES, HORIZON_S = 5, 8.0  # of each: a round and a bit more, looked at so far ahead
CHECKED = 6  # of the best sequences, on all samples
STAND_S = 1.0  # for which it must be safe to stand after a move: the next decision may be late
DOUBTFUL = 0.5  # of these, that samples of the object must keep
DECISION_S = 0.15  # that a decision costs, so that moves are not made ever shorter
MADE, RENEWED = 5, 2  # poses of the roadmap that a decision looks at, until it is complete and then
AWAY = math.radians(10.0)  # a first move that is to be one on the road
SURELY = 0.9  # of the longest time to go: what takes longer may well never come
DEEPEST = 8  # bins into what is wanted: the nearest one alone is often had over and over by a long detour each
REACH_EVERY_S = 4.0
# As long as the radii at the contacts are not known better, the palms keep to gentle moves far from the pads' ends.
CAREFUL_M = 2.5e-4
CAREFUL_ANGLES = (math.radians(22.0), math.radians(75.0)), (math.radians(66.0), math.radians(118.0))
CAREFUL_RADIUS_M = 0.02
# Until a smoother vouches for it, a first estimate of the friction may be off by many of its one-sigmas, and arcs close
# so fast that they squeeze out what they hold: there it must be safe with this as well, two one-sigmas beyond what is
# believed beforehand.
DOUBTED_MU = 0.3
CAREFUL_RATE = math.radians(100.0)
STUCK_S = 40.0  # without anything new
# When all is touched it goes on for the rig's constants: until what touch would tell of them costs less than this share
# of the band, no sequence tried lowers the cost's square by so much of it in a second any more when a smoother has just
# answered, or this time is over.
RIG_SHARE, RIG_RATE, RIG_S = 0.1, 0.03, 15.0
ANSWER_S = 2.0  # until a smoother has told what a motion was good for


@dataclass(frozen=True, slots=True)
class _Roads:
    """The time to go to the nearest bin that is wanted, and to one `depth` bins in: to come there is to touch them."""

    near: TimeToGo
    deep: TimeToGo
    depth: int


def careful_angles(curvatures: tuple[float, ...]) -> tuple[tuple[float, float], ...]:
    """`CAREFUL_ANGLES`, on curved palms those at which a middling object's contacts are as there."""
    if not any(curvatures):
        return CAREFUL_ANGLES
    (first, last), (closed, opened) = CAREFUL_ANGLES
    low, high = (joints_of(CAREFUL_RADIUS_M, (first, opening), curvatures) for opening in (closed, opened))
    turn = (low[0] + high[0]) / 2 - first
    return (first + turn, last + turn), (low[1], high[1])


class Explorer:
    """Decides one move at a time. A decision takes 0.1 s of a core, on arcs 0.4 s: for a process beside the loop."""

    def __init__(self, rig: RigDescription, limits: MotionLimits, goal: ExploreGoal, seed: int = 0):
        """Deterministic for given `seed` and calls; takes seconds when its C has to be compiled first."""
        self._limits = limits
        self._goal = goal
        self._curvatures = rig.curvatures
        gentle = careful_angles(rig.curvatures)
        self._careful = replace(
            limits,
            angles=tuple(_within(wish, limit) for wish, limit in zip(gentle, limits.angles, strict=True)),
            rate=min(CAREFUL_RATE, limits.rate),
        )
        self._random = np.random.default_rng(seed)
        self._predictor = RolloutPredictor(rig_inputs(rig))
        self._information = RigInformation(rig)
        self._pads = rig.pads
        self._surface_limits = surface_limits(limits)
        self._t_begin = math.nan
        self._object_count = 0
        self._forget()

    def decide(self, belief: PlanningBelief, under_way: UnderWay, *, choose: bool = True) -> Decision:
        """What the palms shall do after the move under way, or that it must not go on.

        Without `choose` only the latter is asked, and soon answered.
        """
        if belief.object_count != self._object_count:
            self._object_count = belief.object_count
            self._forget()
        if math.isnan(self._t_begin):
            self._t_begin = belief.t
        if belief.rig is not None:
            self._predictor.correct(belief.rig)
        self._see(belief)
        self._weigh(belief)
        coverage, reachable = self._coverage(belief.touched), float(self._reach.mean())
        seen = coverage >= self._goal.coverage and self._sharp(belief) and belief.confirmed
        open_rig = self._open_rig(belief) if seen else None
        ended = self._ended(belief, coverage, seen and open_rig is None)
        if ended:
            return Decision("done", None, ended, coverage, reachable)
        states, touched, safe = self._after(belief, under_way)
        if not safe:
            return Decision("unsafe", None, self._unsafe(), coverage, reachable)
        if not choose:
            return Decision("safe", None, "", coverage, reachable)
        start = np.array(under_way.move.end)
        careful = _spread(states[: len(belief.states)], start, self._curvatures) > CAREFUL_M
        wanted = self._wanted(belief, touched)
        roads = None if careful else self._roads(states[0], wanted)
        tried = self._tried(start, self._careful if careful else self._limits, None if roads is None else roads.near)
        foreseen = self._predictor.of(states[0], tried, 0.0, HORIZON_S)
        if open_rig is None:
            score = self._score(foreseen, tried, wanted, roads)
        else:
            score = self._rig_score(belief, open_rig, foreseen, tried)
            if not np.any(self._expected) and 0.0 < score.max() < RIG_RATE:
                return Decision("done", None, self._enough(belief, coverage), coverage, reachable)
        move = self._choose(states, tried, foreseen, score.max(axis=1), roads is not None and open_rig is None)
        if move is None:
            return Decision("wait", None, "no safe motion found yet", coverage, reachable)
        if open_rig is not None:
            self._expect(belief, open_rig, states[0], move)
        return Decision("move", move, "", coverage, reachable)

    # ---- what is known, and what is wanted

    def _forget(self) -> None:
        self._reach: Bools = np.ones(BINS, dtype=np.bool_)
        self._t_seen = self._t_new = -math.inf
        self._t_seen_all = math.inf
        self._steps: FloatArray = np.zeros(0)  # of the rig's constants, by the smoother's latest answer
        self._expected: FloatArray | float = 0.0  # information that no answer of a smoother has in it yet
        self._most = 0
        self._most_forces: MostForces | None = None
        self._kept: Moves | None = None
        self._roadmap: Roadmap | None = None

    def _see(self, belief: PlanningBelief) -> None:
        if belief.touched.sum() > self._most or math.isinf(self._t_new):
            self._most, self._t_new = int(belief.touched.sum()), belief.t
            if self._roadmap is not None:
                self._roadmap.forget()
        if belief.t - self._t_seen < REACH_EVERY_S:
            return
        self._t_seen = belief.t
        self._reach = reach(belief.states[0, shape_map.Z.SHAPE :], self._surface_limits) | belief.touched

    def _weigh(self, belief: PlanningBelief) -> None:
        """What may press on the pads; after a saturated reading they do not say, and what was known counts."""
        if self._limits.pad_forces and belief.mass > 0.0:
            self._most_forces = most_forces(self._limits, self._pads, belief.mass, belief.mass_sd)

    def _coverage(self, touched: Bools) -> float:
        return float((touched & self._reach).sum() / max(self._reach.sum(), 1))

    def _wanted(self, belief: PlanningBelief, touched: Bools) -> FloatArray:
        """What touching each bin is worth: 1 where nobody has been, less where the outline is not known well enough."""
        worth = np.where(touched, 0.0, 1.0)
        if not belief.confirmed and not (worth * self._reach).any():
            worth[:] = 1.0  # what a smoother is to vouch for, it must be shown again
        if self._goal.band_mm is not None:
            over = belief.h_sd / (self._goal.band_mm * 1e-3) - 1.0
            worth = np.maximum(worth, np.clip(over, 0.0, 1.0))
        return np.where(self._reach, worth, 0.0)

    def _sharp(self, belief: PlanningBelief) -> bool:
        band = self._goal.band_mm
        return band is None or bool((belief.h_sd[self._reach] < band * 1e-3).all())

    def _open_rig(self, belief: PlanningBelief) -> RigCost | None:
        """What is open of the rig's constants and touch would tell; None where that is little beside the whole band."""
        cost = rig_cost(belief, self._reach)
        if cost is None or cost.sd < RIG_SHARE * cost.band_sd:
            return None
        self._t_seen_all = min(self._t_seen_all, belief.t)
        return cost if belief.t - self._t_seen_all < RIG_S else None

    def _ended(self, belief: PlanningBelief, coverage: float, enough: bool) -> str:
        if enough:
            return self._enough(belief, coverage)
        if belief.t - self._t_begin > self._goal.time_limit_s:
            return f"the time limit of {self._goal.time_limit_s:g} s is over{self._told(belief)}"
        found = self._most > 0  # who knows nothing yet is not stuck
        if found and belief.t - self._t_new > STUCK_S and self._sharp(belief):
            return f"nothing new for {STUCK_S:g} s{self._told(belief)}"
        return ""

    def _enough(self, belief: PlanningBelief, coverage: float) -> str:
        return f"{coverage:.0%} of what can be reached is touched{self._told(belief)}"

    def _told(self, belief: PlanningBelief) -> str:
        """Which arcs of the outward normal were not touched, and which cannot be, and why."""
        left = self._reach & ~belief.touched
        parts = [f"not touched: {arcs(left)}"] if left.any() else []
        parts += why_not(~self._reach, belief.states[0, shape_map.Z.SHAPE :], self._surface_limits)
        return "".join(f"; {part}" for part in parts)

    # ---- what will be

    def _unsafe(self) -> str:
        found = "lose a contact" if self._most_forces is None else "lose a contact or press harder on a pad than it may"
        return f"the move under way would {found}"

    def _after(self, belief: PlanningBelief, under_way: UnderWay) -> tuple[FloatArray, Bools, bool]:
        """The states when the move under way has ended, what is touched then, and whether all get there safely."""
        states = self._doubted(belief)
        move, count = under_way.move, len(states)
        if under_way.elapsed >= move.duration:
            return states, belief.touched, True
        ends, durations = np.tile(np.array(move.end), (count, 1, 1)), np.full((count, 1), move.duration)
        moves = Moves(np.array(move.start), ends, durations)
        foreseen = self._predictor.of(states, moves, under_way.elapsed)
        states[:, shape_map.Z.PSI], states[:, shape_map.Z.OMEGA0] = foreseen.psi[:, 0], foreseen.omega0[:, 0]
        safe = bool((self._goodness(foreseen, moves, under_way.elapsed) > 0.0).all())
        return states, belief.touched | foreseen.touched[0, 0], safe

    def _doubted(self, belief: PlanningBelief) -> FloatArray:
        """The states, and on arcs, until a smoother vouches for them, the likeliest with more friction as well."""
        if belief.confirmed or not any(self._curvatures):
            return belief.states.copy()
        rough = belief.states[0].copy()
        rough[shape_map.Z.MU] = max(rough[shape_map.Z.MU], DOUBTED_MU)
        return np.vstack([belief.states, rough])

    def _roads(self, state: FloatArray, wanted: FloatArray) -> _Roads | None:
        """How far it is to what is wanted, None while the roadmap is being made."""
        if self._roadmap is None:
            self._roadmap = Roadmap(self._predictor, self._limits, state)
        self._roadmap.renew(state, RENEWED if self._roadmap.complete else MADE, self._most_forces)
        if not self._roadmap.complete:
            return None
        inner, depth = _inmost(wanted > 0.0, DEEPEST)
        near = self._roadmap.time_to(wanted > 0.0)
        return _Roads(near, near if depth == 1 else self._roadmap.time_to(inner), depth)

    def _choose(
        self, states: FloatArray, tried: Moves, foreseen: Prediction, score: FloatArray, learns: bool
    ) -> Move | None:
        """The first move of the sequence with the best `score` (N,) that is safe; the roadmap `learns` of it."""
        for number in np.argsort(-score, kind="stable")[:CHECKED]:
            move = _first_move(tried, int(number))
            if np.isfinite(score[number]) and self._safe_for_all(states, move):
                self._kept = Moves(
                    tried.ends[number, 0], tried.ends[None, number, 1:], tried.durations[None, number, 1:]
                )
                if self._roadmap is not None and learns:
                    seconds = 1.0 / score[number] if score[number] > 0.0 else math.inf
                    self._roadmap.learn(tried.start, states[0, shape_map.Z.PSI], seconds)
                return move
        self._kept = None
        return self._least_bad(states, foreseen, tried)

    def _least_bad(self, states: FloatArray, foreseen: Prediction, tried: Moves) -> Move | None:
        """The first move that comes nearest to being safe with every sample, if standing still is worse."""
        here = _pose(tried.start)
        best, best_worst = None, self._goodness_of(states, Move(here, here, candidates.SHORTEST_S)).min()
        for number in np.argsort(-self._goodness(foreseen, tried)[:, 0], kind="stable")[:CHECKED]:
            move = _first_move(tried, int(number))
            worst = self._goodness_of(states, move).min()
            if worst > best_worst and self._within_limits(move):
                best, best_worst = move, worst
        return best

    def _tried(self, start: FloatArray, limits: MotionLimits, to_go: TimeToGo | None) -> Moves:
        """Sequences of moves to choose from; where there is a roadmap they end on it."""
        parts = [
            candidates.loops(self._random, start, LOOPS, MOVES, limits),
            candidates.single_moves(self._random, start, SINGLE_MOVES, MOVES, limits),
        ]
        if self._kept is not None and limits is self._limits and np.allclose(self._kept.start, start):
            kept = candidates.lengthened(self._kept)
            parts += [kept, candidates.mutated(self._random, kept, MUTATED, limits)]
        if to_go is not None:
            away = np.abs(to_go.poses - start).max(axis=-1) > AWAY
            parts.append(candidates.visits(self._random, start, to_go.poses[away], MOVES, limits))
        ends, durations = (np.concatenate([getattr(part, name) for part in parts]) for name in ("ends", "durations"))
        tried = Moves(start, ends, durations)
        return tried if to_go is None else candidates.ending_at(tried, to_go.nearest(ends[:, -2]), limits)

    def _score(self, foreseen: Prediction, tried: Moves, wanted: FloatArray, roads: _Roads | None) -> FloatArray:
        """What each beginning of each sequence brings in a second (N, k), −inf where it is not safe.

        Where it touches nothing itself, it is the one bin at the end of the road, or all those at the end of the longer
        one; a first move that stays where it is leads nowhere.
        """
        time_s, brings = np.cumsum(tried.durations, axis=1) + DECISION_S, foreseen.touched @ wanted
        time_s += HOP_S * may_hop(foreseen, tried)
        score = brings / time_s
        if roads is not None:
            goes = np.abs(tried.ends[:, :1] - tried.start).max(axis=-1) > AWAY
            near, deep = (each.at(tried.ends, foreseen.psi) for each in (roads.near, roads.deep))
            score = np.where(score > 0.0, score, np.where(goes, 1.0 / (time_s + near), 0.0))
            leads = goes & (deep < SURELY * NEVER_S)
            score = np.maximum(score, np.where(leads, (brings + roads.depth) / (time_s + deep), 0.0))
        return np.where(self._goodness(foreseen, tried) > 1.0, score, -np.inf)

    def _rig_score(self, belief: PlanningBelief, cost: RigCost, foreseen: Prediction, tried: Moves) -> FloatArray:
        """By which share of its square each beginning lowers `cost` in a second (N, k), −inf where it is not safe."""
        if not np.array_equal(cost.steps, self._steps):
            self._steps, self._expected = cost.steps, 0.0
        time_s = np.cumsum(tried.durations, axis=1) + ANSWER_S + HOP_S * may_hop(foreseen, tried)
        information = self._information.of(belief, cost, foreseen.path, tried.durations)
        told = cost.share_told(information, self._expected)
        return np.where(self._goodness(foreseen, tried) > 1.0, told / time_s, -np.inf)

    def _expect(self, belief: PlanningBelief, cost: RigCost, state: FloatArray, move: Move) -> None:
        """Count what the move will tell as told, until a smoother says what it has."""
        moves = Moves(np.array(move.start), np.array([[move.end]]), np.array([[move.duration]]))
        path = self._predictor.of(state, moves).path
        self._expected = self._expected + self._information.of(belief, cost, path, moves.durations)[0, 0]

    def _safe_for_all(self, states: FloatArray, move: Move) -> bool:
        """Whether no sample of the object loses a contact on the move, nor if the palms then stand still."""
        if not self._within_limits(move):
            return False
        goodness = self._goodness_of(states, move)
        return bool(goodness[0] > 1.0 and goodness.min() > DOUBTFUL)

    def _goodness(self, foreseen: Prediction, moves: Moves, elapsed: float = 0.0) -> FloatArray:
        return goodness(foreseen, moves, self._limits, elapsed, self._most_forces)

    def _goodness_of(self, states: FloatArray, move: Move) -> FloatArray:
        """How safe the move is for each of the states (N,), and standing still after it."""
        count = len(states)
        ends, durations = np.tile(np.array(move.end), (count, 2, 1)), np.tile([move.duration, STAND_S], (count, 1))
        moves = Moves(np.array(move.start), ends, durations)
        return self._goodness(self._predictor.of(states, moves), moves)[:, -1]

    def _within_limits(self, move: Move) -> bool:
        motion = [self._limits.values(move.at(t)) for t in np.linspace(0.0, move.duration, 12)]
        return not problems(self._limits.bounds, ranges(motion))


def _inmost(wanted: Bools, deepest: int) -> tuple[Bools, int]:
    """Those of the bins `wanted` that are farthest from the others, and how far: 1 next to them, `deepest` at most."""
    inner, depth = wanted, 1
    while depth < deepest and (within := inner & np.roll(inner, 1) & np.roll(inner, -1)).any() and not inner.all():
        inner, depth = within, depth + 1
    return inner, depth


def _first_move(tried: Moves, number: int) -> Move:
    return Move(_pose(tried.start), _pose(tried.ends[number, 0]), float(tried.durations[number, 0]))


def _spread(states: FloatArray, pose: FloatArray, curvatures: tuple[float, ...]) -> float:
    """How far the states disagree about the radii at the palms' pose (rad): the largest one-sigma (m)."""
    psi = states[:, shape_map.Z.PSI]
    if any(curvatures):
        first, opening = pose[:1], pose[1:2]
        each = [touched_normals(x[shape_map.Z.SHAPE :], first, opening, x[:1], curvatures) for x in states]
        normals: Sequence[FloatArray] = [np.concatenate(of_palm) for of_palm in zip(*each, strict=True)]
    else:
        normals = normal_directions([np.asarray(angle) for angle in pose], psi)
    radii = [(basis(theta) * states[:, shape_map.Z.SHAPE :]).sum(axis=1) for theta in normals]
    return float(np.std(radii, axis=1).max())


def _within(wish: tuple[float, float], limit: tuple[float, float]) -> tuple[float, float]:
    """The part of the wished-for range that is allowed, the whole of what is allowed if there is none."""
    low, high = max(wish[0], limit[0]), min(wish[1], limit[1])
    return (low, high) if low < high else limit


def _pose(angles: FloatArray) -> Angles:
    return tuple(angles.tolist())
