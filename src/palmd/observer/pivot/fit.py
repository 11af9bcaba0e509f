"""Levenberg–Marquardt over a whole run of the pivoting grasp: splines of the orientation and constants together.

The normal matrix is banded in the splines' coefficients, with a dense border for the constants, and is factored so.
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
HEIGHT_ERROR_M, HEIGHT_ERROR_READINGS, LEAST_LEVER_SQUARE_M2 = 2.5e-6, 60, 1e-8
_READINGS, _HEIGHTS, _FORCES = range(3)  # kinds of rows, in the order of the kernels
_PSI_SCALE = 0.05
_GAUGE_SD = 1e-5  # of ψ at the first reading, which is 0 by definition
_UNSOLVABLE = (np.linalg.LinAlgError, ValueError)


@dataclass(frozen=True, slots=True)
class ConstantsPrior:
    """Prior of the constants: means and 1σ (CONSTANTS,)."""

    mean: FloatArray
    sd: FloatArray


@dataclass(frozen=True, slots=True)
class Softening:
    """Factors on the 1σ of readings, heights, forces and torques, for graduated optimisation."""

    readings: float = 1.0
    heights: float = 1.0
    forces: float = 1.0
    torques: float = 1.0


UNSOFTENED = Softening()


@dataclass(frozen=True, slots=True)
class PivotFit:
    """A minimum: spline coefficients c, constants p, cost, χ² of each kind without outliers, state of the iteration.

    outliers: fraction of the pad's readings above the gate. gain: amplitudes of the pad's gain modes, in their 1σ.
    """

    c: FloatArray
    p: FloatArray
    cost: float
    chi2: float
    height_chi2: float
    force_chi2: float
    torque_chi2: float
    outliers: float
    converged: bool
    gain: FloatArray


@dataclass(frozen=True, slots=True)
class _Normal:
    cost: float
    chi2: tuple[float, float, float, float]
    outliers: float
    banded: FloatArray
    border: FloatArray
    corner: FloatArray
    c_side: FloatArray
    p_side: FloatArray


class Problem:
    """The least-squares problem of one record; `fit` may be called from many starts."""

    def __init__(self, library: Library, record: PivotRecord, prior: ConstantsPrior, forces: FloatArray | None = None):
        """`forces`: of an earlier fit, from which the pad's hysteresis is computed."""
        self.record = record
        self.prior = prior
        force = "rigid_force" if record.rig.vertical == "rigid" else "slide_force"
        gain = gain_modes(record, forces)
        self._x = np.zeros(CONSTANTS + gain.shape[1])  # constants, and modes of the gain
        self._mean, self._sd = np.zeros_like(self._x), np.ones_like(self._x)
        self._mean[:CONSTANTS], self._sd[:CONSTANTS] = prior.mean, prior.sd
        kinds = (("reading", record.readings), ("height", record.heights), (force, record.forces))
        self._kernels = [
            _Kernel(library, name, rows, self._x, gain if name == force else None)
            for name, rows in (*kinds, ("slide_torque", record.torques))
        ]
        rows = [kernel.rows for kernel in self._kernels]
        columns = np.concatenate([(each.first[:, None] + np.arange(TAPS)).ravel() for each in rows])
        self._pattern = (columns, np.arange(0, len(columns) + 1, TAPS))

    def fit(
        self, c: FloatArray, p: FloatArray, soft: Softening = UNSOFTENED, iterations: int = MAX_ITERATIONS
    ) -> PivotFit:
        """Iterate to convergence; the result may be a local minimum."""
        x = np.concatenate([p, np.zeros(len(self._x) - CONSTANTS)])
        self._open_gates(c, x, soft)
        now = self.linearised(c, x, soft)
        damping, count, converged = FIRST_DAMPING, 0, False
        while count < iterations and damping < MAX_DAMPING and not converged and math.isfinite(now.cost):
            count += 1
            step = self._step(now, damping)
            if step is None:
                damping *= 8.0
                continue
            predicted = float(now.c_side @ step[0] + now.p_side @ step[1])
            if damping <= FIRST_DAMPING and predicted < NEGLIGIBLE:
                converged = True
                break
            trial = c + step[0], x + step[1]
            then = self.linearised(*trial, soft) if _sane(trial[1]) else None
            for _ in range(CORRECTIONS):  # the splines bend where the constants go straight
                if then is None or not math.isfinite(then.cost) or then.cost < GOOD_ENOUGH * now.cost:
                    break
                better = self._resolve_splines(then, trial, soft)
                if better is None or not better[1].cost < 0.999 * then.cost:
                    break
                trial, then = better
            if then is None or not then.cost < now.cost:
                damping = max(damping, 1e-6) * 8.0
                continue
            converged = now.cost - then.cost < NEGLIGIBLE and damping <= FIRST_DAMPING
            (c, x), now = trial, then
            if self._narrow_gates():
                converged, now = False, self.linearised(c, x, soft)
            damping = max(damping / 8.0, LEAST_DAMPING)
        constants, gain = np.split(x, [CONSTANTS])
        return PivotFit(c, constants, now.cost, *now.chi2, now.outliers, converged, gain)

    def _open_gates(self, c: FloatArray, x: FloatArray, soft: Softening) -> None:
        """Set the gates by the present spread of all residuals."""
        for kernel in self._kernels:
            kernel.gate = math.inf
        self.linearised(c, x, soft)
        self._narrow_gates()

    def _narrow_gates(self) -> bool:
        """Narrow gates once the spread is much smaller; returns whether any changed: costs are then not comparable."""
        narrower = [kernel for kernel in self._kernels if kernel.wanted_gate < NARROWER * kernel.gate]
        for kernel in narrower:
            kernel.gate = kernel.wanted_gate
        return bool(narrower)

    def _resolve_splines(
        self, then: _Normal, trial: tuple[FloatArray, FloatArray], soft: Softening
    ) -> tuple[tuple[FloatArray, FloatArray], _Normal] | None:
        try:
            factor = cholesky_banded(then.banded, lower=True)
        except _UNSOLVABLE:
            return None
        better = trial[0] + cho_solve_banded((factor, True), then.c_side), trial[1]
        return better, self.linearised(*better, soft)

    def predicted(self, c: FloatArray, p: FloatArray) -> list[FloatArray]:
        """Predicted readings, heights, forces and torques, without the pad's gain."""
        self._x[:CONSTANTS] = p
        return [kernel.predicted(self.record.motion(c, kernel.rows)) for kernel in self._kernels]

    def linearised(self, c: FloatArray, x: FloatArray, soft: Softening = UNSOFTENED) -> _Normal:
        """Normal equations at c and x, constants and modes of the gain; the cost is infinite if they are not finite."""
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
            body_residual, body_jacobian = body_prior_residuals(x)
            prior_cost = float(deviation @ deviation + body_residual @ body_residual)
            gauge_c, gauge = self._gauge(c)
            cost = sum(part[3] for part in parts) + prior_cost + gauge**2
            if not (math.isfinite(cost) and np.isfinite(in_p).all() and np.isfinite(in_c).all()):
                none: FloatArray = np.zeros(0)
                return _Normal(math.inf, (math.inf,) * 4, 1.0, none, none, none, none, none)
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
            banded,
            across @ in_p,
            in_p.T @ in_p + np.diag(1 / self._sd**2) + body_jacobian.T @ body_jacobian,
            c_side,
            in_p.T @ residual - deviation / self._sd - body_jacobian.T @ body_residual,
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

    def constants_shift(self, fit: PivotFit, kind: int, shift: FloatArray) -> FloatArray | None:
        """Change of the fitted constants for a `shift` of the values of one kind of rows; None if it is singular."""
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
        """Covariance of the constants; raises LinAlgError if the fit is not a minimum."""
        x = np.concatenate([fit.p, fit.gain])
        self._open_gates(fit.c, x, UNSOFTENED)
        now = self.linearised(fit.c, x)
        if not math.isfinite(now.cost):
            raise np.linalg.LinAlgError("the cost of the fit is not finite")
        factor = cholesky_banded(now.banded, lower=True)
        solved = cho_solve_banded((factor, True), now.border)
        schur = now.corner - now.border.T @ solved
        scale = self._sd
        inverse = np.linalg.inv(schur * np.outer(scale, scale)) * np.outer(scale, scale)
        covariance: FloatArray = ((inverse + inverse.T) / 2)[:CONSTANTS, :CONSTANTS]
        if not (np.diagonal(covariance) >= 0).all():
            raise np.linalg.LinAlgError("the fit is not a minimum")
        return covariance


