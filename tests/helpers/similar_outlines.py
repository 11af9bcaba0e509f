"""Libraries of similar outlines: variations of one body, each different from all the others."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray
from palmd.model import shape
from palmd.outlinefile import Outline
from palmd.rig.shapes import Body, Kind, Support, area_moments, random_body

LEAST_M, MOST_M = 0.3e-3, 1.0e-3
"""RMS over all normals between any two outlines after the best rotation."""

LEAST_CURVATURE_RADIUS_M = 2.5e-3
RADIUS_RANGE = 0.01  # of the mean radius, in both directions
H_SD_M = 20e-6
RHO_SD = 0.02  # relative
MASS_SD = 0.02
_VARIATION = {2: 0.30e-3, 3: 0.22e-3, 4: 0.15e-3, 5: 0.11e-3, 6: 0.07e-3}  # m, of each coefficient
_THETA: FloatArray = np.arange(360, dtype=np.float64) * (math.tau / 360)
_ROTATIONS = 3600


def difference(one: FloatArray, other: FloatArray) -> float:
    """RMS between two support functions on 360 normals after the best rotation (m), to 0.5 µm.

    Over rotations δ: mean of (h1(θ) − h2(θ + δ))² = mean h1² + mean h2² − 2·correlation(δ), by Fourier transforms.
    """
    spectrum = np.fft.rfft(one) * np.conj(np.fft.rfft(other)) / len(one)
    correlation = np.fft.irfft(spectrum, _ROTATIONS) * (_ROTATIONS / len(one))
    square = float(np.mean(one**2) + np.mean(other**2) - 2.0 * correlation.max())
    return math.sqrt(max(square, 0.0))


def similar_bodies(kind: Kind, count: int, rng: np.random.Generator) -> list[Body]:
    """Variations of one random body of the kind, with mutual differences from `LEAST_M` to `MOST_M`."""
    base = random_body(kind, rng)
    bodies: list[Body] = []
    outlines: list[FloatArray] = []
    while len(bodies) < count:
        support = _varied(_series(base), rng)
        rho = base.rho * area_moments(support)[3] / area_moments(_series(base))[3]
        body = Body(base.shape, support, rho, base.mass)
        h = support.sample(_THETA)
        convex = support.min_curvature_radius > LEAST_CURVATURE_RADIUS_M
        if convex and all(LEAST_M <= difference(h, other) <= MOST_M for other in outlines):
            bodies.append(body)
            outlines.append(h)
    return bodies


def _series(body: Body) -> Support:
    """The outline of a random body, which is always a Fourier series."""
    if not isinstance(body.support, Support):
        raise TypeError(f"the outline of a {body.shape} is not a Fourier series")
    return body.support


def _varied(base: Support, rng: np.random.Generator) -> Support:
    """The base with other harmonics; its centre of mass is unchanged."""
    c = list(base.coefficients)
    c[0] *= 1.0 + float(rng.uniform(-RADIUS_RANGE, RADIUS_RANGE))
    for k, sd in _VARIATION.items():
        c[k] += sd * complex(*rng.standard_normal(2))
    return Support.from_coefficients(tuple(c))


def as_stored(body: Body, name: str, rng: np.random.Generator) -> Outline:
    """The body as stored after an earlier measurement: errors are drawn with the stated 1σ."""
    sd = H_SD_M / math.sqrt(shape.HARMONICS + 1)
    error = shape.basis(_THETA) @ (sd * rng.standard_normal(shape.COEFFICIENTS))
    return Outline(
        name=name,
        h=body.support.sample(_THETA) + error,
        h_sd=np.full(360, H_SD_M),
        rho=body.rho * (1.0 + RHO_SD * float(rng.standard_normal())),
        rho_sd=RHO_SD * body.rho,
        mass=body.mass * (1.0 + MASS_SD * float(rng.standard_normal())),
        mass_sd=MASS_SD * body.mass,
    )
