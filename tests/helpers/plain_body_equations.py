"""The sum of squares of one record once more, in NumPy: see `palmd.observer.three_palms.equations`."""

from functools import cache

import numpy as np

from palmd.events import FloatArray
from palmd.model import rotation, three_palms
from palmd.model.spherical import count
from palmd.model.three_palms import BODY, PALM_INPUTS, RIG_INPUTS
from palmd.observer.three_palms.arrow import STATES, Arrow
from palmd.observer.three_palms.equations import BodyMotion, Noise, SumOfSquares, _between, _hermite, _turns
from palmd.observer.three_palms.kernels import BlockKernel, by_columns
from palmd.observer.three_palms.record import BodyRecord
from palmd.system.three_palms import ThreePalmsRig
from palmd.system.vibration import VibrationLaw


@cache
def acceleration_kernel(order: int, law: VibrationLaw = "sign_pairs", *, of_motion: bool = False) -> BlockKernel:
    """(R, ω, palms; p, rig) → (ω̇, f, ∂/∂δ, ∂/∂ω, ∂/∂p); of the motion alone: without the last."""
    m = count(order) + BODY
    shapes = [(3,), (3,), (3, 3), (3, 3), (3, m)]
    return _kernel("acceleration", order, law, (9, 3, PALM_INPUTS), (m, RIG_INPUTS), shapes, of_motion)


def _reading_kernel(order: int, law: VibrationLaw, *, of_motion: bool) -> BlockKernel:
    n = count(order)
    return _kernel("reading", order, law, (9, 24), (n,), [(2,), (2, 3), (2, n)], of_motion)


def _kernel(what, order, law, each, shared, shapes, of_motion) -> BlockKernel:
    name, told = (f"{what}_of_motion_block", shapes[:-1]) if of_motion else (f"{what}_block", shapes)
    return BlockKernel(three_palms.library(order, law), name, each, shared, told)


class PlainEquations:
    """As `CompiledEquations`."""

    def __init__(self, record: BodyRecord, noise: Noise, rig: ThreePalmsRig, order: int) -> None:
        self._record, self._noise, self._acting = record, noise, rig.kernel_constants
        self._shape, law = slice(0, count(order)), rig.vibration.law
        self._of_all, self._of_motion = (
            (acceleration_kernel(order, law, of_motion=each), _reading_kernel(order, law, of_motion=each))
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
        arrow.add_residuals(r, left, right, by)
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
