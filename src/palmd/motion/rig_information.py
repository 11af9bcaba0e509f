"""Expected information of motions about the rig's constants, weighted by their effect on the outline.

Readings are linearised about the estimate. ψ is a free parameter at each instant, so that only the geometry of both
contacts counts, not the dynamics. What geometry never determines counts as known: standoffs and magnification.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray, PlanningBelief
from palmd.model import shape, shape_map, smoothing
from palmd.model.rollout import THETA
from palmd.model.smoothing import CONSTANTS, CONTACT_INPUTS, NODE, ORDER, RIG, RIG_CONSTANTS, C, R
from palmd.motion.rollout_predictor import BINS, CALL_S, Bools
from palmd.system.description import RigDescription
from palmd.system.mechanism import PALMS, joints_at

BATCH = 64  # readings per call of the kernel
READING_S = 0.01  # interval of a pad's readings
_NORMALS: FloatArray = (np.arange(BINS, dtype=np.float64) + 0.5) * (2 * np.pi / BINS)
_OUTLINE = 2 * ORDER + 1
_SAME = 1e-6  # singular values smaller than this share of the largest count as zero


@dataclass(frozen=True, slots=True)
class RigCost:
    """Uncertainty of the rig's constants that touch could reduce, as m independent steps of 1σ.

    steps: (15 + 25, m), change of the constants and of the outline's coefficients by each step, in the order of
    `model.smoothing.C`. cost: (m, m), its trace is the mean square change of the outline (m²). band_sd: RMS of the
    outline's total standard deviation (m).
    """

    steps: FloatArray
    cost: FloatArray
    band_sd: float

    @property
    def sd(self) -> float:
        """RMS standard deviation of the outline (m) due to these steps."""
        return float(np.sqrt(np.trace(self.cost)))

    def share_determined(self, information: FloatArray, before: FloatArray | float = 0.0) -> FloatArray:
        """Return the share of the mean square that `information` (…, m, m) removes, in addition to that of `before`."""
        known = np.eye(len(self.cost)) + before
        now = np.einsum("ij,ji->", np.linalg.inv(known), self.cost)
        then = np.einsum("...ij,ji->...", np.linalg.inv(known + information), self.cost)
        share: FloatArray = (now - then) / np.trace(self.cost)
        return share


def rig_cost(belief: PlanningBelief, normals: Bools) -> RigCost | None:
    """Return the `RigCost` for the outline on these bins of `normals`; None without a covariance of the rig."""
    spread = belief.rig_spread
    if spread is None:
        return None
    of_outline, of_rig = spread[:_OUTLINE], spread[_OUTLINE:]
    unobservable = of_rig[[R.STANDOFF, R.STANDOFF + 1, R.SCALE]]
    unobservable[-1] += of_rig[R.SCALE + 1]
    size = np.linalg.norm(unobservable, axis=1, keepdims=True)
    observable = _null_space(unobservable / np.maximum(size, np.finfo(float).tiny))
    steps = np.vstack([of_rig, of_outline]) @ observable
    theta = _NORMALS[normals]
    free = shape.gauge_free_basis(theta, theta, _coefficients(belief))
    moved, whole = free @ steps[RIG_CONSTANTS:], free @ of_outline
    band_sd = np.sqrt(np.mean(belief.h_sd[normals] ** 2 + (whole**2).sum(axis=1)))
    return RigCost(steps, moved.T @ moved / len(theta), float(band_sd))


def _null_space(rows: FloatArray) -> FloatArray:
    """Return an orthonormal basis, in columns, of the null space of `rows`."""
    _, values, directions = np.linalg.svd(rows)
    basis: FloatArray = directions[int((values > _SAME * values.max()).sum()) :].T
    return basis


class RigInformation:
    """Computes the information of predicted paths; owns the arrays of the readings' kernel."""

    def __init__(self, rig: RigDescription):
        """Takes seconds if the kernel must be compiled first."""
        self._reading_sds = np.sqrt(rig.reading_variances)
        self._p = np.zeros(CONSTANTS)
        self._now, self._next = np.zeros((BATCH, NODE)), np.zeros((BATCH, NODE))
        self._inputs = np.zeros((BATCH, CONTACT_INPUTS))
        self._inputs[:, 0] = CALL_S
        self._inputs[:, -len(PALMS) :] = [pad.length for pad in rig.pads]
        self._inputs[:, -2 * len(PALMS) : -len(PALMS)] = rig.curvatures
        self._J = np.zeros((BATCH, 2 * NODE + CONSTANTS))
        self._contact = smoothing.library(rig.curved).bind(
            "contact_batch", [self._now, self._next, self._p, self._inputs], [np.zeros(BATCH), self._J]
        )

    def of(self, belief: PlanningBelief, cost: RigCost, path: FloatArray, durations: FloatArray) -> FloatArray:
        """Return the information about the steps of `cost` up to the end of each move, (N, k, m, m).

        path: as in `Prediction`. durations: (N, k) of the moves (s).
        """
        self._p[C.SHAPE :] = _coefficients(belief)
        self._p[RIG] = 0.0 if belief.rig is None else belief.rig
        ends = np.cumsum(durations, axis=1)
        t = CALL_S * np.arange(1, path.shape[1] + 1)
        live = (t < ends[:, -1:] + CALL_S / 2) & np.isfinite(path).all(axis=-1)
        rows = np.zeros((*live.shape, len(PALMS), cost.steps.shape[1]))
        rows[live] = self._rows(path, live, cost.steps)
        move = (t[:, None] > ends[:, None, :] + CALL_S / 2).sum(axis=-1)  # (N, T)
        by_move = []
        for number in range(ends.shape[1]):
            own = np.where((move == number)[..., None, None], rows, 0.0).reshape(len(path), -1, rows.shape[-1])
            by_move.append(own.transpose(0, 2, 1) @ own)
        return np.cumsum(np.stack(by_move, axis=1), axis=1)

    def _rows(self, path: FloatArray, live: Bools, steps: FloatArray) -> FloatArray:
        """Return the readings' changes by `steps` where `live`, in units of σ (n, palms, m), ψ marginalised."""
        psi = path[..., 0]
        angles = np.stack(joints_at(np.moveaxis(path[..., THETA], -1, 0), psi), axis=-1)
        angles = angles - self._p[RIG][[R.TILT, R.TURN]]
        rates = np.diff(angles, axis=1, prepend=angles[:, :1]) / CALL_S
        spin = path[..., 1]
        now = np.stack([psi, spin], axis=-1)[live]
        inputs = np.concatenate([angles, rates], axis=-1)[live]
        of_psi, of_steps = zip(*(self._linearised(palm, now, inputs, steps) for palm in PALMS), strict=True)
        a, rows = np.stack(of_psi, axis=1), np.stack(of_steps, axis=1)
        # apply a root of I − a aᵀ/(1 + aᵀa): marginalises ψ with a prior of 1 rad
        size = 1.0 + (a**2).sum(axis=1)
        mixed = np.einsum("ni,nim->nm", a, rows) / (size + np.sqrt(size))[:, None]
        marginal: FloatArray = math.sqrt(CALL_S / READING_S) * (rows - a[:, :, None] * mixed[:, None, :])
        return marginal

    def _linearised(
        self, palm: int, now: FloatArray, inputs: FloatArray, steps: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the changes of this palm's readings by ψ (n,) and by each of `steps` (n, m), in units of σ."""
        n = len(now)
        of_psi, of_steps = np.empty(n), np.empty((n, steps.shape[1]))
        self._inputs[:, 2] = palm
        for first in range(0, n, BATCH):
            some = slice(first, min(first + BATCH, n))
            count = some.stop - first
            self._now[:count] = now[some]
            self._next[:count] = now[some]
            self._next[:count, 0] += CALL_S * now[some, 1]
            self._inputs[:count, 3:7] = inputs[some]
            self._contact()
            of_psi[some] = self._J[:count, 0] / self._reading_sds[palm - 1]
            of_steps[some] = self._J[:count, 2 * NODE + C.RIG :] @ steps / self._reading_sds[palm - 1]
        return of_psi, of_steps


def _coefficients(belief: PlanningBelief) -> FloatArray:
    """Return the coefficients of the most likely outline, padded to the smoother's number of harmonics (25,)."""
    coefficients = belief.states[0, shape_map.Z.SHAPE :]
    return np.pad(coefficients, (0, _OUTLINE - len(coefficients)))
