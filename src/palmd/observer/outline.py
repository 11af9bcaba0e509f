"""Outlines with error bands from Fourier coefficients and their covariance. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model import shape
from palmd.model.arcs import touched_normals
from palmd.model.outputs import CURVATURE_INPUTS
from palmd.observer.cutoff import cut_off
from palmd.observer.record import Record
from palmd.system.mechanism import JOINTS, normal_directions

DIRECTIONS = 360
HOLLOW_M = 1e-6  # least v = h + h″ (negative) with which an outline still counts as convex
MOST_CUTS = 200


@dataclass(frozen=True, slots=True)
class OutlineEstimate:
    """Support function h and its 1σ (m) on normals theta (rad); `touched`: by a palm."""

    theta: FloatArray
    h: FloatArray
    h_sd: FloatArray
    touched: npt.NDArray[np.bool_]


def directions() -> FloatArray:
    """The normals of every reconstructed outline: each degree, from 0."""
    return np.arange(DIRECTIONS, dtype=np.float64) * (math.tau / DIRECTIONS)


def normal_angles(palms: FloatArray, psi: FloatArray) -> FloatArray:
    """θ1, θ2 (3.1) for palms (n, ≥ 2) holding φ1, φ2 and orientations psi (n): (n, 2), not wrapped."""
    return np.stack(normal_directions(palms[:, : len(JOINTS)].T, psi), axis=1)


def wrapped(angles: FloatArray) -> FloatArray:
    """The angles (rad), wrapped to within half a turn of 0."""
    within: FloatArray = angles - math.tau * np.round(angles / math.tau)
    return within


def contact_normals(record: Record, psi: FloatArray, coefficients: FloatArray) -> FloatArray:
    """θ1, θ2 at a record's nodes (n, 2); on curved palms they depend on the outline."""
    joints = record.palms[:, : len(JOINTS)].T
    normals = touched_normals(coefficients, joints[0], joints[1], psi, record.rig[CURVATURE_INPUTS].tolist())
    return np.stack(normals, axis=1)


def outline_of(coefficients: FloatArray, covariance: FloatArray, normals: Sequence[FloatArray]) -> OutlineEstimate:
    """The outline on `directions`, touched where the `normals` went, with its gauge-free band.

    normals: of each uninterrupted time (n, 2), in order of time.
    """
    theta = directions()
    touched = np.logical_or.reduce([touched_by(each) for each in normals])
    h = shape.basis(theta, _order(coefficients)) @ coefficients
    return OutlineEstimate(theta, h, gauge_free_sd(theta, theta[touched], coefficients, covariance), touched)


def made_convex(x: FloatArray, P: FloatArray, at: slice) -> bool:
    """Condition a belief (mean x, covariance P, in place) on v = h + h″ ≥ 0 everywhere; part `at` of it is an outline.

    Returns whether the outline is convex then, to `HOLLOW_M`.
    """
    order = (len(x[at]) - 1) // 2
    rows = np.zeros((DIRECTIONS, len(x)))
    rows[:, at] = shape.basis(directions(), order) * (1.0 - shape.harmonic_of_coefficient(order) ** 2)
    for _ in range(MOST_CUTS):
        curvature = rows @ x
        if curvature.min() > -HOLLOW_M:
            return True
        if not cut_off(x, P, rows[int(curvature.argmin())]):
            break
    return False


def gauge_free_sd(
    theta: FloatArray, touched: FloatArray, coefficients: FloatArray, covariance: FloatArray
) -> FloatArray:
    """1σ of h (m) on normals `theta`, with the orientation free; `touched`: normals (rad) that fix it.

    Orientation is gauge: the band is that of h after the rotation that fits the touched part best, so that it does not
    include the error of ψ(0): h(θ) − h′(θ)·ε, with ε the least-squares rotation over the touched normals.
    """
    return sd_of(shape.gauge_free_basis(theta, touched, coefficients), covariance)


def sd_of(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """1σ of rows · x (n,), from rows (n, k) and the covariance of x (k, k)."""
    variance: FloatArray = ((rows @ covariance) * rows).sum(axis=1)
    return np.sqrt(np.maximum(variance, 0.0))


def rms_sd(sd: FloatArray, touched: npt.NDArray[np.bool_]) -> float:
    """RMS 1σ (m) of h over the normals touched."""
    return float(np.sqrt(np.mean(sd[touched] ** 2)))


def _order(coefficients: FloatArray) -> int:
    return (len(coefficients) - 1) // 2


def touched_by(normals: FloatArray) -> npt.NDArray[np.bool_]:
    """Which directions the normals passed; each direction stands for the degree about it."""
    touched = np.zeros(DIRECTIONS, dtype=np.bool_)
    nearest = np.round(normals * (DIRECTIONS / math.tau)).astype(np.intp)
    for column in nearest.T:
        for low, high in {*zip(*np.sort([column[:-1], column[1:]], axis=0).tolist(), strict=True)}:
            touched[np.arange(low, high + 1) % DIRECTIONS] = True
        touched[column % DIRECTIONS] = True
    return touched


def touched_within(record: Record, psi: FloatArray) -> npt.NDArray[np.bool_]:
    """Directions touched in a record's parts, without the ends of each part, next to which there are no readings."""
    parts = np.split(normal_angles(record.palms, psi), record.gap_steps + 1)
    touched: npt.NDArray[np.bool_] = np.logical_or.reduce([touched_by(part[1:-1]) for part in parts])
    return touched
