"""Chooses moves of three palms that show the rest of a body, by trying sequences of them on what is known of it. Pure.

A body lies in a well of the potential and follows it while the palms move; greedy moves show the same stripe again and
again. What turns it on are strokes out with one palm's friction and back with another's, and wells that end. So each
decision grows a tree of moves over many seconds by a rough foresight, where they show most, lead farthest round or face
what is untouched, and takes the first move of the best sequence that surely holds the body, by all that is known of it;
the rest of the best is gone on with next time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.model.convex_bodies import convex
from palmd.model.three_palms import BODY
from palmd.motion.body_prediction import COLUMNS, Bearings, BodyPredictor, PredictedMoves
from palmd.motion.limits import MotionLimits
from palmd.motion.segments import PEAK_ACCELERATION, PEAK_RATE, Move
from palmd.system.three_palms import palms_at

ROUNDS = 12  # of `COLUMNS` moves each, that a decision's tree grows by
HORIZON_S = 12.0  # of a sequence, beyond which it is not gone on with
LIKELY = 12  # of the sequences that show most a second, from which half of the moves of a round go on
AGAIN = 6  # of the last decision's sequences, that are gone on with
LITTLE = 0.004  # of the sphere: where no sequence shows more, places count where the body has not been
NEAR_RAD = math.radians(10.0)  # of a contact curve, where a direction counts as touched
LEAST_SHARE = 0.12  # of the weight, that each palm bears where a move ends
LEAST_FORCE = 0.5  # m/s², of any palm on the way
RESTING = 1.2  # times the least force on the way, that palms bear where a move ends
LEAST_ROOM_M = 3e-3  # of a contact, to its pad's edge
MOST_SPIN = 8.0  # rad/s
NOVELTY = 0.03  # of the sphere, that a rotation is worth which is 1 rad from all before
DECISION_S = 0.3  # that a move costs besides, so that they are not made ever shorter
SLOWER, SLOWLY = 0.2, 1.5  # share of the moves that take longer than they must, and by how much
SHORTEST_S = 0.15
# A move is tried again with so many bodies, off by these one-sigmas besides, and so long of standing after: a body that
# creeps over an edge takes its time before it falls.
BODIES, OFF_RAD, OFF_RAD_S, STAND_S = 12, 0.03, 0.2, 0.8
AT_ONCE = COLUMNS // BODIES  # moves
TRIED = 6 * AT_ONCE  # of them, before the palms rather stand
SURE_MOVES = 2  # that are tried so, one after the other
PEAK = 2.5  # times the mean of a stride, that it may spin the body by on the way
SURE_PEAK = 1.5  # times that, for the bodies that are drawn
MAY_SPIN = 1  # of the bodies that are drawn, which is one in twelve: what leads out of a well goes over an edge
SLOWEST = 3.0  # times as long as they must, that strides may take which have to turn it slowly

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class BodyDraws:
    """N bodies as they may be: turns from the rotation (N, 3), off the spin (N, 3) (rad/s), parameters (N, m)."""

    turn: FloatArray
    spin: FloatArray
    p: FloatArray

    @classmethod
    def of(cls, p: FloatArray, covariance: FloatArray, random: np.random.Generator) -> BodyDraws:
        """`BODIES` of a belief about turn, spin and parameters (6 + m, 6 + m) whose mean has these parameters (m,).

        The first is the mean itself. None is hollow, as far as the belief allows.
        """
        variance, axes = np.linalg.eigh(covariance)
        x = random.normal(size=(BODIES, len(variance))) * np.sqrt(np.maximum(variance, 0.0)) @ axes.T
        x[0] = 0.0
        x[:, 6:] += p
        x = np.array([convex(each, covariance, slice(6, len(variance) - BODY)) for each in x])
        return cls(x[:, :3], x[:, 3:6], x[:, 6:])


@dataclass(frozen=True, slots=True)
class _MoveSequence:
    """Some moves: where they lead, what has been touched then and is new of it (a share), how long they take.

    value: a second, places counted where it has not been.
    """

    bearings: Bearings
    touched: Bools
    seconds: float
    moves: tuple[Move, ...]
    gain: float
    value: float

    @property
    def gained(self) -> float:
        """What is new, a second."""
        return self.gain / (self.seconds + DECISION_S)


def weight_shares(joints: FloatArray) -> FloatArray:
    """(N, 3) of a resting body's weight, what each palm's normal force is: N⁻ᵀe_z for joints (N, 3)."""
    beta, two, three = np.asarray(joints).T
    across = np.sin(beta) / np.sin(two + three)
    return np.stack([np.cos(beta), across * np.cos(three), across * np.cos(two)], axis=1)


class BodyExplorer:
    """Decides one move at a time; deterministic for given seed and calls. A decision takes some 0.3 s of a core."""

    def __init__(self, foresight: BodyPredictor, limits: MotionLimits, directions: FloatArray, seed: int = 0) -> None:
        """`directions`: (D, 3) evenly spread, of which as many as possible are to be touched."""
        self._foresight, self._limits, self._directions = foresight, limits, directions
        self._rough = BodyPredictor(foresight.known, foresight.rig, rough=True)
        self._random = np.random.default_rng(seed)
        self._been: list[FloatArray] = []
        self._plans: list[tuple[Move, ...]] = []  # what the last decision's best sequences go on with
        self.then: Move | None = None  # what may follow the last decided move, as surely as that
        self._low, self._high = np.array(limits.angles).T
        self._least_force, self._most_rad_s, self._shortest_s = LEAST_FORCE, math.inf, SHORTEST_S

    def covered(self, normals: FloatArray, within: float = NEAR_RAD) -> Bools:
        """(D,) which directions lie near any of these (…, 3), of which those that are NaN are none."""
        cosines = self._directions @ normals.reshape(-1, 3).T
        return np.asarray((cosines > math.cos(within)).any(axis=1), np.bool_)

    def decide(
        self, now: Bearings, touched: Bools, least_force: float = LEAST_FORCE, drawn: BodyDraws | None = None,
        *, most_rad_s: float = math.inf, shortest_s: float = SHORTEST_S,
    ) -> Move | None:  # fmt: skip
        """The next move from `now` (of one); None where every one that was tried might lose the body.

        least_force: that every palm is to bear on the way (m/s²). drawn: all of these bodies are to be held.
        most_rad_s: that strides turn the body by in the mean, the time of a decision counted. shortest_s: that a move
        takes.
        """
        self._least_force, self._most_rad_s, self._shortest_s = least_force, most_rad_s, shortest_s
        self._been.append(now.R[0])
        self._rough.learn(self._foresight.known)
        root = _MoveSequence(now, touched, 0.0, (), 0.0, -math.inf)
        tree = [root, *self._followed(root)]
        untouched = self._directions[~touched] if not touched.all() else self._directions
        for number in range(ROUNDS):
            tree += self._grown(self._parents(tree, untouched) if number else [root] * COLUMNS, root)
        found = tree[1:]
        if any(each.gain > LITTLE for each in found):
            found.sort(key=lambda each: -each.gained)
        else:
            found.sort(key=lambda each: -each.value)
        ways = list(dict.fromkeys(each.moves[:SURE_MOVES] for each in found))
        draws = _sure(self._foresight.known) if drawn is None else drawn
        way = self._surest(now, ways, draws)
        self._plans = [each.moves[1:] for each in found if way and each.moves[: len(way)] == way][:AGAIN]
        self.then = way[1] if len(way) > 1 else None
        return way[0] if way else None

    def _surest(self, now: Bearings, ways: Sequence[tuple[Move, ...]], draws: BodyDraws) -> tuple[Move, ...]:
        """The first of the ways that keeps the body, or the first beginning that does; empty where none is found.

        What follows is of use only where the second move is sure, too: else the body goes to and fro before an edge.
        """
        held: dict[Move, bool] = {}
        begun: tuple[Move, ...] = ()
        for _ in range(TRIED // AT_ONCE):
            ways = [way for way in ways if held.get(way[0], True)]
            some, ways = ways[:AT_ONCE], ways[AT_ONCE:]
            if not some:
                break
            for way, n in zip(some, self._held(now, some, draws), strict=True):
                if n == len(way):
                    return way
                held[way[0]] = n > 0
                begun = begun or way[:n]
        return begun

    def _held(self, now: Bearings, ways: Sequence[tuple[Move, ...]], draws: BodyDraws) -> list[int]:
        """How many moves of each of the ways, `AT_ONCE` at most, keep the body, whichever it is.

        Palms stand for a while after each. The first of the bodies is the known one, which the rough tree has not
        tried: it has to be as safe as a move is to be, the others half so.
        """
        sure, going = [0] * len(ways), list(range(len(ways)))
        n = BODIES * len(ways)
        known = np.arange(n) % BODIES == 0
        off, spun = self._random.normal(0.0, (OFF_RAD, OFF_RAD_S), (n, 3, 2)).transpose(2, 0, 1)
        off[known], spun[known] = 0.0, 0.0
        turn, spin, p = (np.tile(each, (len(ways), 1)) for each in (draws.turn, draws.spin, draws.p))
        turned = rotation.exp(off) @ rotation.exp(turn) @ now.R
        there = Bearings(turned, now.omega + spin + spun, np.repeat(now.joints, n, axis=0))
        while going:
            moves = [ways[k][sure[k]] for k in going]
            ends = np.repeat([move.end for move in moves], BODIES, axis=0)
            durations = np.repeat([move.duration for move in moves], BODIES)
            foreseen = self._foresight.of(there, ends, durations, stand=STAND_S, p=p[: len(ends)])
            safe = (foreseen.least_force > 0.5 * self._least_force) & (foreseen.room > 0.5 * LEAST_ROOM_M)
            safe = np.where(known[: len(safe)], self._safe(foreseen), safe)
            fast = (foreseen.spin >= SURE_PEAK * PEAK * self._most_rad_s).reshape(-1, BODIES).sum(axis=1)
            held: Bools = np.asarray(safe.reshape(-1, BODIES).all(axis=1) & (fast <= MAY_SPIN), np.bool_)
            for k in np.array(going)[held].tolist():
                sure[k] += 1
            further = np.array(
                [safely and sure[k] < len(ways[k]) for k, safely in zip(going, held, strict=True)], np.bool_
            )
            going = np.array(going)[further].tolist()
            there = foreseen.after.some(np.repeat(further, BODIES))
        return sure

    def _followed(self, root: _MoveSequence) -> list[_MoveSequence]:
        """The sequences that the last decision went on with, as far as they are safe from where it has led."""
        reached: dict[tuple[Move, ...], _MoveSequence] = {(): root}
        for n in range(1, 1 + max(map(len, self._plans), default=0)):
            plans = dict.fromkeys(plan[:n] for plan in self._plans if len(plan) >= n and plan[: n - 1] in reached)
            parents = [reached[plan[:-1]] for plan in plans]
            moves = [plan[-1] for plan in plans]
            if not moves or moves[0].start != tuple(parents[0].bearings.joints[0].tolist()):
                break  # they begin elsewhere
            ends, durations = np.array([move.end for move in moves]), np.array([move.duration for move in moves])
            carried = zip(plans, self._carried(parents, ends, durations, root), strict=True)
            reached |= {plan: each for plan, each in carried if each is not None}
        return list(reached.values())[1:]

    def _parents(self, tree: list[_MoveSequence], untouched: FloatArray) -> list[_MoveSequence]:
        """Which sequences are gone on with: half of them by what they show, the others by where they have led.

        A quarter the farthest some way round, a quarter to where a palm is nearest to one of the untouched directions.
        """
        short = [each for each in tree if each.seconds < HORIZON_S]
        best = sorted(short, key=lambda each: -each.gained)[:LIKELY]
        rotations = np.concatenate([each.bearings.R for each in short])
        farthest = (rotations.reshape(-1, 9) @ self._random.normal(size=(9, COLUMNS // 4))).argmax(axis=0)
        joints = np.concatenate([each.bearings.joints for each in short])
        still = np.zeros_like(joints)
        facing = -palms_at(joints, still, still).normal @ rotations  # rows: outward in the body
        sought = untouched[self._random.integers(len(untouched), size=COLUMNS // 4)]
        nearest = (facing @ sought.T).max(axis=1).argmax(axis=0)
        others = np.concatenate([farthest, nearest]).tolist()
        return [best[i % len(best)] for i in range(COLUMNS // 2)] + [short[k] for k in others]

    def _grown(self, parents: list[_MoveSequence], root: _MoveSequence) -> list[_MoveSequence]:
        """Those of one move more that are safe."""
        start = np.concatenate([each.bearings.joints for each in parents])
        ends = self._drawn(start)
        way = np.abs(ends - start).max(axis=1)
        least = np.maximum(
            PEAK_RATE * way / self._limits.rate, np.sqrt(PEAK_ACCELERATION * way / self._limits.acceleration)
        )
        longer = np.where(self._random.random(COLUMNS) < SLOWER, SLOWLY, 1.0)
        if math.isfinite(self._most_rad_s):
            longer = 1.0 + (SLOWEST - 1.0) * self._random.random(COLUMNS) ** 4
        durations = np.maximum(least * longer, self._shortest_s)
        return [each for each in self._carried(parents, ends, durations, root) if each is not None]

    def _carried(
        self, parents: list[_MoveSequence], ends: FloatArray, durations: FloatArray, root: _MoveSequence
    ) -> list[_MoveSequence | None]:
        """Each sequence with one move more, to these ends; None where that is not safe."""
        begin = Bearings(*(np.concatenate([getattr(each.bearings, k) for each in parents]) for k in Bearings.__slots__))
        foreseen = self._rough.of(begin, ends, durations)
        turned = _chords(foreseen.after.R, begin.R)
        safe = self._safe(foreseen) & (turned < self._most_rad_s * (durations + DECISION_S))
        found: list[_MoveSequence | None] = [None] * len(parents)
        for k in np.flatnonzero(safe).tolist():
            parent, after = parents[k], foreseen.after.some(np.array([k]))
            seen = parent.touched | self.covered(foreseen.normals[k, ::2])
            seconds = parent.seconds + float(durations[k])
            gain = np.count_nonzero(seen & ~root.touched) / len(seen)
            value = (gain + NOVELTY * self._novelty(after.R[0])) / (seconds + DECISION_S)
            move = Move(tuple(begin.joints[k].tolist()), tuple(ends[k].tolist()), float(durations[k]))
            found[k] = _MoveSequence(after, seen, seconds, (*parent.moves, move), gain, value)
        return found

    def _safe(self, foreseen: PredictedMoves) -> Bools:
        slow = foreseen.spin < min(MOST_SPIN, PEAK * self._most_rad_s)
        return (foreseen.least_force > self._least_force) & (foreseen.room > LEAST_ROOM_M) & slow

    def _novelty(self, rotation: FloatArray) -> float:
        """How far a rotation is from all before (rad), no more than 1."""
        return min(float(_chords(np.stack(self._been), rotation).min()), 1.0)

    def _drawn(self, start: FloatArray) -> FloatArray:
        """Ends of moves from (N, 3): in corners, of one joint, near by, anywhere; where all palms bear the body."""
        n, random = len(start), self._random
        anywhere = random.uniform(self._low, self._high, (n, 3))
        corners = np.where(random.random((n, 3)) < 0.5, self._low, self._high)
        alone = np.where(np.arange(3) == random.integers(3, size=n)[:, None], anywhere, start)
        near = np.clip(start + random.normal(0.0, 0.15, (n, 3)), self._low, self._high)
        kinds = np.stack([corners, alone, near, anywhere])
        ends: FloatArray = kinds[random.choice(4, size=n, p=(0.3, 0.28, 0.13, 0.29)), np.arange(n)]
        inside = weight_shares(start).min(axis=1)
        least = max(LEAST_SHARE, RESTING * self._least_force / self._foresight.rig.gravity)
        for _ in range(6):  # back towards the middle of what is allowed, until all of them bear
            bad = weight_shares(ends).min(axis=1) < np.minimum(least, inside)
            ends[bad] += 0.3 * (0.5 * (self._low + self._high) - ends[bad])
        return ends


def _chords(rotations: FloatArray, other: FloatArray) -> FloatArray:
    """(N,) how far rotations (N, 3, 3) are from others: about the angle between them (rad) where that is small."""
    return np.asarray(np.sqrt(0.5 * ((rotations - other) ** 2).sum(axis=(1, 2))))


def _sure(p: FloatArray) -> BodyDraws:
    """A body that is known."""
    none = np.zeros((BODIES, 3))
    return BodyDraws(none, none, np.tile(p, (BODIES, 1)))
