"""Initial guesses for fits of a pivoting grasp: orientation from the readings, then linear least squares.

Rigid gripper: on one side of the dead centre the locus (z, e) is a curve e(z), from which dθ = dz/e gives the outline.
The rotation between the two sides is searched over a full turn; a candidate is rated by how well a closed outline fits,
and by the forces, which depend on one centre of mass. Slide: the body rolls, with the slip that its lever e requires.
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
from palmd.observer.pivot.fit import CENTRE_SD_M, GYRATION, ConstantsPrior
from palmd.observer.pivot.record import PivotRecord, TouchSpan
from palmd.system.pivot import PivotRig
from palmd.system.vibration import Vibration

ROLLS = 4  # iterations of roll and outline
# 1σ of a roll's rate, relative to that without slip, and at least (rad/s); 1σ of a height's rate (m/s)
ROLL_SD, LEAST_RATE_SD, HEIGHT_RATE_SD = 0.3, 0.1, 5e-4
CONTACT_CELL_S = 0.05  # cell of the splines through a slide's readings
POINTS = 100  # points of each contact by which starts are rated
LEAST_LEVER_M = 3e-4  # least |e| in dz/e
ROTATIONS = 120  # rotations tried between two contacts
BEAMS = 5  # width of the beam search
LEAST_MASS_KG = 5e-3
LEAST_SD = 1e-9  # of a constant that is known exactly
# λ if it is not configured: 1 on a stiff pad, less on a light one on a load cell
TRANSMISSION, TRANSMISSION_SD = 0.8, 0.4
# friction μ and vibration u_d (m/s) that are tried
FRICTIONS = {"rigid": (0.02, 0.06, 0.1, 0.15, 0.22, 0.32), "float": (0.2, 0.27, 0.33, 0.42, 0.6)}
DITHERS = {"rigid": (0.013,), "float": (0.008, 0.013, 0.02)}
_HEIGHT_SD, _LEVER_SD = 3e-5, 6e-5


@dataclass(frozen=True, slots=True)
class StartingPoint:
    """Initial guess of a fit: coefficients of the splines, constants, and its cost."""

    c: FloatArray
    p: FloatArray
    cost: float


def prior_of(record: PivotRecord) -> ConstantsPrior:
    """Prior of the constants for any body on this rig."""
    rig = record.rig
    rigid = rig.vertical == "rigid"
    radius = float(np.median(record.heights.value))
    mass = 0.1
    if not rigid and len(record.forces.value):
        mass = max(float(np.median(record.forces.value)) / rig.gravity - rig.carriage_mass, 0.01)
    mean, sd = np.zeros(CONSTANTS), np.zeros(CONSTANTS)
    # wide priors: the joint prior of moment, inertia and mass is `body_prior_residuals`
    mean[P.INERTIA], sd[P.INERTIA] = mass * radius**2, 10 * mass * radius**2
    sd[P.MOMENT : P.MOMENT + 2] = 10 * mass * radius
    mean[P.DAMPING], sd[P.DAMPING] = 2e-6, 5e-6
    mean[P.MASS], sd[P.MASS] = mass, 2.0 * mass
    mean[P.DRAG], sd[P.DRAG] = (8.0, 12.0) if rigid else (25.0, 20.0)
    mean[P.SATURATION], sd[P.SATURATION] = 7e3, 6e3
    sd[P.ZERO : P.TRANSMISSION] = np.maximum(_constants_sd(rig), LEAST_SD)
    mean[P.TRANSMISSION], sd[P.TRANSMISSION] = _transmission(rig.vibration)
    if rigid:
        sd[P.STANDOFF] = LEAST_SD  # not observable: `rig_error_modes` adds its uncertainty
    mean[P.SHAPE] = radius
    sd[P.SHAPE :] = shape.prior_sd(radius, ORDER)
    sd[P.SHAPE], sd[P.SHAPE + 1 : P.SHAPE + 3] = 0.4 * radius, 0.4 * radius  # the pivot may be anywhere in the body
    return ConstantsPrior(mean, sd)


def _constants_sd(rig: PivotRig) -> FloatArray:
    """1σ of the rig's constants in the order of `P`: zero, scale, lag, standoff, slope."""
    return np.array([rig.pad.zero_sd, rig.pad.scale_sd, rig.pad.lag_sd, rig.pad.standoff_sd, rig.angle_sd])


