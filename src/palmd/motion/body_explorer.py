"""Plan moves of three palms that touch the rest of a body, by a tree search over predicted moves. Pure.

A body lies in a minimum of the potential and follows it while the palms move, so that greedy moves touch the same
stripe repeatedly. It is turned further by strokes out with one palm's friction and back with another's, and where a
minimum vanishes. Each decision therefore grows a tree of move sequences over many seconds with a coarse prediction;
sequences are extended that touch most, lead to the most distant rotations, or bring a palm near untouched surface. The
result is the first move of the best sequence that is safe for bodies drawn from the belief. The next decision continues
with the rest of the best sequences.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.model.convex_bodies import nearest_convex
from palmd.model.three_palms import BODY
from palmd.motion.body_prediction import COLUMNS, Bearings, BodyPredictor, PredictedMoves
from palmd.motion.limits import MotionLimits
from palmd.motion.segments import PEAK_ACCELERATION, PEAK_RATE, Move
from palmd.system.three_palms import palms_at

ROUNDS = 12  # rounds of a decision's tree search, of `COLUMNS` moves each
HORIZON_S = 12.0  # length of a sequence beyond which it is not extended
BEST_SEQUENCES = 12  # best sequences, from which half of a round's moves are extended
CONTINUED_PLANS = 6  # sequences of the last decision that are continued
LITTLE_GAIN = 0.004  # fraction of the sphere; if no sequence gains more, unvisited rotations count, too
NEAR_RAD = math.radians(10.0)  # distance from a contact within which a direction counts as touched
LEAST_SHARE = 0.12  # least share of the weight on each palm at a move's end
LEAST_FORCE = 0.5  # m/s²; least normal force per mass of any palm during a move
REST_FORCE_FACTOR = 1.2  # factor on the least force for the palms' loads at a move's end
LEAST_ROOM_M = 3e-3  # least distance of a contact from its pad's edge
MOST_SPIN = 8.0  # rad/s
NOVELTY = 0.03  # fraction of the sphere; value of a rotation that is 1 rad from all visited ones
DECISION_S = 0.3  # time added to each move's duration in its rating, so that moves do not become ever shorter
SLOWER_SHARE, SLOWDOWN = 0.2, 1.5  # share of the moves that are slower than necessary, and their slowdown
SHORTEST_S = 0.15
# Safety test: number of drawn bodies, 1σ of additional errors of rotation and spin, and rest after each move, because
# a body that creeps over an edge takes time to fall.
DRAWN_BODIES, ERROR_RAD, ERROR_RAD_S, REST_S = 12, 0.03, 0.2, 0.8
AT_ONCE = COLUMNS // DRAWN_BODIES  # moves tested at once
MOST_TESTED = 6 * AT_ONCE  # moves tested before the decision is to wait
TESTED_MOVES = 2  # moves of a sequence that are tested, one after the other
PEAK_SPIN = 2.5  # largest spin during a move, relative to the limit of the mean turn rate
DRAWN_PEAK_SPIN = 1.5  # factor on that for the drawn bodies
MOST_SPINNING = 1  # drawn bodies that may spin faster: a move out of a minimum leads over an edge
SLOWEST = 3.0  # largest slowdown of moves when the mean turn rate is limited

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class BodyDraws:
    """N samples of a belief: errors of rotation (N, 3) (rad) and spin (N, 3) (rad/s), parameters (N, m)."""

    turn: FloatArray
    spin: FloatArray
    p: FloatArray

    @classmethod
    def of(cls, p: FloatArray, covariance: FloatArray, random: np.random.Generator) -> BodyDraws:
        """Draw `DRAWN_BODIES` samples from a belief with parameters p (m,) and this covariance (6 + m, 6 + m).

        The first is the mean. All are made convex, as far as the belief allows.
        """
        variance, axes = np.linalg.eigh(covariance)
        x = random.normal(size=(DRAWN_BODIES, len(variance))) * np.sqrt(np.maximum(variance, 0.0)) @ axes.T
        x[0] = 0.0
        x[:, 6:] += p
        x = np.array([nearest_convex(each, covariance, slice(6, len(variance) - BODY)) for each in x])
        return cls(x[:, :3], x[:, 3:6], x[:, 6:])


@dataclass(frozen=True, slots=True)
class _MoveSequence:
    """A sequence of moves: the state it leads to, directions touched by then, duration.

    gain: newly touched fraction of the sphere. value: gain with novelty of the rotation, per second.
    """

    bearings: Bearings
    touched: Bools
    seconds: float
    moves: tuple[Move, ...]
    gain: float
    value: float

    @property
    def gain_rate(self) -> float:
        """Gain per second."""
        return self.gain / (self.seconds + DECISION_S)


def weight_shares(joints: FloatArray) -> FloatArray:
    """(N, 3) normal forces of a resting body, relative to its weight: N⁻ᵀe_z for joints (N, 3) (rad)."""
    beta, two, three = np.asarray(joints).T
    across = np.sin(beta) / np.sin(two + three)
    return np.stack([np.cos(beta), across * np.cos(three), across * np.cos(two)], axis=1)


class BodyExplorer:
    """Decides one move at a time; deterministic for given seed and calls. A decision takes some 0.3 s on one core."""

    def __init__(self, predictor: BodyPredictor, limits: MotionLimits, directions: FloatArray, seed: int = 0) -> None:
        """`directions`: (D, 3), evenly spread; as many as possible are to be touched."""
        self._predictor, self._limits, self._directions = predictor, limits, directions
        self._coarse = BodyPredictor(predictor.parameters, predictor.rig, rough=True)
        self._random = np.random.default_rng(seed)
        self._visited: list[FloatArray] = []
        self._plans: list[tuple[Move, ...]] = []  # continuations of the last decision's best sequences
        self.then: Move | None = None  # move that may follow the last decided one, equally safe
        self._low, self._high = np.array(limits.angles).T
        self._least_force, self._most_rad_s, self._shortest_s = LEAST_FORCE, math.inf, SHORTEST_S

    def covered(self, normals: FloatArray, within: float = NEAR_RAD) -> Bools:
        """(D,) which directions lie within `within` (rad) of any of `normals` (…, 3); NaN normals are ignored."""
        cosines = self._directions @ normals.reshape(-1, 3).T
        return np.asarray((cosines > math.cos(within)).any(axis=1), np.bool_)

    def decide(
        self, now: Bearings, touched: Bools, least_force: float = LEAST_FORCE, bodies: BodyDraws | None = None,
        *, most_rad_s: float = math.inf, shortest_s: float = SHORTEST_S,
    ) -> Move | None:  # fmt: skip
        """Decide the next move from the state `now` (one body); None if every tested move might lose the body.

        least_force: of every palm during the move (m/s²). bodies: for which the move must be safe, by default the known
        one. most_rad_s: limit of the body's mean turn rate, including the decision's time. shortest_s: least duration.
        """
        self._least_force, self._most_rad_s, self._shortest_s = least_force, most_rad_s, shortest_s
        self._visited.append(now.R[0])
        self._coarse.set_parameters(self._predictor.parameters)
        root = _MoveSequence(now, touched, 0.0, (), 0.0, -math.inf)
        tree = [root, *self._continued(root)]
        untouched = self._directions[~touched] if not touched.all() else self._directions
        for number in range(ROUNDS):
            tree += self._extended_randomly(self._parents(tree, untouched) if number else [root] * COLUMNS, root)
        found = tree[1:]
        if any(each.gain > LITTLE_GAIN for each in found):
            found.sort(key=lambda each: -each.gain_rate)
        else:
            found.sort(key=lambda each: -each.value)
        sequences = list(dict.fromkeys(each.moves[:TESTED_MOVES] for each in found))
        draws = _exact_draws(self._predictor.parameters) if bodies is None else bodies
        chosen = self._safest(now, sequences, draws)
        self._plans = [each.moves[1:] for each in found if chosen and each.moves[: len(chosen)] == chosen][
            :CONTINUED_PLANS
        ]
        self.then = chosen[1] if len(chosen) > 1 else None
        return chosen[0] if chosen else None

    def _safest(self, now: Bearings, sequences: Sequence[tuple[Move, ...]], draws: BodyDraws) -> tuple[Move, ...]:
        """The first sequence that is safe, else the first whose beginning is; empty if none is found.

        Sequences with a safe second move are preferred: otherwise the body is moved to and fro in front of an edge.
        """
        safe_first: dict[Move, bool] = {}
        beginning: tuple[Move, ...] = ()
        for _ in range(MOST_TESTED // AT_ONCE):
            sequences = [sequence for sequence in sequences if safe_first.get(sequence[0], True)]
            batch, sequences = sequences[:AT_ONCE], sequences[AT_ONCE:]
            if not batch:
                break
            for sequence, n in zip(batch, self._safe_moves(now, batch, draws), strict=True):
                if n == len(sequence):
                    return sequence
                safe_first[sequence[0]] = n > 0
                beginning = beginning or sequence[:n]
        return beginning

    def _safe_moves(self, now: Bearings, sequences: Sequence[tuple[Move, ...]], draws: BodyDraws) -> list[int]:
        """Number of safe moves at the beginning of each sequence (`AT_ONCE` at most), for all drawn bodies.

        The palms rest for `REST_S` after each move. The first body is the estimate itself, which the tree has predicted
        only coarsely; it has to keep the full safety margins, the others half of them.
        """
        safe_counts, active = [0] * len(sequences), list(range(len(sequences)))
        n = DRAWN_BODIES * len(sequences)
        known = np.arange(n) % DRAWN_BODIES == 0
        rotation_error, spin_error = self._random.normal(0.0, (ERROR_RAD, ERROR_RAD_S), (n, 3, 2)).transpose(2, 0, 1)
        rotation_error[known], spin_error[known] = 0.0, 0.0
        turn, spin, p = (np.tile(each, (len(sequences), 1)) for each in (draws.turn, draws.spin, draws.p))
        turned = rotation.exp(rotation_error) @ rotation.exp(turn) @ now.R
        state = Bearings(turned, now.omega + spin + spin_error, np.repeat(now.joints, n, axis=0))
        while active:
            moves = [sequences[k][safe_counts[k]] for k in active]
            ends = np.repeat([move.end for move in moves], DRAWN_BODIES, axis=0)
            durations = np.repeat([move.duration for move in moves], DRAWN_BODIES)
            predicted = self._predictor.predict(state, ends, durations, rest=REST_S, p=p[: len(ends)])
            safe = (predicted.least_force > 0.5 * self._least_force) & (predicted.room > 0.5 * LEAST_ROOM_M)
            safe = np.where(known[: len(safe)], self._safe(predicted), safe)
            fast_count = (
                (predicted.spin >= DRAWN_PEAK_SPIN * PEAK_SPIN * self._most_rad_s).reshape(-1, DRAWN_BODIES).sum(axis=1)
            )
            safe_for_all: Bools = np.asarray(
                safe.reshape(-1, DRAWN_BODIES).all(axis=1) & (fast_count <= MOST_SPINNING), np.bool_
            )
            for k in np.array(active)[safe_for_all].tolist():
                safe_counts[k] += 1
            continuing = np.array(
                [
                    is_safe and safe_counts[k] < len(sequences[k])
                    for k, is_safe in zip(active, safe_for_all, strict=True)
                ],
                np.bool_,
            )
            active = np.array(active)[continuing].tolist()
            state = predicted.after.some(np.repeat(continuing, DRAWN_BODIES))
        return safe_counts

    def _continued(self, root: _MoveSequence) -> list[_MoveSequence]:
        """Continuations of the last decision's sequences, as far as they are safe from the state reached."""
        reached: dict[tuple[Move, ...], _MoveSequence] = {(): root}
        for n in range(1, 1 + max(map(len, self._plans), default=0)):
            plans = dict.fromkeys(plan[:n] for plan in self._plans if len(plan) >= n and plan[: n - 1] in reached)
            parents = [reached[plan[:-1]] for plan in plans]
            moves = [plan[-1] for plan in plans]
            if not moves or moves[0].start != tuple(parents[0].bearings.joints[0].tolist()):
                break  # they begin at another pose of the palms
            ends, durations = np.array([move.end for move in moves]), np.array([move.duration for move in moves])
            extended = zip(plans, self._extended(parents, ends, durations, root), strict=True)
            reached |= {plan: each for plan, each in extended if each is not None}
        return list(reached.values())[1:]

    def _parents(self, tree: list[_MoveSequence], untouched: FloatArray) -> list[_MoveSequence]:
        """Select `COLUMNS` sequences to extend.

        Half have the largest gain per second, a quarter the rotations farthest in a random direction, a quarter those
        in which a palm is nearest to a random untouched direction.
        """
        short = [each for each in tree if each.seconds < HORIZON_S]
        best = sorted(short, key=lambda each: -each.gain_rate)[:BEST_SEQUENCES]
        rotations = np.concatenate([each.bearings.R for each in short])
        farthest = (rotations.reshape(-1, 9) @ self._random.normal(size=(9, COLUMNS // 4))).argmax(axis=0)
        joints = np.concatenate([each.bearings.joints for each in short])
        still = np.zeros_like(joints)
        palm_normals = -palms_at(joints, still, still).normal @ rotations  # rows: outward normals in the body's frame
        targets = untouched[self._random.integers(len(untouched), size=COLUMNS // 4)]
        nearest = (palm_normals @ targets.T).max(axis=1).argmax(axis=0)
        others = np.concatenate([farthest, nearest]).tolist()
        return [best[i % len(best)] for i in range(COLUMNS // 2)] + [short[k] for k in others]

    def _extended_randomly(self, parents: list[_MoveSequence], root: _MoveSequence) -> list[_MoveSequence]:
        """Extend each sequence by a random move; returns those that are safe."""
        start = np.concatenate([each.bearings.joints for each in parents])
        ends = self._random_ends(start)
        distance = np.abs(ends - start).max(axis=1)
        least = np.maximum(
            PEAK_RATE * distance / self._limits.rate, np.sqrt(PEAK_ACCELERATION * distance / self._limits.acceleration)
        )
        slowdown = np.where(self._random.random(COLUMNS) < SLOWER_SHARE, SLOWDOWN, 1.0)
        if math.isfinite(self._most_rad_s):
            slowdown = 1.0 + (SLOWEST - 1.0) * self._random.random(COLUMNS) ** 4
        durations = np.maximum(least * slowdown, self._shortest_s)
        return [each for each in self._extended(parents, ends, durations, root) if each is not None]

    def _extended(
        self, parents: list[_MoveSequence], ends: FloatArray, durations: FloatArray, root: _MoveSequence
    ) -> list[_MoveSequence | None]:
        """Extend each sequence by a move to `ends`; None where that is not safe."""
        begin = Bearings(*(np.concatenate([getattr(each.bearings, k) for each in parents]) for k in Bearings.__slots__))
        predicted = self._coarse.predict(begin, ends, durations)
        turned = _chords(predicted.after.R, begin.R)
        safe = self._safe(predicted) & (turned < self._most_rad_s * (durations + DECISION_S))
        found: list[_MoveSequence | None] = [None] * len(parents)
        for k in np.flatnonzero(safe).tolist():
            parent, after = parents[k], predicted.after.some(np.array([k]))
            touched = parent.touched | self.covered(predicted.normals[k, ::2])
            seconds = parent.seconds + float(durations[k])
            gain = np.count_nonzero(touched & ~root.touched) / len(touched)
            value = (gain + NOVELTY * self._novelty(after.R[0])) / (seconds + DECISION_S)
            move = Move(tuple(begin.joints[k].tolist()), tuple(ends[k].tolist()), float(durations[k]))
            found[k] = _MoveSequence(after, touched, seconds, (*parent.moves, move), gain, value)
        return found

    def _safe(self, predicted: PredictedMoves) -> Bools:
        slow = predicted.spin < min(MOST_SPIN, PEAK_SPIN * self._most_rad_s)
        return (predicted.least_force > self._least_force) & (predicted.room > LEAST_ROOM_M) & slow

    def _novelty(self, rotation: FloatArray) -> float:
        """Distance of a rotation from all visited ones (rad), at most 1."""
        return min(float(_chords(np.stack(self._visited), rotation).min()), 1.0)

    def _random_ends(self, start: FloatArray) -> FloatArray:
        """Random ends of moves from `start` (N, 3): corners, one joint, near or anywhere; all palms bear there."""
        n, random = len(start), self._random
        anywhere = random.uniform(self._low, self._high, (n, 3))
        corners = np.where(random.random((n, 3)) < 0.5, self._low, self._high)
        alone = np.where(np.arange(3) == random.integers(3, size=n)[:, None], anywhere, start)
        near = np.clip(start + random.normal(0.0, 0.15, (n, 3)), self._low, self._high)
        kinds = np.stack([corners, alone, near, anywhere])
        ends: FloatArray = kinds[random.choice(4, size=n, p=(0.3, 0.28, 0.13, 0.29)), np.arange(n)]
        inside = weight_shares(start).min(axis=1)
        least = max(LEAST_SHARE, REST_FORCE_FACTOR * self._least_force / self._predictor.rig.gravity)
        for _ in range(6):  # towards the middle of the range until all palms bear enough
            bad = weight_shares(ends).min(axis=1) < np.minimum(least, inside)
            ends[bad] += 0.3 * (0.5 * (self._low + self._high) - ends[bad])
        return ends


def _chords(rotations: FloatArray, other: FloatArray) -> FloatArray:
    """(N,) chordal distance of rotations (N, 3, 3): about the angle between them (rad) if that is small."""
    return np.asarray(np.sqrt(0.5 * ((rotations - other) ** 2).sum(axis=(1, 2))))


def _exact_draws(p: FloatArray) -> BodyDraws:
    """Draws of a body that is known exactly."""
    none = np.zeros((DRAWN_BODIES, 3))
    return BodyDraws(none, none, np.tile(p, (DRAWN_BODIES, 1)))
