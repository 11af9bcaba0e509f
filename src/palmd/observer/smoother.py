"""Levenberg–Marquardt over a whole record at once: trajectory and constants that explain all readings best.

The normal equations (`observer.normal_equations`) are factored exactly in their block-tridiagonal, bordered form, so an
iteration costs a few milliseconds for ten seconds of readings. Not for use inside the loop.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from palmd.events import FloatArray
from palmd.model.compiled import Library
from palmd.model.smoothing import NODE, C
from palmd.observer.factor import Knowledge
from palmd.observer.normal_equations import WILD_SPIN, Guess, NormalEquations, ProcessNoise, Residuals
from palmd.observer.record import Record

MAX_ITERATIONS = 60
NEGLIGIBLE = 0.03  # fall of the cost (twice a log-likelihood) that is not worth another iteration
LITTLE, MUCH = 0.3, 9.0  # of the same, that a step may promise and yet be rejected
FIRST_DAMPING, LEAST_DAMPING, MAX_DAMPING = 1e-2, 1e-9, 1e8
CORRECTIONS, GOOD_ENOUGH = 2, 0.9  # of the nodes alone, unless the cost falls by a tenth at once
LEAST_FALL = 1e-3  # of the cost, by which a correction must lower it


@dataclass(slots=True)
class Budget:
    """Iterations times nodes that fits may still use between them; bounds the processor time of a live answer."""

    left: float = math.inf


@dataclass(frozen=True, slots=True)
class Fit:
    """A minimum that was found: its cost, what that is made of (`NormalEquations`), and how the iteration ended.

    `linearised` is at the minimum.
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
    linearised: Linearised | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Linearised:
    """Normal equations, and what they are of."""

    record: Record
    known: Knowledge
    guess: Guess
    noise: ProcessNoise
    equations: NormalEquations

    def is_of(self, record: Record, known: Knowledge, guess: Guess, noise: ProcessNoise) -> bool:
        """Whether they are of these very objects."""
        return self.record is record and self.known is known and self.guess is guess and self.noise == noise


@dataclass(frozen=True, slots=True)
class Posterior:
    """Covariance of (constants, last node), and the record's log marginal likelihood.

    The latter is Laplace's approximation up to a constant of the record: it compares process noises and rivals.
    beyond: one Newton step beyond the fit, which ends where that is not worth it, and `promise`, by how much the cost
    falls there. To a constant that is all but certain beforehand a step is worth nothing, and yet is all that readings
    say of it.
    """

    covariance: FloatArray
    evidence: float
    beyond: Guess
    promise: float

    @property
    def constants(self) -> FloatArray:
        """Those that the record tells."""
        return self.beyond.p

    def distance2(self, p: FloatArray) -> float:
        """Squared Mahalanobis distance of constants `p` from these; those that were certain beforehand do not count."""
        covariance = self.covariance[: len(p), : len(p)]
        open_ = np.diagonal(covariance) > 0.0
        away = (p - self.constants)[open_]
        return float(away @ np.linalg.solve(covariance[np.ix_(open_, open_)], away))


