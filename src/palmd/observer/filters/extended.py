"""Filters on the project's named state (`model.extended`): kernels, prior, conversions to and from the shape map."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray, PadSample, PalmSample
from palmd.model import extended, shape, shape_map
from palmd.model.outputs import NAMED, RIG_INPUTS, rig_inputs
from palmd.observer import prior
from palmd.observer.bank import Bank, Belief
from palmd.observer.filters.base import (
    CURVATURE_NORMALS,
    GUESSED_ACCELERATION_SD,
    LONGEST_STEP_S,
    SMALLEST_RADIUS_M,
    Overconfidence,
    curvature_rows,
    pad_update,
)
from palmd.observer.palms import PLAN_RATE_SD, PalmTracker, TrackedPalms
from palmd.observer.prior import BlindStart
from palmd.system.description import RigDescription
from palmd.system.mechanism import JOINT_RATES, JOINTS

GUESSED_SLIDING_SD_M_S, GUESSED_ROLLING_SD_M_S = 1e-2, 3e-3  # 1σ of the rates of s and r while palm motion is guessed
OUTLINE_SD_M = 1e-4  # 1σ added to an outline that is assembled from radii, curvature and both contacts
CONSISTENCY_SD_M = 1e-6  # 1σ to which r and s agree with the outline's coefficients at the start


class ExtendedFilters:
    """Filters on the project's named state (`model.extended`)."""

    name = "extended"
    order = shape.HARMONICS
    fuses_palms = True
    supports_rollout = False
    spread: FloatArray | None = None
    provisional_spread: FloatArray | None = None
    overconfidence = Overconfidence(1.2, 3.0)

    def __init__(self, rig: RigDescription, size: int):
        library = extended.library()
        updates = {f"update_{state.name.lower()}": extended.UPDATE_INPUTS for state in extended.MEASURED}
        inputs = (extended.PREDICTION_INPUTS, 2 + RIG_INPUTS, len(NAMED))
        self.bank = Bank(library, size, extended.N, updates, inputs)
        self._rig = rig_inputs(rig)
        n, h = extended.N, shape.COEFFICIENTS
        self._x, self._P = np.zeros(n), np.zeros((n, n))
        self._x_next, self._P_next = np.zeros(n), np.zeros((n, n))
        self._u, self._alpha = np.zeros(extended.PREDICTION_INPUTS), np.zeros(2 + RIG_INPUTS)
        self._u[5:], self._alpha[2:] = self._rig, self._rig
        self._y, self._J = np.zeros(len(NAMED)), np.zeros((n, len(NAMED)))
        self._h, self._J_h = np.zeros(h), np.zeros((n, h))
        self._predict = library.bind("predict", [self._x, self._P, self._u], [self._x_next, self._P_next])
        self._named = library.bind("named", [self._x_next, self._alpha], [self._y, self._J])
        self.curvature = np.zeros((CURVATURE_NORMALS, n))
        self.curvature[:, extended.X.CURVATURE :] = curvature_rows() @ np.linalg.pinv(shape.curvature_rows())
        self._outline = library.bind("outline", [self._x], [self._h, self._J_h])

    def tracker(self, angle_noise: float) -> TrackedPalms:
        return PalmTracker(angle_noise)

    def start(self, start: BlindStart, palms: TrackedPalms, t: float) -> None:
        X = extended.X
        phi1, phi2, omega1, omega2 = palms.at(t)[:4]
        # r and s at the contacts and v along the outline all follow from the coefficients
        linear = np.zeros((extended.N, shape.COEFFICIENTS))
        linear[[X.R1, X.R2]], linear[[X.S1, X.S2]] = shape.contact_rows(phi1, phi2)
        linear[X.CURVATURE :] = shape.curvature_rows()
        x, P = self.bank.x, self.bank.P
        x[:] = start.coefficients @ linear.T
        x[:, X.PHI1], x[:, X.PHI2], x[:, X.OMEGA1], x[:, X.OMEGA2] = phi1, phi2, omega1, omega2
        x[:, X.OMEGA0], x[:, X.RHO], x[:, X.MU] = start.omega0, start.rho, start.mu
        x[:, X.LN_DITHER], x[:, X.DAMPING] = start.ln_dither, start.damping
        sd = np.zeros(extended.N)
        angle_sd, rate_sd = palms.sd(t)
        sd[[X.R1, X.R2, X.S1, X.S2]] = CONSISTENCY_SD_M
        sd[[X.PHI1, X.PHI2]], sd[[X.OMEGA1, X.OMEGA2]] = angle_sd, rate_sd
        sd[X.OMEGA0], sd[X.RHO], sd[X.MU] = start.own_omega0_sd, start.own_rho_sd, start.own_mu_sd
        sd[X.LN_DITHER], sd[X.DAMPING] = start.own_ln_dither_sd, start.own_damping_sd
        P[:] = (linear * start.own_shape_sd**2) @ linear.T + np.diag(sd**2)

    def start_known(self, x: FloatArray, P: FloatArray, psi: FloatArray, palms: TrackedPalms, t: float) -> None:
        X, Z = extended.X, shape_map.Z
        phi1, phi2, omega1, omega2 = palms.at(t)[:4]
        angle_sd, rate_sd = palms.sd(t)
        sd = np.zeros(extended.N)
        sd[[X.R1, X.R2, X.S1, X.S2]] = CONSISTENCY_SD_M
        sd[[X.PHI1, X.PHI2]], sd[[X.OMEGA1, X.OMEGA2]] = angle_sd, rate_sd
        for member, angle in enumerate(psi):
            y = self.bank.x[member]
            # gradient of the named state by the shape map's; contact_rows assumes ψ = 0: the palms are turned instead
            J = np.zeros((extended.N, shape_map.N))
            J[[X.R1, X.R2, X.S1, X.S2], Z.SHAPE :] = np.vstack(shape.contact_rows(phi1 - angle, phi2))
            up, down = (np.vstack(shape.contact_rows(phi1 - angle - step, phi2)) for step in (1e-4, -1e-4))
            J[[X.R1, X.R2, X.S1, X.S2], Z.PSI] = (up - down) @ x[Z.SHAPE :] / 2e-4
            J[X.CURVATURE :, Z.SHAPE :] = shape.curvature_rows()
            y[:] = J @ np.where(np.arange(shape_map.N) < Z.SHAPE, 0.0, x)
            y[[X.PHI1, X.PHI2, X.OMEGA1, X.OMEGA2]] = phi1, phi2, omega1, omega2
            y[X.PSI], y[X.OMEGA0], y[X.RHO] = angle, 0.0, math.exp(x[Z.LN_RHO])
            y[X.MU], y[X.LN_DITHER], y[X.DAMPING] = x[Z.MU], x[Z.LN_DITHER], x[Z.DAMPING]
            J[X.PSI, Z.PSI] = J[X.OMEGA0, Z.OMEGA0] = 1.0
            J[X.RHO, Z.LN_RHO] = y[X.RHO]
            J[X.MU, Z.MU] = J[X.LN_DITHER, Z.LN_DITHER] = J[X.DAMPING, Z.DAMPING] = 1.0
            self.bank.P[member] = J @ P @ J.T + np.diag(sd**2)

    def constants(self, start: BlindStart) -> Belief:
        X = extended.X
        mean, sd = np.zeros((self.bank.size, extended.N)), np.zeros(extended.N)
        curvature = shape.curvature_rows()
        mean[:, X.RHO] = prior.GYRATION * self.bank.x[:, X.CURVATURE]
        mean[:, X.MU], mean[:, X.LN_DITHER] = prior.FRICTION, start.ln_dither[0]
        mean[:, X.DAMPING], mean[:, X.CURVATURE] = prior.DAMPING, start.mean_radius
        sd[X.RHO], sd[X.MU] = prior.GYRATION_SD * prior.GYRATION * start.mean_radius, prior.FRICTION_SD
        sd[X.LN_DITHER], sd[X.DAMPING] = start.own_ln_dither_sd, prior.DAMPING_SD
        sd[X.CURVATURE :] = np.abs(curvature) @ start.shape_sd
        return Belief(slice(X.RHO, extended.N), mean, sd)

    def propagate(self, t: float, until: float, palms: TrackedPalms, repeated: float) -> None:
        gap = until - t
        steps = max(1, math.ceil(gap / LONGEST_STEP_S))  # equal ones
        for _ in range(steps):
            self.bank.predict(gap / steps, palms.at(t)[4:], palms.jerk, self._rig)
            t += gap / steps
        self.bank.age_scores(gap / repeated)

    def fuse_pad(self, sample: PadSample, variance: float, palms: TrackedPalms, repeated: float) -> None:
        del palms  # the palms' angles are part of the state
        self.bank.update(pad_update(sample.pad), sample.s, variance, repeated=repeated)

    def fuse_palms(self, sample: PalmSample, angle_variance: float) -> None:
        for joint, angle in zip(JOINTS, sample.angles, strict=True):
            self.bank.update(f"update_{joint}", angle, angle_variance, scored=False)
        for joint, rate in zip(JOINT_RATES, sample.rates or (), strict=False):
            self.bank.update(f"update_{joint}", rate, PLAN_RATE_SD**2, scored=False)

    def inflate(self, gap: float) -> None:
        X = extended.X
        variance = np.zeros(extended.N)
        variance[[X.OMEGA0, X.OMEGA1, X.OMEGA2]] = (GUESSED_ACCELERATION_SD * gap) ** 2
        variance[[X.PSI, X.PHI1, X.PHI2]] = (GUESSED_ACCELERATION_SD * gap**2 / 2) ** 2
        variance[[X.S1, X.S2]], variance[[X.R1, X.R2]] = (
            (GUESSED_SLIDING_SD_M_S * gap) ** 2,
            (GUESSED_ROLLING_SD_M_S * gap) ** 2,
        )
        self.bank.P[:] += np.diag(variance)

    def named(self, member: int, t: float, dt: float, palms: TrackedPalms) -> tuple[list[float], list[float]]:
        self._x[:], self._P[:] = self.bank.x[member], self.bank.P[member]
        self._u[0], self._u[1:3], self._u[3:5] = dt, palms.at(t)[4:], palms.jerk
        self._predict()
        self._alpha[:2] = palms.at(t + dt)[4:]
        self._named()
        return self._y.tolist(), ((self._P_next @ self._J) * self._J).sum(axis=0).tolist()

    def all_named(self, t: float, palms: TrackedPalms) -> FloatArray:
        return self.bank.values(palms.at(t)[4:], self._rig)

    def outline(self, member: int) -> tuple[FloatArray, FloatArray]:
        self._x[:] = self.bank.x[member]
        self._outline()
        return self._h.copy(), self._J_h.T @ self.bank.P[member] @ self._J_h

    def as_shape_map(self, member: int) -> FloatArray:
        X, Z = extended.X, shape_map.Z
        self._x[:] = self.bank.x[member]
        self._outline()
        state = np.empty(shape_map.N)
        state[Z.PSI], state[Z.OMEGA0], state[Z.MU] = self._x[X.PSI], self._x[X.OMEGA0], self._x[X.MU]
        state[Z.LN_RHO] = math.log(max(self._x[X.RHO], SMALLEST_RADIUS_M))
        state[Z.LN_DITHER], state[Z.DAMPING] = self._x[X.LN_DITHER], self._x[X.DAMPING]
        state[Z.SHAPE :] = self._h
        return state

    def belief(self, member: int) -> tuple[FloatArray, FloatArray]:
        X, Z = extended.X, shape_map.Z
        variance = self.bank.P[member].diagonal()
        x, P = self.as_shape_map(member), np.zeros((shape_map.N, shape_map.N))
        P[Z.MU, Z.MU], P[Z.LN_DITHER, Z.LN_DITHER] = variance[X.MU], variance[X.LN_DITHER]
        P[Z.LN_RHO, Z.LN_RHO] = variance[X.RHO] / self.bank.x[member, X.RHO] ** 2
        P[Z.DAMPING, Z.DAMPING] = variance[X.DAMPING]
        _, P[Z.SHAPE :, Z.SHAPE :] = self.outline(member)
        P[Z.SHAPE :, Z.SHAPE :] += np.eye(shape.COEFFICIENTS) * OUTLINE_SD_M**2
        return x, P
