"""Independent sum of squares of one record in NumPy; see `palmd.observer.three_palms.equations`."""

from functools import cache

import numpy as np

from palmd.model import rotation, three_palms
from palmd.model.spherical import count
from palmd.model.three_palms import BODY, PALM_INPUTS, RIG_INPUTS
from palmd.observer.three_palms import kernels
from palmd.observer.three_palms.arrow import STATES, Arrow
from palmd.observer.three_palms.equations import BodyMotion, Noise, SumOfSquares
from palmd.observer.three_palms.kernels import BlockKernel, by_columns
from palmd.observer.three_palms.record import BodyRecord
from palmd.system.three_palms import ThreePalmsRig
from palmd.system.vibration import VibrationLaw


@cache
def acceleration_kernel(order: int, law: VibrationLaw = "sign_pairs") -> BlockKernel:
    """(R, ω, palms; p, rig) → (ω̇, f, ∂/∂δ, ∂/∂ω, ∂/∂p)."""
    m = count(order) + BODY
    shapes = [(3,), (3,), (3, 3), (3, 3), (3, m)]
    library = three_palms.library(order, law)
    return BlockKernel(library, "acceleration_block", (9, 3, PALM_INPUTS), (m, RIG_INPUTS), shapes)


class PlainEquations:
    """Same interface as `CompiledEquations`."""

    def __init__(self, record: BodyRecord, noise: Noise, rig: ThreePalmsRig, order: int) -> None:
        self._record, self._noise, self._acting = record, noise, rig.kernel_constants
        self._order, self._law = order, rig.vibration.law

    def at(self, motion: BodyMotion) -> SumOfSquares:
        """The sum of squares at `motion`."""
        record, noise, p, m = self._record, self._noise, motion.p, len(motion.p)
        K, h = len(record.middle_palms), record.spacing
        R, omega = motion.R, motion.omega
        acceleration, shared = acceleration_kernel(self._order, self._law), (p, self._acting)
        f, force, f_turn, f_omega, f_p = acceleration((by_columns(R), omega, record.node_palms), shared)
        f0, f1, w0, w1 = f[:-1], f[1:], omega[:-1], omega[1:]
        phi = rotation.log(R[1:] @ np.swapaxes(R[:-1], 1, 2))
        ending = w1 - 0.5 * np.cross(phi, w1)
        w_mid = 0.5 * (w0 + w1) + h / 8 * (f0 - f1)
        R_mid = rotation.exp(0.5 * phi + h / 8 * (w0 - ending)) @ R[:-1]
        fm, _, fm_turn, fm_omega, fm_p = acceleration((by_columns(R_mid), w_mid, record.middle_palms), shared)

        slot = np.arange(len(record.interval)) - np.searchsorted(record.interval, record.interval)
        rows = 6 + 2 * (1 + int(slot.max(initial=-1)))
        r, by = np.zeros((K, rows)), np.zeros((K, rows, m))
        left, right = np.zeros((K, rows, STATES)), np.zeros((K, rows, STATES))
        spin_weight = ((noise.spin + noise.by_spin * (w_mid**2).sum(1)) * h) ** -0.5
        turn_weight = (noise.turn * h) ** -0.5

        r[:, :3] = phi - h / 6 * (w0 + 4 * w_mid + w1) - h**2 / 12 * np.cross(w1, w0)
        left[:, :3, :3] = -rotation.left_inverse(-phi) - h**2 / 12 * f_turn[:-1]
        left[:, :3, 3:] = -h / 2 * np.eye(3) - h**2 / 12 * (f_omega[:-1] + rotation.skew(w1))
        right[:, :3, :3] = rotation.left_inverse(phi) + h**2 / 12 * f_turn[1:]
        right[:, :3, 3:] = -h / 2 * np.eye(3) + h**2 / 12 * (f_omega[1:] + rotation.skew(w0))
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
        by[:, 3:6] = -h / 6 * (f_p[:-1] + f_p[1:] + 4 * (fm_p + eighth @ (f_p[:-1] - f_p[1:])))
        r[:, 3:6] *= spin_weight[:, None]
        for block in (left, right, by):
            block[:, 3:6] *= spin_weight[:, None, None]

        k, share, shape = record.interval, record.share[:, None, None], slice(0, count(self._order))
        there, out, back = 3 * share**2 - 2 * share**3, share - 2 * share**2 + share**3, share**3 - share**2
        turned = (there * phi[k, None] + h * (out * w0[k, None] + back * ending[k, None]))[:, 0]
        reading = kernels.reading(self._order, self._law)
        y, by_turn, by_c = reading((by_columns(rotation.exp(turned) @ R[:-1][k]), record.geometry), (p[shape],))
        residual, weight = y - record.readings.value, 1.0 / noise.reading
        mine = 6 + 2 * slot[:, None] + np.arange(2)
        at, turn = (k[:, None], mine), weight * by_turn
        r[at] = weight * residual
        left[at] = np.concatenate([(1 - there) * turn, h * out * turn], axis=2)
        right[at] = np.concatenate([there * turn, h * back * turn], axis=2)
        by[k[:, None], mine, shape] = weight * by_c

        arrow = Arrow.empty(K + 1, m)
        arrow.add_residuals(r, left, right, by)
        return SumOfSquares(arrow, float((r**2).sum()), residual, force)
