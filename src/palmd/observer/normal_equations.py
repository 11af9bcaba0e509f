"""Normal equations of a record at one trajectory and one set of constants: all readings and steps, linearised.

Unknown are the nodes x_k = (ψ, ω0) on a fixed time grid and the constants p of `model.smoothing` (or of a model with
more of them). The cost is a sum of squares: residuals of the readings, and defects of each step's end from the next
node (process noise). The normal matrix is block-tridiagonal in the nodes with a dense border for p. Prior knowledge
(`observer.factor`) is added to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import LANES, Library
from palmd.model.smoothing import NODE, C
from palmd.observer.factor import Factor, Terms, cholesky_solved
from palmd.observer.median import median
from palmd.observer.record import Record
from palmd.observer.reduction import IntArray, ReadingRows, Reduced, StepRows, Weighed, arithmetic

NODE_SCALE = np.array([0.05, 0.5])
"""Scale of a step of the nodes in the damping: rad and rad/s."""

NO_DAMPING = np.zeros(NODE)
WILD_SPIN = 200.0  # rad/s
BLOW_SD = np.array([2e-3, 1.5])  # of ψ (rad) and of ω0 (rad/s) in one step, at an impact


MOST_DISCREPANCY = 1e4
"""(rad/s)²/s (derivation: 7 rad/s in a step of 5 ms, more than any object turns by): the motion is unknown."""


MOST_PULL = 100.0  # N (derivation: more than any pad measures): the force is unknown


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Spectral densities of the model's error: of ψ (rad²/s) and of ω0 ((rad/s)²/s).

    gate: squared normalised defect of a step beyond which a contact may have jumped, and the motion by `BLOW_SD`.
    """

    psi: float
    omega0: float
    gate: float = math.inf

    def noisier(self, times: float) -> ProcessNoise:
        """The densities times `times`, without a gate."""
        return ProcessNoise(times * self.psi, times * self.omega0)


LOOSENED = (1e3, 10.0)
"""Factors on the process noise of the first iterations, for fits far from their minimum or with stiff friction."""


@dataclass(frozen=True, slots=True)
class Guess:
    """A linearisation point: nodes (K + 1, 2) and constants (CONSTANTS)."""

    x: FloatArray
    p: FloatArray

    def on(self, own: FloatArray, wanted: FloatArray) -> Guess:
        """The guess on nodes at the times `wanted`; `own`: times of the present nodes."""
        interval = np.clip(np.searchsorted(own, wanted, side="right") - 1, 0, len(own) - 2)
        dt = own[interval + 1] - own[interval]
        u, (psi, omega0), (psi_then, omega0_then) = (
            (wanted - own[interval]) / dt,
            self.x[interval].T,
            self.x[interval + 1].T,
        )
        rise, bend = psi_then - psi, dt * (omega0 + omega0_then)  # cubic Hermite
        square, cube = 3 * rise - bend - dt * omega0, bend - 2 * rise
        interpolated = psi + u * (dt * omega0 + u * (square + u * cube))
        return Guess(np.stack([interpolated, omega0 + u * (2 * square + 3 * u * cube) / dt], axis=1), self.p)


@dataclass(frozen=True, slots=True)
class Misfit:
    """The cost at one point, and its parts.

    process_cost: of the process noise. prior_cost: of prior knowledge, above its minimum. outliers: share of contact
    readings beyond the gate. outlier_run: the longest run of them. χ² is per contact and per force reading, robust.
    """

    cost: float
    chi2: float
    force_chi2: float
    process_cost: float
    prior_cost: float
    outliers: float
    outlier_run: int