class Smoother:
    """The least-squares problem of one record; `fit` may be called with many guesses and process noises."""

    def __init__(self, library: Library, record: Record, known: Knowledge, budget: Budget | None = None):
        """Binds the kernels to arrays of the record's size; `known` is about the constants and the first node.

        Fits end unsettled when the `budget` is spent; by default it is unlimited.
        """
        self._residuals = Residuals(library, record)
        self._known = known
        self._budget = budget or Budget()

    def knowing(self, known: Knowledge) -> Self:
        """The same problem with something else known beforehand; kernels and arrays are shared."""
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
        """Iterate from `start` until nothing moves any more; the result may be a local minimum.

        A step that looks bad is given a second chance: with the constants of the step, the nodes alone are solved
        for again. Friction makes the trajectory a strongly curved function of the constants, and without this the
        iteration creeps along a narrow bent valley. After so many `iterations`, or `rejections` in a row of steps that
        promise much, it comes back without having settled. No fall of the cost by less than `worth` is worth another.
        """
        guess = self.completed(start)
        now = self.linearised(guess, noise)
        if not math.isfinite(now.cost):
            return Fit(guess, noise, math.inf, math.inf, math.inf, math.inf, math.inf, 1.0, 0, 0, False)
        damping, count, rejected, settled = FIRST_DAMPING, 0, 0, False
        budget, nodes = self._budget, len(guess.x)
        while (
            count < iterations and rejected < rejections and damping < MAX_DAMPING and not settled and budget.left > 0
        ):
            count += 1
            budget.left -= nodes
            step = _solved(now, damping, self._known.scale)
            if step is None:
                damping *= 6.0
                continue
            promise = now.promise(step)
            if damping <= FIRST_DAMPING and promise < worth:
                settled = True
                break
            trial, then = self._corrected(Guess(guess.x + step.x, guess.p + step.p), noise, now.cost)
            if then is not None:
                fall = now.cost - then.cost
                if fall > 0.0:
                    settled = fall < worth
                    guess, now, rejected = trial, then, 0
                    damping = max(damping / 5.0, LEAST_DAMPING)
                    continue
                near = damping <= FIRST_DAMPING and promise < LITTLE
                settled = near and _most_on_the_way(promise, fall) < worth
            rejected += promise > MUCH
            damping *= 6.0
        return Fit(
            guess, noise, now.cost, now.chi2, now.force_chi2, now.slack, now.strain, now.outliers, now.astray,
            count, settled, Linearised(self._residuals.record, self._known, guess, noise, now),
        )  # fmt: skip

    def completed(self, guess: Guess) -> Guess:
        """The guess as it is, or carried on by the model where it has fewer nodes than the record."""
        return self._residuals.completed(guess)

    def forces(self, guess: Guess) -> FloatArray:
        """Predicted force (N) of each force reading."""
        return self._residuals.forces(guess)

    def pressed(self, guess: Guess) -> Record:
        """The record, its contacts pressed as the model has it at `guess` rather than as the pads tell it."""
        return self._residuals.record.pressed_by(self._residuals.pressing(guess))

    def judged(self, guess: Guess, hopping_only: bool = False) -> Record:
        """The record, its steps as uncertain as the law of friction at `guess`, or as that is where contacts hop.

        Of motions and constants together the least cost is that of a body so heavy that uncertain steps alone turn it:
        but for `hopping_only`, nothing but what is known beforehand speaks against it.
        """
        return replace(self._residuals.record, left_open=self._residuals.discrepancy(guess, hopping_only))

    def places(self, guess: Guess) -> FloatArray:
        """What each contact reading would be without noise (m)."""
        return self._residuals.places(guess)

    def residuals(self, guess: Guess) -> FloatArray:
        """Each contact reading less its prediction, in sigmas of its noise."""
        return self._residuals.contacts(guess)

    def linearised(self, guess: Guess, noise: ProcessNoise) -> NormalEquations:
        """The normal equations at `guess` with what is known besides; the cost is infinite where they are void."""
        now = self._residuals.linearised(guess, noise)
        return now.knowing(self._known.terms(guess.p, guess.x[0])) if math.isfinite(now.cost) else now

    def _corrected(self, trial: Guess, noise: ProcessNoise, to_beat: float) -> tuple[Guess, NormalEquations | None]:
        """The trial with its nodes solved for again while that helps to beat the cost so far; None where it is void."""
        if not self.sane(trial):
            return trial, None
        then = self.linearised(trial, noise)
        if not math.isfinite(then.cost):
            return trial, None
        for _ in range(CORRECTIONS):
            if then.cost < GOOD_ENOUGH * to_beat:
                break
            step = _solved_nodes(then)
            if not then.node_side @ step.ravel() > LEAST_FALL * then.cost:
                break  # by which it would fall, were it square
            better = Guess(trial.x + step, trial.p)
            if not self.sane(better):
                break
            after = self.linearised(better, noise)
            if not after.cost < (1.0 - LEAST_FALL) * then.cost:
                break
            trial, then = better, after
        return trial, then

    def sane(self, guess: Guess) -> bool:
        """Whether the kernels can be asked there: a lump of 1 to 200 mm that weighs something, no wild spin."""
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
        """How sure the fit is of itself; raises LinAlgError where it is no minimum."""
        noise, known = fit.noise, fit.linearised
        if known is not None and known.is_of(self._residuals.record, self._known, fit.guess, noise):
            now = known.equations
        else:
            now = self.linearised(fit.guess, noise)
        if not math.isfinite(now.cost):
            raise np.linalg.LinAlgError("the fit is beyond all numbers")
        covariance, log_det, step = now.posterior()
        steps = len(fit.guess.x) - 1
        left_open = self._residuals.record.left_open[:-1]
        normaliser = steps * math.log(noise.psi) + float(np.log(noise.omega0 + left_open).sum())
        beyond = Guess(fit.guess.x + step.x, fit.guess.p + step.p)
        return Posterior(covariance, -0.5 * (now.cost + log_det + normaliser), beyond, now.promise(step))

    def posterior_if_any(self, fit: Fit) -> Posterior | None:
        """As `posterior`; None where the fit is no minimum."""
        try:
            return self.posterior(fit)
        except np.linalg.LinAlgError:
            return None


def _most_on_the_way(promise: float, fall: float) -> float:
    """By how much the cost falls at most along a step, by the parabola that begins as it promises and ends as it is."""
    return promise**2 / (2.0 * promise - fall)


def _solved(now: NormalEquations, damping: float, scale: FloatArray) -> Guess | None:
    try:
        return now.solved(damping, scale)
    except np.linalg.LinAlgError:
        return None


def _solved_nodes(now: NormalEquations) -> FloatArray:
    """The Newton step of the nodes alone, zero where there is none."""
    try:
        return now.nodes_solved()
    except np.linalg.LinAlgError:
        return np.zeros((len(now.node_side) // NODE, NODE))
