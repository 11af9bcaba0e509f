"""Rollout predictor: motion of objects on sequences of palm moves, many at once. Pure; not for the loop.

Compiled from `model/rollout.c`.
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
"""Durations of moves are integer multiples of this."""

BINS = rollout.BINS
MOST_MOVES = 16  # in one sequence
LEAST_FORCE = 0.8  # m/s², smallest safe force on a contact; at rest it is several m/s²
MARGIN_M = 3e-3  # smallest safe distance of a contact from the pad's ends
TANGENT_ROOM = math.radians(1.0)  # smallest safe distance of a curved palm's tangent from the horizontal
FORCE_SIGMAS = 3.0  # margin of predicted forces from the pad's limit, in σ of a force reading (convention)
MOST_FORCE = 60.0  # m/s², between curved palms, which wedge a sliding object where the tangents are 2 atan μ apart

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Moves:
    """N sequences of k minimum-jerk moves from the pose `start`: `ends` (N, k, 2) (rad), `durations` (N, k) (s)."""

    start: FloatArray
    ends: FloatArray
    durations: FloatArray


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted result of each sequence, up to the end of each of its moves.

    touched: (N, k, BINS), normals touched since the start. least_force: (N, k), smallest force within a vibration
    (m/s²). nearest, farthest: (N, k), distances of contacts from the hinge (m). psi, omega0: (N, k), at the end of each
    move. path: (N, T, OUTPUTS), outputs of `model.rollout` after each `CALL_S`, NaN after the sequence's end or the
    horizon.
    """

    touched: Bools
    least_force: FloatArray
    nearest: FloatArray
    farthest: FloatArray
    psi: FloatArray
    omega0: FloatArray
    path: FloatArray


class MostForces(NamedTuple):
    """Force on each palm's contact per unit mass (m/s²): the largest allowed, and the pad's limit."""

    allowed: FloatArray
    limit: FloatArray


def most_forces(limits: MotionLimits, pads: Sequence[PadSensor], mass: float, mass_sd: float) -> MostForces:
    """Return the force limits for an object of `mass` (kg); the allowed force is `FORCE_SIGMAS` σ below the limit."""
    limit = np.array(limits.pad_forces)
    noise = np.array([pad.force_variance(most) for pad, most in zip(pads, limits.pad_forces, strict=True)])
    sd = np.hypot(np.sqrt(noise), limit * mass_sd / mass)
    return MostForces((limit - FORCE_SIGMAS * sd) / mass, limit / mass)


def goodness(
    prediction: Prediction,
    moves: Moves,
    limits: MotionLimits,
    elapsed: float = 0.0,
    most: MostForces | None = None,
) -> FloatArray:
    """Return the safety margin up to the end of each move (N, k): 1 at the allowed limits, 0 where a contact is lost.

    prediction: of these `moves`, from `elapsed` seconds into the first. most: limits of the forces on the pads, if
    known. On arcs also the last tangent's distance from the horizontal and wedging count.
    """
    margins = np.minimum(prediction.nearest, limits.pad_length - prediction.farthest) / MARGIN_M
    how_safe: FloatArray = np.minimum(margins, prediction.least_force / LEAST_FORCE)
    forces, rooms = prediction.path[..., MEAN_FORCES], []
    if most is not None:
        rooms.append(((most.limit - forces) / (most.limit - most.allowed)).min(axis=-1))
    if any(limits.curvatures):
        rooms += [(PHI12_MAX - tangents(prediction.path)[1]) / TANGENT_ROOM, 2.0 - forces.max(axis=-1) / MOST_FORCE]
    if rooms:
        how_safe = np.minimum(how_safe, _so_far(np.minimum.reduce(rooms), moves, elapsed))
    return how_safe


def may_hop(prediction: Prediction, moves: Moves) -> Bools:
    """Return whether a contact may hop before the end of each move (N, k), although its predicted force is positive.

    A pad's mount overshoots after a change of force, by at most the same amount: a force that falls to less than half
    its mean within a vibration may vanish for a moment.
    """
    path = prediction.path
    swung = 2.0 * path[..., LEAST_FORCES] - path[..., MEAN_FORCES]
    return _so_far(swung.min(axis=-1), moves, 0.0) < LEAST_FORCE


