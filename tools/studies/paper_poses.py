"""Objects in balance while the palms move slowly (CMU-CS-01-107, section 3.2): the pose along a path, and a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from palmd.events import FloatArray
from palmd.model.quasistatic import QuasistaticReadings
from palmd.model.stable_poses import BoolArray, TouchedPoint, basins, nearest_turn, touch

_STEP = 0.02  # rad; longest step along a path of the palms


@dataclass(frozen=True, slots=True)
class Followed:
    """The stable poses of an object along a path of P palm poses, for S starts.

    psi: (P, S), continuous except at jumps (rad). jumped: (P, S), True where the object's minimum has vanished since
    the previous pose.
    """

    psi: FloatArray
    jumped: BoolArray


def follow(coefficients: FloatArray, psi: FloatArray, phi1_path: FloatArray, phi2_path: FloatArray) -> Followed:
    """The object's poses from each of `psi` (S,) (rad) while the palms move slowly along a path of P poses (rad).

    It slides to a minimum at once, stays in it as the minimum moves, and slides to the next one if the minimum
    vanishes. The palms move linearly between the path's poses. Raises ValueError as `height_series` does, and if there
    is no minimum.
    """
    longest = np.maximum(np.abs(np.diff(phi1_path)), np.abs(np.diff(phi2_path)))
    steps = np.maximum(np.ceil(longest / _STEP), 1).astype(np.intp)
    ends = np.concatenate([[0], np.cumsum(steps)])
    fine = np.arange(ends[-1] + 1)
    path = basins(coefficients, np.interp(fine, ends, phi1_path), np.interp(fine, ends, phi2_path))
    if not path.count.all():
        raise ValueError("the object balances everywhere: it has no stable pose to follow")
    at = path.at((0,))
    now = nearest_turn(at.minima[at.index(psi)], psi)
    all_psi = np.empty((len(ends), len(psi)))
    jumped = np.zeros((len(ends), len(psi)), dtype=np.bool_)
    all_psi[0] = now
    for step, end in enumerate(steps):
        for i in range(ends[step] + 1, ends[step] + end + 1):
            before, at = at, path.at((i,))
            after = nearest_turn(at.minima[at.index(now)], now)
            jumped[step + 1] |= before.index(after) != before.index(now)
            now = after
        all_psi[step + 1] = now
    return Followed(all_psi, jumped)


@dataclass(frozen=True, slots=True)
class BalancedRun:
    """Times t (s), palm angles and ψ (rad) along a run, both contacts, and exact readings with rates: n instants."""

    t: FloatArray
    phi1: FloatArray
    phi2: FloatArray
    psi: FloatArray
    contacts: TouchedPoint
    readings: tuple[QuasistaticReadings, ...]
    jumps: int


def balanced_run(
    coefficients: FloatArray, psi: float, t: FloatArray, phi1: FloatArray, phi2: FloatArray
) -> BalancedRun:
    """The run of an outline (m, about its centre of mass) put down near `psi` (rad), for a path of the palms (n).

    Rates are those of cubic splines through the exact values. Raises ValueError as `follow` does.
    """
    followed = follow(coefficients, np.array([psi]), phi1, phi2)
    turned = followed.psi[:, 0]
    contacts = touch(coefficients, phi1, phi2, turned)
    values = np.stack([contacts.s1, contacts.s2, phi1, phi2])
    rates = CubicSpline(t, values, axis=1)(t, 1)
    readings = tuple(QuasistaticReadings(*column) for column in np.concatenate([values, rates]).T.tolist())
    return BalancedRun(t, phi1, phi2, turned, contacts, readings, int(followed.jumped.sum()))
