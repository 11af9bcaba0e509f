"""The normal equations of a record at one trajectory and one set of constants: every reading and every step linearised.

Unknown are the nodes x_k = (ψ, ω0) on a fixed time grid and the constants p of `model.smoothing` (or of a model with
more of them). The cost is a sum of squares: readings about their prediction, each step's end about the next node
(process noise). The normal matrix is block-tridiagonal in the nodes with a dense border for p. What is known besides
(`observer.factor`) is added to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import LANES, Library
from palmd.model.smoothing import NODE
from palmd.observer.factor import Factor, Terms, cholesky_solved
from palmd.observer.median import median
from palmd.observer.record import Record
from palmd.observer.reduction import IntArray, ReadingRows, Reduced, StepRows, Weighed, arithmetic

NODE_SCALE = np.array([0.05, 0.5])
"""Lengths in which a step of the nodes is measured by the damping: rad and rad/s."""

NOTHING = np.zeros(NODE)
WILD_SPIN = 200.0  # rad/s
BLOW_SD = np.array([2e-3, 1.5])  # of ψ (rad) and of ω0 (rad/s), within one step


MOST_DISCREPANCY = 1e4
"""(rad/s)²/s (derivation: 7 rad/s in a step of 5 ms, more than any body turns by): nothing is known of the motion."""


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Densities of what the model leaves out: of ψ (rad²/s) and of ω0 ((rad/s)²/s).

    `gate`: squared normalised defect of a step beyond which a contact may have jumped, and the motion by `BLOW_SD`.
    """

    psi: float
    omega0: float
    gate: float = math.inf

    def noisier(self, times: float) -> ProcessNoise:
        """So many times as dense, without a gate."""
        return ProcessNoise(times * self.psi, times * self.omega0)


LOOSENED = (1e3, 10.0)
"""Factors on the process noise of the first iterations where a fit is far from its minimum or friction is stiff."""