def rig_error_modes(problem: Problem, fit: PivotFit) -> FloatArray:
    """(CONSTANTS, modes): change of a fit for 1σ errors of rig constants that it does not estimate.

    These are the sagitta of the pad's surface, the dependence of its readings on force, and, for a rigid gripper, the
    surface's height, which changes the body's size over the whole outline.
    """
    record, pad = problem.record, problem.record.rig.pad
    moves: list[FloatArray | None] = []
    if pad.sagitta_sd:
        x = record.heights.inputs[:, U.X]
        theta = normal_of(record.motion(fit.c, record.heights)[:, 0])
        u = (x - shape.tangential_basis(theta, ORDER) @ fit.p[P.SHAPE :]) / pad.length
        slope, height = 4.0 * pad.sagitta_sd / pad.length * (1.0 - 2.0 * u), 4.0 * pad.sagitta_sd * u * u
        moves.append(problem.constants_shift(fit, _HEIGHTS, height + slope * x))
    if pad.force_sd and len(record.forces.t):
        forces = problem.predicted(fit.c, fit.p)[_FORCES]
        moves.append(
            problem.constants_shift(
                fit, _READINGS, pad.force_sd * np.interp(record.readings.t, record.forces.t, forces)
            )
        )
    if pad.standoff_sd and record.rig.vertical == "rigid":
        larger = np.zeros(CONSTANTS)
        larger[P.STANDOFF], larger[P.SHAPE] = pad.standoff_sd, -pad.standoff_sd
        moves.append(larger)
    determined = [each for each in moves if each is not None]
    return np.array(determined).T if determined else np.zeros((CONSTANTS, 0))


