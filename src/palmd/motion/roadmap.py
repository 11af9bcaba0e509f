"""Roadmap for exploration: time to go from any pose of palms and object until a wanted normal is touched. Pure.

A rough, nearly round object rests almost anywhere and can be turned only by detours that a few random moves do not
find. So the dynamic model is rolled out on the moves between a grid of palm poses, from the object at rest in each of a
set of orientations; value iteration on the results gives the time to go.

Between two orientations the result of a move is interpolated, not its value. Interpolating the time would correspond
to drawing one of the two orientations at random, and over several moves lucky draws would carry the object onwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model import shape_map
from palmd.model.rollout import THETA
from palmd.motion.candidates import POSE_MARGIN, RATE_SHARE, range_of, timed
from palmd.motion.limits import MotionLimits
from palmd.motion.rollout_predictor import (
    BINS,
    MARGIN_M,
    MOST_FORCE,
    Bools,
    MostForces,
    RolloutPredictor,
    goodness,
    may_hop,
)
from palmd.system.arcs import joints_of, opening_at
from palmd.system.mechanism import PALMS

GRID = 7  # poses along φ1
STEP = math.radians(22.0)  # spacing of poses along φ2
WEDGE_ROOM = 9.81 / MOST_FORCE  # rad
ORIENTATIONS, BETWEEN = 36, 4  # orientations that are rolled out, and table entries for each
LARGEST_GAP = math.radians(20.0)  # of the results of neighbouring orientations; beyond it a barrier lies between them
LEARN_NEIGHBOURS = 2  # orientations on either side that learn the same
RETRY_COST_S = 0.3  # added to the time to go at each visit without success
HOP_S = 5.0
"""Cost of a hop (s): motion is held until both pads are touched, and the estimate has to become valid again (measured
2026-11-29 on simulated explorations of 60 s, 70011 to 70018)."""
SAME = 1e-9  # rad
FARTHEST = math.radians(50.0)  # largest change of an angle by a move between poses
NEVER_S = 60.0  # largest time to go
ITERATIONS, SETTLED_S = 300, 1e-3  # of value iteration; change at which it has converged

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class TimeToGo:
    """Time to go `seconds` (P, O) from each of the `poses` (P, 2) and O evenly spaced orientations, ≤ `NEVER_S`."""

    poses: FloatArray
    seconds: FloatArray

    def at(self, poses: FloatArray, psi: FloatArray) -> FloatArray:
        """Return the time from palms at `poses` (…, 2) (rad), object at rest at `psi` (…); `NEVER_S` elsewhere."""
        pose, distance = self._nearest(poses)
        return np.where(distance < SAME, _interpolated(self.seconds, pose, psi), NEVER_S)

    def nearest(self, poses: FloatArray) -> FloatArray:
        """Return the pose of the roadmap nearest to each of `poses` (…, 2)."""
        return self.poses[self._nearest(poses)[0]]

    def _nearest(self, poses: FloatArray) -> tuple[Indices, FloatArray]:
        distance = np.abs(poses[..., None, :] - self.poses).max(axis=-1)
        return distance.argmin(axis=-1), distance.min(axis=-1)


class Roadmap:
    """Table of moves between poses; computed and renewed a few poses at a time, as all take longer than a decision."""

    def __init__(self, predictor: RolloutPredictor, limits: MotionLimits, state: FloatArray):
        """`state` (21,): gives the object's size, which excludes poses where its contacts would leave the pads."""
        self.poses = _poses(limits, float(state[shape_map.Z.SHAPE]), float(state[shape_map.Z.MU]))
        self._predictor = predictor
        self._limits = limits
        distance = np.abs(self.poses[:, None] - self.poses).max(axis=-1)
        self._from, self._to = np.nonzero((distance <= FARTHEST) & (distance > 0.0))
        shape = (len(self._from), ORIENTATIONS * BETWEEN)
        self._seconds = np.full(shape, np.inf)  # duration of each move, inf if it is unsafe
        self._psi = np.zeros(shape)  # orientation at its end
        self._lowest, self._highest = np.zeros((2, len(PALMS), *shape))  # range of normals that each palm touches
        self._evaluated = 0
        self._learnt = np.zeros((len(self.poses), shape[1]))  # lower bounds of the time to go, from experience

    @property
    def complete(self) -> bool:
        """True once all poses have been evaluated."""
        return self._evaluated >= len(self.poses)

    def renew(self, state: FloatArray, count: int, most: MostForces | None = None) -> None:
        """Roll out the object of `state` (21,) on the moves from the next `count` poses; `most`: see `goodness`."""
        for number in range(self._evaluated, self._evaluated + count):
            self._renew(state, number % len(self.poses), most)
        self._evaluated += count

    def _renew(self, state: FloatArray, pose: int, most: MostForces | None) -> None:
        moves = np.flatnonzero(self._from == pose)
        if not len(moves):  # narrow limits may leave a single pose
            return
        n = len(moves) * ORIENTATIONS
        states = np.tile(state, (n, 1))
        states[:, shape_map.Z.PSI] = np.tile(_ORIENTATION, len(moves))
        states[:, shape_map.Z.OMEGA0] = 0.0
        ends = np.repeat(self.poses[self._to[moves]], ORIENTATIONS, axis=0)[:, None]
        rates = np.full((n, 1), RATE_SHARE * self._limits.rate)
        sequences = timed(self.poses[pose], ends, rates, self._limits)
        prediction = self._predictor.of(states, sequences)
        safe = goodness(prediction, sequences, self._limits, most=most)[:, 0] > 1.0
        psi = _refined(np.where(safe, prediction.psi[:, 0], np.nan).reshape(-1, ORIENTATIONS), math.tau, LARGEST_GAP)
        takes = (sequences.durations + HOP_S * may_hop(prediction, sequences)).reshape(-1, ORIENTATIONS)
        takes = np.repeat(takes, BETWEEN, axis=1)
        self._psi[moves] = np.nan_to_num(psi)
        self._seconds[moves] = np.where(np.isfinite(psi), takes, np.inf)
        theta = np.where(safe[:, None, None], prediction.path[..., THETA], 0.0)
        for table, extreme in ((self._lowest, np.nanmin), (self._highest, np.nanmax)):
            for palm, normal in enumerate(extreme(theta, axis=1).T):
                table[palm, moves] = _refined(normal.reshape(-1, ORIENTATIONS), -math.tau)

    def learn(self, pose: FloatArray, psi: float, seconds: float) -> None:
        """Raise the time to go near this state above `seconds`, so that the explorer does not circle for ever."""
        number = np.abs(self.poses - pose).max(axis=-1).argmin()
        low = int(_place(np.array(psi), self._learnt.shape[1]))
        for orientation in range(low - LEARN_NEIGHBOURS + 1, low + LEARN_NEIGHBOURS + 1):
            here = number, orientation % self._learnt.shape[1]
            self._learnt[here] = min(max(self._learnt[here], seconds) + RETRY_COST_S, NEVER_S)

    def forget(self) -> None:
        """Discard what was learnt, after the wanted normals have changed."""
        self._learnt[:] = 0.0

    def time_to(self, wanted: Bools) -> TimeToGo:
        """Return the time to go until any of the bins `wanted` (BINS,) is touched; takes about 30 ms."""
        there = _touches(self._lowest, self._highest, wanted).any(axis=0)
        left, begins = np.unique(self._from, return_index=True)
        seconds = np.full(self._learnt.shape, NEVER_S)
        low, high, share = _neighbours(self._to[:, None], self._psi, seconds.shape[1])
        for _ in range(ITERATIONS if len(left) else 0):
            flat, newer = seconds.ravel(), seconds.copy()
            after = flat[low]
            after += share * (flat[high] - after)
            after[there] = 0.0
            newer[left] = np.clip(np.minimum.reduceat(self._seconds + after, begins), self._learnt[left], NEVER_S)
            settled = np.abs(newer - seconds).max() < SETTLED_S
            seconds = newer
            if settled:
                break
        return TimeToGo(self.poses, seconds)


