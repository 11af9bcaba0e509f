"""The normal equations of a record at one trajectory and one set of constants: every reading and every step linearised.

Unknown are the nodes x_k = (ψ, ω0) on a fixed time grid and the constants p of `model.smoothing` (or
of a model with more of them). The cost is a sum of
squares: readings about their prediction, each step's end about the next node (process noise). The normal matrix is
block-tridiagonal in the nodes with a dense border for p. What is known besides (`observer.factor`) is added to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import cho_solve_banded, cholesky_banded, solveh_banded
from scipy.sparse import csr_matrix

from palmd.events import FloatArray
from palmd.model.compiled import LANES, Library
from palmd.model.smoothing import NODE
from palmd.observer.factor import Factor, Terms
from palmd.observer.record import Record

IntArray = npt.NDArray[np.intp]

GATE = 16.0  # squared normalised residual beyond which a reading's pull falls off: 4 sigma
BAND = 2 * NODE  # diagonals of the normal matrix in the nodes, from the main one down
WILD_SPIN = 200.0  # rad/s
BLOW_SD = np.array([2e-3, 1.5])  # of ψ (rad) and of ω0 (rad/s), within one step


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Densities of what the model leaves out: of ψ (rad²/s) and of ω0 ((rad/s)²/s).

    `gate`: squared normalised defect of a step beyond which a contact may have jumped, and the motion by `BLOW_SD`.
    """

    psi: float
    omega0: float
    gate: float = math.inf


@dataclass(frozen=True, slots=True)
class Guess:
    """A point to linearise at: nodes (K + 1, 2) and the constants."""

    x: FloatArray
    p: FloatArray

    def on(self, own: FloatArray, wanted: FloatArray) -> Guess:
        """The same on nodes at other times: `own` are the present ones."""
        psi = CubicHermiteSpline(own, self.x[:, 0], self.x[:, 1])
        return Guess(np.stack([psi(wanted), psi(wanted, 1)], axis=1), self.p)


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """At one point: banded (4, 2(K + 1)) lower form, border, corner, right-hand sides, and what the cost is made of.

    `slack` is what the steps' noise, `strain` what prior knowledge contributes; `outliers` is the share of contact
    readings beyond the gate, `astray` the longest run of them. χ² is per contact and per force reading, robust.
    """

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

    def knowing(self, known: Terms) -> NormalEquations:
        """With what is known of the constants and the first node."""
        banded, border, node_side = self.banded.copy(), self.border.copy(), self.node_side.copy()
        constants = len(self.constant_side)
        of_node = known.matrix[constants:, constants:]
        for k in range(NODE):
            banded[k, : NODE - k] += of_node.diagonal(-k)
        border[:NODE] += known.matrix[constants:, :constants]
        node_side[:NODE] += known.side[constants:]
        return replace(
            self,
            cost=self.cost + known.cost,
            strain=known.strain,
            banded=banded,
            border=border,
            corner=self.corner + known.matrix[:constants, :constants],
            node_side=node_side,
            constant_side=self.constant_side + known.side[:constants],
        )

    def summary(self, guess: Guess, scale: FloatArray) -> Factor:
        """The cost as one of (p, first node, last node): the nodes in between are marginalised.

        For two steps at least. Raises LinAlgError where the readings leave a node in between open.
        """
        inner = slice(NODE, len(self.node_side) - NODE)
        constants = len(self.constant_side)
        size = constants + 2 * NODE
        across = np.zeros((inner.stop - inner.start, size))
        across[:, :constants] = self.border[inner]
        across[:NODE, constants : constants + NODE] = _below(self.banded, 0)
        across[-NODE:, constants + NODE :] = _below(self.banded, len(self.node_side) - 2 * NODE).T
        matrix, side = np.zeros((size, size)), np.zeros(size)
        matrix[:constants, :constants], side[:constants] = self.corner, self.constant_side
        for at, node in ((constants, 0), (constants + NODE, len(self.node_side) - NODE)):
            own, nodes = slice(at, at + NODE), slice(node, node + NODE)
            matrix[own, own], side[own] = _block(self.banded, node), self.node_side[nodes]
            matrix[own, :constants] = self.border[nodes]
            matrix[:constants, own] = self.border[nodes].T
        factor = cholesky_banded(self.banded[:, inner], lower=True, check_finite=False)
        solved = cho_solve_banded((factor, True), np.column_stack([across, self.node_side[inner]]), check_finite=False)
        matrix -= across.T @ solved[:, :-1]
        return Factor(
            np.concatenate([guess.p, guess.x[0], guess.x[-1]]),
            self.cost - float(self.node_side[inner] @ solved[:, -1]),
            (matrix + matrix.T) / 2,
            side - across.T @ solved[:, -1],
            scale,
        )

    def inner_step(self) -> FloatArray:
        """The Newton step of the nodes (K + 1, 2) while p and both ends stand still."""
        step = np.zeros(len(self.node_side))
        inner = slice(NODE, len(step) - NODE)
        step[inner] = solveh_banded(self.banded[:, inner], self.node_side[inner], lower=True, check_finite=False)
        return step.reshape(-1, NODE)


