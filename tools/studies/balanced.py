"""Runs as the paper simulates them (CMU-CS-01-107, section 3.4): an object that is always in balance, felt exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from palmd.events import FloatArray
from palmd.model import quasistatic as qs
from palmd.model.stable_poses import TouchedPoint, follow, touch


@dataclass(frozen=True, slots=True)
class BalancedRun:
    """Times t (s), palm angles and ψ (rad) along a run, both contacts, and what is felt, rates included: n instants."""

    t: FloatArray
    phi1: FloatArray
    phi2: FloatArray
    psi: FloatArray
    contacts: TouchedPoint
    felt: tuple[qs.QuasistaticReadings, ...]
    jumps: int


def balanced_run(
    coefficients: FloatArray, psi: float, t: FloatArray, phi1: FloatArray, phi2: FloatArray
) -> BalancedRun:
    """The object with this outline (m, about its centre of mass) put down near `psi` (rad), palms on a path (n).

    Rates are those of cubic splines through the exact values. Raises ValueError as `model.stable_poses.follow` does.
    """
    followed = follow(coefficients, np.array([psi]), phi1, phi2)
    turned = followed.psi[:, 0]
    contacts = touch(coefficients, phi1, phi2, turned)
    values = np.stack([contacts.s1, contacts.s2, phi1, phi2])
    rates = CubicSpline(t, values, axis=1)(t, 1)
    felt = tuple(qs.QuasistaticReadings(*column) for column in np.concatenate([values, rates]).T.tolist())
    return BalancedRun(t, phi1, phi2, turned, contacts, felt, int(followed.jumped.sum()))


def eased_path(t: FloatArray, corners: FloatArray) -> FloatArray:
    """A path (n, k) through `corners` (m, k) in equal times, at rest in each: minimum jerk between them."""
    u = np.clip((t - t[0]) / (t[-1] - t[0]) * (len(corners) - 1), 0.0, len(corners) - 1)
    leg = np.minimum(u.astype(np.intp), len(corners) - 2)
    w = (u - leg)[:, None]
    path: FloatArray = corners[leg] + (corners[leg + 1] - corners[leg]) * w**3 * (10 - 15 * w + 6 * w**2)
    return path
