"""The sum of squares of one record: by how much the equations fail between nodes, and what readings miss. Linearised.

Between nodes the equations of motion are collocated at both ends and midway (Hermite–Simpson, fourth order, stable
however stiff the friction is); by how much they fail is noise of a stated strength. `compiled_equations` has a twin in
C, which serves where there is a compiler.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.model.spherical import count
from palmd.observer.three_palms import kernels
from palmd.observer.three_palms.arrow import STATES, Arrow
from palmd.observer.three_palms.kernels import BlockKernel, by_columns
from palmd.observer.three_palms.motion_noise import BY_SPIN, SPIN, TURN
from palmd.observer.three_palms.record import BodyRecord
from palmd.system.three_palms import ThreePalmsRig


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
class SumOfSquares:
    """At one motion: the normal equations, the sum of squares, what readings miss by (S, 2) (m).

    force: (K + 1, 3) the palms' normal forces per unit mass (m/s²) at the nodes.
    """

    arrow: Arrow
    squares: float
    residual: FloatArray
    force: FloatArray


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


class Equations:
    """Of one record, for outlines up to one degree."""

    def __init__(self, record: BodyRecord, noise: Noise, rig: ThreePalmsRig, order: int) -> None:
        self._record, self._noise, self._acting = record, noise, rig.acting
        self._shape, law = slice(0, count(order)), rig.vibration.law
        self._of_all, self._of_motion = (
            (kernels.acceleration(order, law, of_motion=each), kernels.reading(order, law, of_motion=each))
            for each in (False, True)
        )

    def at(self, motion: BodyMotion, *, nodes_alone: bool = False) -> SumOfSquares:
        """At `motion`; `nodes_alone`: as if the parameters were known, in less time."""
        record, noise, p = self._record, self._noise, motion.p
        K, h = len(record.middle_palms), record.spacing
        m, (acceleration, reading) = (0, self._of_motion) if nodes_alone else (len(p), self._of_all)
        R, omega = motion.R, motion.omega
        shared = (p, self._acting)
        f, force, f_turn, f_omega, *by_p = acceleration((by_columns(R), omega, record.node_palms), shared)
        f0, f1, w0, w1 = f[:-1], f[1:], omega[:-1], omega[1:]
        phi, ending = _turns(R, omega)
        w_mid = 0.5 * (w0 + w1) + h / 8 * (f0 - f1)
        R_mid = rotation.exp(0.5 * phi + h / 8 * (w0 - ending)) @ R[:-1]
        fm, _, fm_turn, fm_omega, *mid_by_p = acceleration((by_columns(R_mid), w_mid, record.middle_palms), shared)

        rows = 6 + 2 * record.slots
        r, by = np.zeros((K, rows)), np.zeros((K, rows, m))
        left, right = np.zeros((K, rows, STATES)), np.zeros((K, rows, STATES))
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

        residual = self._read(reading, motion, phi, ending, r, left, right, by)
        arrow = Arrow.empty(K + 1, m)
        arrow.couple(r, left, right, by)
        return SumOfSquares(arrow, float((r**2).sum()), residual, force)

    def _read(
        self, reading: BlockKernel, motion: BodyMotion, phi: FloatArray, ending: FloatArray,
        r: FloatArray, left: FloatArray, right: FloatArray, by: FloatArray,
    ) -> FloatArray:  # fmt: skip
        """Fill in the readings' rows; returns what they miss by (S, 2) (m)."""
        record, h = self._record, self._record.spacing
        k, (there, out, back) = record.interval, _hermite(record.share)
        R = _between(record, motion.R, motion.omega, phi, ending)
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