def gain_modes(record: PivotRecord, forces: FloatArray | None = None) -> FloatArray:
    """(forces, modes): relative change of each force for a 1σ amplitude of each mode of the pad's gain error.

    The gain has an error of 1σ `force_gain_std`, which drifts within `DRIFT_S`, and a hysteresis of `HYSTERESIS` behind
    changing forces, modelled as a play operator on `forces`, if these are given. The error is common to many readings,
    so that their number does not average it out; repeated visits to one place do.
    """
    rows, std = record.forces, record.rig.pad.force_gain_std
    if not std or not len(rows.t):
        return np.zeros((len(rows.t), 0))
    modes = modes_at(rows.t, [(touch.begin, touch.end) for touch in record.touches], std)
    return modes if forces is None else np.column_stack([modes, HYSTERESIS * _play_state(record, forces)])


def _play_state(record: PivotRecord, forces: FloatArray) -> FloatArray:
    """State of the pad's play operator at each force, touch by touch."""
    state: FloatArray = np.zeros(len(forces))
    for touch in record.touches:
        mine = touch.contains(record.forces.t)
        state[mine] = hysteresis_position(forces[mine])
    return state


class _Kernel:
    """Rows of one kind, bound to their kernel."""

    def __init__(self, library: Library, name: str, rows: Rows, x: FloatArray, gain: FloatArray | None):
        self.rows = rows
        self._x, self._gain = x, gain
        self.gate = self.wanted_gate = GATE
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
        """(Jacobians in coefficients, in constants and gain, residuals, all weighted; cost, χ², share of outliers)."""
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
        self.wanted_gate = GATE * spread if spread > WIDE else GATE
        gate = self.gate
        outlier = nis > gate
        root = np.sqrt(np.where(outlier, gate / np.maximum(nis, gate), 1.0) / variance)
        cost = float(np.where(outlier, gate * (1.0 + np.log(np.maximum(nis, gate) / gate)), nis).sum())
        chi2 = float(nis[~outlier].mean()) if not outlier.all() else math.inf
        in_c = np.einsum("nq,nqk->nk", J[:, :MOTION], rows.weights)
        return in_c * root[:, None], in_x * root[:, None], residual * root, cost, chi2, float(outlier.mean())