def _so_far(room: FloatArray, moves: Moves, elapsed: float) -> FloatArray:
    """Return the smallest value along a path (N, T), up to the end of each move (N, k)."""
    least = np.fmin.accumulate(room, axis=1)
    calls = np.ceil((np.cumsum(moves.durations, axis=1) - elapsed) / CALL_S - 1e-9).astype(np.intp)
    return np.take_along_axis(least, np.clip(calls - 1, 0, least.shape[1] - 1), axis=1)


def tangents(path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both palms' tangents at the contacts, θ + ψ + π/2 and θ + ψ + 3π/2 (rad), along a `Prediction.path`."""
    turned = path[..., THETA] + path[..., :1] + np.pi * np.array([1.0, 2.0])
    angles = np.remainder(turned, 2 * np.pi) - np.pi / 2  # wrapped where no tangent can be, at −90°
    return angles[..., 0], angles[..., 1]


class _Task(ctypes.Structure):
    """`Task` in `model/rollout.c`."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("states", "points", "durations", "rig")),
        *((name, ctypes.c_double) for name in ("elapsed", "horizon")),
        *((name, ctypes.c_long) for name in ("n", "k", "calls")),
        *((name, ctypes.c_void_p) for name in Prediction.__slots__),
    )


@cache
def _routine(curved: bool) -> Callable[[_Task], None]:
    """Load `roll_sequences`; raises RuntimeError if its sizes differ from the model's."""
    library = rollout.library(curved).opened()
    expected = [LANES, shape_map.N, MOVE_INPUTS, SUBSTEPS, OUTPUTS, BINS, MOST_MOVES]
    if list((ctypes.c_long * len(expected)).in_dll(library, "rollout_sizes")) != expected:
        raise RuntimeError("model/rollout.c has other sizes than model/rollout.py")
    roll, library.roll_sequences.restype = library.roll_sequences, None
    return lambda task: roll(ctypes.byref(task))


class RolloutPredictor:
    """Rolls out the dynamic model."""

    def __init__(self, rig: FloatArray):
        """`rig`: from `model.outputs.rig_inputs`. Takes seconds if the kernels must be compiled first."""
        self._rig, self._angles = rig, np.zeros(2)
        self._roll = _routine(bool(rig[CURVATURE_INPUTS].any()))

    def correct(self, errors: FloatArray) -> None:
        """Predict from now on for a rig with these errors of its constants, in the order of `model.smoothing.R`."""
        self._rig[FRICTION_INPUT] = errors[R.FRICTION]
        self._rig[VIBRATION_ERROR_INPUTS] = errors[R.KAPPA : R.ARM + 1]
        self._angles = errors[[R.TILT, R.TURN]]

    def of(self, states: FloatArray, moves: Moves, elapsed: float = 0.0, horizon_s: float = math.inf) -> Prediction:
        """Predict the result of `moves` from `states` (N, 21), or from one state for all (21,).

        The prediction starts `elapsed` seconds into the first move. Moves that end after `horizon_s` are not predicted:
        their `least_force` is −inf. Raises ValueError for sequences of more than `MOST_MOVES` moves.
        """
        n, k = moves.durations.shape
        if not 0 < k <= MOST_MOVES:
            raise ValueError(f"a sequence must have 1 to {MOST_MOVES} moves, got {k}")
        before = np.broadcast_to(moves.start, (n, 1, 2))
        points = np.concatenate([before, moves.ends], axis=1) + self._angles
        states = np.ascontiguousarray(np.broadcast_to(states, (n, shape_map.N)))
        durations = np.ascontiguousarray(moves.durations)
        longest = min(float(durations.sum(axis=1).max()) - elapsed, horizon_s)
        calls = max(math.ceil((longest - 1e-9) / CALL_S), 1)
        shape = (n, k)
        prediction = Prediction(
            touched=np.zeros((n, k, BINS), dtype=np.bool_),
            least_force=np.full(shape, np.inf), nearest=np.full(shape, np.inf), farthest=np.full(shape, -np.inf),
            psi=np.zeros(shape), omega0=np.zeros(shape), path=np.full((n, calls, OUTPUTS), np.nan),
        )  # fmt: skip
        inputs = (each.ctypes.data for each in (states, points, durations, self._rig))
        outputs = (getattr(prediction, name).ctypes.data for name in Prediction.__slots__)
        self._roll(_Task(*inputs, elapsed, horizon_s, n, k, calls, *outputs))
        return prediction
