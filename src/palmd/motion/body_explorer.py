"""Chooses moves of three palms that show the rest of a body, by trying sequences of them on what is known of it. Pure.

A body lies in a well of the potential and follows it while the palms move; greedy moves show the same stripe again and
again. What turns it on are strokes out with one palm's friction and back with another's, and wells that end. So each
decision grows a tree three moves deep, the best few of a level going on, and takes the first move of the best sequence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.motion.body_foresight import COLUMNS, Bearings, BodyForesight, ForeseenMoves
from palmd.motion.limits import MotionLimits
from palmd.motion.segments import Move

LEVELS, KEPT = 3, 6
NEAR_RAD = math.radians(10.0)  # of a contact curve, where a direction counts as touched
LEAST_SHARE = 0.12  # of the weight, that each palm bears where a move ends
LEAST_FORCE = 0.5  # m/s², of any palm on the way
LEAST_ROOM_M = 3e-3  # of a contact, to its pad's edge
MOST_SPIN = 8.0  # rad/s
NOVELTY = 0.03  # of the sphere, that a rotation is worth which is 1 rad from all before
DECISION_S = 0.3  # that a move costs besides, so that they are not made ever shorter
SLOWER, SLOWLY = 0.2, 1.5  # share of the moves that take longer than they must, and by how much
SHORTEST_S = 0.15
# A move is tried again from so many bearings about those known, off by these one-sigmas, and so long of standing after.
SAMPLES, OFF_RAD, OFF_RAD_S, STAND_S = 8, 0.03, 0.2, 0.3
_RATE, _ACCELERATION = 1.875, 10.0 / math.sqrt(3.0)  # the most of a minimum-jerk move's, for way and duration of 1

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class _MoveSequence:
    """A sequence of moves: where it leads, what has been touched then, how long it takes, what it is worth a second."""

    bearings: Bearings
    touched: Bools
    seconds: float
    first: Move | None
    value: float


def weight_shares(joints: FloatArray) -> FloatArray:
    """(N, 3) of a resting body's weight, what each palm's normal force is: N⁻ᵀe_z for joints (N, 3)."""
    beta, two, three = np.asarray(joints).T
    across = np.sin(beta) / np.sin(two + three)
    return np.stack([np.cos(beta), across * np.cos(three), across * np.cos(two)], axis=1)


class BodyExplorer:
    """Decides one move at a time; deterministic for given seed and calls. A decision takes some 0.2 s of a core."""

    def __init__(self, foresight: BodyForesight, limits: MotionLimits, directions: FloatArray, seed: int = 0) -> None:
        """`directions`: (D, 3) evenly spread, of which as many as possible are to be touched."""
        self._foresight, self._limits, self._directions = foresight, limits, directions
        self._random = np.random.default_rng(seed)
        self._been: list[FloatArray] = []
        self._low, self._high = np.array(limits.angles).T

    def covered(self, normals: FloatArray) -> Bools:
        """(D,) which directions lie near any of these (…, 3), of which those that are NaN are none."""
        cosines = self._directions @ normals.reshape(-1, 3).T
        return np.asarray((cosines > math.cos(NEAR_RAD)).any(axis=1), np.bool_)

    def decide(self, now: Bearings, touched: Bools) -> Move | None:
        """The next move from `now` (of one); None where every one that was tried might lose the body."""
        self._been.append(now.R[0])
        level, found = [_MoveSequence(now, touched, 0.0, None, -math.inf)], []
        for _ in range(LEVELS):
            level = self._grown(level, touched)
            if not level:
                break
            found += level
        found.sort(key=lambda each: -each.value)
        best = list(dict.fromkeys(each.first for each in found if each.first))
        at_once = COLUMNS // SAMPLES
        tried = (self._surely_held(now, best[k : k + at_once]) for k in range(0, len(best), at_once))
        return next((move for move in tried if move is not None), None)

    def _surely_held(self, now: Bearings, moves: Sequence[Move]) -> Move | None:
        """The first of the moves that keeps the body from all bearings that may be; palms stand for a while after."""
        n = SAMPLES * len(moves)
        off, spun = self._random.normal(0.0, (OFF_RAD, OFF_RAD_S), (n, 3, 2)).transpose(2, 0, 1)
        begin = Bearings(_turned(now.R, off), now.omega + spun, np.repeat(now.joints, n, axis=0))
        ends = np.repeat([move.end for move in moves], SAMPLES, axis=0)
        foreseen = self._foresight.of(begin, ends, np.repeat([move.duration for move in moves], SAMPLES))
        after = self._foresight.of(foreseen.after, ends, np.full(n, STAND_S))
        force, room = (np.minimum(getattr(foreseen, name), getattr(after, name)) for name in ("least_force", "room"))
        held = ((force > 0.5 * LEAST_FORCE) & (room > 0.5 * LEAST_ROOM_M)).reshape(-1, SAMPLES).all(axis=1)
        return next((move for move, sure in zip(moves, held, strict=True) if sure), None)

    def _grown(self, level: list[_MoveSequence], touched: Bools) -> list[_MoveSequence]:
        """The best sequences of one move more, the best first."""
        parents = [level[k % len(level)] for k in range(COLUMNS)]
        begin = Bearings(*(np.concatenate([getattr(each.bearings, k) for each in parents]) for k in Bearings.__slots__))
        ends = self._drawn(begin.joints)
        way = np.abs(ends - begin.joints).max(axis=1)
        least = np.maximum(_RATE * way / self._limits.rate, np.sqrt(_ACCELERATION * way / self._limits.acceleration))
        longer = np.where(self._random.random(COLUMNS) < SLOWER, SLOWLY, 1.0)
        durations = np.maximum(least * longer, SHORTEST_S)
        foreseen = self._foresight.of(begin, ends, durations)
        found = []
        for k in np.flatnonzero(_safe(foreseen)):
            parent, after = parents[k], foreseen.after.some(np.array([k]))
            seen = parent.touched | self.covered(foreseen.normals[k])
            seconds = parent.seconds + float(durations[k])
            gain = (np.count_nonzero(seen) - np.count_nonzero(touched)) / len(touched)
            value = (gain + NOVELTY * self._novelty(after.R[0])) / (seconds + DECISION_S)
            pose = tuple(begin.joints[k].tolist()), tuple(ends[k].tolist())
            first = parent.first or Move(*pose, float(durations[k]))
            found.append(_MoveSequence(after, seen, seconds, first, value))
        return sorted(found, key=lambda node: -node.value)[:KEPT]

    def _novelty(self, rotation: FloatArray) -> float:
        """How far a rotation is from all before (rad), no more than 1."""
        away = np.sqrt(0.5 * ((np.stack(self._been) - rotation) ** 2).sum(axis=(1, 2)).min())  # the chord of it
        return min(float(away), 1.0)

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
        for _ in range(6):  # back towards the middle of what is allowed, until all of them bear
            bad = weight_shares(ends).min(axis=1) < np.minimum(LEAST_SHARE, inside)
            ends[bad] += 0.3 * (0.5 * (self._low + self._high) - ends[bad])
        return ends


def _turned(rotations: FloatArray, by: FloatArray) -> FloatArray:
    """(N, 3, 3) rotations (1, 3, 3) turned by small vectors (N, 3)."""
    skew = np.cross(by[:, None], np.eye(3)).transpose(0, 2, 1)
    turned, _ = np.linalg.qr((np.eye(3) + skew) @ rotations)
    return np.asarray(turned * np.sign(np.einsum("nij,nij->nj", turned, (np.eye(3) + skew) @ rotations))[:, None])


def _safe(foreseen: ForeseenMoves) -> Bools:
    fast = foreseen.spin > MOST_SPIN
    return (foreseen.least_force > LEAST_FORCE) & (foreseen.room > LEAST_ROOM_M) & ~fast