def body_prior_residuals(p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normalised residuals (3,) of the prior of a body, and their Jacobian (3, len(p)).

    The centre of mass lies near the outline's middle, which is the first harmonic about P, and the radius of gyration
    is near that of a uniform body. This couples moment and inertia.
    """
    mass, moment, inertia = p[P.MASS], p[P.MOMENT : P.MOMENT + 2], p[P.INERTIA]
    radius, middle = p[P.SHAPE], p[P.SHAPE + 1 : P.SHAPE + 3]
    com = moment / mass
    gyration = inertia / mass - com @ com  # ρ²
    expected, sd = (GYRATION * radius) ** 2, 2 * GYRATION_SD * GYRATION**2 * radius**2
    residual = np.array([*((com - middle) / CENTRE_SD_M), (gyration - expected) / sd])
    J = np.zeros((3, len(p)))
    for i in range(2):
        J[i, P.MOMENT + i] = 1 / mass / CENTRE_SD_M
        J[i, P.MASS] = -com[i] / mass / CENTRE_SD_M
        J[i, P.SHAPE + 1 + i] = -1 / CENTRE_SD_M
        J[2, P.MOMENT + i] = -2 * com[i] / mass / sd
    J[2, P.INERTIA] = 1 / mass / sd
    J[2, P.MASS] = (-inertia / mass + 2 * com @ com) / mass / sd
    J[2, P.SHAPE] = (-2 * expected - 2 * (gyration - expected)) / radius / sd
    return residual, J


def _sane(p: FloatArray) -> bool:
    return bool(
        np.isfinite(p).all()
        and 1e-3 < p[P.SHAPE] < 0.2
        and 20.0 < p[P.SATURATION] < 1e7
        and p[P.DRAG] > -5.0
        and p[P.MASS] > 1e-4
    )


def with_model_forces(problem: Problem, library: Library, fit: PivotFit) -> Problem:
    """The same problem, with each force's noise computed from the fit's force instead of neighbouring readings."""
    record = problem.record
    level = np.maximum(problem.predicted(fit.c, fit.p)[_FORCES], 0.05)
    variance = np.asarray(record.rig.pad.force_variance(level)) + (level * _height_error_share(record, fit)) ** 2
    forces = replace(record.forces, variance=variance)
    return Problem(library, replace(record, forces=forces), problem.prior, level)


def _height_error_share(record: PivotRecord, fit: PivotFit) -> FloatArray:
    """Relative 1σ of each force from errors of a rigid gripper's height.

    An error δz changes the lever e by h_P″ δz/e, and the force relatively as much as the lever. Its 1σ is
    `HEIGHT_ERROR_M`; `HEIGHT_ERROR_READINGS` successive readings share it, and carry the information of one.
    """
    if record.rig.vertical != "rigid":
        return np.zeros(len(record.forces.t))
    theta, a = normal_of(record.motion(fit.c, record.forces)[:, 0]), fit.p[P.SHAPE :]
    e = -shape.tangential_basis(theta, ORDER) @ a
    bend = shape.basis(theta, ORDER) @ (-(shape.harmonic_of_coefficient(ORDER) ** 2) * a)
    share: FloatArray = (
        HEIGHT_ERROR_M * math.sqrt(HEIGHT_ERROR_READINGS) * np.abs(bend) / np.maximum(e**2, LEAST_LEVER_SQUARE_M2)
    )
    return share
