"""What a body between three palms will do on many moves at once. Pure; not for the loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model import body_rollout
from palmd.model.body_rollout import MOVE_INPUTS, ROUGH_ORDER, ROUGH_STEP_S, STEP_S, TOLD
from palmd.model.compiled import LANES
from palmd.model.spherical import count, order_of
from palmd.model.three_palms import BODY
from palmd.system.three_palms import ThreePalmsRig, room_on_pads

COLUMNS = 48  # moves side by side
EVERY_S = 0.02  # the normals are told
_FORCES, _CONTACTS, _NORMALS = slice(0, 3), slice(3, 9), slice(9, 18)


@dataclass(frozen=True, slots=True)
class Bearings:
    """N rotations to the world (N, 3, 3), spins in it (N, 3) (rad/s), joints of the palms at rest (N, 3) (rad)."""

    R: FloatArray
    omega: FloatArray
    joints: FloatArray

    def some(self, which: FloatArray) -> Bearings:
        """Those of the given numbers."""
        return Bearings(self.R[which], self.omega[which], self.joints[which])


@dataclass(frozen=True, slots=True)
class PredictedMoves:
    """What comes of N moves. after: when they have ended. least_force: (N,) of any palm on the way (m/s²).

    room: (N,) from any contact to its pad's edge, the least on the way (m). spin: (N,) the most (rad/s). normals:
    (N, T, 3 palms, 3) outward in the body where it was touched, every 20 ms, NaN after a move's end. A body that is no
    more between the palms has a force of −inf.
    """

    after: Bearings
    least_force: FloatArray
    room: FloatArray
    spin: FloatArray
    normals: FloatArray


class BodyPredictor:
    """Rolls the model forward, of a body with parameters p of `model.three_palms`; holds the kernel's memory."""

    def __init__(self, p: FloatArray, rig: ThreePalmsRig, *, rough: bool = False) -> None:
        """Takes a minute when its C has to be compiled first.

        rough: four times as quick, by the outline as far as `ROUGH_ORDER` holds it and in longer steps.
        """
        self._order = min(_order(p), ROUGH_ORDER) if rough else _order(p)
        self.rig, self._step_s = rig, ROUGH_STEP_S if rough else STEP_S
        sizes = (9, 3, MOVE_INPUTS, count(self._order) + BODY)
        self._R, self._omega, self._move, self._p = (np.zeros((COLUMNS, size)) for size in sizes)
        self._R_after, self._omega_after, self._told = (np.zeros((COLUMNS, size)) for size in (9, 3, TOLD))
        self.learn(p)
        inputs = [self._R, self._omega, self._move, self._p, rig.acting]
        outputs = [self._R_after, self._omega_after, self._told]
        self._step = body_rollout.library(self._order, self._step_s).bind("step_columns", inputs, outputs)

    def learn(self, p: FloatArray) -> None:
        """Go by these parameters from now on, as far as its outline goes."""
        assert _order(p) >= self._order, "other parameters than those of the model"
        self._known = self._as_far(p)

    @property
    def known(self) -> FloatArray:
        """The parameters that it goes by."""
        return self._known

    def _as_far(self, p: FloatArray) -> FloatArray:
        return np.concatenate([p[..., : count(self._order)], p[..., -BODY:]], axis=-1)

    def of(
        self, begin: Bearings, ends: FloatArray, durations: FloatArray, elapsed: float = 0.0, stand: float = 0.0,
        p: FloatArray | None = None,
    ) -> PredictedMoves:  # fmt: skip
        """Of N moves, `COLUMNS` at most, from rest at `begin.joints` to rest at `ends` (N, 3) (rad); durations in s.

        elapsed: for how long they have been under way when the body is so (s). stand: what the palms stand after (s).
        p: parameters to go by this time, of all (m,) or of each (N, m), as far as its outline goes.
        """
        n = len(ends)
        steps = np.maximum(np.ceil((durations - elapsed + stand) / self._step_s - 1e-9).astype(np.intp), 1)
        longest = np.argsort(-steps, kind="stable")  # first, so that columns which have ended need not go on
        self._R[:n] = np.swapaxes(begin.R, 1, 2).reshape(-1, 9)[longest]
        self._omega[:n] = begin.omega[longest]
        self._move[:n] = np.column_stack([begin.joints, ends, durations, np.full(n, elapsed)])[longest]
        self._p[:n] = np.broadcast_to(self._known if p is None else self._as_far(p), self._p[:n].shape)[longest]
        for each in (self._R, self._omega, self._move, self._p):
            each[n:] = each[0]
        last = int(steps.max())
        turned, spun, path = (np.empty((last, n, size)) for size in (9, 3, TOLD))
        going = (steps > np.arange(last)[:, None]).sum(axis=1)
        for k, columns in enumerate((-(-going // LANES) * LANES).tolist()):
            self._step(columns)
            self._R[:], self._omega[:] = self._R_after, self._omega_after
            self._move[:, 7] += self._step_s
            turned[k, longest], spun[k, longest], path[k, longest] = self._R[:n], self._omega[:n], self._told[:n]
        over = np.arange(last)[:, None] >= steps
        path[over] = np.nan
        spin = np.where(over, 0.0, np.linalg.norm(spun, axis=2)).max(axis=0)
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
    """The degree of the outline that these are parameters of."""
    order = order_of(len(p) - BODY)
    assert len(p) == count(order) + BODY, "other parameters than those of the model"
    return order
