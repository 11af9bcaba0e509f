"""Filters on the whole outline (`model.shape_map`): kernels, prior, correction by the rig's estimated constants."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palmd.events import Event, FloatArray, PadSample, PalmSample
from palmd.model import shape, shape_map
from palmd.model.dynamics import VIBRATION_ERROR_INPUTS
from palmd.model.outputs import FRICTION_INPUT, NAMED, RIG_INPUTS, rig_inputs
from palmd.model.smoothing import R
from palmd.observer import prior
from palmd.observer.bank import SCORE_MEMORY_S, Belief
from palmd.observer.compiled_fusion import CompiledBank, CompiledPalms, CompiledRig
from palmd.observer.filters.base import (
    CURVATURE_NORMALS,
    GUESSED_ACCELERATION_SD,
    SMALLEST_RADIUS_M,
    Overconfidence,
    curvature_rows,
)
from palmd.observer.palms import TrackedPalms
from palmd.observer.prior import BlindStart
from palmd.observer.rig_error import RigError
from palmd.system.description import RigDescription
from palmd.system.mechanism import JOINT_RATES, JOINTS, PALMS

_LOW, _HIGH = slice(0, shape_map.N), slice(shape_map.N, None)


def smoother_outline(x: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Condition a belief (mean x, covariance P) with more than `HARMONICS` harmonics on the higher ones being zero.

    The outline hardly changes where it has been touched; truncating the harmonics would change it there too.
    """
    gain = _gain(P)
    return x[_LOW] - gain @ x[_HIGH], P[_LOW, _LOW] - gain @ P[_HIGH, _LOW]


def smoother_spread(P: FloatArray, spread: FloatArray) -> FloatArray:
    """`spread` (n + constants, constants) of a belief with covariance `P` (n, n), conditioned as `smoother_outline`."""
    return np.vstack([spread[_LOW] - _gain(P) @ spread[shape_map.N : len(P)], spread[len(P) :]])


def _gain(P: FloatArray) -> FloatArray:
    """Regression of the shape map's states on the higher harmonics."""
    return np.asarray(np.linalg.solve(P[_HIGH, _HIGH], P[_HIGH, _LOW]).T)


_ANGLES = [NAMED.index(name) for name in JOINTS]
_JOINTS_AT = [NAMED.index(name) for name in (*JOINTS, *JOINT_RATES)]
BLIND_OVERCONFIDENCE = Overconfidence(1.0, 0.7)