@dataclass(frozen=True, slots=True)
class Guess:
    """A point to linearise at: nodes (K + 1, 2) and constants (CONSTANTS)."""

    x: FloatArray
    p: FloatArray

    def on(self, own: FloatArray, wanted: FloatArray) -> Guess:
        """The same on nodes at other times: `own` are the present ones."""
        at = np.clip(np.searchsorted(own, wanted, side="right") - 1, 0, len(own) - 2)
        dt = own[at + 1] - own[at]
        u, (psi, omega0), (then, omega0_then) = (wanted - own[at]) / dt, self.x[at].T, self.x[at + 1].T
        rise, bend = then - psi, dt * (omega0 + omega0_then)  # cubic Hermite
        square, cube = 3 * rise - bend - dt * omega0, bend - 2 * rise
        moved = psi + u * (dt * omega0 + u * (square + u * cube))
        return Guess(np.stack([moved, omega0 + u * (2 * square + 3 * u * cube) / dt], axis=1), self.p)


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """At one point: the matrix and the right-hand side as in `observer.reduction`, and what the cost is made of.

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
    rows: FloatArray
    whole_corner: FloatArray
    constants: int

    @property
    def border(self) -> FloatArray:
        """Nodes across constants (2(K + 1), constants)."""
        return self.rows[:, : self.constants]

    @property
    def corner(self) -> FloatArray:
        """Constants across constants."""
        return self.whole_corner[: self.constants, : self.constants]

    @property
    def node_side(self) -> FloatArray:
        """The right-hand side in the nodes."""
        return self.rows[:, self.constants]

    @property
    def constant_side(self) -> FloatArray:
        """The right-hand side in the constants."""
        return self.whole_corner[self.constants, : self.constants]

    def promise(self, step: Guess) -> float:
        """By how much a full Newton step would lower the cost if the problem were linear."""
        return float(self.node_side @ step.x.ravel() + self.constant_side @ step.p)

    def knowing(self, known: Terms) -> NormalEquations:
        """With what is known of the constants and the first node; this one's arrays are taken over."""
        side = self.constants
        of_node = known.matrix[side:, side:]
        for k in range(NODE):
            self.banded[k, : NODE - k] += of_node.diagonal(-k)
        self.rows[:NODE, :side] += known.matrix[side:, :side]
        self.rows[:NODE, side] += known.side[side:]
        self.whole_corner[:side, :side] += known.matrix[:side, :side]
        self.whole_corner[side, :side] += known.side[:side]
        self.whole_corner[:side, side] += known.side[:side]
        return replace(self, cost=self.cost + known.cost, strain=known.strain)

    def knowing_instead(self, known: Terms, before: Terms) -> NormalEquations:
        """With other knowledge than `before`, which is in them; the cost is left as it is."""
        own = replace(self, banded=self.banded.copy(), rows=self.rows.copy(), whole_corner=self.whole_corner.copy())
        return own.knowing(Terms(0.0, known.strain, known.matrix - before.matrix, known.side - before.side))

    def solved(self, damping: float, scale: FloatArray) -> Guess:
        """The damped Newton step of everything; raises LinAlgError where there is none.

        A step is measured by `NODE_SCALE`, that of the constants by `scale`.
        """
        reduced = arithmetic().reduced(self.banded, damping / NODE_SCALE**2, self.rows, self.whole_corner)
        return self._stepped(reduced, np.diag(damping / scale**2))

    def _stepped(self, reduced: Reduced, damping: FloatArray | float = 0.0) -> Guess:
        """The step of everything, the nodes being `reduced`."""
        side = self.constants
        p = cholesky_solved(reduced.left[:side, :side] + damping, reduced.left[side, :side])
        by = np.zeros(self.rows.shape[1])
        by[:side], by[side] = -p, 1.0
        return Guess(arithmetic().back(reduced, by).reshape(-1, NODE), p)

    def nodes_solved(self) -> FloatArray:
        """The Newton step of the nodes (K + 1, 2) alone; raises LinAlgError where there is none."""
        return _nodes_solved(self.banded, self.node_side)

    def posterior(self) -> tuple[FloatArray, float, Guess]:
        """Covariance of (constants, last node), the matrix's log-determinant, and the Newton step of everything.

        Raises LinAlgError at no minimum.
        """
        reduced = arithmetic().reduced(self.banded, NOTHING, self.rows, self.whole_corner)
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
        """The cost as one of (p, first node, last node): the nodes in between are marginalised.

        For two steps at least. Raises LinAlgError where the readings leave a node in between open.
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
        left = arithmetic().reduced(self.banded[:, inner], NOTHING, rows, corner).left
        told = np.concatenate([np.arange(side), np.arange(first.start, last.stop)])
        cost = self.cost + float(left[side, side] - corner[side, side])
        matrix = left[np.ix_(told, told)]
        return Factor(
            np.concatenate([guess.p, guess.x[0], guess.x[-1]]), cost, (matrix + matrix.T) / 2, left[side, told], scale
        )

    def inner_step(self) -> FloatArray:
        """The Newton step of the nodes (K + 1, 2) while p and both ends stand still."""
        inner = slice(NODE, len(self.rows) - NODE)
        step = np.zeros((len(self.rows) // NODE, NODE))
        step[1:-1] = _nodes_solved(self.banded[:, inner], self.node_side[inner])
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
        """The guess as it is, or carried on by the model where it has fewer nodes than the record."""
        known, wanted = len(guess.x), len(self.record.t)
        if known == wanted:
            return guess
        x = np.empty((wanted, NODE))
        x[:known] = guess.x
        self._take(guess)
        for k in range(known - 1, wanted - 1):
            self._now[:], self._u[:] = x[k], self._step_inputs[k]
            self._one_step()
            x[k + 1] = self._then if abs(self._then[1]) < WILD_SPIN else x[k]
        return Guess(x, guess.p)

    def forces(self, guess: Guess) -> FloatArray:
        """Predicted force (N) of each force reading."""
        self._take(guess)
        return self._forces.predicted(guess.x)

    def pressing(self, guess: Guess) -> FloatArray:
        """Predicted force (N) on each contact that is read, whether its pad tells forces or not."""
        record = self.record
        inputs = record.pressing_inputs(_padded(len(record.contact_step)))
        self._take(guess)
        return _Readings(self._library, "force_batch", record.contact_step, inputs, self._p).predicted(guess.x)

    def discrepancy(self, guess: Guess, hopping_only: bool) -> FloatArray:
        """What the law of friction leaves open of ω0 in each step ((rad/s)²/s), or contacts that hop alone do."""
        steps, found = len(self.record.dt), np.zeros((len(self._a) + 1, 2))
        self._take(guess)
        self._a[:steps] = guess.x[:-1]
        self._library.bind("discrepancy_batch", [self._a, self._p, self._step_inputs], [found[:-1]])()
        found[steps:] = 0.0
        left_open = found[: steps + 1, int(hopping_only)]
        return np.minimum(np.nan_to_num(left_open, nan=MOST_DISCREPANCY), MOST_DISCREPANCY)

    def contacts(self, guess: Guess) -> FloatArray:
        """Each contact reading less its prediction, in sigmas of its noise."""
        record = self.record
        return (record.contact_value - self.places(guess)) / np.sqrt(record.contact_variance)

    def _take(self, guess: Guess) -> None:
        self._p[:] = guess.p[: len(self._p)]

    def places(self, guess: Guess) -> FloatArray:
        """Predicted contact readings (m), the pads' maps included."""
        self._take(guess)
        return self._contacts.predicted(guess.x) + self.record.contact_map @ guess.p[len(self._p) :]

    def linearised(self, guess: Guess, noise: ProcessNoise) -> NormalEquations:
        """The normal equations at `guess`; where anything overflows the cost is infinite and the rest is void."""
        with np.errstate(over="ignore", invalid="ignore"):
            now = self._linearised(guess, noise)
            sums = now.cost + now.banded.sum() + now.rows.sum() + now.whole_corner.sum()
        return now if math.isfinite(sums) else replace(now, cost=math.inf)

    def _linearised(self, guess: Guess, noise: ProcessNoise) -> NormalEquations:
        record, x, does = self.record, guess.x, arithmetic()
        steps = len(record.dt)
        self._take(guess)
        self._a[:steps] = x[:-1]
        self._steps()
        contacts = does.weighed(
            self.places(guess), record.contact_value, record.contact_variance, record.contact_weight
        )
        forces = does.weighed(self._forces.predicted(x), record.force_value, record.force_variance, record.force_weight)
        density = np.stack([np.full(steps, noise.psi), noise.omega0 + record.left_open[:-1]], axis=1)
        quiet = 1.0 / np.sqrt(record.dt[:, None] * density)
        quiet[record.torn] = 0.0
        root, blows = _quiet_or_blow(self._end[:steps] - x[1:], quiet, noise)
        root[record.torn] = 0.0
        readings = [self._contacts.rows(contacts), self._forces.rows(forces)]
        if self._wide_jacobian is not self._step_jacobian:
            self._wide_jacobian[:, : self._step_jacobian.shape[1]] = self._step_jacobian
        steps_rows = StepRows(x, self._end[:steps], self._wide_jacobian[:steps], root)
        made = does.assembled(steps_rows, readings)
        slack = made.slack + blows
        return NormalEquations(
            contacts.cost + forces.cost + slack, contacts.chi2, forces.chi2, slack, 0.0,
            contacts.outliers, contacts.astray, made.banded, made.rows, made.corner, self.constants,
        )  # fmt: skip