@dataclass(frozen=True, slots=True)
class NormalEquations(Misfit):
    """Matrix and right-hand side at one point, as in `observer.reduction`."""

    banded: FloatArray
    rows: FloatArray
    whole_corner: FloatArray
    constants: int

    @property
    def border(self) -> FloatArray:
        """Nodes by constants (2(K + 1), constants)."""
        return self.rows[:, : self.constants]

    @property
    def corner(self) -> FloatArray:
        """Constants by constants."""
        return self.whole_corner[: self.constants, : self.constants]

    @property
    def node_side(self) -> FloatArray:
        """Right-hand side of the nodes."""
        return self.rows[:, self.constants]

    @property
    def constant_side(self) -> FloatArray:
        """Right-hand side of the constants."""
        return self.whole_corner[self.constants, : self.constants]

    def predicted_decrease(self, step: Guess) -> float:
        """Decrease of the cost by a full Newton step if the problem were linear."""
        return float(self.node_side @ step.x.ravel() + self.constant_side @ step.p)

    def plus_knowledge(self, known: Terms) -> NormalEquations:
        """With prior knowledge of the constants and the first node added; the arrays are modified in place."""
        side = self.constants
        node_block = known.matrix[side:, side:]
        for k in range(NODE):
            self.banded[k, : NODE - k] += node_block.diagonal(-k)
        self.rows[:NODE, :side] += known.matrix[side:, :side]
        self.rows[:NODE, side] += known.side[side:]
        self.whole_corner[:side, :side] += known.matrix[:side, :side]
        self.whole_corner[side, :side] += known.side[:side]
        self.whole_corner[:side, side] += known.side[:side]
        return replace(self, cost=self.cost + known.cost, prior_cost=known.excess)

    def with_knowledge_replaced(self, known: Terms, before: Terms) -> NormalEquations:
        """With prior knowledge `before` replaced by `known`, in a copy; the cost is not updated."""
        copied = replace(self, banded=self.banded.copy(), rows=self.rows.copy(), whole_corner=self.whole_corner.copy())
        return copied.plus_knowledge(Terms(0.0, known.excess, known.matrix - before.matrix, known.side - before.side))

    def solved(self, damping: float, scale: FloatArray) -> Guess:
        """The damped Newton step of nodes and constants; raises LinAlgError where there is none.

        The damping measures a step of the nodes by `NODE_SCALE`, that of the constants by `scale`.
        """
        reduced = arithmetic().reduced(self.banded, damping / NODE_SCALE**2, self.rows, self.whole_corner)
        return self._stepped(reduced, np.diag(damping / scale**2))

    def _stepped(self, reduced: Reduced, damping: FloatArray | float = 0.0) -> Guess:
        """The step of nodes and constants, from the `reduced` nodes."""
        side = self.constants
        p = cholesky_solved(reduced.left[:side, :side] + damping, reduced.left[side, :side])
        coefficients = np.zeros(self.rows.shape[1])
        coefficients[:side], coefficients[side] = -p, 1.0
        return Guess(arithmetic().back(reduced, coefficients).reshape(-1, NODE), p)

    def nodes_solved(self) -> FloatArray:
        """The Newton step of the nodes (K + 1, 2) at fixed constants; raises LinAlgError where there is none."""
        return _nodes_solved(self.banded, self.node_side)

    def posterior(self) -> tuple[FloatArray, float, Guess]:
        """Covariance of (constants, last node), the matrix's log-determinant, and the Newton step.

        Raises LinAlgError where the point is not a minimum.
        """
        reduced = arithmetic().reduced(self.banded, NO_DAMPING, self.rows, self.whole_corner)
        side = self.constants
        schur = reduced.left[:side, :side]
        constants = np.linalg.inv(schur)
        (first, second), below = reduced.factor[0, -NODE:], reduced.factor[1, -NODE]
        root = np.linalg.inv(np.array([[first, 0.0], [below, second]]))
        tail, own = root.T @ reduced.rows[-NODE:, :side], root.T @ root  # x_last = its own − tail · p
        covariance = np.block([[constants, -constants @ tail.T], [-tail @ constants, own + tail @ constants @ tail.T]])
        log_det = 2 * float(np.log(reduced.factor[0]).sum()) + float(np.linalg.slogdet(schur)[1])
        return (covariance + covariance.T) / 2, log_det, self._stepped(reduced)

    def summary(self, guess: Guess, scale: FloatArray) -> Factor:
        """The cost as a factor of (p, first node, last node); the nodes in between are marginalised.

        For at least two steps. Raises LinAlgError where the readings do not determine a node in between.
        """
        (n, width), side = self.rows.shape, self.constants
        inner = slice(NODE, n - NODE)
        first, last = slice(width, width + NODE), slice(width + NODE, width + 2 * NODE)
        rows = np.zeros((n - 2 * NODE, width + LANES))
        rows[:, :width] = self.rows[inner]
        rows[:NODE, first] = _below(self.banded, 0)
        rows[-NODE:, last] = _below(self.banded, n - 2 * NODE).T
        corner = np.zeros((width + LANES, width + LANES))
        corner[:width, :width] = self.whole_corner
        for own, node in ((first, 0), (last, n - NODE)):
            corner[own, own] = _block(self.banded, node)
            corner[own, :width] = self.rows[node : node + NODE]
            corner[:width, own] = self.rows[node : node + NODE].T
        left = arithmetic().reduced(self.banded[:, inner], NO_DAMPING, rows, corner).left
        kept = np.concatenate([np.arange(side), np.arange(first.start, last.stop)])
        cost = self.cost + float(left[side, side] - corner[side, side])
        matrix = left[np.ix_(kept, kept)]
        return Factor(
            np.concatenate([guess.p, guess.x[0], guess.x[-1]]), cost, (matrix + matrix.T) / 2, left[side, kept], scale
        )

    def inner_step(self, ends: FloatArray) -> FloatArray:
        """The Newton step of the nodes (K + 1, 2) with a given step of (p, first node, last node)."""
        n, side = len(self.rows), self.constants
        inner, step = slice(NODE, n - NODE), np.zeros((n // NODE, NODE))
        step[0], step[-1] = ends[side : side + NODE], ends[side + NODE :]
        pull = self.node_side[inner] - self.border[inner] @ ends[:side]
        pull[:NODE] -= _below(self.banded, 0) @ step[0]
        pull[-NODE:] -= _below(self.banded, n - 2 * NODE).T @ step[-1]
        step[1:-1] = _nodes_solved(self.banded[:, inner], pull)
        return step


class Residuals:
    """The kernels of one record, bound to arrays of its size."""

    def __init__(self, library: Library, record: Record):
        self.record = record
        _, constants = library.signatures["step_batch"].inputs[1]
        self._p, maps = np.zeros(constants), record.contact_map.shape[1]
        self.constants = constants + maps
        rows = _padded(len(record.dt))
        self._step_inputs = record.step_inputs(rows)
        self._a = np.zeros((rows, NODE))
        self._end, self._step_jacobian = np.zeros((rows, NODE)), np.zeros((rows, NODE + constants, NODE))
        ends = [self._end, self._step_jacobian]
        self._steps = library.bind("step_batch", [self._a, self._p, self._step_inputs], ends)
        self._now, self._then, self._u = np.zeros(NODE), np.zeros(NODE), np.zeros(self._step_inputs.shape[1])
        self._one_step = library.bind("advance", [self._now, self._p, self._u], [self._then])
        contacts = record.contact_inputs(_padded(len(record.contact_step)))
        self._contacts = _Readings(library, "contact_batch", record.contact_step, contacts, self._p, maps)
        self._contacts.wide[: len(record.contact_step), 2 * NODE + constants :] = record.contact_map
        forces = record.force_inputs(_padded(len(record.force_step)))
        self._forces = _Readings(library, "force_batch", record.force_step, forces, self._p, maps)
        self._wide_jacobian = np.zeros((rows, NODE + self.constants, NODE)) if maps else self._step_jacobian
        self._library = library

    def completed(self, guess: Guess) -> Guess:
        """The guess, continued by the model where it has fewer nodes than the record."""
        given, wanted = len(guess.x), len(self.record.t)
        if given == wanted:
            return guess
        x = np.empty((wanted, NODE))
        x[:given] = guess.x
        self._take(guess)
        for k in range(given - 1, wanted - 1):
            self._now[:], self._u[:] = x[k], self._step_inputs[k]
            self._one_step()
            x[k + 1] = self._then if abs(self._then[1]) < WILD_SPIN else x[k]
        return Guess(x, guess.p)

    def forces(self, guess: Guess) -> FloatArray:
        """Predicted force (N) of each force reading."""
        self._take(guess)
        return self._forces.predicted(guess.x)

    def contact_forces(self, guess: Guess) -> FloatArray:
        """Predicted force (N) at each contact reading, whether its pad measures forces or not."""
        record = self.record
        inputs = record.contact_force_inputs(_padded(len(record.contact_step)))
        self._take(guess)
        return _Readings(self._library, "force_batch", record.contact_step, inputs, self._p).predicted(guess.x)

    def discrepancy(self, guess: Guess, hopping_only: bool) -> tuple[FloatArray, FloatArray]:
        """What the friction law leaves open: of ω0 in each step ((rad/s)²/s), and of each force reading (N²).

        hopping_only: of ω0 only in steps in which contacts hop. A force is off by about what contacts would have to
        pull (study 2026-11-30, Drake in antiphase, seed 7000: where that is 0.06 and 0.1 N, forces are off by 2.3 and
        1.9σ of their noise, and by 1.0 and 0.6σ with it).
        """
        steps, left = len(self.record.dt), np.zeros((len(self._a) + 1, 3))
        self._take(guess)
        self._a[:steps] = guess.x[:-1]
        self._library.bind("discrepancy_batch", [self._a, self._p, self._step_inputs], [left[:-1]])()
        left[steps:] = 0.0
        pull = math.exp(guess.p[C.LN_MASS]) * left[self.record.force_step, 2]
        return _at_most(left[: steps + 1, int(hopping_only)], MOST_DISCREPANCY), _at_most(pull, MOST_PULL) ** 2

    def residuals(self, guess: Guess) -> FloatArray:
        """Residual of each contact reading, normalised by the σ of its noise."""
        record = self.record
        return (record.contact_value - self.predicted_contacts(guess)) / np.sqrt(record.contact_variance)

    def _take(self, guess: Guess) -> None:
        self._p[:] = guess.p[: len(self._p)]

    def predicted_contacts(self, guess: Guess) -> FloatArray:
        """Predicted contact readings (m), the pads' maps included."""
        self._take(guess)
        return self._contacts.predicted(guess.x) + self.record.contact_map @ guess.p[len(self._p) :]

    def linearised(self, guess: Guess, noise: ProcessNoise) -> NormalEquations:
        """The normal equations at `guess`; after an overflow the cost is infinite and the rest is invalid."""
        with np.errstate(over="ignore", invalid="ignore"):
            equations = self._linearised(guess, noise)
            total = equations.cost + equations.banded.sum() + equations.rows.sum() + equations.whole_corner.sum()
        return equations if math.isfinite(total) else replace(equations, cost=math.inf)

    def _linearised(self, guess: Guess, noise: ProcessNoise) -> NormalEquations:
        record, x, routines = self.record, guess.x, arithmetic()
        steps = len(record.dt)
        self._take(guess)
        self._a[:steps] = x[:-1]
        self._steps()
        contacts = routines.weighed(
            self.predicted_contacts(guess), record.contact_value, record.contact_variance, record.contact_weight
        )
        forces = routines.weighed(
            self._forces.predicted(x), record.force_value, record.total_force_variance, record.force_weight
        )
        density = np.stack([np.full(steps, noise.psi), noise.omega0 + record.discrepancy[:-1]], axis=1)
        without_impacts = 1.0 / np.sqrt(record.dt[:, None] * density)
        without_impacts[record.gap_steps] = 0.0
        root, impact_cost = _step_weights(self._end[:steps] - x[1:], without_impacts, noise)
        root[record.gap_steps] = 0.0
        readings = [self._contacts.rows(contacts), self._forces.rows(forces)]
        if self._wide_jacobian is not self._step_jacobian:
            self._wide_jacobian[:, : self._step_jacobian.shape[1]] = self._step_jacobian
        steps_rows = StepRows(x, self._end[:steps], self._wide_jacobian[:steps], root)
        assembled = routines.assembled(steps_rows, readings)
        process_cost = assembled.process_cost + impact_cost
        return NormalEquations(
            contacts.cost + forces.cost + process_cost, contacts.chi2, forces.chi2, process_cost, 0.0,
            contacts.outliers, contacts.outlier_run, assembled.banded, assembled.rows, assembled.corner, self.constants,
        )  # fmt: skip


def _at_most(values: FloatArray, most: float) -> FloatArray:
    """The values, limited to `most`, which also stands for what is not a number."""
    return np.minimum(np.nan_to_num(values, nan=most), most)


def _step_weights(defect: FloatArray, root: FloatArray, noise: ProcessNoise) -> tuple[FloatArray, float]:
    """1/σ of each step's end (K, 2), and the cost of impacts beyond the weighted squares.

    Beyond the gate the cost grows logarithmically, plus the square by `BLOW_SD`.
    """
    if noise.gate == math.inf:
        return root, 0.0
    nis = (defect * root) ** 2
    # far from the minimum all defects are large: only a defect that stands out is an impact
    gate = noise.gate * max(1.0, median(nis.ravel()) / 0.455)
    beyond = nis > gate
    weight = np.where(beyond, gate / np.maximum(nis, gate), 1.0)
    cost = np.where(beyond, gate * np.log(np.maximum(nis, gate) / gate), 0.0)
    return np.sqrt(weight * root**2 + BLOW_SD**-2.0), float(cost.sum())


def _nodes_solved(banded: FloatArray, side: FloatArray) -> FloatArray:
    routines, rows, coefficients = arithmetic(), np.zeros((len(side), LANES)), np.zeros(LANES)
    rows[:, 0], coefficients[0] = side, 1.0
    reduced = routines.reduced(banded, NO_DAMPING, rows, np.zeros((LANES, LANES)))
    return routines.back(reduced, coefficients).reshape(-1, NODE)


def _block(banded: FloatArray, at: int) -> FloatArray:
    """Diagonal block of the normal matrix for a node, from its banded form."""
    lower = np.array([[banded[max(i - j, 0), at + j] for j in range(NODE)] for i in range(NODE)])
    block: FloatArray = np.tril(lower) + np.tril(lower, -1).T
    return block


def _below(banded: FloatArray, at: int) -> FloatArray:
    """Block below a node's diagonal block: rows of the next node, columns of this one."""
    return np.array([[banded[NODE + i - j, at + j] for j in range(NODE)] for i in range(NODE)])


class _Readings:
    """Readings of one kind, bound to their kernel."""

    def __init__(
        self, library: Library, kernel: str, step: IntArray, inputs: FloatArray, p: FloatArray, further: int = 0
    ):
        """further: number of constants after those of the kernel."""
        rows = len(inputs)
        self.step = step
        self._a, self._b = np.zeros((rows, NODE)), np.zeros((rows, NODE))
        self._value, self._gradient = np.zeros(rows), np.zeros((rows, 2 * NODE + len(p)))
        self.wide = np.zeros((rows, 2 * NODE + len(p) + further)) if further else self._gradient
        self._call = library.bind(kernel, [self._a, self._b, p, inputs], [self._value, self._gradient])

    def predicted(self, x: FloatArray) -> FloatArray:
        n = len(self.step)
        self._a[:n], self._b[:n] = x[self.step], x[self.step + 1]
        self._call()
        return self._value[:n].copy()

    def rows(self, weighed: Weighed) -> ReadingRows:
        """Linearised rows of the last call of `predicted`."""
        if self.wide is not self._gradient:
            self.wide[:, : self._gradient.shape[1]] = self._gradient
        return ReadingRows(self.step, self.wide[: len(self.step)], weighed.residual, weighed.root)


def _padded(count: int) -> int:
    return -(-max(count, 1) // LANES) * LANES
