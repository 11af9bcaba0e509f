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
from palmd.model.compiled import Library
from palmd.model.pivot import BATCH, CONSTANTS, MOTION, P
from palmd.observer.pivot.record import TAPS, PivotRecord, Rows

MAX_ITERATIONS = 60
NEGLIGIBLE = 0.02
FIRST_DAMPING, LEAST_DAMPING, MAX_DAMPING = 1e-3, 1e-10, 1e8
CORRECTIONS, GOOD_ENOUGH = 4, 0.9  # of the splines alone, unless the cost falls by a tenth at once
GATE = 16.0  # squared normalised residual beyond which a reading's pull falls off: 4 sigma
WIDE, NARROWER = 1.5, 0.7  # spread of residuals from which the gate is wider, and how much narrower it must come
# What most bodies are like: how far the centre of mass is off the outline's middle, and the radius of gyration in mean
# radii with its relative one-sigma (a uniform convex body has 0.70 to 0.72, a ring 1).
CENTRE_SD_M, GYRATION, GYRATION_SD = 1e-3, 0.707, 0.1
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

    outliers: share of the pad's readings beyond the gate.
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

    def __init__(self, library: Library, record: PivotRecord, known: Known):
        self.record = record
        self.known = known
        force = "rigid_force" if record.rig.vertical == "rigid" else "slide_force"
        self._p = np.zeros(CONSTANTS)
        kinds = (("reading", record.readings), ("height", record.heights), (force, record.forces))
        self._kernels = [_Kernel(library, name, rows, self._p) for name, rows in kinds]
        self._kernels.append(_Kernel(library, "slide_torque", record.torques, self._p))
        rows = [kernel.rows for kernel in self._kernels]
        columns = np.concatenate([(each.first[:, None] + np.arange(TAPS)).ravel() for each in rows])
        self._pattern = (columns, np.arange(0, len(columns) + 1, TAPS))

    def fit(self, c: FloatArray, p: FloatArray, soft: Softening = SHARP, iterations: int = MAX_ITERATIONS) -> PivotFit:
        """Iterate until nothing moves any more; the result may be a local minimum."""
        self._open_gates(c, p, soft)
        now = self.linearised(c, p, soft)
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
            trial = c + step[0], p + step[1]
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
            (c, p), now = trial, then
            if self._narrow_gates():
                settled, now = False, self.linearised(c, p, soft)
            damping = max(damping / 8.0, LEAST_DAMPING)
        return PivotFit(c, p, now.cost, *now.chi2, now.outliers, now.strain, count, settled)

    def _open_gates(self, c: FloatArray, p: FloatArray, soft: Softening) -> None:
        """Set the gates by how far all residuals are now."""
        for kernel in self._kernels:
            kernel.gate = math.inf
        self.linearised(c, p, soft)
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
        """Readings, heights, forces and torques as the model has them."""
        self._p[:] = p
        return [kernel.predicted(self.record.motion(c, kernel.rows)) for kernel in self._kernels]

    def linearised(self, c: FloatArray, p: FloatArray, soft: Softening = SHARP) -> _Normal:
        """The normal equations; the cost is infinite where they are void."""
        self._p[:] = p
        factors = (soft.readings, soft.heights, soft.forces, soft.torques)
        with np.errstate(all="ignore"):
            parts = [
                kernel.evaluate(self.record.motion(c, kernel.rows), factor)
                for kernel, factor in zip(self._kernels, factors, strict=True)
            ]
            in_c = np.concatenate([part[0].ravel() for part in parts])
            in_p = np.concatenate([part[1] for part in parts])
            residual = np.concatenate([part[2] for part in parts])
            deviation = (p - self.known.mean) / self.known.sd
            likely, in_likely = likely_body(p)
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
            in_p.T @ in_p + np.diag(1 / self.known.sd**2) + in_likely.T @ in_likely,
            c_side,
            in_p.T @ residual - deviation / self.known.sd - in_likely.T @ likely,
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
            schur = now.corner + np.diag(damping / self.known.sd**2) - now.border.T @ solved[:, :-1]
            step = cho_solve(cho_factor(schur), now.p_side - now.border.T @ solved[:, -1])
        except _UNSOLVABLE:
            return None
        return solved[:, -1] - solved[:, :-1] @ step, step

    def solved(self, normal: _Normal) -> FloatArray | None:
        """By how much the constants would move, None where that is open."""
        step = self._step(normal, 0.0)
        return None if step is None else step[1]

    def covariance(self, fit: PivotFit) -> FloatArray:
        """Of the constants; raises LinAlgError where the fit is no minimum."""
        self._open_gates(fit.c, fit.p, SHARP)
        now = self.linearised(fit.c, fit.p)
        if not math.isfinite(now.cost):
            raise np.linalg.LinAlgError("the fit is beyond all numbers")
        factor = cholesky_banded(now.banded, lower=True)
        solved = cho_solve_banded((factor, True), now.border)
        schur = now.corner - now.border.T @ solved
        scale = self.known.sd
        inverse = np.linalg.inv(schur * np.outer(scale, scale)) * np.outer(scale, scale)
        covariance: FloatArray = (inverse + inverse.T) / 2
        if not (np.diagonal(covariance) >= 0).all():
            raise np.linalg.LinAlgError("the fit is no minimum")
        return covariance


