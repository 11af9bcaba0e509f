"""Observability in the last second of readings: the smallest singular value of a scaled Gramian.

Let x0 be the shape map's state one second ago, G the information about it in the readings since, z = (radii, contacts)
at that time and J = ∂z/∂x0. A priori z has the covariance C0 = J P0 Jᵀ, and given that second of readings alone
C = J (P0⁻¹ + G)⁻¹ Jᵀ. The measure is the smallest singular value of (C0^½ C⁻¹ C0^½ − 1)^½: prior 1σ over the 1σ with
which that second determines the worst determined combination of z. Contacts are measured directly, so the worst
combination is one that only motion determines: above 1 in lively motion, near 0 while palms and object rest or the
object turns with the palms.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model import sensitivity, shape_map
from palmd.model.outputs import CURVATURE_INPUTS

WINDOW_S = 1.0
BLOCK_S = 0.1
SAMPLE_S = 0.025
LONGEST_GAP_S = 0.1  # between samples; over a longer gap the trajectory is unknown


@dataclass(frozen=True, slots=True)
class _Block:
    """A block of `BLOCK_S`: its transition Φ, information G about its start, and J = ∂z/∂x there."""

    transition: FloatArray
    information: FloatArray
    aim: FloatArray


class Observability:
    """The measure along one trajectory of the shape map, updated sample by sample; safe inside the loop.

    `sample` takes some 20 µs each `SAMPLE_S`, and 0.1 ms more when a block is full.
    """

    def __init__(self, rig: FloatArray, reading_variances: FloatArray):
        """`rig`: the kernels' inputs for the rig; `reading_variances`: of each pad (m²). May compile C."""
        curvatures = rig[CURVATURE_INPUTS]
        n = shape_map.N
        library = sensitivity.library(bool(curvatures.any()))
        self._weights = (1.0 / reading_variances).tolist()
        self._x, self._J = np.zeros(n), np.zeros((n, sensitivity.AIMED_AT))
        # CasADi stores by columns: these are the transposes
        self._T = [np.zeros((n, sensitivity.MOVING)) for _ in range(2)]
        self._G = [np.zeros((n, n)) for _ in range(2)]
        self._u, self._phi = np.zeros(sensitivity.GATHER_INPUTS), np.array([0.0, 0.0, *curvatures])
        self._u[9:-2] = rig
        self._gather = [
            library.bind("gather", [self._x, self._T[a], self._G[a], self._u], [self._T[1 - a], self._G[1 - a]])
            for a in range(2)
        ]
        self._aim = library.bind("aim", [self._x, self._phi], [self._J])
        self._blocks: deque[_Block] = deque(maxlen=round(WINDOW_S / BLOCK_S))
        self._side = 0  # index of the current one of the two
        self._filled_s = 0.0
        self.begin(math.inf, np.ones(n))

    def begin(self, t: float, prior_sd: FloatArray) -> None:
        """Restart at `t` (s) with the prior 1σ of each state, 0 for ψ (gauge)."""
        self._t_begin = t
        self._prior_sd = prior_sd
        self._value = math.nan
        self._readings = [0, 0]
        self._t_sample = -math.inf
        self._break_off()

    def count(self, pad: int) -> None:
        """Count a fused reading of `pad`."""
        self._readings[pad - 1] += 1

    def due(self, t: float) -> bool:
        """Whether the next `sample` is due at `t` (s)."""
        return t - self._t_sample >= SAMPLE_S

    def sample(self, t: float, x: FloatArray, palms: FloatArray, jerk: FloatArray) -> None:
        """Take the trajectory's state `x` at `t` (s), with the palms' (φ, ω, α) and jerk."""
        dt = t - self._t_sample
        if dt > LONGEST_GAP_S:
            self._break_off()
        else:
            self._u[0] = dt
            self._u[-2:] = [count * weight for count, weight in zip(self._readings, self._weights, strict=True)]
            self._gather[self._side]()
            self._side = 1 - self._side
            self._filled_s += dt
            if self._filled_s >= BLOCK_S - SAMPLE_S / 2:
                self._close_block()
                if t - self._t_begin >= WINDOW_S:
                    self._value = self._evaluate()
        self._t_sample = t
        self._readings = [0, 0]
        self._x[:] = x
        self._u[1:7], self._u[7:9] = palms, jerk
        if self._filled_s == 0.0:
            self._phi[:2] = palms[:2]
            self._aim()

    def value(self) -> float:
        """The measure as of the last full block (no unit, ≥ 0); NaN in the first second."""
        return self._value

    def _break_off(self) -> None:
        self._blocks.clear()
        self._open_block()

    def _open_block(self) -> None:
        self._side = 0
        self._filled_s = 0.0
        self._T[0][:] = np.eye(shape_map.N, sensitivity.MOVING)
        self._G[0][:] = 0.0

    def _close_block(self) -> None:
        transition = np.eye(shape_map.N)
        transition[: sensitivity.MOVING] = self._T[self._side].T
        self._blocks.append(_Block(transition, self._G[self._side].copy(), self._J.T.copy()))
        self._open_block()

    def _evaluate(self) -> float:
        information = np.zeros((shape_map.N, shape_map.N))
        for block in reversed(self._blocks):
            information = block.information + block.transition.T @ information @ block.transition
        return scaled_singular_value(information, self._blocks[0].aim, self._prior_sd)


def scaled_singular_value(information: FloatArray, aim: FloatArray, prior_sd: FloatArray) -> float:
    """σ_min of (C0^½ C⁻¹ C0^½ − 1)^½ with C0 = J P0 Jᵀ, C = J (P0⁻¹ + G)⁻¹ Jᵀ, P0 = diag(sd²).

    No unit, NaN if undefined. A state with sd 0 is known. Safe inside the loop.
    """
    scaled = aim * prior_sd
    scaled_information = np.eye(len(prior_sd)) + prior_sd[:, None] * information * prior_sd
    try:
        root = np.linalg.inv(np.linalg.cholesky(scaled @ scaled.T))
        projected = root @ scaled
        share_left = np.linalg.eigvalsh(projected @ np.linalg.solve(scaled_information, projected.T))[-1]
    except np.linalg.LinAlgError:  # a diverged state; the bank deactivates it
        return math.nan
    return math.sqrt(max(1.0 / share_left - 1.0, 0.0)) if share_left > 0.0 else math.nan
