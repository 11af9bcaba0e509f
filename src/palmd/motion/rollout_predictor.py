"""Rollout predictor: what objects will do on sequences of palm moves, many at once. Pure; not for the loop.

Compiled in `model/rollout.c`.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model import rollout, shape_map
from palmd.model.compiled import LANES
from palmd.model.dynamics import VIBRATION_ERROR_INPUTS
from palmd.model.outputs import CURVATURE_INPUTS, FRICTION_INPUT
from palmd.model.rollout import LEAST_FORCES, MEAN_FORCES, MOVE_INPUTS, OUTPUTS, STEP_S, SUBSTEPS, THETA
from palmd.model.smoothing import R
from palmd.motion.limits import PHI12_MAX, MotionLimits
from palmd.system.description import PadSensor

CALL_S = SUBSTEPS * STEP_S
"""Moves last whole multiples of this."""

BINS = rollout.BINS
MOST_MOVES = 16  # of one sequence
LEAST_FORCE = 0.8  # m/s², of a contact: one that rests has several
MARGIN_M = 3e-3  # of the contacts from a pad's ends
TANGENT_ROOM = math.radians(1.0)  # of a curved palm's tangent, from where it must not be
SIGMAS = 3.0  # of a reading of a pad's force, by which predicted forces stay below the pad's limit (convention)
MOST_FORCE = 60.0  # m/s², between curved palms: there an object that slides is wedged where tangents are 2 atan μ apart

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Moves:
    """N sequences of k minimum-jerk moves from the pose `start`: `ends` (N, k, 2) (rad), `durations` (N, k) (s)."""

    start: FloatArray
    ends: FloatArray
    durations: FloatArray

    def some(self, which: npt.NDArray[np.intp]) -> Moves:
        """Those of the given numbers."""
        return Moves(self.start, self.ends[which], self.durations[which])


@dataclass(frozen=True, slots=True)
class Prediction:
    """What comes of each sequence, up to the end of each of its moves.

    touched: (N, k, BINS), where palms have been since the beginning. least_force: (N, k), m/s², within a vibration.
    nearest, farthest: (N, k), of both contacts from the hinge, m. psi, omega0: (N, k) at the end of each move. path:
    (N, T, OUTPUTS) what `model.rollout` tells after each `CALL_S`, NaN after the sequence's end and after what was looked
    at.
    """

    touched: Bools
    least_force: FloatArray
    nearest: FloatArray
    farthest: FloatArray
    psi: FloatArray
    omega0: FloatArray
    path: FloatArray


class MostForces(NamedTuple):
    """Of each palm's contact, per unit mass (m/s²): as near to the pad's limit as allowed, and at the limit."""

    allowed: FloatArray
    limit: FloatArray


def most_forces(limits: MotionLimits, pads: Sequence[PadSensor], mass: float, mass_sd: float) -> MostForces:
    """What an object of that `mass` (kg) may press with: allowed is what reads `SIGMAS` below the pads' limits."""
    limit = np.array(limits.pad_forces)
    noise = np.array([pad.force_variance(most) for pad, most in zip(pads, limits.pad_forces, strict=True)])
    sd = np.hypot(np.sqrt(noise), limit * mass_sd / mass)
    return MostForces((limit - SIGMAS * sd) / mass, limit / mass)


def goodness(
    foreseen: Prediction,
    moves: Moves,
    limits: MotionLimits,
    elapsed: float = 0.0,
    most: MostForces | None = None,
) -> FloatArray:
    """How safe it is up to the end of each move (N, k): 1 as near to danger as allowed, 0 a contact lost or off.

    `foreseen` of these `moves`, `elapsed` seconds into the first. `most`: what may press on the pads, if that is known.
    On arcs the last tangent may come near the horizontal, and the object be wedged between both, besides.
    """
    margins = np.minimum(foreseen.nearest, limits.pad_length - foreseen.farthest) / MARGIN_M
    how_safe: FloatArray = np.minimum(margins, foreseen.least_force / LEAST_FORCE)
    forces, rooms = foreseen.path[..., MEAN_FORCES], []
    if most is not None:
        rooms.append(((most.limit - forces) / (most.limit - most.allowed)).min(axis=-1))
    if any(limits.curvatures):
        rooms += [(PHI12_MAX - tangents(foreseen.path)[1]) / TANGENT_ROOM, 2.0 - forces.max(axis=-1) / MOST_FORCE]
    if rooms:
        how_safe = np.minimum(how_safe, _so_far(np.minimum.reduce(rooms), moves, elapsed))
    return how_safe


