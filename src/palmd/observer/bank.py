"""A bank of Kalman filters run side by side in generated C, scored by how well each foresaw the readings.

One filter started blind is lost in a third of the starts whatever its tuning; of many started
from samples of the prior some land in the right basin, and the readings tell which. The bank knows nothing of the
model: it holds arrays, calls the kernels, keeps the scores.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.compiled import Library

GATE = 16.0  # innovation² beyond which a reading is an outlier: 4 sigma
SCORE_MEMORY_S = 30.0
NIS_READINGS = 50.0  # readings over which each filter's mean NIS is taken
LOST_SCORE = -1e12


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything a bank needs to go back to one instant."""

    x: FloatArray
    P: FloatArray
    score: FloatArray
    nis: FloatArray


@dataclass(frozen=True, slots=True)
class Belief:
    """Independent Gaussian beliefs about the states in `which`: means (size, n), one-sigma (n)."""

    which: slice
    mean: FloatArray
    sd: FloatArray


class Bank:
    """`size` filters with `n` states each: mean `x` (size, n), covariance `P` (size, n, n), log-score, mean NIS.

    All methods are safe inside the loop: no allocation grows, nothing blocks, a filter that has become non-finite
    is scored out of the race and never read.
    """

    def __init__(self, library: Library, size: int, n: int, updates: Mapping[str, int], prediction_inputs: int):
        """Bind the kernels `predict` and those named in `updates` (name → length of their last input)."""
        self.size, self.n = size, n
        self.backend = library.backend
        self.score = np.zeros(size)
        self.nis = np.ones(size)
        self._x = [np.zeros((size, n)) for _ in range(2)]
        self._P = [np.zeros((size, n, n)) for _ in range(2)]
        self._side = 0  # kernels write into the other side's arrays, which then become the current ones
        self._outcome = np.zeros((size, 2))
        self._u = np.zeros(prediction_inputs)
        self._predict = [
            library.bind("predict_bank", [self._x[a], self._P[a], self._u], [self._x[1 - a], self._P[1 - a]])
            for a in range(2)
        ]
        self._z = {name: np.zeros(length) for name, length in updates.items()}
        self._updates = {
            name: [
                library.bind(
                    f"{name}_bank",
                    [self._x[a], self._P[a], z],
                    [self._x[1 - a], self._P[1 - a], self._outcome],
                )
                for a in range(2)
            ]
            for name, z in self._z.items()
        }

    @property
    def x(self) -> FloatArray:
        """Current means, (size, n); writable, for starting filters."""
        return self._x[self._side]

    @property
    def P(self) -> FloatArray:
        """Current covariances, (size, n, n); writable, for starting filters."""
        return self._P[self._side]

    def predict(self, dt: float, *inputs: FloatArray | float) -> None:
        """Move every filter on by `dt` seconds under the same inputs."""
        self._u[0] = dt
        at = 1
        for value in inputs:
            width = np.size(value)
            self._u[at : at + width] = value
            at += width
        self._predict[self._side]()
        self._side = 1 - self._side
        self.score *= np.exp(-dt / SCORE_MEMORY_S)

    def update(self, name: str, value: float, variance: float, *inputs: float, scored: bool = True) -> None:
        """Fuse one scalar reading into every filter; `scored` says whether it counts in the race."""
        self._z[name][:] = (value, variance, GATE, *inputs)
        self._updates[name][self._side]()
        self._side = 1 - self._side
        sound = np.isfinite(self.x).all(axis=1) & np.isfinite(self._outcome[:, 0])
        if not sound.all():
            self._park(sound)
        if scored:
            outcome = np.where(sound[:, None], self._outcome, 0.0)
            self.score += outcome[:, 0]
            # capped, so that a rare outlier does not pass for a wrong model
            self.nis += (np.minimum(outcome[:, 1], GATE) - self.nis) / NIS_READINGS

    def fade(self, fraction: float, prior: Belief) -> None:
        """Forget `fraction` of what the readings have taught, but not the prior.

        Readings fused about a poor first guess have bent the filters by more than their covariances admit;
        forgetting some of the past all along lets later, better linearised readings mend it. The covariance
        grows by 1 + fraction, and the constants are told their prior again with just the weight that this took
        from it. Takes about a millisecond: for now and then, not for every event.
        """
        x, P = self.x, self.P
        P *= 1.0 + fraction
        for state in range(*prior.which.indices(self.n)):
            spread = P[:, state, state] + prior.sd[state] ** 2 / fraction
            gain = P[:, :, state] / spread[:, None]
            x += gain * (prior.mean[:, state] - x[:, state])[:, None]
            # P − k k' S: symmetric by construction, and S > P[state, state] keeps it positive
            P -= gain[:, :, None] * (gain * spread[:, None])[:, None, :]

    def _park(self, sound: npt.NDArray[np.bool_]) -> None:
        """Take filters that have become non-finite out of the race, with a finite state so that no NaN spreads."""
        if not sound.any():
            self.x[:], self.P[:] = 0.0, np.eye(self.n)
        else:
            heir = int(np.argmax(np.where(sound, self.score, -np.inf)))
            self.x[~sound], self.P[~sound] = self.x[heir], self.P[heir]
        self.score[~sound] = LOST_SCORE

    def best(self) -> int:
        """Index of the most likely filter."""
        return int(np.argmax(self.score))

    def lost(self) -> bool:
        """Whether not one filter is finite any more."""
        return bool(self.score.max() <= LOST_SCORE / 2)

    def plausible(self, margin: float) -> npt.NDArray[np.intp]:
        """Indices of the filters whose score is within `margin` (nats) of the best."""
        return np.flatnonzero(self.score > self.score.max() - margin)

    def snapshot(self, reuse: Snapshot | None = None) -> Snapshot:
        """A copy of the present, for `restore`; `reuse` names one whose memory may be written over."""
        if reuse is None:
            return Snapshot(self.x.copy(), self.P.copy(), self.score.copy(), self.nis.copy())
        reuse.x[:], reuse.P[:], reuse.score[:], reuse.nis[:] = self.x, self.P, self.score, self.nis
        return reuse

    def restore(self, past: Snapshot) -> None:
        """Go back to `past`."""
        self.x[:], self.P[:] = past.x, past.P
        self.score[:], self.nis[:] = past.score, past.nis
