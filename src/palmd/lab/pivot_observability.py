"""What an object in a pivoting grasp, dragged over one pad, lets its readings tell: a question of CMU-CS-01-107.

A rigid gripper's height fixes the body's motion at each instant through the outline itself, z = h_P(θ) and θ̇ = ż/e
(docs/theory/pivot.md). So a reading's whole gradient in the constants is that of `model.pivot` and what the constants
do to ψ, ω0, α0 at the given height. The gradients along a motion span the observability codistribution; weighed with
noise and prior they give what may be known of the object, which are the figures of docs/theory/outlook.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from palmd.events import FloatArray
from palmd.lab.table import aligned
from palmd.model.pivot import BATCH, CONSTANTS, INPUTS, MOTION, ORDER, P, U, library
from palmd.model.shape import basis, coefficients_of, gauge_free_basis, harmonic_of_coefficient, prior_sd
from palmd.rig.shapes import random_body

GRAVITY_M_S2 = 9.81
PIVOT_M, MASS_KG, MU, DITHER_M_S, DAMPING_M2_S = 7.5e-3, 0.08, 0.1, 0.015, 2e-5
READING_S, READING_SD_M, HEIGHT_SD_M = 0.01, 1.1e-4, 2e-5
FORCE_SHARE_SD, FORCE_SD_N = 0.05, 0.006
SIDE_S, BODIES = 5.5, 8
RANK_TOLERANCE = 1e-9  # of the largest singular value; differences leave less
_STEP = 1e-6  # m, of the differences
_DRAGGED_M, _BEGIN_M = 0.02, 0.015
_NORMALS: FloatArray = np.arange(360, dtype=np.float64) * (math.tau / 360)
_SHAPE = slice(P.SHAPE, CONSTANTS)
_STREAM = 0x7069

Reading = Literal["s", "force"]


@dataclass(frozen=True, slots=True)
class Sweep:
    """A motion: how near to the dead centres each side is lowered (shares of the height's range), of one side or both.

    seconds: of a side. shake: of the arm along the pad (m). held: at one height instead, in the middle.
    """

    name: str
    short_of_top: float = 0.15
    short_of_bottom: float = 0.12
    sides: tuple[float, ...] = (1.0, -1.0)
    seconds: float = SIDE_S
    shake: float = 0.0
    held: bool = False


SWEEPS = (
    Sweep("height held", held=True),
    Sweep("one side", sides=(1.0,)),
    Sweep("both sides"),
    Sweep("both, twice as fast", seconds=SIDE_S / 2),
    Sweep("both, shaken along the pad", shake=1.5e-3),
    Sweep("both, near the dead centres", 0.02, 0.06),
    Sweep("both, far from them", 0.35, 0.35),
)
_SHAKE_HZ = 4.0


@dataclass(frozen=True, slots=True)
class Held:
    """A body in the gripper: the kernels' constants (33,), and θ at the lowest and highest h_P (rad), bottom first."""

    constants: FloatArray
    bottom: float
    top: float


@dataclass(frozen=True, slots=True)
class Told:
    """What one motion tells of one body.

    touched: share of the normals. rank, of: of the codistribution of the readings s, and how many directions there are
    but a common rotation. values: singular values of the readings' gradients in .1 mm of outline over their noise,
    largest first. h_by_s, h: one-sigma of the outline where touched (m), by s alone and with force. moment: of M/m (m);
    inertia: of I over I; mu. room: by how much |e| exceeds μz at least (m): below 0 the body wedges.
    """

    touched: float
    rank: int
    of: int
    values: FloatArray
    h_by_s: float
    h: float
    moment: float
    inertia: float
    mu: float
    room: float


def held(seed: int) -> Held | None:
    """A random body with its pivot 7.5 mm from the centre of mass; None where h_P has more dead centres than two."""
    random = np.random.default_rng([_STREAM, seed])
    body, angle = random_body("friction", random), float(random.uniform(0.0, math.tau))
    px, py = PIVOT_M * math.cos(angle), PIVOT_M * math.sin(angle)
    h = body.support.sample(_NORMALS) - px * np.cos(_NORMALS) - py * np.sin(_NORMALS)
    outline = coefficients_of(h, ORDER)
    p = np.zeros(CONSTANTS)
    p[P.INERTIA] = MASS_KG * (body.rho**2 + PIVOT_M**2)
    p[P.MOMENT : P.MOMENT + 2] = -MASS_KG * px, -MASS_KG * py
    p[P.DAMPING], p[P.MASS] = MASS_KG * DAMPING_M2_S, MASS_KG
    p[P.DRAG], p[P.SATURATION] = MU / DITHER_M_S, DITHER_M_S**-2
    p[_SHAPE] = outline
    slope = _derivative(outline, _NORMALS, 1)
    if (np.diff(np.sign(np.append(slope, slope[0]))) != 0).sum() != 2:
        return None
    value = _derivative(outline, _NORMALS, 0)
    return Held(p, float(_NORMALS[value.argmin()]), float(_NORMALS[value.argmax()]))


def bodies(count: int, seed: int) -> list[Held]:
    """So many, from that seed on."""
    found: list[Held] = []
    while len(found) < count:
        body, seed = held(seed), seed + 1
        found += [] if body is None else [body]
    return found


def told(body: Held, sweep: Sweep) -> Told:
    """What the motion tells of the body."""
    psi, u = _motion(body, sweep)
    p = body.constants
    values, gradients = _readings(p, psi, u)
    s_sd, force_sd = _noise(p, psi, values["force"])
    by_s, by_force = gradients["s"] / s_sd[:, None], gradients["force"] / force_sd[:, None]
    theta = -0.5 * math.pi - psi
    touched = np.unique(np.floor(np.mod(theta, math.tau) / (math.tau / 72)))
    shape_alone = np.linalg.svd(by_s[:, _SHAPE] * 1e-4, compute_uv=False)
    spread = _prior(p)
    some = theta[:: max(1, len(theta) // 200)]
    rows = gauge_free_basis(some, some, p[_SHAPE])
    alone, both = (_covariance(J, spread) for J in (by_s, np.concatenate([by_s, by_force])))
    e, z = _derivative(p[_SHAPE], theta, 1), _derivative(p[_SHAPE], theta, 0)
    mu_row = np.zeros(len(spread.names))
    mu_row[spread.names.index("mu")] = 1.0
    return Told(
        len(touched) / 72, int((shape_alone > RANK_TOLERANCE * shape_alone[0]).sum()), 2 * ORDER, shape_alone,
        _outline_sd(alone, rows, spread), _outline_sd(both, rows, spread),
        float(np.sqrt(both[1, 1] + both[2, 2])) / MASS_KG, float(np.sqrt(both[0, 0])) / float(p[P.INERTIA]),
        float(np.sqrt(mu_row @ both @ mu_row)), float((np.abs(e) - MU * z).min()),
    )  # fmt: skip
