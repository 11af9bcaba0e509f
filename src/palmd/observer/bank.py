"""A bank of Kalman filters run side by side in generated C, each scored by the likelihood of the readings.

A single filter started blind diverges in a third of the starts, whatever its tuning; of many filters started from
samples of the prior some converge, and their scores show which. The bank does not know the model: it holds arrays,
calls the kernels, keeps the scores, and prunes unlikely filters.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.compiled import LANES, BoundCall, Library
from palmd.observer.cutoff import cut_off

GATE = 16.0  # normalised innovation squared above which a reading is an outlier: 4σ
SCORE_MEMORY_S = 2.0  # s; with a longer memory a filter that was likely early still leads after it has diverged
NIS_READINGS = 50.0  # readings over which each filter's mean NIS is averaged
LOST_SCORE = -math.inf
_ONLY = np.zeros(1, dtype=np.intp)
_ONLY.setflags(write=False)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of a bank at one instant, for `Bank.restore`."""

    x: FloatArray
    P: FloatArray
    score: FloatArray
    nis: FloatArray


@dataclass(frozen=True, slots=True)
class Belief:
    """Independent Gaussian beliefs about the states in `which`: means (size, n), 1σ (n) or (size, n)."""

    which: slice
    mean: FloatArray
    sd: FloatArray