def may_hop(foreseen: Prediction, moves: Moves) -> Bools:
    """Whether a contact may hop up to the end of each move (N, k), though it is pressed at each instant.

    A pad's mount swings about where a change of force leads it, by as much again at most: a force that falls to less
    than half its mean within a vibration may be gone for a moment.
    """
    path = foreseen.path
    swung = 2.0 * path[..., LEAST_FORCES] - path[..., MEAN_FORCES]
    return _so_far(swung.min(axis=-1), moves, 0.0) < LEAST_FORCE


def _so_far(room: FloatArray, moves: Moves, elapsed: float) -> FloatArray:
    """The least value along a path (N, T), up to the end of each move (N, k)."""
    least = np.fmin.accumulate(room, axis=1)
    calls = np.ceil((np.cumsum(moves.durations, axis=1) - elapsed) / CALL_S - 1e-9).astype(np.intp)
    return np.take_along_axis(least, np.clip(calls - 1, 0, least.shape[1] - 1), axis=1)


def tangents(path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both palms' at their contacts, θ + ψ + π/2 and θ + ψ + 3π/2 (rad), along a `Prediction.path`, NaN after it."""
    turned = path[..., THETA] + path[..., :1] + np.pi * np.array([1.0, 2.0])
    told = np.remainder(turned, 2 * np.pi) - np.pi / 2  # of none is −90° or 270° anything like right
    return told[..., 0], told[..., 1]


class _Task(ctypes.Structure):
    """As in `model/rollout.c`."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("states", "points", "durations", "rig")),
        *((name, ctypes.c_double) for name in ("elapsed", "horizon")),
        *((name, ctypes.c_long) for name in ("n", "k", "calls")),
        *((name, ctypes.c_void_p) for name in Prediction.__slots__),
    )


@cache
def _routine(curved: bool) -> Callable[[_Task], None]:
    """`roll_sequences`. Raises RuntimeError where its sizes are not the model's."""
    library = rollout.library(curved).opened()
    wanted = [LANES, shape_map.N, MOVE_INPUTS, SUBSTEPS, OUTPUTS, BINS, MOST_MOVES]
    if list((ctypes.c_long * len(wanted)).in_dll(library, "rollout_sizes")) != wanted:
        raise RuntimeError("model/rollout.c has other sizes than model/rollout.py")
    roll, library.roll_sequences.restype = library.roll_sequences, None
    return lambda task: roll(ctypes.byref(task))


class RolloutPredictor:
    """Rolls the dynamic model forward."""

    def __init__(self, rig: FloatArray):
        """`rig` as `model.outputs.rig_inputs` gives it; takes seconds when its C has to be compiled first."""
        self._rig, self._angles = rig, np.zeros(2)
        self._roll = _routine(bool(rig[CURVATURE_INPUTS].any()))

    def correct(self, off: FloatArray) -> None:
        """Foretell from now on for a rig whose constants are `off` by so much, in the order of `model.smoothing.R`."""
        self._rig[FRICTION_INPUT] = off[R.FRICTION]
        self._rig[VIBRATION_ERROR_INPUTS] = off[R.KAPPA : R.ARM + 1]
        self._angles = off[[R.TILT, R.TURN]]

    def of(self, states: FloatArray, moves: Moves, elapsed: float = 0.0, horizon_s: float = math.inf) -> Prediction:
        """From `states` (N, 21), or one for all (21,), at rest or `elapsed` seconds into the first move.

        Moves that end after `horizon_s` are not looked at: their `least_force` is −inf. Raises ValueError for sequences
        of more than `MOST_MOVES` moves.
        """
        n, k = moves.durations.shape
        if not 0 < k <= MOST_MOVES:
            raise ValueError(f"a sequence is of 1 to {MOST_MOVES} moves, not {k}")
        before = np.broadcast_to(moves.start, (n, 1, 2))
        points = np.concatenate([before, moves.ends], axis=1) + self._angles
        states = np.ascontiguousarray(np.broadcast_to(states, (n, shape_map.N)))
        durations = np.ascontiguousarray(moves.durations)
        longest = min(float(durations.sum(axis=1).max()) - elapsed, horizon_s)
        calls = max(math.ceil((longest - 1e-9) / CALL_S), 1)
        shape = (n, k)
        foreseen = Prediction(
            touched=np.zeros((n, k, BINS), dtype=np.bool_),
            least_force=np.full(shape, np.inf), nearest=np.full(shape, np.inf), farthest=np.full(shape, -np.inf),
            psi=np.zeros(shape), omega0=np.zeros(shape), path=np.full((n, calls, OUTPUTS), np.nan),
        )  # fmt: skip
        inputs = (each.ctypes.data for each in (states, points, durations, self._rig))
        told = (getattr(foreseen, name).ctypes.data for name in Prediction.__slots__)
        self._roll(_Task(*inputs, elapsed, horizon_s, n, k, calls, *told))
        return foreseen
