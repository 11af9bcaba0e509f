"""Prior of an object before it is touched: a smooth body of unknown size, lying on two palms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray, PalmMotion
from palmd.model import shape, shape_map
from palmd.model.friction import SLOPE
from palmd.system.arcs import FLAT, circle_radius
from palmd.system.vibration import INDEPENDENT, LN_SPEED_SD, SPEED_M_S, Vibration

# Share of the prior's 1σ that scatters the filters' starts, and share that each filter keeps.
SCATTER = 0.7
OWN = 0.7

RADIUS_SD = 0.10  # relative, of the mean radius from the first two readings
SPIN_AT_REST_SD, SPIN_MOVING_SD = 0.25, 1.5  # rad/s
# A uniform convex body has ρ = 0.70…0.72 mean radii, a ring 1: most objects are near the first.
GYRATION, GYRATION_SD = 0.707, 0.04
FRICTION, FRICTION_SD = 0.10, 0.10
DITHER, LN_DITHER_SD = SPEED_M_S * SLOPE, LN_SPEED_SD  # m/s: u_d = πV/2 of an undescribed shaker
DAMPING, DAMPING_SD = 2e-4, 3e-4  # m²/s


@dataclass(frozen=True, slots=True)
class BlindStart:
    """Samples of the prior, one row a filter, and the 1σ that each filter keeps about its own sample."""

    mean_radius: float
    shape_sd: FloatArray  # of the whole prior, per coefficient
    coefficients: FloatArray
    omega0: FloatArray
    rho: FloatArray
    mu: FloatArray
    ln_dither: FloatArray
    damping: FloatArray
    own_shape_sd: FloatArray
    own_omega0_sd: float
    own_rho_sd: float
    own_mu_sd: float
    own_ln_dither_sd: float
    own_damping_sd: float


def ln_dither_of(vibration: Vibration) -> tuple[float, float]:
    """ln u_d (m/s), u_d = πV/2, and its 1σ."""
    ln_speed, sd = vibration.ln_speed
    return ln_speed + math.log(SLOPE), sd


def blind_start(
    contacts: Sequence[float],
    palms: PalmMotion,
    size: int,
    at_rest: bool,
    random: np.random.Generator,
    order: int = shape.HARMONICS,
    curvatures: Sequence[float] = FLAT,
    vibration: Vibration = INDEPENDENT,
) -> BlindStart:
    """Draw `size` starts about the circle that would give the readings `contacts` (m); outlines have `order` harmonics.

    at_rest: the object has just been put down; else it may be turning. Orientation is gauge: 0 at the start. curvatures
    (1/m), vibration: of the palms.
    """
    ln_dither, ln_dither_sd = ln_dither_of(vibration)
    mean_radius = circle_radius(palms.angles, contacts, curvatures)
    shape_sd = shape.prior_sd(mean_radius, order)
    shape_sd[0] = RADIUS_SD * mean_radius
    coefficients = SCATTER * shape_sd * random.standard_normal((size, len(shape_sd)))
    coefficients[:, 0] += mean_radius
    spin_sd = SPIN_AT_REST_SD if at_rest else SPIN_MOVING_SD
    return BlindStart(
        mean_radius=mean_radius,
        shape_sd=shape_sd,
        coefficients=coefficients,
        omega0=SCATTER * spin_sd * random.standard_normal(size),
        rho=GYRATION * coefficients[:, 0],
        mu=np.abs(FRICTION + SCATTER * FRICTION_SD * random.standard_normal(size)),
        ln_dither=np.full(size, ln_dither),
        damping=np.abs(DAMPING + SCATTER * DAMPING_SD * random.standard_normal(size)),
        own_shape_sd=OWN * shape_sd,
        own_omega0_sd=OWN * spin_sd,
        own_rho_sd=GYRATION_SD * GYRATION * mean_radius,
        own_mu_sd=OWN * FRICTION_SD,
        own_ln_dither_sd=ln_dither_sd,
        own_damping_sd=OWN * DAMPING_SD,
    )


def shape_map_sd(start: BlindStart) -> FloatArray:
    """1σ of each state of `model.shape_map` for a moving object before the first reading; ψ is gauge: 0."""
    Z = shape_map.Z
    sd = np.zeros(shape_map.N)
    sd[Z.OMEGA0], sd[Z.LN_RHO] = SPIN_MOVING_SD, math.hypot(GYRATION_SD, RADIUS_SD)
    sd[Z.MU], sd[Z.LN_DITHER], sd[Z.DAMPING] = FRICTION_SD, start.own_ln_dither_sd, DAMPING_SD
    sd[Z.SHAPE :] = start.shape_sd[: shape.COEFFICIENTS]
    return sd
