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
from enum import IntEnum

import numpy as np

from palmd.console.columns import aligned
from palmd.events import FloatArray
from palmd.model.pivot import BATCH, CONSTANTS, INPUTS, MOTION, ORDER, P, U, library
from palmd.model.shape import coefficients_of, gauge_free_basis, prior_sd
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

_BIN = math.tau / 72


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
    Sweep("height held", sides=(1.0,), held=True),
    Sweep("one side", sides=(1.0,)),
    Sweep("both sides"),
    Sweep("both, twice as fast", seconds=SIDE_S / 2),
    Sweep("both, shaken along the pad", shake=1.5e-3),
    Sweep("both, near the dead centres", 0.06, 0.06),
    Sweep("both, up to them", 0.02, 0.02),
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
class ToldByMotion:
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
    p[P.TRANSMISSION] = 1.0
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


def told(body: Held, sweep: Sweep) -> ToldByMotion:
    """What the motion tells of the body."""
    p = body.constants
    psi, u = _motion(body, sweep)
    theta = -0.5 * math.pi - psi
    e, z = _derivative(p[_SHAPE], theta, 1), _derivative(p[_SHAPE], theta, 0)
    by_s, by_force = _weighed(p, psi, u)
    values = np.asarray(np.linalg.svd(by_s[:, Y.SHAPE :] * 1e-4, compute_uv=False), dtype=np.float64)
    outline, moment = _gauge_free(p, theta[:: max(1, len(theta) // 200)])
    alone, both = (_covariance(each, p) for each in (by_s, np.concatenate([by_s, by_force])))
    sd = np.sqrt(np.diag(both))
    return ToldByMotion(
        len(np.unique(np.floor(np.mod(theta, math.tau) / _BIN))) * _BIN / math.tau,
        int((values > RANK_TOLERANCE * values[0]).sum()), 2 * ORDER, values,
        _rms_sd(alone, outline), _rms_sd(both, outline), math.sqrt(2) * _rms_sd(both, moment) / MASS_KG,
        float(sd[Y.INERTIA] / p[P.INERTIA]), float(sd[Y.MU]), float((np.abs(e) - MU * z).min()),
    )  # fmt: skip


def mass_null(body: Held, sweep: Sweep) -> tuple[float, FloatArray]:
    """(smallest over largest singular value, its direction) of the forces in ln (m, |b|, k², c), I = m k², M = m b.

    b: from the centre of mass to the pivot, in its direction; c: damping per mass. The direction has m's share as 1.
    """
    p = body.constants
    psi, u = _motion(body, sweep)
    by_force = _weighed(p, psi, u)[1][:, : Y.MU] * p[: P.DAMPING + 1]  # in ln I, M's components, ln C
    by_moment = by_force[:, Y.MOMENT] + by_force[:, Y.MOMENT + 1]
    by_inertia, by_damping = by_force[:, Y.INERTIA], by_force[:, Y.DAMPING]
    by_mass = by_inertia + by_moment + by_damping
    gradients = np.stack([by_mass, by_moment, by_inertia, by_damping], axis=1)
    _, values, directions = np.linalg.svd(gradients, full_matrices=False)
    return float(values[-1] / values[0]), np.asarray(directions[-1] / directions[-1][0])


class Y(IntEnum):
    """Index of each thing to be known: of `P` the body's, friction as μ and ln u_d, and the outline."""

    INERTIA = 0
    MOMENT = 1
    DAMPING = 3
    MU = 4
    LN_DITHER = 5
    SHAPE = 6


def _motion(body: Held, sweep: Sweep) -> tuple[FloatArray, FloatArray]:
    """ψ (n,) (rad) and the kernels' inputs (n, 9) at each reading."""
    outline = body.constants[_SHAPE]
    low, high = (float(_derivative(outline, np.array([at]), 0)[0]) for at in (body.bottom, body.top))
    begin, end = high - sweep.short_of_top * (high - low), low + sweep.short_of_bottom * (high - low)
    t = np.arange(0.0, sweep.seconds, READING_S * sweep.seconds / SIDE_S)
    half = sweep.seconds / 2
    there, back = _eased(t / half), _eased((t - half) / half)
    # first down, then up again: W, Ẇ, Ẅ of the way down
    way = [down - up for down, up in zip(there, back, strict=True)]
    z = [begin + (end - begin) * way[0], (end - begin) * way[1] / half, (end - begin) * way[2] / half**2]
    if sweep.held:
        z = [np.full(len(t), (low + high) / 2), 0 * t, 0 * t]
    x = [_BEGIN_M + _DRAGGED_M * way[0], _DRAGGED_M * way[1] / half, _DRAGGED_M * way[2] / half**2]
    k = math.tau * _SHAKE_HZ
    for order, wave in enumerate((np.sin(k * t), k * np.cos(k * t), -(k**2) * np.sin(k * t))):
        x[order] = x[order] + sweep.shake * wave
    psi, u = [], []
    for side in sweep.sides:
        # friction trails behind the contact (u·e < 0): the arm goes the other way than the contact lies
        inputs = np.zeros((len(t), INPUTS))
        for index, value in zip((U.X, U.VX, U.AX), x, strict=True):
            inputs[:, index] = -side * value
        inputs[:, [U.Z, U.VZ, U.AZ]] = np.stack(z, axis=1)
        inputs[:, U.GRAVITY] = GRAVITY_M_S2
        psi.append(-0.5 * math.pi - _at_height(outline, body, side, z[0]))
        u.append(inputs)
    return np.concatenate(psi), np.concatenate(u)


def _at_height(outline: FloatArray, body: Held, side: float, z: FloatArray) -> FloatArray:
    """θ (rad) at which h_P = z, on the side on which h_P′ has this sign."""
    top = body.bottom + side * np.mod(side * (body.top - body.bottom), math.tau)
    low, high = np.full(len(z), body.bottom), np.full(len(z), top)
    for _ in range(60):
        middle = (low + high) / 2
        above = _derivative(outline, middle, 0) > z
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray((low + high) / 2)


def _turning(outline: FloatArray, psi: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 3) ψ, ω0, α0 of an outline held at the given heights, and (n, 3, 21) what its coefficients do to them.

    z = h_P(−π/2 − ψ), ω0 = −ż/h_P′, α0 = (h_P″ω0² − z̈)/h_P′, differentiated once more.
    """
    rows = [_basis(-0.5 * math.pi - psi, order) for order in range(4)]
    e, bend, third = (each @ outline for each in rows[1:])
    omega0 = -u[:, U.VZ] / e
    alpha0 = (bend * omega0**2 - u[:, U.AZ]) / e
    by_psi = rows[0] / e[:, None]  # and θ by as much less
    by_e, by_bend = rows[1] - bend[:, None] * by_psi, rows[2] - third[:, None] * by_psi
    by_omega0 = (u[:, U.VZ] / e**2)[:, None] * by_e
    by_alpha0 = (omega0**2 / e)[:, None] * by_bend + (2 * bend * omega0 / e)[:, None] * by_omega0
    by_alpha0 -= (alpha0 / e)[:, None] * by_e
    return np.stack([psi, omega0, alpha0], axis=1), np.stack([by_psi, by_omega0, by_alpha0], axis=1)


def _weighed(p: FloatArray, psi: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gradients of the readings s and of the forces in `Y`, over their noise, (n, 27) each."""
    motion, by_shape = _turning(p[_SHAPE], psi, u)
    told = []
    for name in ("reading", "rigid_force"):
        value, gradient = _kernel(name, motion, p, u)
        own = gradient[:, MOTION:]
        rows = np.zeros((len(psi), len(_believed(p))))
        rows[:, : Y.MU] = own[:, : P.DAMPING + 1]
        rows[:, Y.MU] = own[:, P.DRAG] / DITHER_M_S
        rows[:, Y.LN_DITHER] = -own[:, P.DRAG] * p[P.DRAG] - 2 * own[:, P.SATURATION] * p[P.SATURATION]
        rows[:, Y.SHAPE :] = own[:, _SHAPE] + (gradient[:, :MOTION, None] * by_shape).sum(axis=1)
        if name == "reading":
            theta = -0.5 * math.pi - motion[:, 0]
            by_height = _derivative(p[_SHAPE], theta, 2) / _derivative(p[_SHAPE], theta, 1)
            sd = np.hypot(READING_SD_M, by_height * HEIGHT_SD_M)
        else:
            sd = np.hypot(FORCE_SHARE_SD * value, FORCE_SD_N)
        told.append(rows / sd[:, None])
    return told[0], told[1]


def _kernel(name: str, motion: FloatArray, p: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    n = -(-len(u) // BATCH) * BATCH
    x, inputs = (np.concatenate([each, np.repeat(each[-1:], n - len(each), axis=0)]) for each in (motion, u))
    value, gradient = np.zeros(n), np.zeros((n, MOTION + CONSTANTS))
    library().bind(f"{name}_batch", [np.ascontiguousarray(x), p, np.ascontiguousarray(inputs)], [value, gradient])()
    return value[: len(u)], gradient[: len(u)]


def _covariance(gradients: FloatArray, p: FloatArray) -> FloatArray:
    sd = _believed(p)
    scaled = gradients * sd
    return np.asarray(np.linalg.inv(scaled.T @ scaled + np.eye(len(sd))) * np.outer(sd, sd))


def _rms_sd(covariance: FloatArray, rows: FloatArray) -> float:
    return math.sqrt(float(np.mean(((rows @ covariance) * rows).sum(axis=1))))


def _gauge_free(p: FloatArray, touched: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows that map errors in `Y` to those of h_P on the normals `touched`, and of M, after the best rotation."""
    outline, moment = np.zeros((len(touched), len(_believed(p)))), np.zeros((2, len(_believed(p))))
    outline[:, Y.SHAPE :] = gauge_free_basis(touched, touched, p[_SHAPE])
    slope = _derivative(p[_SHAPE], touched, 1)
    mx, my = p[P.MOMENT : P.MOMENT + 2]
    moment[:, Y.MOMENT : Y.DAMPING] = np.eye(2)
    moment[:, Y.SHAPE :] = np.outer([-my, mx], slope @ _basis(touched, 0) / (slope @ slope))
    return outline, moment


def _believed(p: FloatArray) -> FloatArray:
    """One-sigma of `Y` beforehand: hardly anything."""
    mean = float(p[P.SHAPE])
    shape = prior_sd(mean, ORDER)
    shape[0], shape[1:3] = 0.2 * mean, 1.2 * PIVOT_M  # the first harmonic is where the pivot lies
    own = [p[P.INERTIA], 0.01 * MASS_KG, 0.01 * MASS_KG, 10 * p[P.DAMPING], 0.2, 0.5]
    return np.concatenate([own, shape])


def _derivative(outline: FloatArray, theta: FloatArray, order: int) -> FloatArray:
    """h_P (order 0) or a derivative of it in θ."""
    return np.asarray(_basis(theta, order) @ outline)


def _basis(theta: FloatArray, order: int) -> FloatArray:
    """(n, 21): by how much each coefficient enters."""
    k = np.arange(1, ORDER + 1)
    angles = np.multiply.outer(theta, k) + order * math.pi / 2
    rows = np.full((len(theta), 2 * ORDER + 1), float(order == 0))
    rows[:, 1::2], rows[:, 2::2] = k**order * np.cos(angles), k**order * np.sin(angles)
    return rows


def _eased(u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The smooth step on 0…1, its first and second derivative."""
    u = np.clip(u, 0.0, 1.0)
    return (
        u**3 * (10.0 - 15.0 * u + 6.0 * u * u),
        30.0 * u * u * (1.0 - u) ** 2,
        60.0 * u * (1.0 - u) * (1.0 - 2.0 * u),
    )


def table(rows: Sequence[Sequence[ToldByMotion]]) -> str:
    """A line a sweep of `SWEEPS`, `rows` in that order: medians over the bodies."""
    head = ("touched", "rank by s", "sigma most", "least", "h by s, µm", "h, µm", "M/m, µm", "I, %", "µ", "e − µz, mm")
    lines = [("", head), *((sweep.name, _cells(some)) for sweep, some in zip(SWEEPS, rows, strict=True))]
    return aligned(lines)


_SDS: tuple[Callable[[ToldByMotion], float], ...] = (
    lambda each: each.h_by_s,
    lambda each: each.h,
    lambda each: each.moment,
)


def _cells(some: Sequence[ToldByMotion]) -> tuple[str, ...]:
    def middle(value: Callable[[ToldByMotion], float]) -> float:
        return float(np.median([value(each) for each in some]))

    rank = middle(lambda each: each.rank)
    return (
        f"{middle(lambda each: each.touched):.2f}",
        f"{rank:.0f} of {some[0].of}",
        f"{middle(lambda each: each.values[0]):.0e}",
        f"{middle(lambda each: each.values[each.of - 1]):.0e}",
        *(["–"] * 3 if rank == 1 else [f"{middle(of) * 1e6:.0f}" for of in _SDS]),
        f"{middle(lambda each: each.inertia) * 1e2:.0f}",
        f"{middle(lambda each: each.mu):.4f}",
        f"{min(each.room for each in some) * 1e3:.1f}",
    )
