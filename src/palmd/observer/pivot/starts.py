"""Where a fit of a pivoting grasp begins: orientation from readings alone, then everything linear by least squares.

Rigid gripper: on one side of the dead centre the locus (z, e) is a curve e(z), and dθ = dz/e makes the outline of it;
how the sides are turned against each other is tried all round, judged by the outline that must close and by the force,
which sees one centre of mass. Slide: the body rolls but for the slip that its lever e needs.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import BSpline

from palmd.events import FloatArray
from palmd.model import shape
from palmd.model.friction import mean_direction
from palmd.model.pivot import CONSTANTS, KINK, ORDER, P, U
from palmd.observer.pivot.fit import CENTRE_SD_M, GYRATION, Known
from palmd.observer.pivot.record import PivotRecord, TouchSpan
from palmd.system.pivot import PivotRig
from palmd.system.vibration import Vibration

ROLLS = 4  # rounds of roll and outline
# One-sigma of a roll's rate, as a share of that without slip and at least (rad/s), and of a height's rate (m/s).
ROLL_SD, LEAST_RATE_SD, HEIGHT_RATE_SD = 0.3, 0.1, 5e-4
FELT_S = 0.05  # of a spline's cells through what a slide feels
POINTS = 100  # of each touch, that starts are judged by
LEAST_LEVER_M = 3e-4  # of e, for dz/e
ROTATIONS = 120
BEAMS = 5
LEAST_MASS_KG = 5e-3
LEAST_SD = 1e-9  # of a constant that is known
TRANSMISSION, TRANSMISSION_SD = (
    0.8,
    0.4,
)  # λ, where nobody knows it: 1 on a stiff pad, less on a light one on a load cell
# friction μ, vibration u_d (m/s) that are tried
FRICTIONS = {"rigid": (0.02, 0.06, 0.1, 0.15, 0.22, 0.32), "float": (0.2, 0.27, 0.33, 0.42, 0.6)}
DITHERS = {"rigid": (0.013,), "float": (0.008, 0.013, 0.02)}
_HEIGHT_SD, _LEVER_SD = 3e-5, 6e-5


@dataclass(frozen=True, slots=True)
class StartingPoint:
    """A point to begin at: coefficients of the splines, constants, and how bad it looks."""

    c: FloatArray
    p: FloatArray
    cost: float


def believed(record: PivotRecord) -> Known:
    """What is believed of any body, on this rig."""
    rig = record.rig
    rigid = rig.vertical == "rigid"
    radius = float(np.median(record.heights.value))
    mass = 0.1
    if not rigid and len(record.forces.value):
        mass = max(float(np.median(record.forces.value)) / rig.gravity - rig.carriage_mass, 0.01)
    mean, sd = np.zeros(CONSTANTS), np.zeros(CONSTANTS)
    # what most bodies are like is believed of moment, inertia and mass together (`likely_body`): here is nothing to add
    mean[P.INERTIA], sd[P.INERTIA] = mass * radius**2, 10 * mass * radius**2
    sd[P.MOMENT : P.MOMENT + 2] = 10 * mass * radius
    mean[P.DAMPING], sd[P.DAMPING] = 2e-6, 5e-6
    mean[P.MASS], sd[P.MASS] = mass, 2.0 * mass
    mean[P.DRAG], sd[P.DRAG] = (8.0, 12.0) if rigid else (25.0, 20.0)
    mean[P.SATURATION], sd[P.SATURATION] = 7e3, 6e3
    sd[P.ZERO : P.TRANSMISSION] = np.maximum(_constants_sd(rig), LEAST_SD)
    mean[P.TRANSMISSION], sd[P.TRANSMISSION] = _transmission(rig.vibration)
    if rigid:
        sd[P.STANDOFF] = LEAST_SD  # nothing tells it: `moved_by_rig` widens the band
    mean[P.SHAPE] = radius
    sd[P.SHAPE :] = shape.prior_sd(radius, ORDER)
    sd[P.SHAPE], sd[P.SHAPE + 1 : P.SHAPE + 3] = 0.4 * radius, 0.4 * radius  # the pivot may be anywhere in the body
    return Known(mean, sd)


def _constants_sd(rig: PivotRig) -> FloatArray:
    """In the order of `P`: zero, scale, lag, standoff, slope."""
    return np.array([rig.pad.zero_sd, rig.pad.scale_sd, rig.pad.lag_sd, rig.pad.standoff_sd, rig.angle_sd])


def _transmission(vibration: Vibration) -> tuple[float, float]:
    """What is believed of λ, and its one-sigma; there is none where the law has no ripple."""
    if vibration.law == "averaged":
        return 0.0, LEAST_SD
    if vibration.transmission is None:
        return TRANSMISSION, TRANSMISSION_SD
    return vibration.transmission, max(vibration.transmission_sd or 0.0, LEAST_SD)


# ---------------------------------------------------------------------------------------------------- rigid


@dataclass(frozen=True, slots=True)
class Side:
    """One touch by its locus: at times t, the normal θ (rad) from an open beginning, h, h′, and the motion.

    side: the sign of e. scatter: standard deviation of the readings about the locus, in sigmas of their noise.
    """

    touch: TouchSpan
    t: FloatArray
    theta: FloatArray
    h: FloatArray
    e: FloatArray
    rate: FloatArray  # of ψ
    second: FloatArray
    inputs: FloatArray
    force: FloatArray
    force_sd: FloatArray
    side: float
    scatter: float


def side_of(record: PivotRecord, touch: TouchSpan) -> Side:
    """The touch's locus, smoothed, and the outline that dθ = dz/e makes of it."""
    rows = record.readings
    mine = (rows.t >= touch.begin) & (rows.t <= touch.end)
    u = rows.inputs[mine]
    z, e = u[:, U.Z], rows.value[mine] - u[:, U.X]
    curve = _curve(z, e, math.sqrt(record.rig.pad.reading_variance), float(np.ptp(z)) / 14)
    side = float(np.sign(np.median(e))) or 1.0
    grid = np.linspace(z.min(), z.max(), 400)
    lever = side * np.maximum(side * curve(grid), LEAST_LEVER_M)
    slope = np.gradient(lever, grid)
    turned = cumulative_trapezoid(1.0 / lever, grid, initial=0.0)
    index = np.linspace(0, len(z) - 1, POINTS).astype(int)
    t, at = rows.t[mine][index], z[index]
    theta, e_at = np.interp(at, grid, turned), np.interp(at, grid, lever)
    vz, az = u[index, U.VZ], u[index, U.AZ]
    rate = -vz / e_at
    second = (e_at * np.interp(at, grid, slope) * rate**2 - az) / e_at
    spread = (e - curve(z)) / math.sqrt(record.rig.pad.reading_variance)
    scatter = 1.4826 * float(np.median(np.abs(spread)))
    forces = record.forces
    felt = (forces.t >= touch.begin) & (forces.t <= touch.end)
    force, force_sd = np.full(len(t), np.nan), np.full(len(t), np.inf)
    if felt.sum() >= 2:
        force = np.interp(t, forces.t[felt], _eased(forces.value[felt]))
        share = math.sqrt(min(len(t) / felt.sum(), 1.0))  # each point stands for several readings
        force_sd = np.interp(t, forces.t[felt], np.sqrt(forces.variance[felt])) * share
    return Side(touch, t, theta, at, e_at, rate, second, u[index], force, force_sd, side, scatter)


