"""The way through barriers: from any pose of palms and object, the time until something wanted is touched. Pure.

A rough and nearly round object rests almost anywhere, and turns on only by detours that no few moves drawn at random
find. So the dynamic model is rolled forward on the moves between some poses of the palms, from the object at rest in
each of some orientations; value iteration on what comes of them gives the time to go.

Between two orientations it is interpolated where a move leads, not what that is worth: a time between that of two
orientations is what a draw between them would take, and at each move a lucky draw carries the object on.
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
STEP = math.radians(22.0)  # between those along φ2
WEDGE_ROOM = 9.81 / MOST_FORCE  # rad
ORIENTATIONS, BETWEEN = 36, 4  # that are rolled forward, and how many each stands for
TORN = math.radians(20.0)  # between where neighbours end: with a barrier between them nobody knows
NEAR = 2  # orientations on either side for which the same is learnt
AGAIN_S = 0.3  # that it takes longer each time one has been there in vain
HOP_S = 5.0
"""s that a hop costs: motion is held until both pads are touched, and the estimate has to become valid again (measured
2026-11-29 on simulated explorations of 60 s, 70011 to 70018)."""
SAME = 1e-9  # rad
FARTHEST = math.radians(50.0)  # that a move between poses turns an angle
NEVER_S = 60.0
ITERATIONS, SETTLED_S = 300, 1e-3

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class TimeToGo:
    """From each of the `poses` (P, 2) and of evenly spaced orientations the `seconds` (P, O), `NEVER_S` at most."""

    poses: FloatArray
    seconds: FloatArray

    def at(self, poses: FloatArray, psi: FloatArray) -> FloatArray:
        """From palms at `poses` (…, 2) (rad) and the object at rest at `psi` (…); `NEVER_S` from other poses."""
        pose, apart = self._nearest(poses)
        return np.where(apart < SAME, _interpolated(self.seconds, pose, psi), NEVER_S)

    def nearest(self, poses: FloatArray) -> FloatArray:
        """The pose of the roadmap nearest to each of `poses` (…, 2)."""
        return self.poses[self._nearest(poses)[0]]

    def _nearest(self, poses: FloatArray) -> tuple[Indices, FloatArray]:
        apart = np.abs(poses[..., None, :] - self.poses).max(axis=-1)
        return apart.argmin(axis=-1), apart.min(axis=-1)


class Roadmap:
    """The table of moves; it takes as long as several decisions, so it is made, and renewed, some poses at a time."""

    def __init__(self, predictor: RolloutPredictor, limits: MotionLimits, state: FloatArray):
        """`state` (21,) tells how large the object is: where its contacts would leave the pads no pose is of use."""
        self.poses = _poses(limits, float(state[shape_map.Z.SHAPE]), float(state[shape_map.Z.MU]))
        self._predictor = predictor
        self._limits = limits
        apart = np.abs(self.poses[:, None] - self.poses).max(axis=-1)
        self._from, self._to = np.nonzero((apart <= FARTHEST) & (apart > 0.0))
        shape = (len(self._from), ORIENTATIONS * BETWEEN)
        self._seconds = np.full(shape, np.inf)  # what each move takes, if it is safe
        self._psi = np.zeros(shape)  # where it ends
        self._lowest, self._highest = np.zeros((2, len(PALMS), *shape))  # normals that each palm touches on the way
        self._made = 0
        self._least = np.zeros((len(self.poses), shape[1]))  # what has turned out to take longer than foreseen

    @property
    def complete(self) -> bool:
        """Whether all poses have been looked at once."""
        return self._made >= len(self.poses)

    def renew(self, state: FloatArray, count: int, most: MostForces | None = None) -> None:
        """Roll the object of `state` (21,) forward on the moves from the next `count` poses; `most`: see `goodness`."""
        for number in range(self._made, self._made + count):
            self._renew(state, number % len(self.poses), most)
        self._made += count

    def _renew(self, state: FloatArray, pose: int, most: MostForces | None) -> None:
        moves = np.flatnonzero(self._from == pose)
        if not len(moves):  # narrow limits may leave but one pose
            return
        n = len(moves) * ORIENTATIONS
        states = np.tile(state, (n, 1))
        states[:, shape_map.Z.PSI] = np.tile(_ORIENTATION, len(moves))
        states[:, shape_map.Z.OMEGA0] = 0.0
        ends = np.repeat(self.poses[self._to[moves]], ORIENTATIONS, axis=0)[:, None]
        rates = np.full((n, 1), RATE_SHARE * self._limits.rate)
        tried = timed(self.poses[pose], ends, rates, self._limits)
        foreseen = self._predictor.of(states, tried)
        safe = goodness(foreseen, tried, self._limits, most=most)[:, 0] > 1.0
        psi = _between(np.where(safe, foreseen.psi[:, 0], np.nan).reshape(-1, ORIENTATIONS), math.tau, TORN)
        takes = (tried.durations + HOP_S * may_hop(foreseen, tried)).reshape(-1, ORIENTATIONS)
        takes = np.repeat(takes, BETWEEN, axis=1)
        self._psi[moves] = np.nan_to_num(psi)
        self._seconds[moves] = np.where(np.isfinite(psi), takes, np.inf)
        theta = np.where(safe[:, None, None], foreseen.path[..., THETA], 0.0)
        for table, extreme in ((self._lowest, np.nanmin), (self._highest, np.nanmax)):
            for palm, normal in enumerate(extreme(theta, axis=1).T):
                table[palm, moves] = _between(normal.reshape(-1, ORIENTATIONS), -math.tau)

    def learn(self, pose: FloatArray, psi: float, seconds: float) -> None:
        """From near here it takes longer than `seconds`, whatever the table says: nobody shall go round for ever."""
        number = np.abs(self.poses - pose).max(axis=-1).argmin()
        low = int(_place(np.array(psi), self._least.shape[1]))
        for orientation in range(low - NEAR + 1, low + NEAR + 1):
            here = number, orientation % self._least.shape[1]
            self._least[here] = min(max(self._least[here], seconds) + AGAIN_S, NEVER_S)

    def forget(self) -> None:
        """What has been learnt does not count any more, since something else is wanted."""
        self._least[:] = 0.0

    def time_to(self, wanted: Bools) -> TimeToGo:
        """The time to go until any of the bins `wanted` (BINS,) is touched; takes some 30 ms."""
        there = _touches(self._lowest, self._highest, wanted).any(axis=0)
        left, begins = np.unique(self._from, return_index=True)
        seconds = np.full(self._least.shape, NEVER_S)
        low, high, share = _neighbours(self._to[:, None], self._psi, seconds.shape[1])
        for _ in range(ITERATIONS if len(left) else 0):
            flat, newer = seconds.ravel(), seconds.copy()
            after = flat[low]
            after += share * (flat[high] - after)
            after[there] = 0.0
            newer[left] = np.clip(np.minimum.reduceat(self._seconds + after, begins), self._least[left], NEVER_S)
            settled = np.abs(newer - seconds).max() < SETTLED_S
            seconds = newer
            if settled:
                break
        return TimeToGo(self.poses, seconds)


def _poses(limits: MotionLimits, radius: float, mu: float) -> FloatArray:
    """Some poses (P, 2) all over where an object of the mean `radius` (m) may be, the rims included.

    On arcs they lie as close as its tangents do on flat palms, which turn by less; the rim is also where friction `mu`
    would wedge it: tangents that press with f as it slides out are 2 atan μ + g/f apart.
    """
    low, high = range_of(limits)
    top = limits.top - POSE_MARGIN
    closed = max(low[1], opening_at(radius, limits.pad_length - MARGIN_M, limits.curvatures) + POSE_MARGIN)
    felt = _felt(radius, limits.curvatures) if any(limits.curvatures) else None
    if felt is not None and not len(felt[0]):  # first estimates may say that it would lie in its palm
        felt = None
    if felt is not None:
        closed = max(closed, float(np.interp(2 * math.atan(mu) + WEDGE_ROOM, *felt)))
    poses = []
    for first in np.linspace(low[0], max(min(high[0], top - closed), low[0]), GRID):
        opened = max(min(high[1], top - first), closed)
        poses += [(first, opening) for opening in _steps(opened, closed, felt)]
    return np.array(poses)


def _felt(radius: float, curvatures: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Openings of the tangents at a circle, rising, and those of the palms for them (rad)."""
    tangents = np.linspace(0.1, 3.0, 60)
    palms = np.array([joints_of(radius, (0.0, each), curvatures)[1] for each in tangents])
    there = np.isfinite(palms)
    return tangents[there], palms[there]


