"""Motion and body together from a record: Gauss–Newton with damping on the equations' defects, readings and beliefs.

Unknown are the rotation and spin at each node, and the parameters of `model.three_palms`. Between nodes the equations
of motion are collocated at both ends and midway (Hermite–Simpson, fourth order, stable however stiff the friction is);
by how much they fail is noise of a stated strength, so that nothing is ever integrated and a poor guess stays bounded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.model.spherical import count, order_of
from palmd.model.three_palms import BODY
from palmd.observer.three_palms import kernels
from palmd.observer.three_palms.arrow import STATES, Arrow
from palmd.observer.three_palms.kernels import by_columns
from palmd.observer.three_palms.motion_noise import BY_SPIN, SPIN, TURN
from palmd.observer.three_palms.record import BodyRecord

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
class Noise:
    """One-sigma of a reading (m); what the equations leave out, as in `motion_noise`."""

    reading: float
    spin: float = SPIN
    by_spin: float = BY_SPIN
    turn: float = TURN


@dataclass(frozen=True, slots=True)
class BodyMotion:
    """Rotations R (K + 1, 3, 3) and spins omega (K + 1, 3), and the parameters p (m,)."""

    R: FloatArray
    omega: FloatArray
    p: FloatArray

    def moved(self, nodes: FloatArray, step: FloatArray) -> BodyMotion:
        """After a step (K + 1, 6) of the nodes and (m,) of the parameters."""
        return BodyMotion(rotation.exp(nodes[:, :3]) @ self.R, self.omega + nodes[:, 3:], self.p + step)


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
    residual: FloatArray
    iterations: int


def at_readings(record: BodyRecord, R: FloatArray, omega: FloatArray) -> FloatArray:
    """(S, 3, 3) rotations at the readings' times, between nodes that turn as R and omega (K + 1, …) say."""
    return _between(record, R, omega, *_turns(R, omega))