def _curve(x: FloatArray, y: FloatArray, noise: float, cell: float) -> BSpline:
    """y(x) through readings with outliers: a penalised cubic spline of such cells, its weights those of Huber."""
    low, high = float(x.min()), float(x.max())
    cells = max(math.ceil((high - low) / max(cell, 1e-9)), 1)
    step = max(high - low, 1e-9) / cells
    knots = low + step * np.arange(-3, cells + 4)
    A = BSpline.design_matrix(np.clip(x, low, high - 1e-12), knots, 3, extrapolate=True).toarray()
    bend = np.diff(np.eye(cells + 3), 3, axis=0)
    stiff = 0.5 * bend.T @ bend + 1e-9 * np.eye(cells + 3)
    weight = np.ones(len(x))
    coefficients = np.full(cells + 3, float(np.median(y)))
    for _ in range(6):
        W = A * weight[:, None]
        coefficients = np.linalg.solve(W.T @ A + stiff, W.T @ y)
        off = np.abs(y - A @ coefficients)
        scale = max(noise, 1.4826 * float(np.median(off)))
        weight = np.minimum(1.0, 2.0 * scale / np.maximum(off, 1e-12)) ** 2
    return BSpline(knots, coefficients, 3, extrapolate=True)


def _eased(values: FloatArray, reach: int = 3) -> FloatArray:
    """Medians of neighbours: a force without its outliers."""
    if len(values) <= 2 * reach:
        return values
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, reach, mode="edge"), 2 * reach + 1)
    return np.asarray(windows.mean(axis=1))


