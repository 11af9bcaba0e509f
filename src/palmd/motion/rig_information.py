"""What motions would tell of the rig's constants, by what these cost the outline; for whoever chooses motions.

Readings are linearised about what is known. ψ is left open at each instant, so that only what the geometry of both
contacts tells is counted, and not the dynamics. What that never tells counts as known: standoffs and magnification.
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

BATCH = 64  # readings in one call
READING_S = 0.01  # from one reading of a pad to the next
_NORMALS: FloatArray = (np.arange(BINS, dtype=np.float64) + 0.5) * (2 * np.pi / BINS)
_OUTLINE = 2 * ORDER + 1
_SAME = 1e-6  # of steps that differ by less


@dataclass(frozen=True, slots=True)
class RigCost:
    """What is not known of the rig's constants though touch would tell it, as m independent one-sigma steps.

    steps: (15 + 25, m) what each moves of the constants and of the outline's coefficients, in the order of
    `model.smoothing.C`. cost: (m, m), its trace is the mean square of what they move the outline by (m²). band_sd: RMS
    of the outline's one-sigma (m), with all that is not known.
    """

    steps: FloatArray
    cost: FloatArray
    band_sd: float

    @property
    def sd(self) -> float:
        """What they leave open of the outline: RMS of its one-sigma (m)."""
        return float(np.sqrt(np.trace(self.cost)))

    def share_told(self, information: FloatArray, before: FloatArray | float = 0.0) -> FloatArray:
        """By which share of the mean square `information` (…, m, m) lowers what is left of it by that of `before`."""
        known = np.eye(len(self.cost)) + before
        now = np.einsum("ij,ji->", np.linalg.inv(known), self.cost)
        then = np.einsum("...ij,ji->...", np.linalg.inv(known + information), self.cost)
        share: FloatArray = (now - then) / np.trace(self.cost)
        return share


def rig_cost(belief: PlanningBelief, normals: Bools) -> RigCost | None:
    """Of the outline on these bins of `normals`; None where nothing is known of the rig."""
    spread = belief.rig_spread
    if spread is None:
        return None
    of_outline, of_rig = spread[:_OUTLINE], spread[_OUTLINE:]
    never_told = of_rig[[R.STANDOFF, R.STANDOFF + 1, R.SCALE]]
    never_told[-1] += of_rig[R.SCALE + 1]
    size = np.linalg.norm(never_told, axis=1, keepdims=True)
    others = _null_space(never_told / np.maximum(size, np.finfo(float).tiny))
    steps = np.vstack([of_rig, of_outline]) @ others
    theta = _NORMALS[normals]
    free = shape.gauge_free_basis(theta, theta, _coefficients(belief))
    moved, whole = free @ steps[RIG_CONSTANTS:], free @ of_outline
    band_sd = np.sqrt(np.mean(belief.h_sd[normals] ** 2 + (whole**2).sum(axis=1)))
    return RigCost(steps, moved.T @ moved / len(theta), float(band_sd))


def _null_space(rows: FloatArray) -> FloatArray:
    """An orthonormal basis, in columns, of what `rows` map to 0."""
    _, values, directions = np.linalg.svd(rows)
    basis: FloatArray = directions[int((values > _SAME * values.max()).sum()) :].T
    return basis


class RigInformation:
    """Holds the memory of the readings' kernel."""

    def __init__(self, rig: RigDescription):
        """Takes seconds when its C has to be compiled first."""
        self._sigmas = np.sqrt(rig.reading_variances)
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
        """About the steps of `cost`, up to the end of each move (N, k, m, m): `path` foreseen, `durations` (N, k)."""
        self._p[C.SHAPE :] = _coefficients(belief)
        self._p[RIG] = 0.0 if belief.rig is None else belief.rig
        ends = np.cumsum(durations, axis=1)
        t = CALL_S * np.arange(1, path.shape[1] + 1)
        live = (t < ends[:, -1:] + CALL_S / 2) & np.isfinite(path).all(axis=-1)
        told = np.zeros((*live.shape, len(PALMS), cost.steps.shape[1]))
        told[live] = self._rows(path, live, cost.steps)
        move = (t[:, None] > ends[:, None, :] + CALL_S / 2).sum(axis=-1)  # (N, T)
        each = []
        for number in range(ends.shape[1]):
            own = np.where((move == number)[..., None, None], told, 0.0).reshape(len(path), -1, told.shape[-1])
            each.append(own.transpose(0, 2, 1) @ own)
        return np.cumsum(np.stack(each, axis=1), axis=1)

    def _rows(self, path: FloatArray, live: Bools, steps: FloatArray) -> FloatArray:
        """What `steps` move the readings by where it is `live`, less what ψ may have: in sigmas (n, palms, m)."""
        psi = path[..., 0]
        angles = np.stack(joints_at(np.moveaxis(path[..., THETA], -1, 0), psi), axis=-1)
        angles = angles - self._p[RIG][[R.TILT, R.TURN]]
        rates = np.diff(angles, axis=1, prepend=angles[:, :1]) / CALL_S
        spin = path[..., 1]
        now = np.stack([psi, spin], axis=-1)[live]
        inputs = np.concatenate([angles, rates], axis=-1)[live]
        of_psi, of_steps = zip(*(self._linearised(palm, now, inputs, steps) for palm in PALMS), strict=True)
        a, rows = np.stack(of_psi, axis=1), np.stack(of_steps, axis=1)
        # a root of I − a aᵀ/(1 + aᵀa), which is what a ψ that is open by a radian leaves of the readings
        size = 1.0 + (a**2).sum(axis=1)
        mixed = np.einsum("ni,nim->nm", a, rows) / (size + np.sqrt(size))[:, None]
        left: FloatArray = math.sqrt(CALL_S / READING_S) * (rows - a[:, :, None] * mixed[:, None, :])
        return left

    def _linearised(
        self, palm: int, now: FloatArray, inputs: FloatArray, steps: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """What ψ (n,) and each of `steps` (n, m) move a reading of this palm by, in sigmas."""
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
            of_psi[some] = self._J[:count, 0] / self._sigmas[palm - 1]
            of_steps[some] = self._J[:count, 2 * NODE + C.RIG :] @ steps / self._sigmas[palm - 1]
        return of_psi, of_steps


def _coefficients(belief: PlanningBelief) -> FloatArray:
    """Those of the likeliest outline, with as many harmonics as a smoother's (25,)."""
    coefficients = belief.states[0, shape_map.Z.SHAPE :]
    return np.pad(coefficients, (0, _OUTLINE - len(coefficients)))