class ShapeFilters:
    """Filters on the whole outline (`model.shape_map`), of `order` harmonics; the palms' angles are inputs.

    Readings and angles are corrected by `rig_error`. The filters' covariances assume that this is exact; the outputs
    `named` and `outline` add spread·spreadᵀ, or provisional_spread·provisional_spreadᵀ, to them.
    """

    name = "shape"
    fuses_palms = False
    supports_rollout = True

    def __init__(
        self,
        rig: RigDescription,
        size: int,
        memory_s: float = SCORE_MEMORY_S,
        order: int = shape.HARMONICS,
        overconfidence: Overconfidence = BLIND_OVERCONFIDENCE,
    ):
        """Bind the kernels of `size` filters; may compile C. `memory_s` as in `Bank`."""
        self.overconfidence = overconfidence
        library = shape_map.library(order, rig.curved)
        inputs = (shape_map.PREDICTION_INPUTS, shape_map.PALM_INPUTS + RIG_INPUTS, len(NAMED))
        n = shape_map.size(order)
        # variances added to those of NAMED before a smoother has estimated the rig's constants, and after
        self._added_variances = np.zeros((2, len(NAMED)))
        self._added_variances[:, _JOINTS_AT] = np.ravel(rig.rounding_sd) ** 2
        self._added_variances[:, _ANGLES[0]] += rig.gravity_sd**2  # readings give φ1 relative to gravity, not the rig
        self._added_variances[0, _ANGLES] += rig.angle_sd**2
        self._rig = rig_inputs(rig)
        updates = dict.fromkeys(shape_map.UPDATES, shape_map.UPDATE_INPUTS + len(PALMS) * rig.curved)
        self.bank = CompiledBank(library, size, n, updates, inputs, memory_s, self._rig, tuple(self._added_variances))
        self.order = order
        self.curvature = np.zeros((CURVATURE_NORMALS, n))
        self.curvature[:, shape_map.Z.SHAPE :] = curvature_rows(order)
        self.rig_error = RigError(tuple(pad.length for pad in rig.pads), rig.curvatures)
        self.spread: FloatArray | None = None
        self.provisional_spread: FloatArray | None = None
        self._start: BlindStart | None = None  # the start for which `_prior` was computed

    @property
    def rig_error(self) -> RigError:
        """Correction of readings and angles; may be shared with other filters."""
        return self._rig_error

    @rig_error.setter
    def rig_error(self, error: RigError) -> None:
        self._rig_error, self.compiled_rig = error, CompiledRig(error)

    def tracker(self, angle_noise: float) -> TrackedPalms:
        return CompiledPalms(self.bank.routines, angle_noise)

    def start(self, start: BlindStart, palms: TrackedPalms, t: float) -> None:
        del palms, t  # the palms are not part of the state
        self.provisional_spread = None
        Z = shape_map.Z
        x, P = self.bank.x, self.bank.P
        x[:] = 0.0
        x[:, Z.OMEGA0], x[:, Z.LN_RHO], x[:, Z.MU] = start.omega0, np.log(start.rho), start.mu
        x[:, Z.LN_DITHER], x[:, Z.DAMPING] = start.ln_dither, start.damping
        x[:, Z.SHAPE :] = start.coefficients
        sd = np.zeros(self.bank.n)
        sd[Z.OMEGA0], sd[Z.LN_RHO] = start.own_omega0_sd, start.own_rho_sd / start.rho.mean()
        sd[Z.MU], sd[Z.LN_DITHER], sd[Z.DAMPING] = (
            start.own_mu_sd,
            start.own_ln_dither_sd,
            start.own_damping_sd,
        )
        sd[Z.SHAPE :] = start.own_shape_sd
        P[:] = np.diag(sd**2)

    def start_known(self, x: FloatArray, P: FloatArray, psi: FloatArray, palms: TrackedPalms, t: float) -> None:
        del palms, t  # the palms are not part of the state
        Z = shape_map.Z
        self.bank.x[: len(psi)], self.bank.P[: len(psi)] = x, P
        self.bank.x[: len(psi), Z.PSI], self.bank.x[: len(psi), Z.OMEGA0] = psi, 0.0

    def constants(self, start: BlindStart) -> Belief:
        Z = shape_map.Z
        if start is not self._start:
            self._start, self._prior = start, self._constants(start)
        cached, ln_ratio = self._prior, math.log(prior.GYRATION)
        mean = cached.mean[: self.bank.size]
        mean[:, Z.LN_RHO] = np.log(np.maximum(self.bank.x[:, Z.SHAPE], SMALLEST_RADIUS_M)) + ln_ratio
        return Belief(cached.which, mean, cached.sd)

    def _constants(self, start: BlindStart) -> Belief:
        """The prior, except the mean of ln ρ, which depends on each filter's mean radius."""
        Z = shape_map.Z
        mean, sd = np.zeros((self.bank.full_size, self.bank.n)), np.zeros(self.bank.n)
        mean[:, Z.MU], mean[:, Z.LN_DITHER] = prior.FRICTION, start.ln_dither[0]
        mean[:, Z.DAMPING], mean[:, Z.SHAPE] = prior.DAMPING, start.mean_radius
        sd[Z.LN_RHO], sd[Z.MU] = prior.GYRATION_SD, prior.FRICTION_SD
        sd[Z.LN_DITHER], sd[Z.DAMPING] = start.own_ln_dither_sd, prior.DAMPING_SD
        sd[Z.SHAPE :] = start.shape_sd
        return Belief(slice(Z.LN_RHO, self.bank.n), mean, sd)

    def propagate(self, t: float, until: float, palms: TrackedPalms, repeated: float) -> None:
        self.bank.propagate(self.compiled_rig, palms, t, until, repeated)

    def fuse_pad(self, sample: PadSample, variance: float, palms: TrackedPalms, repeated: float) -> None:
        self.bank.fuse_pad(self.compiled_rig, palms, sample, variance, repeated)

    def fuse_events(
        self, events: Sequence[Event], t: float, palms: TrackedPalms, variances: FloatArray, shared: FloatArray
    ) -> tuple[float, int]:
        """Fuse events in their order from `t` (s) on, at times corrected by the pads' estimated lags.

        Readings from before the last fused one are skipped. `variances`: of each pad's readings (m²). Returns the time
        of the last fused reading (s) and the number of readings fused.
        """
        return self.bank.fuse_events(self.compiled_rig, palms, events, variances, shared, t)

    def fuse_palms(self, sample: PalmSample, angle_variance: float) -> None:
        raise NotImplementedError("the palms' motion is an input of the shape map")

    def inflate(self, gap: float) -> None:
        Z = shape_map.Z
        variance = np.zeros(self.bank.n)
        variance[Z.OMEGA0] = (GUESSED_ACCELERATION_SD * gap) ** 2
        variance[Z.PSI] = (GUESSED_ACCELERATION_SD * gap**2 / 2) ** 2
        self.bank.P[:] += np.diag(variance)

    def named(self, member: int, t: float, dt: float, palms: TrackedPalms) -> tuple[list[float], list[float]]:
        return self.bank.named(self.compiled_rig, palms, member, t, dt, self._present_spread())

    def all_named(self, t: float, palms: TrackedPalms) -> FloatArray:
        return self.bank.values(self._palms_at(t, palms), self._rig_now())

    def outline(self, member: int) -> tuple[FloatArray, FloatArray]:
        at = shape_map.Z.SHAPE
        return self.bank.x[member, at:].copy(), self._total_covariance(member)[at:, at:].copy()

    def as_shape_map(self, member: int) -> FloatArray:
        x, P = self.bank.x[member], self.bank.P[member]
        state: FloatArray = x if len(x) == shape_map.N else x[_LOW] - _gain(P) @ x[_HIGH]
        return state

    def belief(self, member: int) -> tuple[FloatArray, FloatArray]:
        return self.bank.x[member].copy(), self.bank.P[member].copy()

    def _rig_now(self) -> FloatArray:
        self._rig[FRICTION_INPUT] = self.rig_error.values[R.FRICTION]
        self._rig[VIBRATION_ERROR_INPUTS] = self.rig_error.values[R.KAPPA : R.ARM + 1]
        return self._rig

    def _palms_at(self, t: float, palms: TrackedPalms) -> FloatArray:
        motion = palms.at(t)
        motion[:2] += self.rig_error.angles()
        return motion

    def _total_covariance(self, member: int) -> FloatArray:
        P: FloatArray = self.bank.P[member]
        steps = self._present_spread()
        if steps is not None:
            steps = steps[: self.bank.n]
            P = P + steps @ steps.T
        return P

    def _present_spread(self) -> FloatArray | None:
        """1σ steps of the rig's constants: n rows of their effect on the state, then perhaps the constants' own."""
        return self.provisional_spread if self.spread is None else self.spread
