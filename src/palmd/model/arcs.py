"""Contacts of an object on curved palms for many poses at once, in NumPy; `model.touch` does one pose in a kernel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palmd.events import FloatArray
from palmd.model.shape import basis, harmonic_of_coefficient, tangential_basis
from palmd.model.touch import LEAST_CURVATURE_MARGIN
from palmd.system.arcs import FLAT, tangents
from palmd.system.mechanism import OPENING, normal_directions

STEPS = 8


def contacts_on_arcs(
    coefficients: FloatArray,
    first: FloatArray,
    opening: FloatArray,
    psi: FloatArray,
    curvatures: Sequence[float] = FLAT,
) -> FloatArray:
    """Return s of both contacts (m), (2, n), of an outline in n poses on palms at these joint angles (rad).

    Accurate where 1 − κv > `LEAST_CURVATURE_MARGIN`.
    """
    order = (len(coefficients) - 1) // 2
    curvature_radius = coefficients * (1 - harmonic_of_coefficient(order) ** 2)
    kappa = np.asarray(curvatures)[:, None]
    s = np.zeros((2, len(psi)))
    for _ in range(STEPS if kappa.any() else 1):
        joints = tangents((first, opening), s, curvatures)
        theta, beta = normal_directions(joints, psi), joints[OPENING]
        r, (before, after), v = (
            np.stack([rows @ weights for rows in (rows_of(angle, order) for angle in theta)])
            for rows_of, weights in (
                (basis, coefficients),
                (tangential_basis, coefficients),
                (basis, curvature_radius),
            )
        )
        above = r - kappa / 2 * (s * np.sinc(kappa * s / (2 * np.pi))) ** 2
        along = (above * np.cos(beta) + above[::-1]) / np.sin(beta) + [-before, after]
        s += (along - s * np.sinc(kappa * s / np.pi)) / np.maximum(1 - kappa * v, LEAST_CURVATURE_MARGIN)
    return s


def touched_normals(
    coefficients: FloatArray,
    first: FloatArray,
    opening: FloatArray,
    psi: FloatArray,
    curvatures: Sequence[float] = FLAT,
) -> tuple[FloatArray, ...]:
    """Return θ1, θ2 (rad), the object's outward normals at both contacts; not wrapped."""
    joints: tuple[FloatArray, ...] = (first, opening)
    if any(curvatures):
        joints = tangents(joints, contacts_on_arcs(coefficients, first, opening, psi, curvatures), curvatures)
    return normal_directions(joints, psi)
