"""How an object rests between palms that are arcs (docs/theory/curved.md).

Palms press along their tangents' normals. So an object balances on arcs exactly where it would on flat palms that lie
as the tangents do, β1 and β2 for φ1 and φ12: d1 sin β2 + d2 sin β1 = 0 (3.23). What is new is where the contacts are,
which follows from the tangents without the outline being read again, and what happens when the object turns a little:
the tangents turn as well, while the palms stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model.stable_poses import BoolArray, TouchedPoint
from palmd.system.arcs import MOST_LYING, arc_lengths


@dataclass(frozen=True, slots=True)
class OnArcs:
    """Where palms and contacts are for poses in balance: φ1, φ2 (rad), s1, s2 (m), NaN where palms cannot be so.

    stable: whether the object comes back when it is turned a little.
    """

    phi1: FloatArray
    phi2: FloatArray
    s1: FloatArray
    s2: FloatArray
    stable: BoolArray


def on_arcs(contacts: TouchedPoint, beta1: FloatArray, opening: FloatArray, curvatures: Sequence[float]) -> OnArcs:
    """The palms that touch an object with tangents at β1 and β2 = β1 + opening (…) (rad), contacts as `touch` has them.

    Stable where (d1 sin β2 + d2 sin β1) rises with ψ at standing palms: then β_i′ = κ_i (u_i − v_i)/(1 − κ_i v_i) with
    the slip u = t·c′ + r a radian, d_i′ = (v_i − r_i)(1 − β_i′). Beyond `MOST_LYING` nothing is.
    """
    r, d, v = (np.stack(each) for each in zip(*[(contacts.r1, contacts.d1, contacts.v1),
                                                (contacts.r2, contacts.d2, contacts.v2)], strict=True))  # fmt: skip
    kappa = np.array(curvatures).reshape(-1, *[1] * (r.ndim - 1))
    s1, s2 = s = arc_lengths(r, d, opening, curvatures)
    turn1, turn2 = kappa * s
    beta = np.stack([beta1, beta1 + opening])
    along = (d * np.cos(opening) + d[::-1]) / np.sin(opening) * np.array([1.0, -1.0]).reshape(kappa.shape)  # t·c′
    with np.errstate(divide="ignore", invalid="ignore"):
        turning = kappa * (along + r - v) / (1.0 - kappa * v)
        rise = (v - r) * (1.0 - turning) * np.sin(beta[::-1]) + d[::-1] * np.cos(beta) * turning
        stable = (rise.sum(axis=0) > 0.0) & (kappa * v < MOST_LYING).all(axis=0)
    return OnArcs(beta1 - turn1, opening + turn1 + turn2, s1, s2, np.asarray(stable))