def _steps(opened: float, closed: float, felt: tuple[FloatArray, FloatArray] | None) -> FloatArray:
    """Openings from one to the other (rad) that are `STEP` apart or nearly, as they are `felt`."""
    if felt is None:
        return np.linspace(opened, closed, 1 + math.ceil((opened - closed) / STEP - 0.5))
    tangents, palms = felt
    wide, narrow = np.interp([opened, closed], palms, tangents)
    return np.interp(_steps(wide, narrow, None), tangents, palms)


_ORIENTATION = np.arange(ORIENTATIONS) * (2 * np.pi / ORIENTATIONS)


def _place(psi: FloatArray, orientations: int) -> FloatArray:
    """`psi` (rad) counted in orientations, 0 where it is no number."""
    turned = np.remainder(np.where(np.isfinite(psi), psi, 0.0), math.tau)
    place: FloatArray = turned * (orientations / math.tau)
    return place


def _neighbours(pose: Indices, psi: FloatArray, orientations: int) -> tuple[Indices, Indices, FloatArray]:
    """The places in a flattened table (P, O) below and above `psi` (rad) at `pose`, and how far between them it is."""
    place = _place(psi, orientations)
    low = np.floor(place).astype(np.intp)
    row = pose * orientations
    return row + low % orientations, row + (low + 1) % orientations, place - low


def _interpolated(table: FloatArray, pose: Indices, psi: FloatArray) -> FloatArray:
    """`table` (P, O) at `pose` and, between orientations, at `psi` (rad)."""
    low, high, share = _neighbours(pose, psi, table.shape[1])
    flat = table.ravel()
    values: FloatArray = (1.0 - share) * flat[low] + share * flat[high]
    return values


def _between(angles: FloatArray, turn: float, torn: float = math.inf) -> FloatArray:
    """`angles` (M, O) and those between one and the next, (M, O · BETWEEN): they rise by `turn` once around.

    NaN where next to NaN, or where neighbours are `torn` (rad) apart.
    """
    step = np.roll(angles, -1, axis=1) - angles
    step[:, -1] += turn
    step[np.abs(step) > torn] = np.nan
    finer = angles[..., None] + step[..., None] * (np.arange(BETWEEN) / BETWEEN)
    finer[..., 0] = angles
    return np.asarray(finer.reshape(len(angles), -1))


def _touches(lowest: FloatArray, highest: FloatArray, wanted: Bools) -> Bools:
    """Whether any bin of `wanted` (BINS,) lies between normals (rad)."""
    first, last = (np.floor(each * (BINS / math.tau)).astype(np.intp) for each in (lowest, highest))
    before = np.concatenate([[0], np.cumsum(np.tile(wanted, 2))])
    begin = first % BINS
    return np.asarray(before[begin + np.minimum(last - first + 1, BINS)] > before[begin])
