"""Explorer: chooses palm motions that touch the rest of an outline, by rollouts from the belief of the object. Pure.

Each decision rolls out about two hundred sequences of palm moves from the most likely state, scores the new normals
that they would touch per second, and rolls out the best ones again from the other samples of the belief. The first move
of the best sequence that is safe for all samples is the decision; the rest is kept as a candidate for the next one.
Jumps are predicted like any other motion.
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

LOOPS, SINGLE_MOVES, MUTATED = 104, 56, 32  # numbers of candidate sequences
MOVES, HORIZON_S = 5, 8.0  # moves per sequence, a little more than a round; prediction horizon
CHECKED = 6  # best sequences that are checked on all samples
STAND_S = 1.0  # standing still after a move must be safe for this long: the next decision may be late
DOUBTFUL = 0.5  # safety margin (`goodness`) that samples other than the most likely one must keep
DECISION_S = 0.15  # time charged per decision, so that moves do not become ever shorter
INITIAL_POSES, RENEWED_POSES = 5, 2  # roadmap poses evaluated per decision, until it is complete and after
LEAST_ROAD_MOVE = math.radians(10.0)  # shortest first move that counts as progress on the roadmap
REACHABLE_SHARE = 0.9  # of the longest time to go; what takes longer may never be reached
DEEPEST = 8  # bins into the wanted normals; going for the nearest bin only often repeats a long detour for each bin
REACH_EVERY_S = 4.0
# Until the standard deviation of the radii at the contacts is below this, palms move gently, far from the pads' ends.
CAREFUL_M = 2.5e-4
CAREFUL_ANGLES = (math.radians(22.0), math.radians(75.0)), (math.radians(66.0), math.radians(118.0))
CAREFUL_RADIUS_M = 0.02
# Until a smoother confirms it, the error of a first estimate of friction may be many σ, and arcs can close so fast that
# they squeeze the object out: on arcs, moves must also be safe with this friction, 2σ above the prior.
DOUBTED_MU = 0.3
CAREFUL_RATE = math.radians(100.0)
STUCK_S = 40.0  # without new normals
# Once all is touched, exploration continues for the rig's constants until the part of the outline's band that touch
# could remove is below this share of it, no sequence reduces its square by this share per second (checked just after a
# smoother's answer), or this time is over.
RIG_SHARE, RIG_RATE, RIG_S = 0.1, 0.03, 15.0
SMOOTHER_DELAY_S = 2.0  # until the smoother's answer contains the information of a motion


@dataclass(frozen=True, slots=True)
class _RoadTimes:
    """Time to go to the nearest wanted bin, and to one `depth` bins inside; on the way to it all these are touched."""

    near: TimeToGo
    deep: TimeToGo
    depth: int


def careful_angles(curvatures: tuple[float, ...]) -> tuple[tuple[float, float], ...]:
    """Return `CAREFUL_ANGLES`; for curved palms, the angles at which a 20 mm radius touches as there on flat ones."""
    if not any(curvatures):
        return CAREFUL_ANGLES
    (first, last), (closed, opened) = CAREFUL_ANGLES
    low, high = (joints_of(CAREFUL_RADIUS_M, (first, opening), curvatures) for opening in (closed, opened))
    turn = (low[0] + high[0]) / 2 - first
    return (first + turn, last + turn), (low[1], high[1])


class Explorer:
    """Decides one move at a time. A decision takes 0.1 s on one core, on arcs 0.4 s: not for the loop."""

    def __init__(self, rig: RigDescription, limits: MotionLimits, goal: ExploreGoal, seed: int = 0):
        """Deterministic for given `seed` and calls; takes seconds if kernels must be compiled first."""
        self._limits = limits
        self._goal = goal
        self._curvatures = rig.curvatures
        gentle = careful_angles(rig.curvatures)
        self._careful = replace(
            limits,
            angles=tuple(_within(wanted, limit) for wanted, limit in zip(gentle, limits.angles, strict=True)),
            rate=min(CAREFUL_RATE, limits.rate),
        )
        self._random = np.random.default_rng(seed)
        self._predictor = RolloutPredictor(rig_inputs(rig))
        self._information = RigInformation(rig)
        self._pads = rig.pads
        self._surface_limits = surface_limits(limits)
        self._t_begin = math.nan
        self._object_count = 0
        self._reset()

    def decide(self, belief: PlanningBelief, under_way: UnderWay, *, choose: bool = True) -> Decision:
        """Decide the next move, or that the move under way must stop.

        Without `choose` only the safety of the move under way is checked, which is fast.
        """
        if belief.object_count != self._object_count:
            self._object_count = belief.object_count
            self._reset()
        if math.isnan(self._t_begin):
            self._t_begin = belief.t
        if belief.rig is not None:
            self._predictor.correct(belief.rig)
        self._update_reach(belief)
        self._update_forces(belief)
        coverage, reachable = self._coverage(belief.touched), float(self._reach.mean())
        seen = coverage >= self._goal.coverage and self._band_met(belief) and belief.confirmed
        rig_cost_left = self._remaining_rig_cost(belief) if seen else None
        ended = self._ended(belief, coverage, seen and rig_cost_left is None)
        if ended:
            return Decision("done", None, ended, coverage, reachable)
        states, touched, safe = self._after_move(belief, under_way)
        if not safe:
            danger = "lose a contact" + " or exceed the force limit of a pad" * (self._most_forces is not None)
            return Decision("unsafe", None, f"the move under way would {danger}", coverage, reachable)
        if not choose:
            return Decision("safe", None, "", coverage, reachable)
        start = np.array(under_way.move.end)
        careful = _radius_sd(states[: len(belief.states)], start, self._curvatures) > CAREFUL_M
        wanted = self._wanted(belief, touched)
        road_times = None if careful else self._road_times(states[0], wanted)
        sequences = self._sequences(
            start, self._careful if careful else self._limits, None if road_times is None else road_times.near
        )
        prediction = self._predictor.of(states[0], sequences, 0.0, HORIZON_S)
        if rig_cost_left is None:
            score = self._score(prediction, sequences, wanted, road_times)
        else:
            score = self._rig_score(belief, rig_cost_left, prediction, sequences)
            if not np.any(self._expected) and 0.0 < score.max() < RIG_RATE:
                return Decision("done", None, self._coverage_text(belief, coverage), coverage, reachable)
        move = self._choose(
            states, sequences, prediction, score.max(axis=1), road_times is not None and rig_cost_left is None
        )
        if move is None:
            return Decision("wait", None, "no safe motion found yet", coverage, reachable)
        if rig_cost_left is not None:
            self._expect(belief, rig_cost_left, states[0], move)
        return Decision("move", move, "", coverage, reachable)

    # ---- what is known, and what is wanted ----------------------------------------------------------------

    def _reset(self) -> None:
        self._reach: Bools = np.ones(BINS, dtype=np.bool_)
        self._t_seen = self._t_new = -math.inf
        self._t_seen_all = math.inf
        self._steps: FloatArray = np.zeros(0)  # `RigCost.steps` of the smoother's latest answer
        self._expected: FloatArray | float = 0.0  # information of moves that is not yet in a smoother's answer
        self._most_touched = 0
        self._most_forces: MostForces | None = None
        self._kept: Moves | None = None
        self._roadmap: Roadmap | None = None

    def _update_reach(self, belief: PlanningBelief) -> None:
        if belief.touched.sum() > self._most_touched or math.isinf(self._t_new):
            self._most_touched, self._t_new = int(belief.touched.sum()), belief.t
            if self._roadmap is not None:
                self._roadmap.forget()
        if belief.t - self._t_seen < REACH_EVERY_S:
            return
        self._t_seen = belief.t
        self._reach = reach(belief.states[0, shape_map.Z.SHAPE :], self._surface_limits) | belief.touched

    def _update_forces(self, belief: PlanningBelief) -> None:
        """Update the force limits; while the mass is unknown (after a saturated reading) the last ones remain."""
        if self._limits.pad_forces and belief.mass > 0.0:
            self._most_forces = most_forces(self._limits, self._pads, belief.mass, belief.mass_sd)

    def _coverage(self, touched: Bools) -> float:
        return float((touched & self._reach).sum() / max(self._reach.sum(), 1))

    def _wanted(self, belief: PlanningBelief, touched: Bools) -> FloatArray:
        """Return the value of touching each bin: 1 if untouched, less if touched but above the wanted band."""
        worth = np.where(touched, 0.0, 1.0)
        if not belief.confirmed and not (worth * self._reach).any():
            worth[:] = 1.0  # an estimate that a smoother has not confirmed needs all normals again
        if self._goal.band_mm is not None:
            over = belief.h_sd / (self._goal.band_mm * 1e-3) - 1.0
            worth = np.maximum(worth, np.clip(over, 0.0, 1.0))
        return np.where(self._reach, worth, 0.0)

    def _band_met(self, belief: PlanningBelief) -> bool:
        band = self._goal.band_mm
        return band is None or bool((belief.h_sd[self._reach] < band * 1e-3).all())

    def _remaining_rig_cost(self, belief: PlanningBelief) -> RigCost | None:
        """Return the remaining cost of the rig's constants; None if small against the band, or `RIG_S` is over."""
        cost = rig_cost(belief, self._reach)
        if cost is None or cost.sd < RIG_SHARE * cost.band_sd:
            return None
        self._t_seen_all = min(self._t_seen_all, belief.t)
        return cost if belief.t - self._t_seen_all < RIG_S else None

    def _ended(self, belief: PlanningBelief, coverage: float, enough: bool) -> str:
        if enough:
            return self._coverage_text(belief, coverage)
        if belief.t - self._t_begin > self._goal.time_limit_s:
            return f"the time limit of {self._goal.time_limit_s:g} s is over{self._untouched_text(belief)}"
        touched_any = self._most_touched > 0  # an exploration without a first estimate is not stuck
        if touched_any and belief.t - self._t_new > STUCK_S and self._band_met(belief):
            return f"nothing new for {STUCK_S:g} s{self._untouched_text(belief)}"
        return ""

    def _coverage_text(self, belief: PlanningBelief, coverage: float) -> str:
        return f"{coverage:.0%} of what can be reached is touched{self._untouched_text(belief)}"

    def _untouched_text(self, belief: PlanningBelief) -> str:
        """Return as text which normals were not touched, and which cannot be touched and why."""
        left = self._reach & ~belief.touched
        parts = [f"not touched: {arcs(left)}"] if left.any() else []
        parts += why_not(~self._reach, belief.states[0, shape_map.Z.SHAPE :], self._surface_limits)
        return "".join(f"; {part}" for part in parts)

    # ---- predictions and candidates -----------------------------------------------------------------------

    def _after_move(self, belief: PlanningBelief, under_way: UnderWay) -> tuple[FloatArray, Bools, bool]:
        """Return states and touched bins at the end of the move under way, and whether it is safe for all states."""
        states = self._with_doubted_friction(belief)
        move, count = under_way.move, len(states)
        if under_way.elapsed >= move.duration:
            return states, belief.touched, True
        ends, durations = np.tile(np.array(move.end), (count, 1, 1)), np.full((count, 1), move.duration)
        moves = Moves(np.array(move.start), ends, durations)
        prediction = self._predictor.of(states, moves, under_way.elapsed)
        states[:, shape_map.Z.PSI], states[:, shape_map.Z.OMEGA0] = prediction.psi[:, 0], prediction.omega0[:, 0]
        safe = bool((self._goodness(prediction, moves, under_way.elapsed) > 0.0).all())
        return states, belief.touched | prediction.touched[0, 0], safe

    def _with_doubted_friction(self, belief: PlanningBelief) -> FloatArray:
        """Return the states; on arcs, until a smoother confirms them, with a copy of the first with high friction."""
        if belief.confirmed or not any(self._curvatures):
            return belief.states.copy()
        rough = belief.states[0].copy()
        rough[shape_map.Z.MU] = max(rough[shape_map.Z.MU], DOUBTED_MU)
        return np.vstack([belief.states, rough])

    def _road_times(self, state: FloatArray, wanted: FloatArray) -> _RoadTimes | None:
        """Return the times to go to the wanted bins; None while the roadmap is incomplete."""
        if self._roadmap is None:
            self._roadmap = Roadmap(self._predictor, self._limits, state)
        self._roadmap.renew(state, RENEWED_POSES if self._roadmap.complete else INITIAL_POSES, self._most_forces)
        if not self._roadmap.complete:
            return None
        inner, depth = _inmost(wanted > 0.0, DEEPEST)
        near = self._roadmap.time_to(wanted > 0.0)
        return _RoadTimes(near, near if depth == 1 else self._roadmap.time_to(inner), depth)

    def _choose(
        self, states: FloatArray, sequences: Moves, prediction: Prediction, score: FloatArray, learns: bool
    ) -> Move | None:
        """Return the first move of the safe sequence with the best `score` (N,); if `learns`, the roadmap learns it."""
        for number in np.argsort(-score, kind="stable")[:CHECKED]:
            move = _first_move(sequences, int(number))
            if np.isfinite(score[number]) and self._safe_for_all(states, move):
                self._kept = Moves(
                    sequences.ends[number, 0], sequences.ends[None, number, 1:], sequences.durations[None, number, 1:]
                )
                if self._roadmap is not None and learns:
                    seconds = 1.0 / score[number] if score[number] > 0.0 else math.inf
                    self._roadmap.learn(sequences.start, states[0, shape_map.Z.PSI], seconds)
                return move
        self._kept = None
        return self._least_bad(states, prediction, sequences)

    def _least_bad(self, states: FloatArray, prediction: Prediction, sequences: Moves) -> Move | None:
        """Return the first move with the largest margin over all samples, if it is safer than standing still."""
        here = _pose(sequences.start)
        best, best_worst = None, self._goodness_of(states, Move(here, here, candidates.SHORTEST_S)).min()
        for number in np.argsort(-self._goodness(prediction, sequences)[:, 0], kind="stable")[:CHECKED]:
            move = _first_move(sequences, int(number))
            worst = self._goodness_of(states, move).min()
            if worst > best_worst and self._within_limits(move):
                best, best_worst = move, worst
        return best

    def _sequences(self, start: FloatArray, limits: MotionLimits, to_go: TimeToGo | None) -> Moves:
        """Return the candidate sequences; with a roadmap (`to_go`) they end on its poses."""
        parts = [
            candidates.loops(self._random, start, LOOPS, MOVES, limits),
            candidates.single_moves(self._random, start, SINGLE_MOVES, MOVES, limits),
        ]
        if self._kept is not None and limits is self._limits and np.allclose(self._kept.start, start):
            kept = candidates.lengthened(self._kept)
            parts += [kept, candidates.mutated(self._random, kept, MUTATED, limits)]
        if to_go is not None:
            away = np.abs(to_go.poses - start).max(axis=-1) > LEAST_ROAD_MOVE
            parts.append(candidates.visits(self._random, start, to_go.poses[away], MOVES, limits))
        ends, durations = (np.concatenate([getattr(part, name) for part in parts]) for name in ("ends", "durations"))
        sequences = Moves(start, ends, durations)
        return sequences if to_go is None else candidates.ending_at(sequences, to_go.nearest(ends[:, -2]), limits)

    def _score(
        self, prediction: Prediction, sequences: Moves, wanted: FloatArray, road_times: _RoadTimes | None
    ) -> FloatArray:
        """Return the value per second of each prefix of each sequence (N, k), −inf where it is unsafe.

        A prefix without value of its own is scored with the roadmap: the value of one bin over the time to the nearest
        wanted bin, or the value of all bins on the way to the deep one. A first move that stays in place gets none.
        """
        time_s, value = np.cumsum(sequences.durations, axis=1) + DECISION_S, prediction.touched @ wanted
        time_s += HOP_S * may_hop(prediction, sequences)
        score = value / time_s
        if road_times is not None:
            goes = np.abs(sequences.ends[:, :1] - sequences.start).max(axis=-1) > LEAST_ROAD_MOVE
            near, deep = (each.at(sequences.ends, prediction.psi) for each in (road_times.near, road_times.deep))
            score = np.where(score > 0.0, score, np.where(goes, 1.0 / (time_s + near), 0.0))
            leads = goes & (deep < REACHABLE_SHARE * NEVER_S)
            score = np.maximum(score, np.where(leads, (value + road_times.depth) / (time_s + deep), 0.0))
        return np.where(self._goodness(prediction, sequences) > 1.0, score, -np.inf)

    def _rig_score(self, belief: PlanningBelief, cost: RigCost, prediction: Prediction, sequences: Moves) -> FloatArray:
        """Return the share of `cost`'s square that each prefix removes per second (N, k), −inf where it is unsafe."""
        if not np.array_equal(cost.steps, self._steps):
            self._steps, self._expected = cost.steps, 0.0
        time_s = np.cumsum(sequences.durations, axis=1) + SMOOTHER_DELAY_S + HOP_S * may_hop(prediction, sequences)
        information = self._information.of(belief, cost, prediction.path, sequences.durations)
        removed = cost.share_determined(information, self._expected)
        return np.where(self._goodness(prediction, sequences) > 1.0, removed / time_s, -np.inf)

    def _expect(self, belief: PlanningBelief, cost: RigCost, state: FloatArray, move: Move) -> None:
        """Add the move's expected information, which counts as gained until the smoother's next answer."""
        moves = Moves(np.array(move.start), np.array([[move.end]]), np.array([[move.duration]]))
        path = self._predictor.of(state, moves).path
        self._expected = self._expected + self._information.of(belief, cost, path, moves.durations)[0, 0]

    def _safe_for_all(self, states: FloatArray, move: Move) -> bool:
        """True if no sample of the object loses a contact during the move and while the palms then stand still."""
        if not self._within_limits(move):
            return False
        goodness = self._goodness_of(states, move)
        return bool(goodness[0] > 1.0 and goodness.min() > DOUBTFUL)

    def _goodness(self, prediction: Prediction, moves: Moves, elapsed: float = 0.0) -> FloatArray:
        return goodness(prediction, moves, self._limits, elapsed, self._most_forces)

    def _goodness_of(self, states: FloatArray, move: Move) -> FloatArray:
        """Return the margin of the move, and of standing still after it, for each of the states (N,)."""
        count = len(states)
        ends, durations = np.tile(np.array(move.end), (count, 2, 1)), np.tile([move.duration, STAND_S], (count, 1))
        moves = Moves(np.array(move.start), ends, durations)
        return self._goodness(self._predictor.of(states, moves), moves)[:, -1]

    def _within_limits(self, move: Move) -> bool:
        motion = [self._limits.values(move.at(t)) for t in np.linspace(0.0, move.duration, 12)]
        return not problems(self._limits.bounds, ranges(motion))


