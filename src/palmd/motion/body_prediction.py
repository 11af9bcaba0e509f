"""Predict a body between three palms for many moves at once. Pure; not for the loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model import body_rollout
from palmd.model.body_rollout import MOVE_INPUTS, ROUGH_ORDER, ROUGH_STEP_S, STEP_OUTPUTS, STEP_S
from palmd.model.compiled import LANES
from palmd.model.spherical import count, order_of
from palmd.model.three_palms import BODY
from palmd.system.three_palms import ThreePalmsRig, room_on_pads

COLUMNS = 48  # moves predicted at once
EVERY_S = 0.02  # interval of the predicted normals
_FORCES, _CONTACTS, _NORMALS = slice(0, 3), slice(3, 9), slice(9, 18)


@dataclass(frozen=True, slots=True)
class Bearings:
    """N states: rotations R to the world (N, 3, 3), spins (N, 3) (rad/s), joints of the resting palms (N, 3) (rad)."""

    R: FloatArray
    omega: FloatArray
    joints: FloatArray

    def some(self, which: FloatArray) -> Bearings:
        """The states with these indices."""
        return Bearings(self.R[which], self.omega[which], self.joints[which])


@dataclass(frozen=True, slots=True)
class PredictedMoves:
    """Prediction of N moves.

    after: states at their ends. least_force: (N,) smallest normal force of any palm per mass (m/s²), −inf if the body
    leaves the palms. room: (N,) smallest distance of a contact from its pad's edge (m). spin: (N,) largest spin
    (rad/s). normals: (N, T, 3 palms, 3) outward normals at the contacts in the body's frame, every `EVERY_S`, NaN after
    a move's end.
    """

    after: Bearings
    least_force: FloatArray
    room: FloatArray
    spin: FloatArray
    normals: FloatArray


class BodyPredictor:
    """Simulates a body with parameters p of `model.three_palms`; owns the kernel's buffers."""

    def __init__(self, p: FloatArray, rig: ThreePalmsRig, *, rough: bool = False) -> None:
        """Takes a minute if its C has to be compiled first.

        rough: four times as fast, with the outline truncated at `ROUGH_ORDER` and longer steps.
        """
        self._order = min(_order(p), ROUGH_ORDER) if rough else _order(p)
        self.rig, self._step_s = rig, ROUGH_STEP_S if rough else STEP_S
        sizes = (9, 3, MOVE_INPUTS, count(self._order) + BODY)
        self._R, self._omega, self._move, self._p = (np.zeros((COLUMNS, size)) for size in sizes)
        self._R_after, self._omega_after, self._outputs = (np.zeros((COLUMNS, size)) for size in (9, 3, STEP_OUTPUTS))
        self.set_parameters(p)
        inputs = [self._R, self._omega, self._move, self._p, rig.kernel_constants]
        outputs = [self._R_after, self._omega_after, self._outputs]
        self._step = body_rollout.library(self._order, self._step_s).bind("step_columns", inputs, outputs)

    def set_parameters(self, p: FloatArray) -> None:
        """Use parameters p from now on, truncated to its own degree."""
        assert _order(p) >= self._order, "parameters do not fit the model"
        self._parameters = self._truncated(p)

    @property
    def parameters(self) -> FloatArray:
        """The parameters in use."""
        return self._parameters

    def _truncated(self, p: FloatArray) -> FloatArray:
        return np.concatenate([p[..., : count(self._order)], p[..., -BODY:]], axis=-1)

    def predict(
        self, begin: Bearings, ends: FloatArray, durations: FloatArray, elapsed: float = 0.0, rest: float = 0.0,
        p: FloatArray | None = None,
    ) -> PredictedMoves:  # fmt: skip
        """Predict N moves (at most `COLUMNS`) from rest at `begin.joints` to rest at `ends` (N, 3) (rad).

        durations: (N,) (s). elapsed: time since the moves' start at which the body is in the state `begin` (s). rest:
        time for which the palms rest after the moves (s). p: parameters for this call, of all (m,) or of each (N, m),
        truncated to its own degree.
        """
        n = len(ends)
        steps = np.maximum(np.ceil((durations - elapsed + rest) / self._step_s - 1e-9).astype(np.intp), 1)
        longest = np.argsort(-steps, kind="stable")  # the longest first, so that finished columns can be skipped
        self._R[:n] = np.swapaxes(begin.R, 1, 2).reshape(-1, 9)[longest]
        self._omega[:n] = begin.omega[longest]
        self._move[:n] = np.column_stack([begin.joints, ends, durations, np.full(n, elapsed)])[longest]
        self._p[:n] = np.broadcast_to(self._parameters if p is None else self._truncated(p), self._p[:n].shape)[longest]
        for each in (self._R, self._omega, self._move, self._p):
            each[n:] = each[0]
        last = int(steps.max())
        turned, spun, path = (np.empty((last, n, size)) for size in (9, 3, STEP_OUTPUTS))
        going = (steps > np.arange(last)[:, None]).sum(axis=1)
        for k, columns in enumerate((-(-going // LANES) * LANES).tolist()):
            self._step(columns)
            self._R[:], self._omega[:] = self._R_after, self._omega_after
            self._move[:, 7] += self._step_s
            turned[k, longest], spun[k, longest], path[k, longest] = self._R[:n], self._omega[:n], self._outputs[:n]
        ended = np.arange(last)[:, None] >= steps
        path[ended] = np.nan
        spin = np.where(ended, 0.0, np.linalg.norm(spun, axis=2)).max(axis=0)
        turn, omega = (each[steps - 1, np.arange(n)] for each in (turned, spun))
        force, contacts = path[..., _FORCES], path[..., _CONTACTS].reshape(last, n, 3, 2)
        room = room_on_pads(contacts, self.rig.pad.side)
        finite = np.isfinite(turn).all(axis=1) & np.isfinite(spin)
        return PredictedMoves(
            Bearings(np.swapaxes(turn.reshape(-1, 3, 3), 1, 2), omega, ends),
            np.where(finite, np.nanmin(force, axis=(0, 2)), -np.inf),
            np.nanmin(room, axis=(0, 2, 3)),
            spin,
            np.swapaxes(path[:: round(EVERY_S / self._step_s), :, _NORMALS], 0, 1).reshape(n, -1, 3, 3),
        )


def _order(p: FloatArray) -> int:
    """Degree of the outline of parameters p."""
    order = order_of(len(p) - BODY)
    assert len(p) == count(order) + BODY, "parameters do not fit the model"
    return order