class Bank:
    """Filters with `n` states each: mean `x` (size, n), covariance `P` (size, n, n), log-score, mean NIS.

    `size` is a multiple of the kernels' block; `prune` reduces it and `refill` restores its full value. All methods
    are safe inside the loop: they allocate no growing memory and do not block. A filter that becomes non-finite is
    deactivated.
    """

    def __init__(
        self, library: Library, size: int, n: int, updates: Mapping[str, int], inputs: tuple[int, int, int],
        memory_s: float = SCORE_MEMORY_S,
    ):  # fmt: skip
        """Bind the kernels `predict`, `values` and those in `updates` (name → length of their last input).

        `inputs` are the lengths of the last inputs of `predict` and `values`, and the number of values. Scores decay
        with the time constant `memory_s`. A bank of one filter uses the kernels for a single filter.
        """
        self.block = 1 if size == 1 else LANES
        suffix = "" if size == 1 else "_block"
        blocks = math.ceil(size / self.block)
        self.full_size = blocks * self.block
        self.n = n
        self.backend = library.backend
        self.memory_s = memory_s
        self._now = (ctypes.c_long * 2)(0, blocks)  # current side and number of active blocks; C changes both
        self._x = [np.zeros((self.full_size, n)) for _ in range(2)]
        self._P = [np.zeros((self.full_size, n, n)) for _ in range(2)]
        self._score, self._nis = np.zeros(self.full_size), np.ones(self.full_size)
        self._outcome = np.zeros((self.full_size, 2))
        self._u, self._v = np.zeros(inputs[0]), np.zeros(inputs[1])
        self._y = np.zeros((self.full_size, inputs[2]))
        self._z = {name: np.zeros(length) for name, length in updates.items()}

        def bound(name: str, last: FloatArray, outcome: bool) -> list[BoundCall]:
            def call(a: int) -> BoundCall:
                outputs = [self._x[1 - a], self._P[1 - a]]
                inputs = [self._x[a], self._P[a], last]
                return library.bind(f"{name}{suffix}", inputs, [*outputs, self._outcome] if outcome else outputs)

            return [call(a) for a in range(2)]

        self._predict = bound("predict", self._u, outcome=False)
        self._updates = {name: bound(name, z, outcome=True) for name, z in self._z.items()}
        self._values = [library.bind(f"values{suffix}", [self._x[a], self._v], [self._y]) for a in range(2)]

    @property
    def size(self) -> int:
        """How many filters are active."""
        return self._now[1] * self.block

    @property
    def blocks(self) -> int:
        """How many blocks of filters are active."""
        return self._now[1]

    @property
    def _side(self) -> int:
        """Index of the current arrays; kernels write into the other side's, which then become current."""
        return self._now[0]

    def members(self, block: int) -> slice:
        """The filters of one block."""
        return slice(block * self.block, (block + 1) * self.block)

    @property
    def x(self) -> FloatArray:
        """Current means, (size, n); writable, for starting filters."""
        return self._x[self._side][: self.size]

    @property
    def P(self) -> FloatArray:
        """Current covariances, (size, n, n); writable, for starting filters."""
        return self._P[self._side][: self.size]

    @property
    def score(self) -> FloatArray:
        """Log-likelihood of the readings so far, with exponential forgetting, (size)."""
        return self._score[: self.size]

    @property
    def nis(self) -> FloatArray:
        """Running mean of the normalised innovation squared, (size)."""
        return self._nis[: self.size]

    def nis_of(self, member: int) -> float:
        """Mean NIS of one filter."""
        return float(self._nis[member])

    def refill(self) -> None:
        """Activate all filters with equal scores; the caller sets their states."""
        self._now[1] = self.full_size // self.block
        self._score[:] = 0.0
        self._nis[:] = 1.0

    def predict(self, dt: float, *inputs: FloatArray) -> None:
        """Propagate every filter by `dt` seconds with the same inputs."""
        self._u[0] = dt
        self._u[1:] = np.concatenate(inputs)
        self._call(self._predict)
        self._now[0] = 1 - self._now[0]

    def age_scores(self, seconds: float) -> None:
        """Reduce the weight of past readings in the scores."""
        self.score[:] *= math.exp(-seconds / self.memory_s)

    def update(
        self, name: str, value: float, variance: float, *inputs: float, repeated: float = 1.0, scored: bool = True
    ) -> None:
        """Fuse one scalar reading into every filter; `repeated` readings share one error.

        `scored`: whether it counts in the scores and the mean NIS.
        """
        self._z[name][:] = (value, variance, GATE, repeated, *inputs)
        self._call(self._updates[name])
        self._now[0] = 1 - self._now[0]
        outcome = self._outcome[: self.size]
        # a sum is finite only if all its terms are (or they cancel as infinities, which gives NaN)
        with np.errstate(over="ignore", invalid="ignore"):
            if not math.isfinite(self.x.sum() + outcome.sum()):
                self._deactivate(np.isfinite(self.x.sum(axis=1) + outcome.sum(axis=1)))
        if scored:
            self.score[:] += outcome[:, 0]
            # capped, so that a rare outlier is not taken for a wrong model
            self.nis[:] += (np.minimum(outcome[:, 1], GATE) - self.nis) / NIS_READINGS

    def values(self, *inputs: FloatArray) -> FloatArray:
        """Evaluate the kernel `values` for every filter, (size, number of values); overwritten by the next call."""
        self._v[:] = np.concatenate(inputs)
        self._call(self._values)
        return self._y[: self.size]

    def fade(self, block: int, fraction: float, prior: Belief) -> None:
        """Discount the readings fused into one block's filters by `fraction`, but not the prior.

        Readings linearised about a poor first guess bias the filters by more than their covariances show; forgetting
        lets later, better linearised readings correct that. The covariance grows by 1 + fraction, and the prior of
        the constants is fused again with the information that this removed from it. Takes a tenth of a millisecond:
        call it now and then, not for every event.
        """
        members = self.members(block)
        x, P, mean = self.x[members], self.P[members], prior.mean[members]
        variance = np.broadcast_to(prior.sd, prior.mean.shape)[members] ** 2
        P *= 1.0 + fraction
        with np.errstate(over="ignore", invalid="ignore"):  # a diverged filter is deactivated at the next reading
            for state in range(*prior.which.indices(self.n)):
                spread = P[:, state, state] + variance[:, state] / fraction
                gain = P[:, :, state] / spread[:, None]
                x += gain * (mean[:, state] - x[:, state])[:, None]
                # P − k k' S: symmetric by construction, and S > P[state, state] keeps it positive
                P -= gain[:, :, None] * (gain * spread[:, None])[:, None, :]

    def impose_nonnegative(self, block: int, rows: FloatArray) -> bool:
        """Impose rows·x ≥ 0 on the filters of one block, for the row whose mean is lowest, if that is negative.

        Mean and variance become exactly those of the normal distribution truncated at 0. Returns whether all filters
        satisfied the constraint already. A few microseconds if so, else some 20 µs for each filter.
        """
        members = self.members(block)
        x, P = self.x[members], self.P[members]
        values = x @ rows.T
        below = np.flatnonzero(values.min(axis=1) < 0.0)
        for member in below:
            # a diverged filter cannot be truncated; it is deactivated at the next reading
            cut_off(x[member], P[member], rows[int(values[member].argmin())])
        return not len(below)

    def falls_below(self, member: int, rows: FloatArray) -> bool:
        """Whether rows·x of one filter is negative anywhere."""
        return bool((rows @ self.x[member]).min() < 0.0)

    def prune(self, margin: float) -> npt.NDArray[np.intp] | None:
        """Drop filters whose score is more than `margin` (nats) below the best, block by block.

        Returns the former index of each remaining filter, None if none was dropped. Pruning invalidates earlier
        indices and snapshots.
        """
        hopeful = int(np.count_nonzero(self.score > self.score.max() - margin))
        blocks = max(1, math.ceil(hopeful / self.block))
        if blocks == self.blocks:
            return None
        order = np.argsort(-self.score, kind="stable")
        for array in (self.x, self.P, self.score, self.nis):
            array[:] = array[order]
        self._now[1] = blocks
        return order[: self.size]

    def drop(self, members: npt.NDArray[np.bool_]) -> None:
        """Deactivate some filters until the next `refill`."""
        self.score[members] = LOST_SCORE

    def best(self) -> int:
        """Index of the most likely filter."""
        return int(self._score[: self.size].argmax()) if self.full_size > 1 else 0

    def lost(self) -> bool:
        """Whether no filter is finite any more."""
        return self.is_lost(self.best())

    def is_lost(self, member: int) -> bool:
        """Whether one filter has been deactivated."""
        return bool(self._score[member] == LOST_SCORE)

    def plausible(self, margin: float) -> npt.NDArray[np.intp]:
        """Indices of the filters whose score is within `margin` (nats) of the best."""
        if self.size == 1:
            return _ONLY
        score = self.score
        members: npt.NDArray[np.intp] = (score > score[score.argmax()] - margin).nonzero()[0]
        return members

    def blank(self) -> Snapshot:
        """Allocate one snapshot, to be written by `remember`."""
        full = self.full_size
        return Snapshot(np.ones((full, self.n)), np.ones((full, self.n, self.n)), np.ones(full), np.ones(full))

    def remember(self, into: Snapshot) -> None:
        """Copy the present state into `into`, for `restore`."""
        n = self.size
        into.x[:n], into.P[:n], into.score[:n], into.nis[:n] = self.x, self.P, self.score, self.nis

    def restore(self, past: Snapshot) -> None:
        """Go back to `past`, which was saved after the last `prune` and `refill`."""
        n = self.size
        self.x[:], self.P[:], self.score[:], self.nis[:] = past.x[:n], past.P[:n], past.score[:n], past.nis[:n]

    def _call(self, kernel: list[BoundCall]) -> None:
        kernel[self._side](self.size)

    def _deactivate(self, sound: npt.NDArray[np.bool_]) -> None:
        """Deactivate filters that are not `sound` and give them a finite state, so that no NaN spreads."""
        if sound.any():
            successor = int(np.argmax(np.where(sound, self.score, -np.inf)))
            self.x[~sound], self.P[~sound] = self.x[successor], self.P[successor]
        else:
            self.x[:], self.P[:] = 0.0, np.eye(self.n)
        self._outcome[: self.size][~sound] = 0.0
        self.score[~sound] = LOST_SCORE
