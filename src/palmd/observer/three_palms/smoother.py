"""Batch estimation of motion and body from a record: damped Gauss–Newton over defects, readings and prior.

Unknowns are the rotation and spin at each node, and the parameters of `model.three_palms`. The defects of the equations
of motion between nodes (`equations`) are noise of given spectral density, so that nothing is integrated and a poor
initial guess stays bounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.model.spherical import order_of
from palmd.model.three_palms import BODY
from palmd.observer.three_palms.arrow import STATES, Arrow
from palmd.observer.three_palms.compiled_equations import CompiledEquations
from palmd.observer.three_palms.equations import BodyMotion, Noise
from palmd.observer.three_palms.record import BodyRecord
from palmd.system.three_palms import ThreePalmsRig

LARGEST_TURN = 0.5  # rad; step limit of a node's rotation
NEGLIGIBLE_DECREASE = 0.1  # predicted decrease of the cost below which the iteration has converged
DAMPING, LEAST_DAMPING = 1e-6, 1e-9  # relative to the diagonal; weakly determined directions have 1e-6 of it left
MAX_DAMPING = 1e6  # damping at which the iteration is abandoned
GAUGE = 1e12  # 1/rad²; information that fixes a rotation


@dataclass(frozen=True, slots=True)
class BodyPrior:
    """Joint Gaussian prior of the first node's rotation R and spin (rad/s) and of the parameters.

    mean: (m,) of the parameters. information: (6 + m, 6 + m), of the turn from R, the spin and the parameters.
    """

    R: FloatArray
    spin: FloatArray
    mean: FloatArray
    information: FloatArray

    @classmethod
    def independent(cls, mean: FloatArray, information: FloatArray, spin: FloatArray, spin_sd: float) -> BodyPrior:
        """Prior with independent parameters and spin; the first node's rotation is the gauge, fixed at 1."""
        joint = np.zeros((STATES + len(mean),) * 2)
        joint[:3, :3] = GAUGE * np.eye(3)
        joint[3:6, 3:6] = np.eye(3) / spin_sd**2
        joint[STATES:, STATES:] = information
        return cls(np.eye(3), spin, mean, joint)


@dataclass(frozen=True, slots=True)
class BodyFit:
    """Result of the iteration: motion, cost, χ² of the readings per number read, and the normal equations.

    force: (K + 1, 3) the palms' normal forces per unit mass (m/s²) at the nodes.
    """

    motion: BodyMotion
    cost: float
    chi2: float
    force: FloatArray
    arrow: Arrow


class BodySmoother:
    """Least-squares estimator for one record."""

    def __init__(self, record: BodyRecord, prior: BodyPrior, noise: Noise, rig: ThreePalmsRig) -> None:
        self._prior, self._reading_sd = prior, noise.reading
        self._equations = CompiledEquations(record, noise, rig, order_of(len(prior.mean) - BODY))

    def evaluate(self, motion: BodyMotion, *, nodes_alone: bool = False) -> BodyFit:
        """Cost and normal equations at `motion`; `nodes_alone`: with fixed parameters, which is faster."""
        prior, sums = self._prior, self._equations.at(motion, nodes_alone=nodes_alone)
        error = np.concatenate(
            [rotation.log(motion.R[0] @ prior.R.T), motion.omega[0] - prior.spin, motion.p - prior.mean]
        )
        known = slice(0, STATES + len(sums.arrow.gradient))
        sums.arrow.add_prior(prior.information[known, known], (prior.information @ error)[known])
        cost = sums.squares + float(error @ prior.information @ error)
        chi2 = float((sums.residual**2).mean()) / self._reading_sd**2
        return BodyFit(motion, cost, chi2, sums.force, sums.arrow)

    def fit(self, guess: BodyMotion, iterations: int = 30) -> BodyFit:
        """Iterate from `guess` to a minimum, or for at most `iterations` evaluations.

        Damping follows the ratio of actual to predicted decrease (Nielsen 1999).
        """
        best, damping, raised = self.evaluate(guess), DAMPING, 2.0
        for _ in range(iterations):
            try:
                nodes, step = best.arrow.solve(damping)
            except np.linalg.LinAlgError:
                damping = max(10 * damping, 1e-6)
                if damping > MAX_DAMPING:
                    break
                continue
            scale = min(1.0, LARGEST_TURN / float(np.abs(nodes[:, :3]).max()))
            predicted = best.arrow.predicted_decrease(scale * nodes, scale * step)
            if predicted < NEGLIGIBLE_DECREASE and damping <= DAMPING:
                break
            trial = self.evaluate(best.motion.moved(scale * nodes, scale * step))
            ratio = (best.cost - trial.cost) / predicted
            if ratio > 0.0:
                best, raised = trial, 2.0
                damping = max(damping * max(0.1, 1.0 - (2.0 * ratio - 1.0) ** 3), LEAST_DAMPING)
            else:
                damping, raised = damping * raised, 2.0 * raised
                if damping > MAX_DAMPING:
                    break
        return best

    def fit_nodes(self, guess: BodyMotion, iterations: int = 5) -> BodyFit:
        """Fit the nodes of `guess` with its parameters fixed."""
        best = self.evaluate(guess, nodes_alone=True)
        for _ in range(iterations):
            try:
                nodes = best.arrow.nodes_step(DAMPING)
            except np.linalg.LinAlgError:
                break
            scale = min(1.0, LARGEST_TURN / float(np.abs(nodes[:, :3]).max()))
            moved = best.motion.moved(scale * nodes, np.zeros(len(guess.p)))
            trial = self.evaluate(moved, nodes_alone=True)
            decrease = best.cost - trial.cost
            if decrease > 0.0:
                best = trial
            if decrease < 1.0:
                break
        return best

    def end_belief(self, fit: BodyFit) -> BodyPrior:
        """Marginal of `fit` over the last node and the parameters: the prior of a record that begins there."""
        information, gradient = fit.arrow.marginal_of_last_node()
        correction: FloatArray = np.asarray(-np.linalg.solve(information, gradient), np.float64)
        motion = fit.motion
        return BodyPrior(
            rotation.exp(correction[:3]) @ motion.R[-1],
            motion.omega[-1] + correction[3:STATES],
            motion.p + correction[STATES:],
            information,
        )