def _inmost(wanted: Bools, deepest: int) -> tuple[Bools, int]:
    """Return the wanted bins farthest from unwanted ones, and their depth: 1 next to unwanted ones, ≤ `deepest`."""
    inner, depth = wanted, 1
    while depth < deepest and (within := inner & np.roll(inner, 1) & np.roll(inner, -1)).any() and not inner.all():
        inner, depth = within, depth + 1
    return inner, depth


def _first_move(sequences: Moves, number: int) -> Move:
    return Move(_pose(sequences.start), _pose(sequences.ends[number, 0]), float(sequences.durations[number, 0]))


def _radius_sd(states: FloatArray, pose: FloatArray, curvatures: tuple[float, ...]) -> float:
    """Return the larger standard deviation (m) over the states of the two radii at the palms' pose (rad)."""
    psi = states[:, shape_map.Z.PSI]
    if any(curvatures):
        first, opening = pose[:1], pose[1:2]
        each = [touched_normals(x[shape_map.Z.SHAPE :], first, opening, x[:1], curvatures) for x in states]
        normals: Sequence[FloatArray] = [np.concatenate(of_palm) for of_palm in zip(*each, strict=True)]
    else:
        normals = normal_directions([np.asarray(angle) for angle in pose], psi)
    radii = [(basis(theta) * states[:, shape_map.Z.SHAPE :]).sum(axis=1) for theta in normals]
    return float(np.std(radii, axis=1).max())


def _within(wanted: tuple[float, float], limit: tuple[float, float]) -> tuple[float, float]:
    """Intersect the wanted range with the limits; the limits if the intersection is empty."""
    low, high = max(wanted[0], limit[0]), min(wanted[1], limit[1])
    return (low, high) if low < high else limit


def _pose(angles: FloatArray) -> Angles:
    return tuple(angles.tolist())
