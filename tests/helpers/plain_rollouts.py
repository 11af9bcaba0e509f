"""Rollouts once more, with the kernels of `palmd.model.rollout` and NumPy: see `palmd.motion.rollout_predictor`."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model import rollout, shape_map
from palmd.model.compiled import LANES
from palmd.model.outputs import CURVATURE_INPUTS
from palmd.model.rollout import MOVE_INPUTS, OUTPUTS, STEP_S, SUBSTEPS, THETA, S
from palmd.motion.rollout_predictor import BINS, CALL_S, Moves, Prediction

_BIN_RAD = 2 * np.pi / BINS
COLUMNS = 4 * LANES  # sequences that are rolled side by side


class PlainPredictor:
    """As `RolloutPredictor` of a rig exactly as described."""

    def __init__(self, rig: FloatArray):
        curved = bool(rig[CURVATURE_INPUTS].any())
        self._x = np.zeros((COLUMNS, shape_map.N))
        self._move = np.zeros((COLUMNS, MOVE_INPUTS))
        self._moved = np.zeros((COLUMNS, 2))
        self._told = np.zeros((COLUMNS, SUBSTEPS, OUTPUTS))
        self._s = np.zeros((COLUMNS, 2))
        bind = rollout.library(curved).bind
        self._begin = bind("begin_batch", [self._x, self._move, rig], [self._s])
        self._roll = bind("roll_batch", [self._x, self._s, self._move, rig], [self._moved, self._told])

    def of(self, states: FloatArray, moves: Moves, elapsed: float = 0.0, horizon_s: float = math.inf) -> Prediction:
        """See `RolloutPredictor.of`."""
        n = len(moves.durations)
        states = np.broadcast_to(states, (n, shape_map.N))
        order = np.argsort(moves.durations.sum(axis=1), kind="stable")  # those side by side end at about the same time
        parts = [
            self._batch(states[some], moves.select(some), elapsed, horizon_s)
            for some in (order[i : i + COLUMNS] for i in range(0, n, COLUMNS))
        ]
        back = np.argsort(order, kind="stable")
        longest = max(part.path.shape[1] for part in parts)
        parts = [replace(part, path=_lengthened(part.path, longest)) for part in parts]
        return Prediction(
            *(np.concatenate([getattr(part, name) for part in parts])[back] for name in Prediction.__slots__)
        )

    def _batch(self, states: FloatArray, moves: Moves, elapsed: float, horizon_s: float) -> Prediction:
        n, k = moves.durations.shape
        rows = np.arange(COLUMNS)
        filled = np.minimum(rows, n - 1)
        ends, durations = moves.ends[filled], moves.durations[filled]
        finished = np.cumsum(durations, axis=1) - elapsed
        points = np.concatenate([np.broadcast_to(moves.start, (COLUMNS, 1, 2)), ends], axis=1)
        calls = max(int(np.ceil((min(finished[:, -1].max(), horizon_s) - 1e-9) / CALL_S)), 1)
        told = np.empty((COLUMNS, calls * SUBSTEPS, OUTPUTS))
        leg_of = np.empty((COLUMNS, calls), dtype=np.intp)
        self._x[:] = states[filled]
        for call in range(calls):
            t = call * CALL_S
            leg = np.minimum((finished <= t + 1e-9).sum(axis=1), k - 1)
            leg_of[:, call] = leg
            begun = finished[rows, leg] - durations[rows, leg]
            self._move[:, 0:2], self._move[:, 2:4] = points[rows, leg], points[rows, leg + 1]
            self._move[:, 4], self._move[:, 5] = durations[rows, leg], t - begun
            if call == 0:
                self._begin()
            self._roll()
            told[:, call * SUBSTEPS : (call + 1) * SUBSTEPS] = self._told
            self._x[:, :2], self._s[:] = self._moved, self._told[:, -1, S]
        return _foreseen(told[:n], np.repeat(leg_of[:n], SUBSTEPS, axis=1), finished[:n], k)


def _foreseen(told: FloatArray, leg: npt.NDArray[np.intp], finished: FloatArray, k: int) -> Prediction:
    n, steps, _ = told.shape
    live = np.arange(steps) * STEP_S < finished[:, -1:] - 1e-9
    rows = np.broadcast_to(np.arange(n)[:, None], (n, steps))
    theta = told[..., THETA]
    turned = np.remainder(np.where(np.isfinite(theta), theta, 0.0), 2 * np.pi)  # where it diverged it is no bin's
    bins = np.floor(turned / _BIN_RAD).astype(np.intp) % BINS
    touched = np.zeros((n, k, BINS), dtype=np.bool_)
    for contact in range(2):
        touched[rows[live], leg[live], bins[..., contact][live]] = True
    lowest, nearest, farthest = (np.full((n, k), value) for value in (np.inf, np.inf, -np.inf))
    force, low, high = told[..., 2:4].min(axis=-1), told[..., 4:6].min(axis=-1), told[..., 4:6].max(axis=-1)
    force = np.where(np.isfinite(force), force, -np.inf)
    for number in range(k):
        own = live & (leg == number)
        lowest[:, number] = np.where(own, force, np.inf).min(axis=1)
        nearest[:, number] = np.where(own, low, np.inf).min(axis=1)
        farthest[:, number] = np.where(own, high, -np.inf).max(axis=1)
    last = np.clip(np.ceil(finished / STEP_S - 1e-9).astype(np.intp) - 1, 0, steps - 1)
    path = told[:, SUBSTEPS - 1 :: SUBSTEPS].copy()
    path[np.arange(steps // SUBSTEPS) * CALL_S >= finished[:, -1:] - 1e-9] = np.nan
    path[:, 0] = told[:, SUBSTEPS - 1]
    each = np.arange(n)[:, None]
    lowest[finished > steps * STEP_S + 1e-9] = -np.inf
    return Prediction(
        np.logical_or.accumulate(touched, axis=1),
        np.minimum.accumulate(lowest, axis=1),
        np.minimum.accumulate(nearest, axis=1),
        np.maximum.accumulate(farthest, axis=1),
        told[each, last, 0],
        told[each, last, 1],
        path,
    )


def _lengthened(path: FloatArray, length: int) -> FloatArray:
    return np.pad(path, ((0, 0), (0, length - path.shape[1]), (0, 0)), constant_values=np.nan)