def rigid_starts(record: PivotRecord, known: Known, sides: Sequence[Side]) -> list[StartingPoint]:
    """The likeliest ways in which the sides may be turned against each other, the best first."""
    ordered = sorted(sides, key=lambda each: each.touch.begin - each.touch.end)
    beams: list[tuple[float, tuple[float, ...]]] = [(0.0, (0.0,))]
    for count in range(2, len(ordered) + 1):
        found: list[tuple[float, tuple[float, ...]]] = []
        for _, turns in beams:
            angles = np.linspace(0.0, math.tau, ROTATIONS, endpoint=False)
            # two sides meet nowhere, and the force says the most of how they belong; more of one side overlap
            judge = _judged if count == 2 else _joined
            costs = np.array([judge(ordered[:count], (*turns, a), known)[0] for a in angles])
            lowest = np.flatnonzero((costs < np.roll(costs, 1)) & (costs <= np.roll(costs, -1)))
            lowest = lowest[np.argsort(costs[lowest])][:BEAMS]
            tried = [(*turns, float(angles[i])) for i in lowest]
            found += [(_judged(ordered[:count], each, known)[0], each) for each in tried]
        beams = sorted(found)[:BEAMS]
    return [_rigid_start(record, ordered, turns, known) for _, turns in beams]


def _joined(sides: Sequence[Side], turns: Sequence[float], known: Known) -> tuple[float, FloatArray]:
    """(the cost of the outline alone of sides so turned, its coefficients)."""
    theta = np.concatenate([side.theta + turn for side, turn in zip(sides, turns, strict=True)])
    h, e = (np.concatenate([getattr(side, name) for side in sides]) for name in "he")
    return outline_through(theta, h, e, known)


def _judged(sides: Sequence[Side], turns: Sequence[float], known: Known) -> tuple[float, FloatArray]:
    """(the cost of sides so turned, the constants that fit them best)."""
    theta = np.concatenate([side.theta + turn for side, turn in zip(sides, turns, strict=True)])
    p = known.mean.copy()
    cost, p[P.SHAPE :] = _joined(sides, turns, known)
    force, p[: P.SHAPE] = _weighed(sides, theta, known)
    middle = p[P.SHAPE + 1 : P.SHAPE + 3]
    far = float(np.hypot(*middle))
    along = float(p[P.MOMENT : P.MOMENT + 2] @ middle) / max(far, 1e-4) ** 2  # the mass, were its centre the middle
    p[P.MASS] = max(along, LEAST_MASS_KG)
    across = p[P.MOMENT : P.MOMENT + 2] / p[P.MASS] - middle
    p[P.INERTIA] = p[P.MASS] * ((GYRATION * p[P.SHAPE]) ** 2 + far**2)
    return cost + force + float(np.minimum(across @ across / CENTRE_SD_M**2, 100.0)), p


def outline_through(
    theta: FloatArray, h: FloatArray, e: FloatArray, known: Known, share: float = 1.0
) -> tuple[float, FloatArray]:
    """(cost, coefficients) of the outline with these h and h′ (m) at normals θ; share: of a point's information."""
    mean, sd = known.mean[P.SHAPE :], known.sd[P.SHAPE :]
    A = np.concatenate([shape.basis(theta, ORDER) / _HEIGHT_SD, -shape.tangential_basis(theta, ORDER) / _LEVER_SD])
    y = np.concatenate([h / _HEIGHT_SD, e / _LEVER_SD])
    A, y = A * math.sqrt(share), y * math.sqrt(share)
    normal = A.T @ A + np.diag(1 / sd**2)
    coefficients = np.asarray(np.linalg.solve(normal, A.T @ y + mean / sd**2), dtype=np.float64)
    off, strain = A @ coefficients - y, (coefficients - mean) / sd
    return float(off @ off + strain @ strain), coefficients


