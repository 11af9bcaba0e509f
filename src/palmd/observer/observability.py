"""How much the last second of readings tells by itself: the smallest singular value of a scaled Gramian.

Let x0 be the shape map's state a second ago, G the information about it in the readings since, z = (radii, contacts) of
that instant and J = ∂z/∂x0. Before anything is felt z has the covariance C0 = J P0 Jᵀ, and from that second alone
C = J (P0⁻¹ + G)⁻¹ Jᵀ. The number is the smallest singular value of (C0^½ C⁻¹ C0^½ − 1)^½: prior one-sigma over
the error with which that second tells the combination of z that it tells worst. contacts are read; so the worst is what
motion has to tell, above 1 in lively motion and near 0 when palms and object rest or the object turns along with them.
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
LONGEST_GAP_S = 0.1  # between samples; beyond, the trajectory between them is not known


@dataclass(frozen=True, slots=True)
class _Block:
    """A tenth of a second: its transition Φ, information G about its beginning, and J = ∂z/∂x there."""

    transition: FloatArray
    information: FloatArray
    aim: FloatArray


class Observability:
    """Follows one trajectory of the shape map, sample by sample; safe inside the loop.

    `sample` takes some 20 µs each `SAMPLE_S`, and a tenth of a millisecond more when a block is full.
    """

    def __init__(self, rig: FloatArray, reading_variances: FloatArray):
        """`rig` are the kernels' inputs for it, `reading_variances` of each pad are in m²; may compile C."""
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
        self._side = 0  # of the two, which is current
        self._filled_s = 0.0
        self.begin(math.inf, np.ones(n))

    def begin(self, t: float, prior_sd: FloatArray) -> None:
        """Begin anew at `t` (s) with the one-sigma of each state before anything is felt, 0 for the gauge's ψ."""
        self._t_begin = t
        self._prior_sd = prior_sd
        self._value = math.nan
        self._readings = [0, 0]
        self._t_sample = -math.inf
        self._break_off()

    def count(self, pad: int) -> None:
        """A reading of `pad` has been fused."""
        self._readings[pad - 1] += 1

    def due(self, t: float) -> bool:
        """Whether `sample` wants the trajectory at `t` (s)."""
        return t - self._t_sample >= SAMPLE_S

    def sample(self, t: float, x: FloatArray, palms: FloatArray, jerk: FloatArray) -> None:
        """The trajectory is at state `x` at `t` (s), with the palms' (φ, ω, α) and jerk."""
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
                    self._value = self._judge()
        self._t_sample = t
        self._readings = [0, 0]
        self._x[:] = x
        self._u[1:7], self._u[7:9] = palms, jerk
        if self._filled_s == 0.0:
            self._phi[:2] = palms[:2]
            self._aim()

    def value(self) -> float:
        """The number as of the last full block (no unit, ≥ 0); NaN in the first second."""
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

    def _judge(self) -> float:
        information = np.zeros((shape_map.N, shape_map.N))
        for block in reversed(self._blocks):
            information = block.information + block.transition.T @ information @ block.transition
        return scaled_singular_value(information, self._blocks[0].aim, self._prior_sd)


def scaled_singular_value(information: FloatArray, aim: FloatArray, prior_sd: FloatArray) -> float:
    """σ_min of (C0^½ C⁻¹ C0^½ − 1)^½ with C0 = J P0 Jᵀ, C = J (P0⁻¹ + G)⁻¹ Jᵀ, P0 = diag(sd²).

    No unit, NaN if undefined. A state with sd 0 is known. Safe inside the loop.
    """
    scaled = aim * prior_sd
    told = np.eye(len(prior_sd)) + prior_sd[:, None] * information * prior_sd
    try:
        root = np.linalg.inv(np.linalg.cholesky(scaled @ scaled.T))
        left = root @ scaled
        share_left = np.linalg.eigvalsh(left @ np.linalg.solve(told, left.T))[-1]
    except np.linalg.LinAlgError:  # a state gone wild; the bank parks it
        return math.nan
    return math.sqrt(max(1.0 / share_left - 1.0, 0.0)) if share_left > 0.0 else math.nan
