"""Where an object touches curved palms, in arrays: many poses at once, as `model.touch` finds one in a kernel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palmd.events import FloatArray
from palmd.model.shape import basis, harmonic_of_coefficient, tangential_basis
from palmd.model.touch import LEAST_SLACK
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
    """s of both contacts (m), (2, n), of an outline in n poses on palms at these joint angles (rad).

    As good as `LEAST_SLACK` < 1 − κv.
    """
    order = (len(coefficients) - 1) // 2
    bent = coefficients * (1 - harmonic_of_coefficient(order) ** 2)
    kappa = np.asarray(curvatures)[:, None]
    s = np.zeros((2, len(psi)))
    for _ in range(STEPS if kappa.any() else 1):
        joints = tangents((first, opening), s, curvatures)
        theta, beta = normal_directions(joints, psi), joints[OPENING]
        r, (before, after), v = (
            np.stack([rows @ of for rows in (each(angle, order) for angle in theta)])
            for each, of in ((basis, coefficients), (tangential_basis, coefficients), (basis, bent))
        )
        above = r - kappa / 2 * (s * np.sinc(kappa * s / (2 * np.pi))) ** 2
        along = (above * np.cos(beta) + above[::-1]) / np.sin(beta) + [-before, after]
        s += (along - s * np.sinc(kappa * s / np.pi)) / np.maximum(1 - kappa * v, LEAST_SLACK)
    return s


def touched_normals(
    coefficients: FloatArray,
    first: FloatArray,
    opening: FloatArray,
    psi: FloatArray,
    curvatures: Sequence[float] = FLAT,
) -> tuple[FloatArray, ...]:
    """θ1, θ2 (rad): the outward normals at the contacts, those of the palms' tangents there; not wrapped."""
    joints: tuple[FloatArray, ...] = (first, opening)
    if any(curvatures):
        joints = tangents(joints, contacts_on_arcs(coefficients, first, opening, psi, curvatures), curvatures)
    return normal_directions(joints, psi)