def _poses(limits: MotionLimits, radius: float, mu: float) -> FloatArray:
    """Return a grid of palm poses (P, 2) that hold an object of mean `radius` (m), including the limits.

    On arcs the grid is even in the tangents' opening, which changes by less than that of flat palms. There it also ends
    where friction `mu` would wedge the object: tangents that press with f as it slides out are 2 atan μ + g/f apart.
    """
    low, high = range_of(limits)
    top = limits.top - POSE_MARGIN
    closed = max(low[1], opening_at(radius, limits.pad_length - MARGIN_M, limits.curvatures) + POSE_MARGIN)
    openings = _tangent_openings(radius, limits.curvatures) if any(limits.curvatures) else None
    if openings is not None and not len(openings[0]):  # by a first estimate the object may not fit into the palms
        openings = None
    if openings is not None:
        closed = max(closed, float(np.interp(2 * math.atan(mu) + WEDGE_ROOM, *openings)))
    poses = []
    for first in np.linspace(low[0], max(min(high[0], top - closed), low[0]), GRID):
        opened = max(min(high[1], top - first), closed)
        poses += [(first, opening) for opening in _steps(opened, closed, openings)]
    return np.array(poses)


def _tangent_openings(radius: float, curvatures: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Return openings of the tangents at a circle, ascending, and the corresponding openings of the palms (rad)."""
    tangents = np.linspace(0.1, 3.0, 60)
    palms = np.array([joints_of(radius, (0.0, each), curvatures)[1] for each in tangents])
    there = np.isfinite(palms)
    return tangents[there], palms[there]


def _steps(opened: float, closed: float, openings: tuple[FloatArray, FloatArray] | None) -> FloatArray:
    """Return openings (rad) from one to the other about `STEP` apart; if `openings` is given, in the tangents."""
    if openings is None:
        return np.linspace(opened, closed, 1 + math.ceil((opened - closed) / STEP - 0.5))
    tangents, palms = openings
    wide, narrow = np.interp([opened, closed], palms, tangents)
    return np.interp(_steps(wide, narrow, None), tangents, palms)


_ORIENTATION = np.arange(ORIENTATIONS) * (2 * np.pi / ORIENTATIONS)


def _place(psi: FloatArray, orientations: int) -> FloatArray:
    """Return `psi` (rad) in units of the orientations' spacing; 0 for NaN."""
    turned = np.remainder(np.where(np.isfinite(psi), psi, 0.0), math.tau)
    place: FloatArray = turned * (orientations / math.tau)
    return place


def _neighbours(pose: Indices, psi: FloatArray, orientations: int) -> tuple[Indices, Indices, FloatArray]:
    """Return indices in a flattened table (P, O) below and above `psi` (rad) at `pose`, and the weight of the upper."""
    place = _place(psi, orientations)
    low = np.floor(place).astype(np.intp)
    row = pose * orientations
    return row + low % orientations, row + (low + 1) % orientations, place - low


def _interpolated(table: FloatArray, pose: Indices, psi: FloatArray) -> FloatArray:
    """Interpolate `table` (P, O) at `pose` and `psi` (rad)."""
    low, high, share = _neighbours(pose, psi, table.shape[1])
    flat = table.ravel()
    values: FloatArray = (1.0 - share) * flat[low] + share * flat[high]
    return values


def _refined(angles: FloatArray, turn: float, largest_gap: float = math.inf) -> FloatArray:
    """Refine periodic `angles` (M, O), which rise by `turn` per revolution, by interpolation to (M, O · BETWEEN).

    NaN next to NaN, and between neighbours that differ by more than `largest_gap` (rad).
    """
    step = np.roll(angles, -1, axis=1) - angles
    step[:, -1] += turn
    step[np.abs(step) > largest_gap] = np.nan
    finer = angles[..., None] + step[..., None] * (np.arange(BETWEEN) / BETWEEN)
    finer[..., 0] = angles
    return np.asarray(finer.reshape(len(angles), -1))


def _touches(lowest: FloatArray, highest: FloatArray, wanted: Bools) -> Bools:
    """True where any bin of `wanted` (BINS,) lies between the normals `lowest` and `highest` (rad)."""
    first, last = (np.floor(each * (BINS / math.tau)).astype(np.intp) for each in (lowest, highest))
    before = np.concatenate([[0], np.cumsum(np.tile(wanted, 2))])
    begin = first % BINS
    return np.asarray(before[begin + np.minimum(last - first + 1, BINS)] > before[begin])