def _transmission(vibration: Vibration) -> tuple[float, float]:
    """Prior mean and 1σ of λ; 0 in the averaged law, which has no ripple."""
    if vibration.law == "averaged":
        return 0.0, LEAST_SD
    if vibration.transmission is None:
        return TRANSMISSION, TRANSMISSION_SD
    return vibration.transmission, max(vibration.transmission_sd or 0.0, LEAST_SD)


# ---------------------------------------------------------------------------------------------------- rigid


@dataclass(frozen=True, slots=True)
class Side:
    """One contact described by its locus: at times t, the normal θ (rad) up to a constant, h, h′ = e, and the motion.

    side: the sign of e. scatter: standard deviation of the readings about the locus, in units of their noise.
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
    """Smooth a contact's locus, and integrate dθ = dz/e to its outline."""
    rows = record.readings
    mine = touch.contains(rows.t)
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
    with_force = touch.contains(forces.t)
    force, force_sd = np.full(len(t), np.nan), np.full(len(t), np.inf)
    if with_force.sum() >= 2:
        force = np.interp(t, forces.t[with_force], _running_mean(forces.value[with_force]))
        share = math.sqrt(min(len(t) / with_force.sum(), 1.0))  # each point represents several readings
        force_sd = np.interp(t, forces.t[with_force], np.sqrt(forces.variance[with_force])) * share
    return Side(touch, t, theta, at, e_at, rate, second, u[index], force, force_sd, side, scatter)


def _curve(x: FloatArray, y: FloatArray, noise: float, cell: float) -> BSpline:
    """Robust y(x) through readings with outliers: a penalised cubic spline with this cell, Huber-like weights."""
    low, high = float(x.min()), float(x.max())
    cells = max(math.ceil((high - low) / max(cell, 1e-9)), 1)
    step = max(high - low, 1e-9) / cells
    knots = low + step * np.arange(-3, cells + 4)
    A = BSpline.design_matrix(np.clip(x, low, high - 1e-12), knots, 3, extrapolate=True).toarray()
    third_differences = np.diff(np.eye(cells + 3), 3, axis=0)
    penalty = 0.5 * third_differences.T @ third_differences + 1e-9 * np.eye(cells + 3)
    weight = np.ones(len(x))
    coefficients = np.full(cells + 3, float(np.median(y)))
    for _ in range(6):
        W = A * weight[:, None]
        coefficients = np.linalg.solve(W.T @ A + penalty, W.T @ y)
        residual = np.abs(y - A @ coefficients)
        scale = max(noise, 1.4826 * float(np.median(residual)))
        weight = np.minimum(1.0, 2.0 * scale / np.maximum(residual, 1e-12)) ** 2
    return BSpline(knots, coefficients, 3, extrapolate=True)


def _running_mean(values: FloatArray, reach: int = 3) -> FloatArray:
    """Running mean over 2 `reach` + 1 neighbours."""
    if len(values) <= 2 * reach:
        return values
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, reach, mode="edge"), 2 * reach + 1)
    return np.asarray(windows.mean(axis=1))


def rigid_starts(record: PivotRecord, prior: ConstantsPrior, sides: Sequence[Side]) -> list[StartingPoint]:
    """Starts with the likeliest rotations between the sides, the best first; beam search over the contacts."""
    ordered = sorted(sides, key=lambda each: each.touch.begin - each.touch.end)
    beams: list[tuple[float, tuple[float, ...]]] = [(0.0, (0.0,))]
    for count in range(2, len(ordered) + 1):
        found: list[tuple[float, tuple[float, ...]]] = []
        for _, turns in beams:
            angles = np.linspace(0.0, math.tau, ROTATIONS, endpoint=False)
            # two sides do not overlap, so that the force determines their rotation; further contacts overlap
            rate = _rated if count == 2 else _outline_cost
            costs = np.array([rate(ordered[:count], (*turns, a), prior)[0] for a in angles])
            lowest = np.flatnonzero((costs < np.roll(costs, 1)) & (costs <= np.roll(costs, -1)))
            lowest = lowest[np.argsort(costs[lowest])][:BEAMS]
            tried = [(*turns, float(angles[i])) for i in lowest]
            found += [(_rated(ordered[:count], each, prior)[0], each) for each in tried]
        beams = sorted(found)[:BEAMS]
    return [_rigid_start(record, ordered, turns, prior) for _, turns in beams]