class Residuals:
    """The kernels of one record, bound to arrays of its size."""

    def __init__(self, library: Library, record: Record):
        self.record = record
        constants = self._constants = library.signatures["step_batch"].inputs[1][1]
        self._p = np.zeros(constants)
        rows = _padded(len(record.dt))
        self._step_inputs = record.step_inputs(rows)
        self._pattern = _pattern(record)
        self._a = np.zeros((rows, NODE))
        self._end, self._step_jacobian = np.zeros((rows, NODE)), np.zeros((rows, NODE + constants, NODE))
        ends = [self._end, self._step_jacobian]
        self._steps = library.bind("step_batch", [self._a, self._p, self._step_inputs], ends)
        self._now, self._then, self._u = np.zeros(NODE), np.zeros(NODE), np.zeros(self._step_inputs.shape[1])
        self._one_step = library.bind("advance", [self._now, self._p, self._u], [self._then])
        contacts = record.contact_inputs(_padded(len(record.contact_step)))
        self._contacts = _Readings(library, "contact_batch", record.contact_step, contacts, self._p)
        forces = record.force_inputs(_padded(len(record.force_step)))
        self._forces = _Readings(library, "force_batch", record.force_step, forces, self._p)

    def completed(self, guess: Guess) -> Guess:
        """The guess as it is, or carried on by the model where it has fewer nodes than the record."""
        known, wanted = len(guess.x), len(self.record.t)
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

    def contacts(self, guess: Guess) -> FloatArray:
        """Each contact reading less its prediction, in sigmas of its noise."""
        self._p[:] = guess.p
        record = self.record
        return (record.contact_value - self._contacts.predicted(guess.x)) / np.sqrt(record.contact_variance)

    def linearised(self, guess: Guess, noise: ProcessNoise) -> NormalEquations:
        """The normal equations at `guess`; where anything overflows the cost is infinite and the rest is void."""
        with np.errstate(over="ignore", invalid="ignore"):
            now = self._linearised(guess, noise)
            sums = now.cost + now.banded.sum() + now.border.sum() + now.corner.sum() + now.node_side.sum()
        return now if math.isfinite(sums) else replace(now, cost=math.inf)

    def _linearised(self, guess: Guess, noise: ProcessNoise) -> NormalEquations:
        record, x = self.record, guess.x
        steps = len(record.dt)
        self._p[:] = guess.p
        self._a[:steps] = x[:-1]
        self._steps()
        contacts = self._contacts.evaluate(x, record.contact_value, record.contact_variance, record.contact_weight)
        forces = self._forces.evaluate(x, record.force_value, record.force_variance, record.force_weight)
        J = self._step_jacobian[:steps].transpose(0, 2, 1).reshape(steps * NODE, NODE + self._constants)
        root = 1.0 / np.sqrt(np.outer(record.dt, [noise.psi, noise.omega0]).ravel())

        defect = self._end[:steps] - x[1:]
        root, blows = _quiet_or_blow(defect, root.reshape(-1, NODE), noise)
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
        defect = defect.ravel() * root
        residual = np.concatenate([defect, -contacts.residual * contacts.root, -forces.residual * forces.root])
        sparse = csr_matrix((in_nodes, *self._pattern), shape=(len(residual), x.size))
        across = sparse.T.tocsr()
        normal = across @ sparse
        banded = np.zeros((BAND, x.size))
        for k in range(BAND):
            banded[k, : x.size - k] = normal.diagonal(-k)
        slack = float(defect @ defect) + blows
        return NormalEquations(
            contacts.cost + forces.cost + slack, contacts.chi2, forces.chi2, slack, 0.0,
            contacts.outliers, contacts.astray,
            banded, across @ in_constants, in_constants.T @ in_constants,
            -(across @ residual), -(in_constants.T @ residual),
        )  # fmt: skip


