"""Levenberg–Marquardt over a whole record at once: trajectory and constants that explain all readings best.

Unknown are the nodes x_k = (ψ, ω0) on a fixed time grid and the constants p of `model.smoothing`. The cost is a sum
of squares: readings about their prediction, each step's end about the next node (process noise), constants about
their prior. The normal matrix is block-tridiagonal in the nodes with a dense border for p; it is factored exactly
in that form, so an iteration costs a few milliseconds for ten seconds of readings. Not for use inside the loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded, solveh_banded
from scipy.sparse import csr_matrix

from palmd.events import FloatArray
from palmd.model.compiled import BoundCall, Library
from palmd.model.smoothing import BATCH, CONSTANTS, NODE, C
from palmd.observer.record import Record

IntArray = npt.NDArray[np.intp]

GATE = 16.0  # squared normalised residual beyond which a reading's pull falls off: 4 sigma
GAUGE_SD = 1e-7  # rad, of ψ at the first node
MAX_ITERATIONS = 60
NEGLIGIBLE = 0.03  # fall of the cost (twice a log-likelihood) that is not worth another iteration
FIRST_DAMPING, LEAST_DAMPING, MAX_DAMPING = 1e-2, 1e-9, 1e8
BAND = 2 * NODE  # diagonals of the normal matrix in the nodes, from the main one down
CORRECTIONS, GOOD_ENOUGH = 2, 0.9  # of the nodes alone, unless the cost falls by a tenth at once
WILD_SPIN = 200.0  # rad/s
_UNSOLVABLE = (np.linalg.LinAlgError, ValueError)  # the latter is what scipy says of numbers that are not finite
# Lengths in which a step is measured by the damping: radians and radians per second of the nodes.
_NODE_SCALE = np.array([0.05, 0.5])


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Densities of what the model leaves out: of ψ (rad²/s) and of ω0 ((rad/s)²/s)."""

    psi: float
    omega0: float


