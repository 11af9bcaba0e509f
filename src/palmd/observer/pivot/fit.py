"""Levenberg–Marquardt over a whole run of the pivoting grasp: the orientation's splines and the constants at once.

The normal matrix is banded in the splines' coefficients with a dense border for the constants, and is factored so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from scipy.sparse import csr_matrix

from palmd.events import FloatArray
from palmd.model import shape
from palmd.model.compiled import Library
from palmd.model.pivot import BATCH, CONSTANTS, MOTION, ORDER, P, U
from palmd.observer.force_gain import HYSTERESIS, hysteresis_position, modes_at
from palmd.observer.pivot.record import TAPS, PivotRecord, Rows
from palmd.system.pivot import normal_of

MAX_ITERATIONS = 60
NEGLIGIBLE = 0.02
FIRST_DAMPING, LEAST_DAMPING, MAX_DAMPING = 1e-3, 1e-10, 1e8
CORRECTIONS, GOOD_ENOUGH = 4, 0.9  # of the splines alone, unless the cost falls by a tenth at once
GATE = 16.0  # squared normalised residual beyond which a reading's pull falls off: 4 sigma
WIDE, NARROWER = 1.5, 0.7  # spread of residuals from which the gate is wider, and how much narrower it must come
# What most bodies are like: how far the centre of mass is off the outline's middle, and the radius of gyration in mean
# radii with its relative one-sigma (a uniform convex body has 0.70 to 0.72, a ring 1).
CENTRE_SD_M, GYRATION, GYRATION_SD = 1e-3, 0.707, 0.1
STRAY_M, STRAY_READINGS, LEAST_SQUARE_M2 = 2.5e-6, 60, 1e-8
_READINGS, _HEIGHTS, _FORCES = range(3)  # kinds of rows, in the order of the kernels
_PSI_SCALE = 0.05
_GAUGE_SD = 1e-5  # of ψ at the first reading, which is 0 by definition
_UNSOLVABLE = (np.linalg.LinAlgError, ValueError)


@dataclass(frozen=True, slots=True)
class Known:
    """What is believed of the constants beforehand: means and one-sigmas (CONSTANTS)."""

    mean: FloatArray
    sd: FloatArray


@dataclass(frozen=True, slots=True)
class Softening:
    """Factors on the one-sigmas of readings, heights, forces and torques: an early fit sees through a soft lens."""

    readings: float = 1.0
    heights: float = 1.0
    forces: float = 1.0
    torques: float = 1.0


SHARP = Softening()


@dataclass(frozen=True, slots=True)
class PivotFit:
    """A minimum: spline coefficients c, constants p, its cost, robust χ² of each kind, and how the iteration ended.

    outliers: share of the pad's readings beyond the gate. gain: of the modes of the pad's gain, in one-sigmas.
    """

    c: FloatArray
    p: FloatArray
    cost: float
    chi2: float
    height_chi2: float
    force_chi2: float
    torque_chi2: float
    outliers: float
    strain: float
    iterations: int
    settled: bool
    gain: FloatArray


@dataclass(frozen=True, slots=True)
class _Normal:
    cost: float
    chi2: tuple[float, float, float, float]
    outliers: float
    strain: float
    banded: FloatArray
    border: FloatArray
    corner: FloatArray
    c_side: FloatArray
    p_side: FloatArray


class Problem:
    """The least-squares problem of one record; `fit` may be called with many starts."""

    def __init__(self, library: Library, record: PivotRecord, known: Known, felt: FloatArray | None = None):
        """`felt`: the forces as a fit had them, from which it follows how far the pad falls behind them."""
        self.record = record
        self.known = known
        force = "rigid_force" if record.rig.vertical == "rigid" else "slide_force"
        gain = gain_modes(record, felt)
        self._x = np.zeros(CONSTANTS + gain.shape[1])  # constants, and modes of the gain
        self._mean, self._sd = np.zeros_like(self._x), np.ones_like(self._x)
        self._mean[:CONSTANTS], self._sd[:CONSTANTS] = known.mean, known.sd
        kinds = (("reading", record.readings), ("height", record.heights), (force, record.forces))
        self._kernels = [
            _Kernel(library, name, rows, self._x, gain if name == force else None)
            for name, rows in (*kinds, ("slide_torque", record.torques))
        ]
        rows = [kernel.rows for kernel in self._kernels]
        columns = np.concatenate([(each.first[:, None] + np.arange(TAPS)).ravel() for each in rows])
        self._pattern = (columns, np.arange(0, len(columns) + 1, TAPS))

    def fit(self, c: FloatArray, p: FloatArray, soft: Softening = SHARP, iterations: int = MAX_ITERATIONS) -> PivotFit:
        """Iterate until nothing moves any more; the result may be a local minimum."""
        x = np.concatenate([p, np.zeros(len(self._x) - CONSTANTS)])
        self._open_gates(c, x, soft)
        now = self.linearised(c, x, soft)
        damping, count, settled = FIRST_DAMPING, 0, False
        while count < iterations and damping < MAX_DAMPING and not settled and math.isfinite(now.cost):
            count += 1
            step = self._step(now, damping)
            if step is None:
                damping *= 8.0
                continue
            promise = float(now.c_side @ step[0] + now.p_side @ step[1])
            if damping <= FIRST_DAMPING and promise < NEGLIGIBLE:
                settled = True
                break
            trial = c + step[0], x + step[1]
            then = self.linearised(*trial, soft) if _sane(trial[1]) else None
            for _ in range(CORRECTIONS):  # the splines bend where the constants go straight
                if then is None or not math.isfinite(then.cost) or then.cost < GOOD_ENOUGH * now.cost:
                    break
                better = self._splines_again(then, trial, soft)
                if better is None or not better[1].cost < 0.999 * then.cost:
                    break
                trial, then = better
            if then is None or not then.cost < now.cost:
                damping = max(damping, 1e-6) * 8.0
                continue
            settled = now.cost - then.cost < NEGLIGIBLE and damping <= FIRST_DAMPING
            (c, x), now = trial, then
            if self._narrow_gates():
                settled, now = False, self.linearised(c, x, soft)
            damping = max(damping / 8.0, LEAST_DAMPING)
        constants, gain = np.split(x, [CONSTANTS])
        return PivotFit(c, constants, now.cost, *now.chi2, now.outliers, now.strain, count, settled, gain)

    def _open_gates(self, c: FloatArray, x: FloatArray, soft: Softening) -> None:
        """Set the gates by how far all residuals are now."""
        for kernel in self._kernels:
            kernel.gate = math.inf
        self.linearised(c, x, soft)
        self._narrow_gates()

    def _narrow_gates(self) -> bool:
        """Let outliers be what stands out now, where that has become much less; else no cost would compare."""
        narrower = [kernel for kernel in self._kernels if kernel.wanted < NARROWER * kernel.gate]
        for kernel in narrower:
            kernel.gate = kernel.wanted
        return bool(narrower)

    def _splines_again(
        self, then: _Normal, trial: tuple[FloatArray, FloatArray], soft: Softening
    ) -> tuple[tuple[FloatArray, FloatArray], _Normal] | None:
        try:
            factor = cholesky_banded(then.banded, lower=True)
        except _UNSOLVABLE:
            return None
        better = trial[0] + cho_solve_banded((factor, True), then.c_side), trial[1]
        return better, self.linearised(*better, soft)

    def predicted(self, c: FloatArray, p: FloatArray) -> list[FloatArray]:
        """Readings, heights, forces and torques as the model has them, without the gain."""
        self._x[:CONSTANTS] = p
        return [kernel.predicted(self.record.motion(c, kernel.rows)) for kernel in self._kernels]

    def linearised(self, c: FloatArray, x: FloatArray, soft: Softening = SHARP) -> _Normal:
        """The normal equations; the cost is infinite where they are void. x: constants, and modes of the gain."""
        self._x[:] = x
        factors = (soft.readings, soft.heights, soft.forces, soft.torques)
        with np.errstate(all="ignore"):
            parts = [
                kernel.evaluate(self.record.motion(c, kernel.rows), factor)
                for kernel, factor in zip(self._kernels, factors, strict=True)
            ]
            in_c = np.concatenate([part[0].ravel() for part in parts])
            in_p = np.concatenate([part[1] for part in parts])
            residual = np.concatenate([part[2] for part in parts])
            deviation = (x - self._mean) / self._sd
            likely, in_likely = likely_body(x)
            strain = float(deviation @ deviation + likely @ likely)
            gauge_c, gauge = self._gauge(c)
            cost = sum(part[3] for part in parts) + strain + gauge**2
            if not (math.isfinite(cost) and np.isfinite(in_p).all() and np.isfinite(in_c).all()):
                none: FloatArray = np.zeros(0)
                return _Normal(math.inf, (math.inf,) * 4, 1.0, math.inf, none, none, none, none, none)
        sparse = csr_matrix((in_c, *self._pattern), shape=(len(residual), len(c)))
        across = sparse.T.tocsr()
        normal = across @ sparse
        banded = np.zeros((TAPS, len(c)))
        for k in range(TAPS):
            banded[k, : len(c) - k] = normal.diagonal(-k)
        banded[0] += 1e-9  # what no reading sees stays where it is
        for k in range(TAPS):
            banded[k, : TAPS - k] += gauge_c[k:] * gauge_c[: TAPS - k]
        c_side = across @ residual
        c_side[:TAPS] -= gauge_c * gauge
        return _Normal(
            cost,
            (parts[0][4], parts[1][4], parts[2][4], parts[3][4]),
            parts[0][5],
            strain,
            banded,
            across @ in_p,
            in_p.T @ in_p + np.diag(1 / self._sd**2) + in_likely.T @ in_likely,
            c_side,
            in_p.T @ residual - deviation / self._sd - in_likely.T @ likely,
        )

    def _gauge(self, c: FloatArray) -> tuple[FloatArray, float]:
        weights = np.array([1.0, 4.0, 1.0, 0.0]) / 6 / _GAUGE_SD
        return weights, float(weights @ c[:TAPS])

    def _step(self, now: _Normal, damping: float) -> tuple[FloatArray, FloatArray] | None:
        banded = now.banded.copy()
        banded[0] += damping / _PSI_SCALE**2
        try:
            factor = cholesky_banded(banded, lower=True, overwrite_ab=True)
            solved = cho_solve_banded((factor, True), np.column_stack([now.border, now.c_side]))
            schur = now.corner + np.diag(damping / self._sd**2) - now.border.T @ solved[:, :-1]
            step = cho_solve(cho_factor(schur), now.p_side - now.border.T @ solved[:, -1])
        except _UNSOLVABLE:
            return None
        return solved[:, -1] - solved[:, :-1] @ step, step

    def moved(self, fit: PivotFit, kind: int, shift: FloatArray) -> FloatArray | None:
        """By how much the constants would move if the values of a kind of rows did by so much; None: it is open."""
        kernel, x = self._kernels[kind], np.concatenate([fit.p, fit.gain])
        gate, rows = kernel.gate, kernel.rows
        kernel.gate = math.inf
        before = self.linearised(fit.c, x)
        kernel.rows = replace(rows, value=rows.value + shift)
        after = self.linearised(fit.c, x)
        kernel.gate, kernel.rows = gate, rows
        step = self._step(
            replace(before, c_side=after.c_side - before.c_side, p_side=after.p_side - before.p_side), 0.0
        )
        return None if step is None else step[1][:CONSTANTS]

    def covariance(self, fit: PivotFit) -> FloatArray:
        """Of the constants; raises LinAlgError where the fit is no minimum."""
        x = np.concatenate([fit.p, fit.gain])
        self._open_gates(fit.c, x, SHARP)
        now = self.linearised(fit.c, x)
        if not math.isfinite(now.cost):
            raise np.linalg.LinAlgError("the fit is beyond all numbers")
        factor = cholesky_banded(now.banded, lower=True)
        solved = cho_solve_banded((factor, True), now.border)
        schur = now.corner - now.border.T @ solved
        scale = self._sd
        inverse = np.linalg.inv(schur * np.outer(scale, scale)) * np.outer(scale, scale)
        covariance: FloatArray = ((inverse + inverse.T) / 2)[:CONSTANTS, :CONSTANTS]
        if not (np.diagonal(covariance) >= 0).all():
            raise np.linalg.LinAlgError("the fit is no minimum")
        return covariance


def moved_by_rig(problem: Problem, fit: PivotFit) -> FloatArray:
    """(CONSTANTS, modes): how a fit moves where what it does not estimate of the rig is off by one sigma.

    That is the bow of the pad's surface, what its readings move by with the force, and under a rigid gripper the
    surface's height: a body is larger by as much all round.
    """
    record, pad = problem.record, problem.record.rig.pad
    moves: list[FloatArray | None] = []
    if pad.sagitta_sd:
        x = record.heights.inputs[:, U.X]
        theta = normal_of(record.motion(fit.c, record.heights)[:, 0])
        u = (x - shape.tangential_basis(theta, ORDER) @ fit.p[P.SHAPE :]) / pad.length
        slope, height = 4.0 * pad.sagitta_sd / pad.length * (1.0 - 2.0 * u), 4.0 * pad.sagitta_sd * u * u
        moves.append(problem.moved(fit, _HEIGHTS, height + slope * x))
    if pad.force_sd and len(record.forces.t):
        felt = problem.predicted(fit.c, fit.p)[_FORCES]
        moves.append(problem.moved(fit, _READINGS, pad.force_sd * np.interp(record.readings.t, record.forces.t, felt)))
    if pad.standoff_sd and record.rig.vertical == "rigid":
        larger = np.zeros(CONSTANTS)
        larger[P.STANDOFF], larger[P.SHAPE] = pad.standoff_sd, -pad.standoff_sd
        moves.append(larger)
    told = [each for each in moves if each is not None]
    return np.array(told).T if told else np.zeros((CONSTANTS, 0))


def gain_modes(record: PivotRecord, felt: FloatArray | None = None) -> FloatArray:
    """(forces, modes): the share by which each mode of the pad's gain moves each force, where it is off by one sigma.

    The gain is off by `force_gain_std`, drifts within `DRIFT_S`, and falls behind a force that changes by `BEHIND`: as
    a play does behind the forces `felt`, where these are known. Readings share it, and no number of them averages it
    out; visits to one place at several times do.
    """
    rows, std = record.forces, record.rig.pad.force_gain_std
    if not std or not len(rows.t):
        return np.zeros((len(rows.t), 0))
    modes = modes_at(rows.t, [(touch.begin, touch.end) for touch in record.touches], std)
    return modes if felt is None else np.column_stack([modes, HYSTERESIS * _behind(record, felt)])


def _behind(record: PivotRecord, felt: FloatArray) -> FloatArray:
    """Where in its play the pad is at each force, touch by touch."""
    place: FloatArray = np.zeros(len(felt))
    for touch in record.touches:
        mine = (record.forces.t >= touch.begin) & (record.forces.t <= touch.end)
        place[mine] = hysteresis_position(felt[mine])
    return place


class _Kernel:
    """Rows of one kind, bound to their kernel."""

    def __init__(self, library: Library, name: str, rows: Rows, x: FloatArray, gain: FloatArray | None):
        self.rows = rows
        self._x, self._gain = x, gain
        self.gate = self.wanted = GATE
        n = len(rows.t)
        size = -(-max(n, 1) // BATCH) * BATCH
        self._motion, inputs = np.zeros((size, MOTION)), np.zeros((size, rows.inputs.shape[1]))
        inputs[:n] = rows.inputs
        self._value, self._gradient = np.zeros(size), np.zeros((size, MOTION + CONSTANTS))
        self._calls = [
            library.bind(
                f"{name}_batch",
                [self._motion[at : at + BATCH], x[:CONSTANTS], inputs[at : at + BATCH]],
                [self._value[at : at + BATCH], self._gradient[at : at + BATCH]],
            )
            for at in range(0, size if n else 0, BATCH)
        ]

    def predicted(self, motion: FloatArray) -> FloatArray:
        n = len(self.rows.t)
        self._motion[:n] = motion
        for call in self._calls:
            call()
        return self._value[:n].copy()

    def evaluate(
        self, motion: FloatArray, soft: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, float, float]:
        """(gradients in coefficients, in constants and gain, residuals, all weighed; cost, χ², share of outliers)."""
        rows = self.rows
        n = len(rows.t)
        if not n:
            return np.zeros((0, TAPS)), np.zeros((0, len(self._x))), np.zeros(0), 0.0, 0.0, 0.0
        value, J = self.predicted(motion), self._gradient[:n]
        in_x = np.zeros((n, len(self._x)))
        if self._gain is not None and self._gain.shape[1]:
            in_x[:, CONSTANTS:] = value[:, None] * self._gain
            factor = 1.0 + self._gain @ self._x[CONSTANTS:]
            value, J = value * factor, J * factor[:, None]
        in_x[:, :CONSTANTS] = J[:, MOTION:]
        residual = rows.value - value
        variance = rows.variance * soft**2
        nis = residual**2 / variance
        # far from the answer all residuals are large: only what stands out from the others is an outlier
        spread = float(np.median(nis)) / 0.455
        self.wanted = GATE * spread if spread > WIDE else GATE
        gate = self.gate
        outlier = nis > gate
        root = np.sqrt(np.where(outlier, gate / np.maximum(nis, gate), 1.0) / variance)
        cost = float(np.where(outlier, gate * (1.0 + np.log(np.maximum(nis, gate) / gate)), nis).sum())
        chi2 = float(nis[~outlier].mean()) if not outlier.all() else math.inf
        in_c = np.einsum("nq,nqk->nk", J[:, :MOTION], rows.weights)
        return in_c * root[:, None], in_x * root[:, None], residual * root, cost, chi2, float(outlier.mean())


def likely_body(p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """By how many sigmas a body is not as most are, and the gradient of it (3, len(p)).

    Its centre of mass lies near the outline's middle, which the first harmonic about P tells, and its radius of
    gyration is near that of a uniform body: so moment and inertia tell of each other.
    """
    mass, moment, inertia = p[P.MASS], p[P.MOMENT : P.MOMENT + 2], p[P.INERTIA]
    radius, middle = p[P.SHAPE], p[P.SHAPE + 1 : P.SHAPE + 3]
    com = moment / mass
    gyration = inertia / mass - com @ com  # ρ²
    wanted, sd = (GYRATION * radius) ** 2, 2 * GYRATION_SD * GYRATION**2 * radius**2
    off = np.array([*((com - middle) / CENTRE_SD_M), (gyration - wanted) / sd])
    J = np.zeros((3, len(p)))
    for i in range(2):
        J[i, P.MOMENT + i] = 1 / mass / CENTRE_SD_M
        J[i, P.MASS] = -com[i] / mass / CENTRE_SD_M
        J[i, P.SHAPE + 1 + i] = -1 / CENTRE_SD_M
        J[2, P.MOMENT + i] = -2 * com[i] / mass / sd
    J[2, P.INERTIA] = 1 / mass / sd
    J[2, P.MASS] = (-inertia / mass + 2 * com @ com) / mass / sd
    J[2, P.SHAPE] = (-2 * wanted - 2 * (gyration - wanted)) / radius / sd
    return off, J


def _sane(p: FloatArray) -> bool:
    return bool(
        np.isfinite(p).all()
        and 1e-3 < p[P.SHAPE] < 0.2
        and 20.0 < p[P.SATURATION] < 1e7
        and p[P.DRAG] > -5.0
        and p[P.MASS] > 1e-4
    )


def with_forces_of(problem: Problem, library: Library, fit: PivotFit) -> Problem:
    """The same problem, each force's noise taken from the model's force instead of its neighbours'."""
    record = problem.record
    level = np.maximum(problem.predicted(fit.c, fit.p)[_FORCES], 0.05)
    variance = np.asarray(record.rig.pad.force_variance(level)) + (level * _strayed(record, fit)) ** 2
    forces = replace(record.forces, variance=variance)
    return Problem(library, replace(record, forces=forces), problem.known, level)


def _strayed(record: PivotRecord, fit: PivotFit) -> FloatArray:
    """The share by which each force is off where a rigid gripper is not quite where the fit takes it to be.

    Off by δz, the lever e is by h_P″ δz/e, and the force by as large a share of itself as the lever. It strays by
    `STRAY_M` and for as long as so many readings take, which therefore tell no more than one.
    """
    if record.rig.vertical != "rigid":
        return np.zeros(len(record.forces.t))
    theta, a = normal_of(record.motion(fit.c, record.forces)[:, 0]), fit.p[P.SHAPE :]
    e = -shape.tangential_basis(theta, ORDER) @ a
    bend = shape.basis(theta, ORDER) @ (-(shape.harmonic_of_coefficient(ORDER) ** 2) * a)
    share: FloatArray = STRAY_M * math.sqrt(STRAY_READINGS) * np.abs(bend) / np.maximum(e**2, LEAST_SQUARE_M2)
    return share