def _outline_cost(sides: Sequence[Side], turns: Sequence[float], prior: ConstantsPrior) -> tuple[float, FloatArray]:
    """(cost of the outline alone for these rotations of the sides, its coefficients)."""
    theta = np.concatenate([side.theta + turn for side, turn in zip(sides, turns, strict=True)])
    h, e = (np.concatenate([getattr(side, name) for side in sides]) for name in "he")
    return outline_through(theta, h, e, prior)


def _rated(sides: Sequence[Side], turns: Sequence[float], prior: ConstantsPrior) -> tuple[float, FloatArray]:
    """(cost of these rotations of the sides, with forces; constants that fit best)."""
    theta = np.concatenate([side.theta + turn for side, turn in zip(sides, turns, strict=True)])
    p = prior.mean.copy()
    cost, p[P.SHAPE :] = _outline_cost(sides, turns, prior)
    force, p[: P.SHAPE] = _force_cost(sides, theta, prior)
    middle = p[P.SHAPE + 1 : P.SHAPE + 3]
    far = float(np.hypot(*middle))
    # the mass if the centre of mass were the middle
    along = float(p[P.MOMENT : P.MOMENT + 2] @ middle) / max(far, 1e-4) ** 2
    p[P.MASS] = max(along, LEAST_MASS_KG)
    across = p[P.MOMENT : P.MOMENT + 2] / p[P.MASS] - middle
    p[P.INERTIA] = p[P.MASS] * ((GYRATION * p[P.SHAPE]) ** 2 + far**2)
    return cost + force + float(np.minimum(across @ across / CENTRE_SD_M**2, 100.0)), p


def outline_through(
    theta: FloatArray, h: FloatArray, e: FloatArray, prior: ConstantsPrior, share: float = 1.0
) -> tuple[float, FloatArray]:
    """(cost, coefficients) of the outline through h and h′ = e (m) at normals θ; share: weight of a point."""
    mean, sd = prior.mean[P.SHAPE :], prior.sd[P.SHAPE :]
    A = np.concatenate([shape.basis(theta, ORDER) / _HEIGHT_SD, -shape.tangential_basis(theta, ORDER) / _LEVER_SD])
    y = np.concatenate([h / _HEIGHT_SD, e / _LEVER_SD])
    A, y = A * math.sqrt(share), y * math.sqrt(share)
    normal = A.T @ A + np.diag(1 / sd**2)
    coefficients = np.asarray(np.linalg.solve(normal, A.T @ y + mean / sd**2), dtype=np.float64)
    residual, prior_residual = A @ coefficients - y, (coefficients - mean) / sd
    return float(residual @ residual + prior_residual @ prior_residual), coefficients