def moved_by_gain(problem: Problem, library: Library, fit: PivotFit) -> FloatArray:
    """(CONSTANTS, modes): how a fit moves where the pad's gain is off by one sigma, or drifts by it, in each touch.

    Readings of one touch share their gain, so that no number of them averages it out.
    """
    record, share = problem.record, problem.record.rig.pad.force_gain_std
    rows = record.forces
    none: FloatArray = np.zeros((CONSTANTS, 0))
    if not share or not len(rows.t):
        return none
    before = problem.linearised(fit.c, fit.p)
    moves = []
    for touch in record.touches:
        mine = (rows.t >= touch.begin) & (rows.t <= touch.end)
        along = 2.0 * (rows.t - touch.begin) / (touch.end - touch.begin) - 1.0
        for mode in (1.0, along):
            forces = replace(rows, value=rows.value * (1.0 + share * mode * mine))
            after = Problem(library, replace(record, forces=forces), problem.known).linearised(fit.c, fit.p)
            step = problem.solved(
                replace(before, c_side=after.c_side - before.c_side, p_side=after.p_side - before.p_side)
            )
            if step is not None:
                moves.append(step)
    return np.array(moves).T if moves else none


class _Kernel:
    """Rows of one kind, bound to their kernel."""

    def __init__(self, library: Library, name: str, rows: Rows, p: FloatArray):
        self.rows = rows
        self.gate = self.wanted = GATE
        n = len(rows.t)
        size = -(-max(n, 1) // BATCH) * BATCH
        self._motion, inputs = np.zeros((size, MOTION)), np.zeros((size, rows.inputs.shape[1]))
        inputs[:n] = rows.inputs
        self._value, self._gradient = np.zeros(size), np.zeros((size, MOTION + CONSTANTS))
        self._calls = [
            library.bind(
                f"{name}_batch",
                [self._motion[at : at + BATCH], p, inputs[at : at + BATCH]],
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
        """(gradients in the coefficients, in the constants, residuals, all weighed; cost, χ², share of outliers)."""
        rows = self.rows
        n = len(rows.t)
        if not n:
            return np.zeros((0, TAPS)), np.zeros((0, CONSTANTS)), np.zeros(0), 0.0, 0.0, 0.0
        residual = rows.value - self.predicted(motion)
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
        J = self._gradient[:n]
        in_c = np.einsum("nq,nqk->nk", J[:, :MOTION], rows.weights)
        return in_c * root[:, None], J[:, MOTION:] * root[:, None], residual * root, cost, chi2, float(outlier.mean())


def likely_body(p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """By how many sigmas a body is not as most are, and the gradient of it (3, CONSTANTS).

    Its centre of mass lies near the outline's middle, which the first harmonic about P tells, and its radius of
    gyration is near that of a uniform body: so moment and inertia tell of each other.
    """
    mass, moment, inertia = p[P.MASS], p[P.MOMENT : P.MOMENT + 2], p[P.INERTIA]
    radius, middle = p[P.SHAPE], p[P.SHAPE + 1 : P.SHAPE + 3]
    com = moment / mass
    gyration = inertia / mass - com @ com  # ρ²
    wanted, sd = (GYRATION * radius) ** 2, 2 * GYRATION_SD * GYRATION**2 * radius**2
    off = np.array([*((com - middle) / CENTRE_SD_M), (gyration - wanted) / sd])
    J = np.zeros((3, CONSTANTS))
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
    level = np.maximum(problem.predicted(fit.c, fit.p)[2], 0.05)
    forces = replace(record.forces, variance=np.asarray(record.rig.pad.force_variance(level)))
    return Problem(library, replace(record, forces=forces), problem.known)