@dataclass(frozen=True, slots=True)
class Prior:
    """Independent Gaussian belief about the constants, and about ω0 at the first node (rad/s).

    Only for ln ρ it depends on another constant: `mean` and `sd` hold for ln(ρ/h0), h0 the mean radius.
    """

    mean: FloatArray
    sd: FloatArray
    omega0_sd: float

    def rows(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(Jacobian, value) of the belief's residuals at `p`, each of one-sigma 1."""
        miss = p - self.mean
        miss[C.LN_RHO] -= math.log(p[C.SHAPE])
        rows = np.diag(1.0 / self.sd)
        rows[C.LN_RHO, C.SHAPE] = -1.0 / (p[C.SHAPE] * self.sd[C.LN_RHO])
        return rows, miss / self.sd


@dataclass(frozen=True, slots=True)
class Guess:
    """Where an iteration starts or ends: nodes (K + 1, 2) and constants (CONSTANTS)."""

    x: FloatArray
    p: FloatArray

    def on(self, own: FloatArray, wanted: FloatArray) -> Guess:
        """The same on nodes at other times: `own` are the present ones."""
        psi = CubicHermiteSpline(own, self.x[:, 0], self.x[:, 1])
        return Guess(np.stack([psi(wanted), psi(wanted, 1)], axis=1), self.p)


@dataclass(frozen=True, slots=True)
class Fit:
    """A minimum that was found: its cost, χ² per contact and force reading (robust), and how the iteration ended.

    `slack` is what the steps' noise and `strain` what the prior contributes to the cost; `outliers` is the share of
    contact readings beyond the gate, `astray` the longest run of them.
    """

    guess: Guess
    noise: ProcessNoise
    cost: float
    chi2: float
    force_chi2: float
    slack: float
    strain: float
    outliers: float
    astray: int
    iterations: int
    settled: bool


@dataclass(frozen=True, slots=True)
class Posterior:
    """Covariance of (constants, last node), (CONSTANTS + 2) square, and the record's log marginal likelihood.

    The latter is Laplace's approximation up to a constant of the record: it compares process noises and rivals.
    """

    covariance: FloatArray
    evidence: float


@dataclass(frozen=True, slots=True)
class _Linear:
    """The normal equations at one point: banded (4, 2(K + 1)) lower form, border, corner, right-hand sides."""

    cost: float
    chi2: float
    force_chi2: float
    slack: float
    strain: float
    outliers: float
    astray: int
    banded: FloatArray
    border: FloatArray
    corner: FloatArray
    node_side: FloatArray
    constant_side: FloatArray

    def promise(self, step: Guess) -> float:
        """By how much a full Newton step would lower the cost if the problem were linear."""
        return float(self.node_side @ step.x.ravel() + self.constant_side @ step.p)


class Smoother:
    """The least-squares problem of one record; `fit` may be called with many guesses and process noises."""

    def __init__(self, library: Library, record: Record, prior: Prior):
        """Binds the kernels to arrays of the record's size."""
        self._record = record
        self._prior = prior
        self._p = np.zeros(CONSTANTS)
        rows = _padded(len(record.dt))
        self._step_inputs = record.step_inputs(rows)
        self._pattern = _pattern(record)
        self._a = np.zeros((rows, NODE))
        self._end, self._step_jacobian = np.zeros((rows, NODE)), np.zeros((rows, NODE + CONSTANTS, NODE))
        ends = [self._end, self._step_jacobian]
        self._steps = _bound(library, "step_batch", [self._a], self._p, self._step_inputs, ends)
        self._now, self._then, self._u = np.zeros(NODE), np.zeros(NODE), np.zeros(self._step_inputs.shape[1])
        self._one_step = library.bind("advance", [self._now, self._p, self._u], [self._then])
        contacts = record.contact_inputs(_padded(len(record.contact_step)))
        self._contacts = _Readings(library, "contact_batch", record.contact_step, contacts, self._p)
        forces = record.force_inputs(_padded(len(record.force_step)))
        self._forces = _Readings(library, "force_batch", record.force_step, forces, self._p)

    def fit(self, start: Guess, noise: ProcessNoise, iterations: int = MAX_ITERATIONS) -> Fit:
        """Iterate from `start` until nothing moves any more; the result may be a local minimum.

        A step that looks bad is given a second chance: with the constants of the step, the nodes alone are solved
        for again. Friction makes the trajectory a strongly curved function of the constants, and without this the
        iteration creeps along a narrow bent valley.
        """
        guess = self.completed(start)
        now = self._linearise(guess, noise)
        if not math.isfinite(now.cost):
            return Fit(guess, noise, math.inf, math.inf, math.inf, math.inf, math.inf, 1.0, 0, 0, False)
        damping, count, settled = FIRST_DAMPING, 0, False
        while count < iterations and damping < MAX_DAMPING and not settled:
            count += 1
            step = _solved(now, damping, self._prior.sd)
            if step is not None and damping <= FIRST_DAMPING and now.promise(step) < NEGLIGIBLE:
                settled = True
                break
            found = self._corrected(Guess(guess.x + step.x, guess.p + step.p), noise, now.cost) if step else None
            if found is None:
                damping *= 6.0
                continue
            settled = now.cost - found[1].cost < NEGLIGIBLE
            guess, now = found
            damping = max(damping / 5.0, LEAST_DAMPING)
        return Fit(
            guess,
            noise,
            now.cost,
            now.chi2,
            now.force_chi2,
            now.slack,
            now.strain,
            now.outliers,
            now.astray,
            count,
            settled,
        )

    def completed(self, guess: Guess) -> Guess:
        """The guess as it is, or carried on by the model where it has fewer nodes than the record."""
        known, wanted = len(guess.x), len(self._record.t)
        if known == wanted:
            return guess
        x = np.empty((wanted, NODE))
        x[:known] = guess.x
        self._p[:] = guess.p
        for k in range(known - 1, wanted - 1):
            self._now[:], self._u[:] = x[k], self._step_inputs[k]
            self._one_step()
            x[k + 1] = self._then if abs(self._then[1]) < WILD_SPIN else x[k]
        return Guess(x, guess.p)

    def forces(self, guess: Guess) -> FloatArray:
        """Predicted force (N) of each force reading."""
        self._p[:] = guess.p
        return self._forces.predicted(guess.x)

    def residuals(self, guess: Guess) -> FloatArray:
        """Each contact reading less its prediction, in sigmas of its noise."""
        self._p[:] = guess.p
        record = self._record
        return (record.contact_value - self._contacts.predicted(guess.x)) / np.sqrt(record.contact_variance)

    def _corrected(self, trial: Guess, noise: ProcessNoise, to_beat: float) -> tuple[Guess, _Linear] | None:
        """The trial with its nodes solved for again while that helps; None if it does not beat the cost so far."""
        if not _sane(trial):
            return None
        then = self._linearise(trial, noise)
        if not math.isfinite(then.cost):
            return None
        for _ in range(CORRECTIONS):
            if then.cost < GOOD_ENOUGH * to_beat:
                break
            better = Guess(trial.x + _solved_nodes(then), trial.p)
            if not _sane(better):
                break
            after = self._linearise(better, noise)
            if not after.cost < 0.999 * then.cost:
                break
            trial, then = better, after
        return (trial, then) if then.cost < to_beat else None

    def posterior(self, fit: Fit) -> Posterior:
        """How sure the fit is of itself; raises LinAlgError where it is no minimum."""
        noise = fit.noise
        now = self._linearise(fit.guess, noise)
        if not math.isfinite(now.cost):
            raise np.linalg.LinAlgError("the fit is beyond all numbers")
        factor = cholesky_banded(now.banded, lower=True)
        last = np.zeros((len(now.node_side), NODE))
        last[-NODE:] = np.eye(NODE)
        solved = cho_solve_banded((factor, True), np.concatenate([now.border, last], axis=1))
        schur = now.corner - now.border.T @ solved[:, :CONSTANTS]
        constants = np.linalg.inv(schur)
        tail, own = solved[-NODE:, :CONSTANTS], solved[-NODE:, CONSTANTS:]  # x_last = its own − tail · p
        covariance = np.block([[constants, -constants @ tail.T], [-tail @ constants, own + tail @ constants @ tail.T]])
        log_det = 2 * float(np.log(factor[0]).sum()) + float(np.linalg.slogdet(schur)[1])
        steps = len(self._record.dt)
        normaliser = steps * (math.log(noise.psi) + math.log(noise.omega0))
        return Posterior((covariance + covariance.T) / 2, -0.5 * (now.cost + log_det + normaliser))

    # ---- one point

    def _linearise(self, guess: Guess, noise: ProcessNoise) -> _Linear:
        """The normal equations at `guess`; where anything overflows the cost is infinite and the rest is void."""
        with np.errstate(over="ignore", invalid="ignore"):
            now = self._normal_equations(guess, noise)
            sums = now.cost + now.banded.sum() + now.border.sum() + now.corner.sum() + now.node_side.sum()
        return now if math.isfinite(sums) else replace(now, cost=math.inf)

    def _normal_equations(self, guess: Guess, noise: ProcessNoise) -> _Linear:
        record, x, prior = self._record, guess.x, self._prior
        steps = len(record.dt)
        self._p[:] = guess.p
        self._a[:steps] = x[:-1]
        for call in self._steps:
            call()
        contacts = self._contacts.evaluate(x, record.contact_value, record.contact_variance)
        forces = self._forces.evaluate(x, record.force_value, record.force_variance)
        J = self._step_jacobian[:steps].transpose(0, 2, 1).reshape(steps * NODE, NODE + CONSTANTS)
        root = 1.0 / np.sqrt(np.outer(record.dt, [noise.psi, noise.omega0]).ravel())

        # every residual is a row, divided by its one-sigma: first the steps' ends, then the readings
        in_nodes = np.concatenate(
            [
                np.column_stack([J[:, :NODE], np.full(len(J), -1.0)]).ravel() * np.repeat(root, NODE + 1),
                (contacts.gradient[:, : 2 * NODE] * contacts.root[:, None]).ravel(),
                (forces.gradient[:, : 2 * NODE] * forces.root[:, None]).ravel(),
            ]
        )
        in_constants = np.concatenate(
            [
                J[:, NODE:] * root[:, None],
                contacts.gradient[:, 2 * NODE :] * contacts.root[:, None],
                forces.gradient[:, 2 * NODE :] * forces.root[:, None],
            ]
        )
        defect = (self._end[:steps] - x[1:]).ravel() * root
        residual = np.concatenate([defect, -contacts.residual * contacts.root, -forces.residual * forces.root])
        rows, belief = prior.rows(guess.p)
        first = np.array([GAUGE_SD**-2, prior.omega0_sd**-2])

        sparse = csr_matrix((in_nodes, *self._pattern), shape=(len(residual), x.size))
        across = sparse.T.tocsr()
        normal = across @ sparse
        banded = np.zeros((BAND, x.size))
        for k in range(BAND):
            banded[k, : x.size - k] = normal.diagonal(-k)
        banded[0, :NODE] += first
        side = -(across @ residual)
        side[:NODE] -= first * x[0]
        slack, strain = float(defect @ defect), float(belief @ belief + first @ x[0] ** 2)
        cost = contacts.cost + forces.cost + slack + strain
        return _Linear(
            cost, contacts.chi2, forces.chi2, slack, strain, contacts.outliers, contacts.astray,
            banded, across @ in_constants, in_constants.T @ in_constants + rows.T @ rows,
            side, -(in_constants.T @ residual) - rows.T @ belief,
        )  # fmt: skip


def _pattern(record: Record) -> tuple[IntArray, IntArray]:
    """Columns and row starts of the residuals' Jacobian in the nodes, as `_linearise` fills it."""
    k = np.arange(len(record.dt))
    ends = np.stack([np.stack([2 * k, 2 * k + 1, 2 * k + 2 + i], axis=1) for i in range(NODE)], axis=1)
    readings = [np.add.outer(NODE * step, np.arange(2 * NODE)) for step in (record.contact_step, record.force_step)]
    columns = np.concatenate([ends.ravel(), *(each.ravel() for each in readings)])
    lengths = np.concatenate([np.full(NODE * len(k), NODE + 1), *(np.full(len(each), 2 * NODE) for each in readings)])
    return columns, np.concatenate([[0], np.cumsum(lengths)])


@dataclass(frozen=True, slots=True)
class _Evaluated:
    residual: FloatArray  # value − prediction
    root: FloatArray  # of the weight: one over the one-sigma, less for outliers
    gradient: FloatArray  # (n, 4 + CONSTANTS)
    cost: float
    chi2: float
    outliers: float
    astray: int


class _Readings:
    """Readings of one kind, bound to their kernel."""

    def __init__(self, library: Library, kernel: str, step: IntArray, inputs: FloatArray, p: FloatArray):
        rows = len(inputs)
        self._step = step
        self._a, self._b = np.zeros((rows, NODE)), np.zeros((rows, NODE))
        self._value, self._gradient = np.zeros(rows), np.zeros((rows, 2 * NODE + CONSTANTS))
        self._calls = _bound(library, kernel, [self._a, self._b], p, inputs, [self._value, self._gradient])

    def predicted(self, x: FloatArray) -> FloatArray:
        n = len(self._step)
        self._a[:n], self._b[:n] = x[self._step], x[self._step + 1]
        for call in self._calls:
            call()
        return self._value[:n].copy()

    def evaluate(self, x: FloatArray, values: FloatArray, variance: FloatArray) -> _Evaluated:
        n = len(values)
        residual = values - self.predicted(x)
        nis = residual**2 / variance
        # far from the answer all residuals are large: only what stands out from the others is an outlier
        gate = GATE * max(1.0, float(np.median(nis)) / 0.455) if n else GATE
        outlier = nis > gate
        root = np.sqrt(np.where(outlier, gate / np.maximum(nis, gate), 1.0) / variance)
        cost = np.where(outlier, gate * (1.0 + np.log(np.maximum(nis, gate) / gate)), nis)
        total = float(cost.sum())
        # of what is no outlier: those are counted, and have no say in how well the others are explained
        chi2 = float(nis[~outlier].mean()) if n and not outlier.all() else math.inf
        outliers = float(outlier.sum()) / max(n, 1)
        return _Evaluated(
            residual, root, self._gradient[:n], total, chi2 if n else 0.0, outliers, _longest_run(outlier)
        )


def _longest_run(flags: npt.NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.intp), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _solved(now: _Linear, damping: float, scale: FloatArray) -> Guess | None:
    banded = now.banded.copy()
    banded[0] += np.tile(damping / _NODE_SCALE**2, banded.shape[1] // NODE)
    try:
        factor = cholesky_banded(banded, lower=True, overwrite_ab=True)
        solved = cho_solve_banded((factor, True), np.column_stack([now.border, now.node_side]))
        schur = now.corner + np.diag(damping / scale**2) - now.border.T @ solved[:, :-1]
        p = cho_solve(cho_factor(schur), now.constant_side - now.border.T @ solved[:, -1])
    except _UNSOLVABLE:
        return None
    x = solved[:, -1] - solved[:, :-1] @ p
    return Guess(x.reshape(-1, NODE), p)


def _solved_nodes(now: _Linear) -> FloatArray:
    """The Newton step of the nodes alone, zero where there is none."""
    try:
        step: FloatArray = solveh_banded(now.banded, now.node_side, lower=True)
    except _UNSOLVABLE:
        step = np.zeros(len(now.node_side))
    return step.reshape(-1, NODE)


def _sane(guess: Guess) -> bool:
    """Whether the kernels can be asked there: a lump of 1 to 200 mm that weighs something, no wild spin."""
    p = guess.p
    return bool(
        np.isfinite(guess.x).all()
        and np.isfinite(p).all()
        and 1e-3 < p[C.SHAPE] < 0.2
        and abs(p[C.LN_RHO] - math.log(p[C.SHAPE])) < 3.0
        and -12.0 < p[C.LN_DITHER] < 2.0
        and abs(p[C.LN_MASS]) < 12.0
        and np.abs(guess.x[:, 1]).max() < WILD_SPIN
    )


def _padded(count: int) -> int:
    return -(-max(count, 1) // BATCH) * BATCH


def _bound(
    library: Library, name: str, nodes: list[FloatArray], p: FloatArray, inputs: FloatArray, outputs: list[FloatArray]
) -> list[BoundCall]:
    rows = len(inputs)
    slices = [slice(at, at + BATCH) for at in range(0, rows, BATCH)]
    return [
        library.bind(name, [*(each[s] for each in nodes), p, inputs[s]], [each[s] for each in outputs]) for s in slices
    ]