def _turns(R: FloatArray, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(K, 3) rotation vectors from each node to the next, and at which rate they end there."""
    phi = rotation.log(R[1:] @ np.swapaxes(R[:-1], 1, 2))
    return phi, omega[1:] - 0.5 * np.cross(phi, omega[1:])


def _between(record: BodyRecord, R: FloatArray, omega: FloatArray, phi: FloatArray, ending: FloatArray) -> FloatArray:
    k, (there, out, back) = record.interval, (each[:, None] for each in _hermite(record.share))
    turned = there * phi[k] + record.spacing * (out * omega[:-1][k] + back * ending[k])
    return rotation.exp(turned) @ R[:-1][k]


def _hermite(share: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights of the end's value, the beginning's rate and the end's rate in a cubic that begins at 0."""
    return 3 * share**2 - 2 * share**3, share - 2 * share**2 + share**3, share**3 - share**2


class BodySmoother:
    """The sum of squares of one record, and its minimum."""

    def __init__(self, record: BodyRecord, prior: BodyPrior, noise: Noise, gravity: float) -> None:
        self._record, self._prior, self._noise, self._gravity = record, prior, noise, gravity
        order = order_of(len(prior.mean) - BODY)
        self._shape = slice(0, count(order))
        self._acceleration, self._reading = kernels.acceleration(order), kernels.reading(order)
        self._accelerated, self._read_off = kernels.acceleration_of_motion(order), kernels.reading_of_motion(order)
        self._of_width: dict[int, tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = {}

    def _rows(self, m: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Residuals of each interval, their Jacobians in both nodes and in m parameters.

        Each evaluation fills the same places; others are 0 and stay so.
        """
        if m not in self._of_width:
            K, rows = len(self._record.middle_palms), 6 + 2 * self._record.slots
            shapes = ((K, rows), (K, rows, STATES), (K, rows, STATES), (K, rows, m))
            r, left, right, by = map(np.zeros, shapes)
            self._of_width[m] = r, left, right, by
        return self._of_width[m]

    def evaluate(self, motion: BodyMotion, *, nodes_alone: bool = False) -> BodyFit:
        """Cost and normal equations at `motion`; `nodes_alone`: as if the parameters were known, in less time."""
        record, prior, noise, p = self._record, self._prior, self._noise, motion.p
        K, h = len(record.middle_palms), record.spacing
        m, acceleration = (0, self._accelerated) if nodes_alone else (len(p), self._acceleration)
        R, omega = motion.R, motion.omega
        shared = (p, self._gravity)
        f, force, f_turn, f_omega, *by_p = acceleration((by_columns(R), omega, record.node_palms), shared)
        f0, f1, w0, w1 = f[:-1], f[1:], omega[:-1], omega[1:]
        phi, ending = _turns(R, omega)
        w_mid = 0.5 * (w0 + w1) + h / 8 * (f0 - f1)
        R_mid = rotation.exp(0.5 * phi + h / 8 * (w0 - ending)) @ R[:-1]
        fm, _, fm_turn, fm_omega, *mid_by_p = acceleration((by_columns(R_mid), w_mid, record.middle_palms), shared)

        r, left, right, by = self._rows(m)
        spin_weight = ((noise.spin + noise.by_spin * (w_mid**2).sum(1)) * h) ** -0.5
        turn_weight = (noise.turn * h) ** -0.5

        r[:, :3] = phi - h / 6 * (w0 + 4 * w_mid + w1) - h**2 / 12 * np.cross(w1, w0)
        left[:, :3, :3] = -rotation.left_inverse(-phi) - h**2 / 12 * f_turn[:-1]
        left[:, :3, 3:] = -h / 2 * np.eye(3) - h**2 / 12 * (f_omega[:-1] + rotation.skew(w1))
        right[:, :3, :3] = rotation.left_inverse(phi) + h**2 / 12 * f_turn[1:]
        right[:, :3, 3:] = -h / 2 * np.eye(3) + h**2 / 12 * (f_omega[1:] + rotation.skew(w0))
        for f_p in by_p:
            by[:, :3] = -(h**2) / 12 * (f_p[:-1] - f_p[1:])
        for block in (r, left, right, by):
            block[:, :3] *= turn_weight

        eighth = h / 8 * fm_omega
        r[:, 3:6] = w1 - w0 - h / 6 * (f0 + 4 * fm + f1)
        left[:, 3:6, :3] = -h / 6 * (f_turn[:-1] + 4 * (0.5 * fm_turn + eighth @ f_turn[:-1]))
        left[:, 3:6, 3:] = -np.eye(3) - h / 6 * (
            f_omega[:-1] + 4 * (h / 8 * fm_turn + 0.5 * fm_omega + eighth @ f_omega[:-1])
        )
        right[:, 3:6, :3] = -h / 6 * (f_turn[1:] + 4 * (0.5 * fm_turn - eighth @ f_turn[1:]))
        right[:, 3:6, 3:] = np.eye(3) - h / 6 * (
            f_omega[1:] + 4 * (-h / 8 * fm_turn + 0.5 * fm_omega - eighth @ f_omega[1:])
        )
        for f_p, fm_p in zip(by_p, mid_by_p, strict=True):
            by[:, 3:6] = -h / 6 * (f_p[:-1] + f_p[1:] + 4 * (fm_p + eighth @ (f_p[:-1] - f_p[1:])))
        r[:, 3:6] *= spin_weight[:, None]
        for block in (left, right, by):
            block[:, 3:6] *= spin_weight[:, None, None]

        residual = self._read(motion, phi, ending, r, left, right, by)
        arrow = Arrow.empty(K + 1, m)
        arrow.couple(r, left, right, by)
        off = np.concatenate([rotation.log(R[0] @ prior.R.T), omega[0] - prior.spin, p - prior.mean])
        known = slice(0, STATES + m)
        arrow.believe(prior.information[known, known], (prior.information @ off)[known])
        cost = float((r**2).sum() + off @ prior.information @ off)
        chi2 = float((residual**2).mean()) / noise.reading**2
        return BodyFit(motion, cost, chi2, force, arrow, residual, 0)

    def _read(
        self, motion: BodyMotion, phi: FloatArray, ending: FloatArray,
        r: FloatArray, left: FloatArray, right: FloatArray, by: FloatArray,
    ) -> FloatArray:  # fmt: skip
        """Fill in the readings' rows; returns what they miss by (S, 2) (m)."""
        record, h = self._record, self._record.spacing
        k, (there, out, back) = record.interval, _hermite(record.share)
        R = _between(record, motion.R, motion.omega, phi, ending)
        reading = self._reading if by.shape[2] else self._read_off
        y, by_turn, *by_shape = reading((by_columns(R), record.geometry), (motion.p[self._shape],))
        residual = y - record.readings.value
        weight = 1.0 / self._noise.reading
        there, out, back = (each[:, None, None] for each in (there, out, back))
        rows = 6 + 2 * record.slot[:, None] + np.arange(2)
        at = (k[:, None], rows)
        r[at] = weight * residual
        turn = weight * by_turn
        left[at] = np.concatenate([(1 - there) * turn, h * out * turn], axis=2)
        right[at] = np.concatenate([there * turn, h * back * turn], axis=2)
        for by_c in by_shape:
            by[k[:, None], rows, self._shape] = weight * by_c
        return residual

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