def _quiet_or_blow(defect: FloatArray, root: FloatArray, noise: ProcessNoise) -> tuple[FloatArray, float]:
    """One over the one-sigma of each step's ends (flat), and what the cost has besides their squares.

    Beyond the gate the cost goes on as a logarithm, and as the square of a blow's own size.
    """
    nis = (defect * root) ** 2
    if noise.gate == math.inf:
        return root.ravel(), 0.0
    # far from the answer all defects are large: only what stands out from the others is a blow
    gate = noise.gate * max(1.0, float(np.median(nis)) / 0.455)
    beyond = nis > gate
    pull = np.where(beyond, gate / np.maximum(nis, gate), 1.0)
    cost = np.where(beyond, gate * np.log(np.maximum(nis, gate) / gate), 0.0)
    return np.sqrt(pull * root**2 + BLOW_SD**-2.0).ravel(), float(cost.sum())


def _block(banded: FloatArray, at: int) -> FloatArray:
    """The node's own block of the normal matrix, from its banded form."""
    lower = np.array([[banded[max(i - j, 0), at + j] for j in range(NODE)] for i in range(NODE)])
    block: FloatArray = np.tril(lower) + np.tril(lower, -1).T
    return block


def _below(banded: FloatArray, at: int) -> FloatArray:
    """The block below the node's own: rows of the next node, columns of this one."""
    return np.array([[banded[NODE + i - j, at + j] for j in range(NODE)] for i in range(NODE)])


def _pattern(record: Record) -> tuple[IntArray, IntArray]:
    """Columns and row starts of the residuals' Jacobian in the nodes, as `Residuals` fills it."""
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
    gradient: FloatArray  # (n, 4 + constants)
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
        self._value, self._gradient = np.zeros(rows), np.zeros((rows, 2 * NODE + len(p)))
        self._call = library.bind(kernel, [self._a, self._b, p, inputs], [self._value, self._gradient])

    def predicted(self, x: FloatArray) -> FloatArray:
        n = len(self._step)
        self._a[:n], self._b[:n] = x[self._step], x[self._step + 1]
        self._call()
        return self._value[:n].copy()

    def evaluate(self, x: FloatArray, values: FloatArray, variance: FloatArray, weight: FloatArray) -> _Evaluated:
        n = len(values)
        residual = values - self.predicted(x)
        nis = residual**2 / variance
        # far from the answer all residuals are large: only what stands out from the others is an outlier
        gate = GATE * max(1.0, float(np.median(nis)) / 0.455) if n else GATE
        outlier = nis > gate
        root = np.sqrt(np.where(outlier, gate / np.maximum(nis, gate), 1.0) * weight / variance)
        cost = weight * np.where(outlier, gate * (1.0 + np.log(np.maximum(nis, gate) / gate)), nis)
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


def _padded(count: int) -> int:
    return -(-max(count, 1) // LANES) * LANES
