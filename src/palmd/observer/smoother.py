"""Levenberg–Marquardt over a whole record: the trajectory and constants that explain all readings best.

The normal equations (`observer.normal_equations`) are factored exactly in their block-tridiagonal, bordered form, so an
iteration takes a few milliseconds for ten seconds of readings. Not for use inside the loop.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import Library
from palmd.model.smoothing import CONSTANTS, NODE, C
from palmd.observer.factor import SIZE, Factor, Knowledge, cholesky_solved
from palmd.observer.normal_equations import WILD_SPIN, Guess, Misfit, NormalEquations, ProcessNoise, Residuals
from palmd.observer.record import Record

MAX_ITERATIONS = 60
NEGLIGIBLE = 0.03  # decrease of the cost (twice a log-likelihood) that is not worth another iteration
# predicted decrease of a rejected step: below it the fit may have converged; above it the rejection is counted
SMALL_PREDICTED, LARGE_PREDICTED = 0.3, 9.0
FIRST_DAMPING, LEAST_DAMPING, MAX_DAMPING = 1e-2, 1e-9, 1e8
CORRECTIONS, GOOD_ENOUGH = 2, 0.9  # of the nodes alone, unless the cost falls by a tenth at once
LEAST_DECREASE = 1e-3  # relative decrease of the cost required of a correction
KNOWLEDGE_SIGMAS = 3.0  # by which constants may leave what earlier readings determine (choice: as for χ² of readings)


@dataclass(slots=True)
class Budget:
    """Iterations times nodes that fits may still use together; limits the processor time of a live answer."""

    left: float = math.inf


@dataclass(frozen=True, slots=True)
class Fit(Misfit):
    """A minimum and how the iteration ended. linearised: at the minimum."""

    guess: Guess
    noise: ProcessNoise
    iterations: int
    settled: bool
    linearised: Linearised | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Linearised:
    """Normal equations and the problem and point that they belong to."""

    record: Record
    known: Knowledge
    guess: Guess
    noise: ProcessNoise
    equations: NormalEquations

    def is_of(self, record: Record, known: Knowledge, guess: Guess, noise: ProcessNoise) -> bool:
        """Whether they belong to these very objects."""
        return self.record is record and self.known is known and self.guess is guess and self.noise == noise


@dataclass(frozen=True, slots=True)
class Posterior:
    """Covariance of (constants, last node), and the record's log marginal likelihood.

    evidence: Laplace's approximation, up to a constant of the record; it compares process noises and rivals.
    beyond: the fit plus one Newton step, since the fit ends where a step is not worth it; predicted_decrease: of the
    cost by this step. For a constant with a very narrow prior a step is worth nothing, but contains all that the
    readings determine of it.
    """

    covariance: FloatArray
    evidence: float
    beyond: Guess
    predicted_decrease: float

    @property
    def constants(self) -> FloatArray:
        """The constants that the record determines."""
        return self.beyond.p

    def distance2(self, p: FloatArray) -> float:
        """Squared Mahalanobis distance of constants `p` from these; exactly known constants do not count."""
        covariance = self.covariance[: len(p), : len(p)]
        open_ = np.diagonal(covariance) > 0.0
        away = (p - self.constants)[open_]
        return float(away @ np.linalg.solve(covariance[np.ix_(open_, open_)], away))


class Smoother(Residuals):
    """The least-squares problem of one record; `fit` may be called with many guesses and process noises."""

    def __init__(self, library: Library, record: Record, known: Knowledge, budget: Budget | None = None):
        """Bind the kernels to arrays of the record's size; `known`: knowledge of the constants and the first node.

        Fits end without convergence when the `budget` is spent; by default it is unlimited.
        """
        super().__init__(library, record)
        self._known = known
        self._budget = budget or Budget()

    def with_knowledge(self, known: Knowledge) -> Self:
        """The same problem with other prior knowledge; kernels and arrays are shared."""
        other = copy(self)
        other._known = known
        return other

    def fit(
        self,
        start: Guess,
        noise: ProcessNoise,
        iterations: int = MAX_ITERATIONS,
        rejections: int = MAX_ITERATIONS,
        worth: float = NEGLIGIBLE,
    ) -> Fit:
        """Iterate from `start` to convergence; the result may be a local minimum.

        After a step that does not decrease the cost enough, the nodes alone are solved for again with the constants of
        the step. Friction makes the trajectory a strongly curved function of the constants, and without this correction
        the iteration creeps along a narrow, curved valley. Ends without convergence after so many `iterations`, or
        `rejections` in a row of steps with a large predicted decrease. worth: least decrease of the cost for another
        iteration.
        """
        guess = self.completed(start)
        equations = self.linearised(guess, noise)
        if not math.isfinite(equations.cost):
            return Fit(math.inf, math.inf, math.inf, math.inf, math.inf, 1.0, 0, guess, noise, 0, False)
        damping, count, rejected, settled = FIRST_DAMPING, 0, 0, False
        budget, nodes = self._budget, len(guess.x)
        while (
            count < iterations and rejected < rejections and damping < MAX_DAMPING and not settled and budget.left > 0
        ):
            count += 1
            budget.left -= nodes
            step = _solved(equations, damping, self._known.scale)
            if step is None:
                damping *= 6.0
                continue
            predicted = equations.predicted_decrease(step)
            if damping <= FIRST_DAMPING and predicted < worth:
                settled = True
                break
            trial, trial_equations = self._corrected(Guess(guess.x + step.x, guess.p + step.p), noise, equations.cost)
            if trial_equations is not None:
                decrease = equations.cost - trial_equations.cost
                if decrease > 0.0:
                    settled = decrease < worth
                    guess, equations, rejected = trial, trial_equations, 0
                    damping = max(damping / 5.0, LEAST_DAMPING)
                    continue
                nearly_converged = damping <= FIRST_DAMPING and predicted < SMALL_PREDICTED
                settled = nearly_converged and _largest_decrease(predicted, decrease) < worth
            rejected += predicted > LARGE_PREDICTED
            damping *= 6.0
        return Fit(
            equations.cost, equations.chi2, equations.force_chi2, equations.process_cost, equations.prior_cost,
            equations.outliers, equations.outlier_run, guess, noise, count, settled,
            Linearised(self.record, self._known, guess, noise, equations),
        )  # fmt: skip

    def with_predicted_forces(self, guess: Guess) -> Record:
        """The record with contact forces predicted by the model at `guess` instead of the measured ones."""
        return self.record.with_contact_forces(self.contact_forces(guess))

    def with_discrepancy(self, guess: Guess, hopping_only: bool = False) -> Record:
        """The record with the friction law's uncertainty at `guess` as process noise and as noise of the forces.

        hopping_only: only in steps in which contacts hop. Without it, the least cost over motions and constants is that
        of an object so heavy that only the uncertainty of steps turns it; only prior knowledge contradicts that.
        """
        discrepancy, force_discrepancy = self.discrepancy(guess, hopping_only)
        return replace(self.record, discrepancy=discrepancy, force_discrepancy=force_discrepancy)

    def linearised(self, guess: Guess, noise: ProcessNoise) -> NormalEquations:
        """The normal equations at `guess`, with prior knowledge; the cost is infinite where they are invalid."""
        now = super().linearised(guess, noise)
        return now.plus_knowledge(self._known.terms(guess.p, guess.x[0])) if math.isfinite(now.cost) else now

    def _corrected(self, trial: Guess, noise: ProcessNoise, to_beat: float) -> tuple[Guess, NormalEquations | None]:
        """The trial, its nodes solved for again while that helps to beat the cost so far; None where it is invalid."""
        if not self.sane(trial):
            return trial, None
        equations = self.linearised(trial, noise)
        if not math.isfinite(equations.cost):
            return trial, None
        for _ in range(CORRECTIONS):
            if equations.cost < GOOD_ENOUGH * to_beat:
                break
            step = _solved_nodes(equations)
            if not equations.node_side @ step.ravel() > LEAST_DECREASE * equations.cost:
                break  # predicted decrease, if the cost were quadratic
            better = Guess(trial.x + step, trial.p)
            if not self.sane(better):
                break
            better_equations = self.linearised(better, noise)
            if not better_equations.cost < (1.0 - LEAST_DECREASE) * equations.cost:
                break
            trial, equations = better, better_equations
        return trial, equations

    def sane(self, guess: Guess) -> bool:
        """Whether the kernels can be evaluated: an object of 1 to 200 mm with a mass, and no excessive spin."""
        p = guess.p
        return bool(
            np.isfinite(guess.x).all()
            and np.isfinite(p).all()
            and 1e-3 < p[C.SHAPE] < 0.2
            and abs(p[C.LN_RHO] - math.log(p[C.SHAPE])) < 3.0
            and 0.02 < p[C.SATURATION] < 1e10
            and abs(p[C.LN_MASS]) < 12.0
            and np.abs(guess.x[:, 1]).max() < WILD_SPIN
        )

    def posterior(self, fit: Fit) -> Posterior:
        """Posterior of the fit; raises LinAlgError where it is no minimum."""
        noise, linearised = fit.noise, fit.linearised
        if linearised is not None and linearised.is_of(self.record, self._known, fit.guess, noise):
            equations = linearised.equations
        else:
            equations = self.linearised(fit.guess, noise)
        if not math.isfinite(equations.cost):
            raise np.linalg.LinAlgError("the cost of the fit is not finite")
        covariance, log_det, step = equations.posterior()
        steps = len(fit.guess.x) - 1
        discrepancy = self.record.discrepancy[:-1]
        normaliser = steps * math.log(noise.psi) + float(np.log(noise.omega0 + discrepancy).sum())
        beyond = Guess(fit.guess.x + step.x, fit.guess.p + step.p)
        return Posterior(
            covariance, -0.5 * (equations.cost + log_det + normaliser), beyond, equations.predicted_decrease(step)
        )

    def posterior_if_any(self, fit: Fit) -> Posterior | None:
        """As `posterior`; None where the fit is no minimum."""
        try:
            return self.posterior(fit)
        except np.linalg.LinAlgError:
            return None


def contradicts_knowledge(fit: Fit) -> bool:
    """Whether the readings have moved (constants, first node) farther from earlier readings' estimate than is likely.

    The squared Mahalanobis distance of a posterior mean from the prior mean has, over many data, the mean
    tr(1 − P K): P is the posterior covariance, K the prior information. It is compared with that quantile of χ² with as
    many degrees of freedom. A general prior of objects is not tested: objects may be unlikely.
    """
    linearised = fit.linearised
    if linearised is None or not isinstance(linearised.known, Factor):
        return False
    guess, known = fit.guess, linearised.known
    try:
        matrix = linearised.equations.summary(guess, known.scale).matrix
        constants = len(matrix) - 2 * NODE
        kept = np.r_[:CONSTANTS, constants : constants + NODE]
        sides = np.zeros((len(matrix), SIZE))
        sides[kept] = known.terms(guess.p[:CONSTANTS], guess.x[0]).matrix
        determined = SIZE - float(np.trace(cholesky_solved(matrix, sides)[kept]))
    except np.linalg.LinAlgError:
        return False  # no minimum; other tests reject it
    determined = max(determined, 0.0)
    return fit.prior_cost > determined + KNOWLEDGE_SIGMAS * math.sqrt(2.0 * determined)


def evidence_of(posterior: Posterior | None) -> float:
    """The log evidence, -inf where a fit is no minimum."""
    return -math.inf if posterior is None else posterior.evidence


def _largest_decrease(predicted: float, decrease: float) -> float:
    """Largest decrease of the cost along a step, by the parabola with the predicted slope and the actual end."""
    return predicted**2 / (2.0 * predicted - decrease)


def _solved(equations: NormalEquations, damping: float, scale: FloatArray) -> Guess | None:
    try:
        return equations.solved(damping, scale)
    except np.linalg.LinAlgError:
        return None


def _solved_nodes(equations: NormalEquations) -> FloatArray:
    """The Newton step of the nodes alone; zero where there is none."""
    try:
        return equations.nodes_solved()
    except np.linalg.LinAlgError:
        return np.zeros((len(equations.node_side) // NODE, NODE))