def _weighed(sides: Sequence[Side], theta: FloatArray, known: Known) -> tuple[float, FloatArray]:
    """(cost, constants before the outline) of the forces, over the frictions that are tried."""
    rate, second, h, e, force, sd = (
        np.concatenate([getattr(side, name) for side in sides])
        for name in ("rate", "second", "h", "e", "force", "force_sd")
    )
    u = np.concatenate([side.inputs for side in sides])
    felt = np.isfinite(force) & (np.abs(e) > 2 * LEAST_LEVER_M)
    best, constants = math.inf, known.mean[: P.SHAPE].copy()
    if felt.sum() < 10:
        return 0.0, constants
    psi = -0.5 * math.pi - theta
    cos, sin, down, along = np.cos(psi), np.sin(psi), u[:, U.GRAVITY] + u[:, U.AZ], u[:, U.AX]
    columns = np.stack([second, cos * down - sin * along, -sin * down - cos * along, rate], axis=1)
    prior_mean, prior_sd = np.array([4e-5, 0.0, 0.0, 2e-6]), np.array([5e-5, 4e-3, 4e-3, 5e-6])
    slip = u[:, U.VX] + h * rate
    for mu, dither in itertools.product(FRICTIONS["rigid"], DITHERS["rigid"]):
        lever = _lever(e, h, slip, mu, dither, known.mean[P.TRANSMISSION])
        fine = felt & (lever * np.sign(e) > LEAST_LEVER_M)
        if fine.sum() < 0.8 * felt.sum():
            continue
        A = columns[fine] / (lever * sd)[fine, None]
        y = (force / sd)[fine]
        normal = A.T @ A + np.diag(1 / prior_sd**2)
        found = np.linalg.solve(normal, A.T @ y + prior_mean / prior_sd**2)
        off, strain = A @ found - y, (found - prior_mean) / prior_sd
        cost = float(np.minimum(off**2, 50.0).sum() + strain @ strain)
        if cost < best:
            best = cost
            constants[: P.MASS] = found
            constants[P.DRAG], constants[P.SATURATION] = mu / dither, 1 / dither**2
    return best, constants


def _lever(e: FloatArray, h: FloatArray, slip: FloatArray, mu: float, dither: float, transmission: float) -> FloatArray:
    """Of the pad's mean force about the pivot (m), as in `model.pivot`: by the old law where nothing is transmitted."""
    if not transmission:
        return e - mu * slip / np.hypot(slip, dither) * h
    sigma = mean_direction(math.pi / 2 * slip / dither, np, KINK)
    effective = (sigma * e + mu * h) / (e + sigma * mu * h)
    lever: FloatArray = e - mu * (sigma + transmission * (effective - sigma)) * h
    return lever


def _rigid_start(record: PivotRecord, sides: Sequence[Side], turns: Sequence[float], known: Known) -> StartingPoint:
    cost, p = _judged(sides, turns, known)
    paths = [(side.touch, side.t, side.theta + turn) for side, turn in zip(sides, turns, strict=True)]
    return _from_paths(record, paths, p, cost)


def _from_paths(
    record: PivotRecord, paths: Sequence[tuple[TouchSpan, FloatArray, FloatArray]], p: FloatArray, cost: float
) -> StartingPoint:
    """Splines through the paths of θ, everything turned so that ψ = 0 at the first reading."""
    c = np.zeros(record.coefficients)
    for touch, t, theta in paths:
        own = touch.through(t, -0.5 * math.pi - theta)
        c[touch.coefficients] = own
    turn = float(c[:3] @ np.array([1.0, 4.0, 1.0]) / 6)
    return StartingPoint(c - turn, turned(p, turn), cost)


def turned(p: FloatArray, turn: float) -> FloatArray:
    """The same body in a frame from which its orientations look smaller by `turn` (rad): ψ − turn."""
    p = p.copy()
    p[P.SHAPE :] = shape.turned(-turn, ORDER) @ p[P.SHAPE :]
    cos, sin = math.cos(turn), math.sin(turn)
    mx, my = p[P.MOMENT : P.MOMENT + 2]
    p[P.MOMENT : P.MOMENT + 2] = cos * mx - sin * my, sin * mx + cos * my
    return p


# ---------------------------------------------------------------------------------------------------- slide