def _force_cost(sides: Sequence[Side], theta: FloatArray, prior: ConstantsPrior) -> tuple[float, FloatArray]:
    """(cost, constants before the outline) of the best fit to the forces over all frictions that are tried."""
    rate, second, h, e, force, sd = (
        np.concatenate([getattr(side, name) for side in sides])
        for name in ("rate", "second", "h", "e", "force", "force_sd")
    )
    u = np.concatenate([side.inputs for side in sides])
    usable = np.isfinite(force) & (np.abs(e) > 2 * LEAST_LEVER_M)
    best, constants = math.inf, prior.mean[: P.SHAPE].copy()
    if usable.sum() < 10:
        return 0.0, constants
    psi = -0.5 * math.pi - theta
    cos, sin, vertical, along = np.cos(psi), np.sin(psi), u[:, U.GRAVITY] + u[:, U.AZ], u[:, U.AX]
    columns = np.stack([second, cos * vertical - sin * along, -sin * vertical - cos * along, rate], axis=1)
    prior_mean, prior_sd = np.array([4e-5, 0.0, 0.0, 2e-6]), np.array([5e-5, 4e-3, 4e-3, 5e-6])
    slip = u[:, U.VX] + h * rate
    for mu, dither in itertools.product(FRICTIONS["rigid"], DITHERS["rigid"]):
        lever = _lever(e, h, slip, mu, dither, prior.mean[P.TRANSMISSION])
        valid = usable & (lever * np.sign(e) > LEAST_LEVER_M)
        if valid.sum() < 0.8 * usable.sum():
            continue
        A = columns[valid] / (lever * sd)[valid, None]
        y = (force / sd)[valid]
        normal = A.T @ A + np.diag(1 / prior_sd**2)
        found = np.linalg.solve(normal, A.T @ y + prior_mean / prior_sd**2)
        residual, prior_residual = A @ found - y, (found - prior_mean) / prior_sd
        cost = float(np.minimum(residual**2, 50.0).sum() + prior_residual @ prior_residual)
        if cost < best:
            best = cost
            constants[: P.MASS] = found
            constants[P.DRAG], constants[P.SATURATION] = mu / dither, 1 / dither**2
    return best, constants


def _lever(e: FloatArray, h: FloatArray, slip: FloatArray, mu: float, dither: float, transmission: float) -> FloatArray:
    """Lever of the pad's mean force about the pivot (m), as in `model.pivot`; transmission 0 means the averaged law."""
    if not transmission:
        return e - mu * slip / np.hypot(slip, dither) * h
    sigma = mean_direction(math.pi / 2 * slip / dither, np, KINK)
    effective = (sigma * e + mu * h) / (e + sigma * mu * h)
    lever: FloatArray = e - mu * (sigma + transmission * (effective - sigma)) * h
    return lever


def _rigid_start(
    record: PivotRecord, sides: Sequence[Side], turns: Sequence[float], prior: ConstantsPrior
) -> StartingPoint:
    cost, p = _rated(sides, turns, prior)
    paths = [(side.touch, side.t, side.theta + turn) for side, turn in zip(sides, turns, strict=True)]
    return _from_paths(record, paths, p, cost)


def _from_paths(
    record: PivotRecord, paths: Sequence[tuple[TouchSpan, FloatArray, FloatArray]], p: FloatArray, cost: float
) -> StartingPoint:
    """Start with splines through the paths of θ, turned so that ψ = 0 at the first reading."""
    c = np.zeros(record.coefficients)
    for touch, t, theta in paths:
        own = touch.through(t, -0.5 * math.pi - theta)
        c[touch.coefficients] = own
    turn = float(c[:3] @ np.array([1.0, 4.0, 1.0]) / 6)
    return StartingPoint(c - turn, turned(p, turn), cost)


def turned(p: FloatArray, turn: float) -> FloatArray:
    """The same body in a frame in which its orientation is ψ − `turn` (rad)."""
    p = p.copy()
    p[P.SHAPE :] = shape.turned(-turn, ORDER) @ p[P.SHAPE :]
    cos, sin = math.cos(turn), math.sin(turn)
    mx, my = p[P.MOMENT : P.MOMENT + 2]
    p[P.MOMENT : P.MOMENT + 2] = cos * mx - sin * my, sin * mx + cos * my
    return p


# ---------------------------------------------------------------------------------------------------- slide


def float_starts(record: PivotRecord, prior: ConstantsPrior) -> list[StartingPoint]:
    """Starts with the likeliest rolls, one for each friction that is tried, the best first."""
    paths = [_contact_grid(record, touch) for touch in record.touches]
    starts = [
        _rolled(record, paths, prior, mu, dither)
        for mu, dither in itertools.product(FRICTIONS["float"], DITHERS["float"])
    ]
    return sorted(starts, key=lambda start: start.cost)[:BEAMS]


