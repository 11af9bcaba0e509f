"""Motion and body together from a record: Gauss–Newton with damping on the equations' defects, readings and beliefs.

Unknown are the rotation and spin at each node, and the parameters of `model.three_palms`. By how much the equations of
motion fail between nodes (`equations`) is noise of a stated strength, so that nothing is ever integrated and a poor
guess stays bounded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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

LARGEST_TURN = 0.5  # of a node in one step (rad)
SETTLED = 0.1  # decrease of the cost that a step promises, below which it is not taken any more
DAMPING, LEAST_DAMPING = 1e-6, 1e-9  # as a share of the diagonal: what is hardly known has 1e-6 of it left by all else
GIVE_UP = 1e6  # damping beyond which no step helps
GAUGE = 1e12  # information that holds a rotation (1/rad²)


@dataclass(frozen=True, slots=True)
class BodyPrior:
    """What is believed beforehand of the first node's rotation R and spin (rad/s) and of the parameters, all at once.

    mean: (m,) of the parameters. information: (6 + m, 6 + m), of the turn from R, the spin and the parameters.
    """

    R: FloatArray
    spin: FloatArray
    mean: FloatArray
    information: FloatArray

    @classmethod
    def apart(cls, mean: FloatArray, information: FloatArray, spin: FloatArray, spin_sd: float) -> BodyPrior:
        """Parameters and spin apart from each other; the first node's rotation is the gauge, 1, and stays so."""
        whole = np.zeros((STATES + len(mean),) * 2)
        whole[:3, :3] = GAUGE * np.eye(3)
        whole[3:6, 3:6] = np.eye(3) / spin_sd**2
        whole[STATES:, STATES:] = information
        return cls(np.eye(3), spin, mean, whole)


@dataclass(frozen=True, slots=True)
class BodyFit:
    """Where the iteration ended: its cost, the readings' own part of it per number read, and the normal equations.

    force: (K + 1, 3) the palms' normal forces per unit mass (m/s²) at the nodes.
    """

    motion: BodyMotion
    cost: float
    chi2: float
    force: FloatArray
    arrow: Arrow
    iterations: int


class BodySmoother:
    """The sum of squares of one record, and its minimum."""

    def __init__(self, record: BodyRecord, prior: BodyPrior, noise: Noise, rig: ThreePalmsRig) -> None:
        self._prior, self._reading_sd = prior, noise.reading
        self._equations = CompiledEquations(record, noise, rig, order_of(len(prior.mean) - BODY))

    def evaluate(self, motion: BodyMotion, *, nodes_alone: bool = False) -> BodyFit:
        """Cost and normal equations at `motion`; `nodes_alone`: as if the parameters were known, in less time."""
        prior, told = self._prior, self._equations.at(motion, nodes_alone=nodes_alone)
        off = np.concatenate(
            [rotation.log(motion.R[0] @ prior.R.T), motion.omega[0] - prior.spin, motion.p - prior.mean]
        )
        known = slice(0, STATES + len(told.arrow.gradient))
        told.arrow.believe(prior.information[known, known], (prior.information @ off)[known])
        cost = told.squares + float(off @ prior.information @ off)
        chi2 = float((told.residual**2).mean()) / self._reading_sd**2
        return BodyFit(motion, cost, chi2, told.force, told.arrow, 0)

    def fit(self, guess: BodyMotion, iterations: int = 30, damping: float = DAMPING) -> BodyFit:
        """The minimum that the iteration from `guess` leads to, or where it stands after so many evaluations.

        The damping follows how much of what a step promises it keeps (Nielsen 1999).
        """
        best, raised = self.evaluate(guess), 2.0
        for number in range(iterations):
            try:
                nodes, step = best.arrow.solve(damping)
            except np.linalg.LinAlgError:
                damping = max(10 * damping, 1e-6)
                if damping > GIVE_UP:
                    break
                continue
            shrink = min(1.0, LARGEST_TURN / float(np.abs(nodes[:, :3]).max()))
            promised = best.arrow.promise(shrink * nodes, shrink * step)
            if promised < SETTLED and damping <= DAMPING:
                break
            trial = self.evaluate(best.motion.moved(shrink * nodes, shrink * step))
            kept = (best.cost - trial.cost) / promised
            if kept > 0.0:
                best, raised = replace(trial, iterations=number + 1), 2.0
                damping = max(damping * max(0.1, 1.0 - (2.0 * kept - 1.0) ** 3), LEAST_DAMPING)
            else:
                damping, raised = damping * raised, 2.0 * raised
                if damping > GIVE_UP:
                    break
        return best

    def settled(self, guess: BodyMotion, iterations: int = 5) -> BodyFit:
        """The guess with its nodes moved to where its parameters want them."""
        best = self.evaluate(guess, nodes_alone=True)
        for _ in range(iterations):
            try:
                nodes = best.arrow.nodes_step(DAMPING)
            except np.linalg.LinAlgError:
                break
            shrink = min(1.0, LARGEST_TURN / float(np.abs(nodes[:, :3]).max()))
            moved = best.motion.moved(shrink * nodes, np.zeros(len(guess.p)))
            trial = self.evaluate(moved, nodes_alone=True)
            gained = best.cost - trial.cost
            if gained > 0.0:
                best = trial
            if gained < 1.0:
                break
        return best

    def ahead(self, fit: BodyFit) -> BodyPrior:
        """What `fit` says of the last node and the parameters: the belief that a record from there on begins with."""
        information, gradient = fit.arrow.onto_last()
        off: FloatArray = np.asarray(-np.linalg.solve(information, gradient), np.float64)
        motion = fit.motion
        return BodyPrior(
            rotation.exp(off[:3]) @ motion.R[-1], motion.omega[-1] + off[3:STATES], motion.p + off[STATES:], information
        )