def _quiet_or_blow(defect: FloatArray, root: FloatArray, noise: ProcessNoise) -> tuple[FloatArray, float]:
    """One over the one-sigma of each step's ends (K, 2), and what the cost has besides their squares.

    Beyond the gate the cost goes on as a logarithm, and as the square of a blow's own size.
    """
    if noise.gate == math.inf:
        return root, 0.0
    nis = (defect * root) ** 2
    # far from the answer all defects are large: only what stands out from the others is a blow
    gate = noise.gate * max(1.0, median(nis.ravel()) / 0.455)
    beyond = nis > gate
    pull = np.where(beyond, gate / np.maximum(nis, gate), 1.0)
    cost = np.where(beyond, gate * np.log(np.maximum(nis, gate) / gate), 0.0)
    return np.sqrt(pull * root**2 + BLOW_SD**-2.0), float(cost.sum())


def _nodes_solved(banded: FloatArray, side: FloatArray) -> FloatArray:
    does, rows, by = arithmetic(), np.zeros((len(side), LANES)), np.zeros(LANES)
    rows[:, 0], by[0] = side, 1.0
    reduced = does.reduced(banded, NOTHING, rows, np.zeros((LANES, LANES)))
    return does.back(reduced, by).reshape(-1, NODE)


def _block(banded: FloatArray, at: int) -> FloatArray:
    """The node's own block of the normal matrix, from its banded form."""
    lower = np.array([[banded[max(i - j, 0), at + j] for j in range(NODE)] for i in range(NODE)])
    block: FloatArray = np.tril(lower) + np.tril(lower, -1).T
    return block


def _below(banded: FloatArray, at: int) -> FloatArray:
    """The block below the node's own: rows of the next node, columns of this one."""
    return np.array([[banded[NODE + i - j, at + j] for j in range(NODE)] for i in range(NODE)])


class _Readings:
    """Readings of one kind, bound to their kernel."""

    def __init__(
        self, library: Library, kernel: str, step: IntArray, inputs: FloatArray, p: FloatArray, further: int = 0
    ):
        """further: constants that the kernel does not know of, which follow its own."""
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
        """As last `predicted`, linearised."""
        if self.wide is not self._gradient:
            self.wide[:, : self._gradient.shape[1]] = self._gradient
        return ReadingRows(self.step, self.wide[: len(self.step)], weighed.residual, weighed.root)


def _padded(count: int) -> int:
    return -(-max(count, 1) // LANES) * LANES
