"""Stable poses of an object between palms that are arcs (docs/theory/curved.md).

Palms press along the normals of their tangents. So an object balances on arcs exactly where it would on flat palms
that coincide with the tangents, β1 and β2 in place of φ1 and φ12: d1 sin β2 + d2 sin β1 = 0 (3.23). Different are the
contacts' positions, which follow from the tangents without evaluating the outline again, and stability: when the object
turns a little while the palms stand, the tangents turn too.
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
    """Palms and contacts of poses in balance: φ1, φ2 (rad), s1, s2 (m), NaN for impossible palm poses.

    stable: whether the object returns after a small rotation.
    """

    phi1: FloatArray
    phi2: FloatArray
    s1: FloatArray
    s2: FloatArray
    stable: BoolArray


def on_arcs(contacts: TouchedPoint, beta1: FloatArray, opening: FloatArray, curvatures: Sequence[float]) -> OnArcs:
    """Return the palms whose tangents β1 and β2 = β1 + opening (…) (rad) touch an object, contacts from `touch`.

    Stable where d1 sin β2 + d2 sin β1 rises with ψ while the palms stand: β_i′ = κ_i (u_i − v_i)/(1 − κ_i v_i) with the
    slip per radian u = t·c′ + r, d_i′ = (v_i − r_i)(1 − β_i′). Never stable where κ_i v_i > `MOST_LYING`.
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