def float_starts(record: PivotRecord, known: Known) -> list[StartingPoint]:
    """The likeliest rolls, one for each friction that is tried, the best first."""
    paths = [_felt(record, touch) for touch in record.touches]
    starts = [
        _rolled(record, paths, known, mu, dither)
        for mu, dither in itertools.product(FRICTIONS["float"], DITHERS["float"])
    ]
    return sorted(starts, key=lambda start: start.cost)[:BEAMS]


@dataclass(frozen=True, slots=True)
class _Felt:
    """A touch on an even grid: time, height and its rate, lever, and speed of the arm."""

    touch: TouchSpan
    t: FloatArray
    z: FloatArray
    vz: FloatArray
    e: FloatArray
    vx: FloatArray


def _felt(record: PivotRecord, touch: TouchSpan) -> _Felt:
    t = np.linspace(touch.begin, touch.end, max(int((touch.end - touch.begin) / 0.01), 10))
    smooth = []
    for rows, own in ((record.heights, 0), (record.readings, 1)):
        mine = (rows.t >= touch.begin) & (rows.t <= touch.end)
        value = rows.value[mine] - (rows.inputs[mine, U.X] if own else 0.0)
        value = _without_outliers(value, math.sqrt(float(rows.variance[mine].mean())))
        smooth.append(_curve(rows.t[mine], value, math.sqrt(float(rows.variance[mine].mean())), FELT_S))
    x = np.interp(t, record.readings.t, record.readings.inputs[:, U.VX])
    height, lever = smooth
    return _Felt(touch, t, height(t), height(t, 1), lever(t), x)


def _without_outliers(values: FloatArray, noise: float) -> FloatArray:
    """The values, each that is far from the median of its neighbours in its place."""
    reach = 5
    if len(values) <= 2 * reach:
        return values
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, reach, mode="edge"), 2 * reach + 1)
    median = np.median(windows, axis=1)
    cleaned: FloatArray = np.where(np.abs(values - median) > 6 * noise, median, values)
    return cleaned


def _rolled(record: PivotRecord, felt: Sequence[_Felt], known: Known, mu: float, dither: float) -> StartingPoint:
    """The roll with this friction; how far the body's weight is off the pivot comes from the outline so far."""
    z, e = np.concatenate([each.z for each in felt]), np.concatenate([each.e for each in felt])
    p = known.mean.copy()
    p[P.DRAG], p[P.SATURATION] = mu / dither, 1 / dither**2
    ends = np.cumsum([len(each.t) for each in felt])[:-1]
    weight = p[P.MASS] / (p[P.MASS] + record.rig.carriage_mass)
    averaged = record.rig.vibration.law == "averaged"
    off = np.zeros(len(e))  # from the pivot to the centre of mass along the pad
    best: StartingPoint | None = None
    for _ in range(ROLLS):
        paths = []
        for each, own in zip(felt, np.split(off, ends), strict=True):
            share = np.clip((each.e - weight * own) / (mu * each.z), -0.97, 0.97)  # of friction, that the lever needs
            slip = dither * (share / np.sqrt(1 - share**2) if averaged else 2 / math.pi * np.sin(math.pi / 2 * share))
            rolled = (each.vx - slip) / each.z
            # where the lever is long the height tells the rate too: dz = e dθ
            sure = (ROLL_SD * np.abs(each.vx) / each.z + LEAST_RATE_SD) ** 2 / HEIGHT_RATE_SD**2
            rate = (rolled + sure * each.e * each.vz) / (1 + sure * each.e**2)
            theta = cumulative_trapezoid(rate, each.t, initial=0.0)
            paths.append((each.touch, each.t, theta))
        theta = np.concatenate([path[2] for path in paths])
        cost, p[P.SHAPE :] = outline_through(theta, z, e, known)
        middle = p[P.SHAPE + 1 : P.SHAPE + 3]
        off = -np.sin(theta) * middle[0] + np.cos(theta) * middle[1]
        if best is None or cost < best.cost:
            p[P.MOMENT : P.MOMENT + 2] = p[P.MASS] * middle
            p[P.INERTIA] = p[P.MASS] * ((GYRATION * p[P.SHAPE]) ** 2 + middle @ middle)
            best = _from_paths(record, paths, p, cost)
    if best is None:
        raise ValueError("no roll was tried")
    return best