@dataclass(frozen=True, slots=True)
class _ContactGrid:
    """A contact on an even time grid: height and its rate, lever, and velocity of the arm."""

    touch: TouchSpan
    t: FloatArray
    z: FloatArray
    vz: FloatArray
    e: FloatArray
    vx: FloatArray


def _contact_grid(record: PivotRecord, touch: TouchSpan) -> _ContactGrid:
    t = np.linspace(touch.begin, touch.end, max(int((touch.end - touch.begin) / 0.01), 10))
    smooth = []
    for rows, own in ((record.heights, 0), (record.readings, 1)):
        mine = touch.contains(rows.t)
        value = rows.value[mine] - (rows.inputs[mine, U.X] if own else 0.0)
        value = _without_outliers(value, math.sqrt(float(rows.variance[mine].mean())))
        smooth.append(_curve(rows.t[mine], value, math.sqrt(float(rows.variance[mine].mean())), CONTACT_CELL_S))
    x = np.interp(t, record.readings.t, record.readings.inputs[:, U.VX])
    height, lever = smooth
    return _ContactGrid(touch, t, height(t), height(t, 1), lever(t), x)


def _without_outliers(values: FloatArray, noise: float) -> FloatArray:
    """Replace values far from the median of their neighbours by that median."""
    reach = 5
    if len(values) <= 2 * reach:
        return values
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, reach, mode="edge"), 2 * reach + 1)
    median = np.median(windows, axis=1)
    cleaned: FloatArray = np.where(np.abs(values - median) > 6 * noise, median, values)
    return cleaned


def _rolled(
    record: PivotRecord, grids: Sequence[_ContactGrid], prior: ConstantsPrior, mu: float, dither: float
) -> StartingPoint:
    """The roll with this friction; the centre of mass is taken from the outline of the iteration before."""
    z, e = np.concatenate([each.z for each in grids]), np.concatenate([each.e for each in grids])
    p = prior.mean.copy()
    p[P.DRAG], p[P.SATURATION] = mu / dither, 1 / dither**2
    ends = np.cumsum([len(each.t) for each in grids])[:-1]
    weight = p[P.MASS] / (p[P.MASS] + record.rig.carriage_mass)
    averaged = record.rig.vibration.law == "averaged"
    com_offset = np.zeros(len(e))  # offset of the centre of mass from the pivot along the pad
    best: StartingPoint | None = None
    for _ in range(ROLLS):
        paths = []
        for each, own in zip(grids, np.split(com_offset, ends), strict=True):
            share = np.clip((each.e - weight * own) / (mu * each.z), -0.97, 0.97)  # of friction that the lever requires
            slip = dither * (share / np.sqrt(1 - share**2) if averaged else 2 / math.pi * np.sin(math.pi / 2 * share))
            rolled = (each.vx - slip) / each.z
            # with a long lever the height determines the rate, too: dz = e dθ
            precision = (ROLL_SD * np.abs(each.vx) / each.z + LEAST_RATE_SD) ** 2 / HEIGHT_RATE_SD**2
            rate = (rolled + precision * each.e * each.vz) / (1 + precision * each.e**2)
            theta = cumulative_trapezoid(rate, each.t, initial=0.0)
            paths.append((each.touch, each.t, theta))
        theta = np.concatenate([path[2] for path in paths])
        cost, p[P.SHAPE :] = outline_through(theta, z, e, prior)
        middle = p[P.SHAPE + 1 : P.SHAPE + 3]
        com_offset = -np.sin(theta) * middle[0] + np.cos(theta) * middle[1]
        if best is None or cost < best.cost:
            p[P.MOMENT : P.MOMENT + 2] = p[P.MASS] * middle
            p[P.INERTIA] = p[P.MASS] * ((GYRATION * p[P.SHAPE]) ** 2 + middle @ middle)
            best = _from_paths(record, paths, p, cost)
    if best is None:
        raise ValueError("no roll was tried")
    return best
