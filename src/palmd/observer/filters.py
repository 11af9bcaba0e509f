"""The two kinds of filter that a bank can hold, behind one interface: the named state, and the shape map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from palmd.events import FloatArray, PadSample, PalmSample
from palmd.model import extended, shape, shape_map
from palmd.model.outputs import NAMED, RIG_INPUTS, rig_inputs
from palmd.observer import prior
from palmd.observer.bank import SCORE_MEMORY_S, Bank, Belief
from palmd.observer.palms import PLAN_RATE_SD, PalmTracker
from palmd.observer.prior import BlindStart
from palmd.observer.rig_error import RigError
from palmd.system.description import RigDescription
from palmd.system.mechanism import JOINT_RATES, JOINTS


@dataclass(frozen=True, slots=True)
class Optimism:
    """How much too sure a young filter is: its true errors are 1 + excess · exp(−age/lasts_s) of its own sigmas.

    Linearising about a blind guess costs more than a covariance can know. Measured over simulated runs of the kind
    `nominal`, as the root mean square of error over sigma, r1 and r2, by age.
    """

    excess: float
    lasts_s: float

    def factor(self, age: float) -> float:
        """What to multiply one-sigmas with at `age` (s)."""
        return 1.0 + self.excess * math.exp(-age / self.lasts_s)


class Filters(Protocol):
    """A bank and what it takes to feed it; all safe inside the loop but the construction (it may compile C)."""

    name: str
    bank: Bank
    order: int  # harmonics of its outlines
    fuses_palms: bool  # whether reports of the palms are readings; else the palms' motion is an input
    optimism: Optimism
    curvature: FloatArray  # rows that map the state to v (m) on `CURVATURE_NORMALS` normals

    def start(self, start: BlindStart, palms: PalmTracker, t: float) -> None:
        """Set every filter to its sample of the prior, at time `t`."""

    def start_known(self, x: FloatArray, P: FloatArray, psi: FloatArray, palms: PalmTracker, t: float) -> None:
        """Set the first filters, one for each of `psi` (rad), to a state of `model.shape_map` turned there.

        `x` and its covariance `P` are one for all; a bank of shape maps also takes one for each.
        """

    def constants(self, start: BlindStart) -> Belief:
        """What was believed of the object's constants at the start, for `Bank.fade`."""

    def predict(self, t: float, dt: float, palms: PalmTracker) -> None:
        """Move the bank from `t` to `t + dt`."""

    def fuse_pad(self, sample: PadSample, variance: float, palms: PalmTracker) -> None:
        """Fuse one contact reading."""

    def fuse_palms(self, sample: PalmSample, angle_variance: float) -> None:
        """Fuse one report of the palms; only where `fuses_palms`."""

    def doubt(self, gap: float) -> None:
        """Widen what moves after `gap` seconds through which the palms' motion was not reported but guessed."""

    def named(self, member: int, t: float, dt: float, palms: PalmTracker) -> tuple[FloatArray, FloatArray]:
        """Values of `NAMED` and their covariance for one filter, taken from `t` to `t + dt`."""

    def all_named(self, t: float, palms: PalmTracker) -> FloatArray:
        """Values of `NAMED` of every filter at `t`, (size, len(NAMED)); overwritten by the next call."""

    def outline(self, member: int) -> tuple[FloatArray, FloatArray]:
        """Fourier coefficients of the support function (m) and their covariance for one filter."""

    def as_shape_map(self, member: int) -> FloatArray:
        """The state of one filter in the coordinates of `model.shape_map`, with `HARMONICS` harmonics."""

    def belief(self, member: int) -> tuple[FloatArray, FloatArray]:
        """Mean and, as far as it concerns the constants, covariance in these coordinates, with all its harmonics."""


CURVATURE_NORMALS = 72
LONGEST_STEP_S = 0.0061  # of one integration step: readings of one pad come every 10 ms


def carry(filters: Filters, t: float, until: float, palms: PalmTracker) -> None:
    """Move a bank from `t` to `until` (s) in equal steps of at most `LONGEST_STEP_S`; safe inside the loop."""
    gap = until - t
    steps = max(1, math.ceil(gap / LONGEST_STEP_S))
    for _ in range(steps):
        filters.predict(t, gap / steps, palms)
        t += gap / steps


def smoother_outline(x: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The belief (mean x, covariance P) about a shape map of more than `HARMONICS` harmonics, if it had no more.

    Where the outline has been felt it is much the same; merely leaving harmonics out would bend it there too.
    """
    low, high = slice(0, shape_map.N), slice(shape_map.N, None)
    gain = np.linalg.solve(P[high, high], P[high, low]).T
    return x[low] - gain @ x[high], P[low, low] - gain @ P[high, low]


SMALLEST_RADIUS = 1e-3  # m, below which a filter's mean radius is not taken at its word
GUESSED_ACCELERATION_SD = 2.0  # rad/s², of palms and object while the palms' motion is guessed
GUESSED_SLIDING_SD, GUESSED_ROLLING_SD = 1e-2, 3e-3  # m/s, of s and of r then
OUTLINE_SD = 1e-4  # m, of an outline put together from radii, curvature and what both contacts say of its centre
CONSISTENCY_SD = 1e-6  # m, to which r and s agree with the outline's coefficients at the start


def _curvature(order: int = shape.HARMONICS) -> FloatArray:
    """Rows that map the coefficients of h to v = h + h″ on normals all around."""
    rows = shape.basis(np.linspace(0.0, 2 * np.pi, CURVATURE_NORMALS, endpoint=False), order)
    v: FloatArray = rows * (1.0 - shape.harmonic_of_coefficient(order) ** 2)
    return v


def _pad_update(pad: int) -> str:
    return f"update_s{pad}"


class ExtendedFilters:
    """Filters on the project's named state (`model.extended`)."""

    name = "extended"
    order = shape.HARMONICS
    fuses_palms = True
    optimism = Optimism(1.2, 3.0)

    def __init__(self, rig: RigDescription, size: int):
        library = extended.library()
        updates = {f"update_{state.name.lower()}": 3 for state in extended.MEASURED}
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
        self.curvature[:, extended.X.CURVATURE :] = _curvature() @ np.linalg.pinv(shape.curvature_rows())
        self._outline = library.bind("outline", [self._x], [self._h, self._J_h])

    def start(self, start: BlindStart, palms: PalmTracker, t: float) -> None:
        X = extended.X
        phi1, phi2, omega1, omega2 = palms.at(t)[:4]
        # r and s at the contacts and v along the outline all follow from one belief about the coefficients
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
        sd[[X.R1, X.R2, X.S1, X.S2]] = CONSISTENCY_SD
        sd[[X.PHI1, X.PHI2]], sd[[X.OMEGA1, X.OMEGA2]] = angle_sd, rate_sd
        sd[X.OMEGA0], sd[X.RHO], sd[X.MU] = start.own_omega0_sd, start.own_rho_sd, start.own_mu_sd
        sd[X.LN_DITHER], sd[X.DAMPING] = start.own_ln_dither_sd, start.own_damping_sd
        P[:] = (linear * start.own_shape_sd**2) @ linear.T + np.diag(sd**2)

    def start_known(self, x: FloatArray, P: FloatArray, psi: FloatArray, palms: PalmTracker, t: float) -> None:
        X, Z = extended.X, shape_map.Z
        phi1, phi2, omega1, omega2 = palms.at(t)[:4]
        angle_sd, rate_sd = palms.sd(t)
        sd = np.zeros(extended.N)
        sd[[X.R1, X.R2, X.S1, X.S2]] = CONSISTENCY_SD
        sd[[X.PHI1, X.PHI2]], sd[[X.OMEGA1, X.OMEGA2]] = angle_sd, rate_sd
        for member, turn in enumerate(psi):
            y = self.bank.x[member]
            # the named state's gradient in the shape map's; contact_rows is for ψ = 0: turn the palms instead
            J = np.zeros((extended.N, shape_map.N))
            J[[X.R1, X.R2, X.S1, X.S2], Z.SHAPE :] = np.vstack(shape.contact_rows(phi1 - turn, phi2))
            up, down = (np.vstack(shape.contact_rows(phi1 - turn - by, phi2)) for by in (1e-4, -1e-4))
            J[[X.R1, X.R2, X.S1, X.S2], Z.PSI] = (up - down) @ x[Z.SHAPE :] / 2e-4
            J[X.CURVATURE :, Z.SHAPE :] = shape.curvature_rows()
            y[:] = J @ np.where(np.arange(shape_map.N) < Z.SHAPE, 0.0, x)
            y[[X.PHI1, X.PHI2, X.OMEGA1, X.OMEGA2]] = phi1, phi2, omega1, omega2
            y[X.PSI], y[X.OMEGA0], y[X.RHO] = turn, 0.0, math.exp(x[Z.LN_RHO])
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
        mean[:, X.MU], mean[:, X.LN_DITHER] = prior.FRICTION, math.log(prior.DITHER)
        mean[:, X.DAMPING], mean[:, X.CURVATURE] = prior.DAMPING, start.mean_radius
        sd[X.RHO], sd[X.MU] = prior.GYRATION_SD * prior.GYRATION * start.mean_radius, prior.FRICTION_SD
        sd[X.LN_DITHER], sd[X.DAMPING] = prior.LN_DITHER_SD, prior.DAMPING_SD
        sd[X.CURVATURE :] = np.abs(curvature) @ start.shape_sd
        return Belief(slice(X.RHO, extended.N), mean, sd)

    def predict(self, t: float, dt: float, palms: PalmTracker) -> None:
        self.bank.predict(dt, palms.at(t)[4:], palms.jerk, self._rig)

    def fuse_pad(self, sample: PadSample, variance: float, palms: PalmTracker) -> None:
        del palms  # the palms' angles are part of the state
        self.bank.update(_pad_update(sample.pad), sample.s, variance)

    def fuse_palms(self, sample: PalmSample, angle_variance: float) -> None:
        for joint, angle in zip(JOINTS, sample.angles, strict=True):
            self.bank.update(f"update_{joint}", angle, angle_variance, scored=False)
        for joint, rate in zip(JOINT_RATES, sample.rates or (), strict=False):
            self.bank.update(f"update_{joint}", rate, PLAN_RATE_SD**2, scored=False)

    def doubt(self, gap: float) -> None:
        X = extended.X
        variance = np.zeros(extended.N)
        variance[[X.OMEGA0, X.OMEGA1, X.OMEGA2]] = (GUESSED_ACCELERATION_SD * gap) ** 2
        variance[[X.PSI, X.PHI1, X.PHI2]] = (GUESSED_ACCELERATION_SD * gap**2 / 2) ** 2
        variance[[X.S1, X.S2]], variance[[X.R1, X.R2]] = (
            (GUESSED_SLIDING_SD * gap) ** 2,
            (GUESSED_ROLLING_SD * gap) ** 2,
        )
        self.bank.P[:] += np.diag(variance)

    def named(self, member: int, t: float, dt: float, palms: PalmTracker) -> tuple[FloatArray, FloatArray]:
        self._x[:], self._P[:] = self.bank.x[member], self.bank.P[member]
        self._u[0], self._u[1:3], self._u[3:5] = dt, palms.at(t)[4:], palms.jerk
        self._predict()
        self._alpha[:2] = palms.at(t + dt)[4:]
        self._named()
        return self._y.copy(), self._J.T @ self._P_next @ self._J

    def all_named(self, t: float, palms: PalmTracker) -> FloatArray:
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
        state[Z.LN_RHO] = math.log(max(self._x[X.RHO], SMALLEST_RADIUS))
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
        P[Z.SHAPE :, Z.SHAPE :] += np.eye(shape.COEFFICIENTS) * OUTLINE_SD**2
        return x, P


class ShapeFilters:
    """Filters on the whole outline (`model.shape_map`), of `order` harmonics; the palms' angles are inputs.

    Readings and angles are taken as `rig_error` corrects them. Beliefs are those of filters to which that is right;
    what is told, `named` and `outline`, has the covariance spread·spreadᵀ besides.
    """

    name = "shape"
    fuses_palms = False
    optimism = Optimism(1.0, 0.7)

    def __init__(self, rig: RigDescription, size: int, memory_s: float = SCORE_MEMORY_S, order: int = shape.HARMONICS):
        library = shape_map.library(order)
        inputs = (shape_map.PREDICTION_INPUTS, shape_map.PALM_INPUTS + RIG_INPUTS, len(NAMED))
        n = shape_map.size(order)
        self.bank = Bank(library, size, n, {"update_s1": 5, "update_s2": 5}, inputs, memory_s)
        self.order = order
        self._rig = rig_inputs(rig)
        self._x, self._P = np.zeros(n), np.zeros((n, n))
        self._x_next, self._P_next = np.zeros(n), np.zeros((n, n))
        self._u = np.zeros(shape_map.PREDICTION_INPUTS)
        self._u[9:] = self._rig
        self._v = np.zeros(shape_map.PALM_INPUTS + RIG_INPUTS)
        self._v[shape_map.PALM_INPUTS :] = self._rig
        self._y, self._J = np.zeros(len(NAMED)), np.zeros((n, len(NAMED)))
        self._predict = library.bind("predict", [self._x, self._P, self._u], [self._x_next, self._P_next])
        self._named = library.bind("named", [self._x_next, self._v], [self._y, self._J])
        self.curvature = np.zeros((CURVATURE_NORMALS, n))
        self.curvature[:, shape_map.Z.SHAPE :] = _curvature(order)
        self.rig_error = RigError(tuple(pad.length for pad in rig.pads))
        self.spread: FloatArray | None = None

    def start(self, start: BlindStart, palms: PalmTracker, t: float) -> None:
        del palms, t  # the palms are not part of the state
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

    def start_known(self, x: FloatArray, P: FloatArray, psi: FloatArray, palms: PalmTracker, t: float) -> None:
        del palms, t  # the palms are not part of the state
        Z = shape_map.Z
        self.bank.x[: len(psi)], self.bank.P[: len(psi)] = x, P
        self.bank.x[: len(psi), Z.PSI], self.bank.x[: len(psi), Z.OMEGA0] = psi, 0.0

    def constants(self, start: BlindStart) -> Belief:
        Z = shape_map.Z
        mean, sd = np.zeros((self.bank.size, self.bank.n)), np.zeros(self.bank.n)
        ln_ratio = math.log(prior.GYRATION)
        mean[:, Z.LN_RHO] = np.log(np.maximum(self.bank.x[:, Z.SHAPE], SMALLEST_RADIUS)) + ln_ratio
        mean[:, Z.MU], mean[:, Z.LN_DITHER] = prior.FRICTION, math.log(prior.DITHER)
        mean[:, Z.DAMPING], mean[:, Z.SHAPE] = prior.DAMPING, start.mean_radius
        sd[Z.LN_RHO], sd[Z.MU] = prior.GYRATION_SD, prior.FRICTION_SD
        sd[Z.LN_DITHER], sd[Z.DAMPING] = prior.LN_DITHER_SD, prior.DAMPING_SD
        sd[Z.SHAPE :] = start.shape_sd
        return Belief(slice(Z.LN_RHO, self.bank.n), mean, sd)

    def predict(self, t: float, dt: float, palms: PalmTracker) -> None:
        self.bank.predict(dt, self._palms_at(t, palms), palms.jerk, self._rig)

    def fuse_pad(self, sample: PadSample, variance: float, palms: PalmTracker) -> None:
        phi1, phi2 = self._palms_at(sample.t_sample, palms)[:2]
        s = self.rig_error.corrected(sample, phi2)
        self.bank.update(_pad_update(sample.pad), s, variance, phi1, phi2)

    def fuse_palms(self, sample: PalmSample, angle_variance: float) -> None:
        raise NotImplementedError("the palms' motion is an input of the shape map")

    def doubt(self, gap: float) -> None:
        Z = shape_map.Z
        variance = np.zeros(self.bank.n)
        variance[Z.OMEGA0] = (GUESSED_ACCELERATION_SD * gap) ** 2
        variance[Z.PSI] = (GUESSED_ACCELERATION_SD * gap**2 / 2) ** 2
        self.bank.P[:] += np.diag(variance)

    def named(self, member: int, t: float, dt: float, palms: PalmTracker) -> tuple[FloatArray, FloatArray]:
        self._x[:], self._P[:] = self.bank.x[member], self._whole(member)
        self._u[0], self._u[1:7], self._u[7:9] = dt, self._palms_at(t, palms), palms.jerk
        self._predict()
        self._v[: shape_map.PALM_INPUTS] = self._palms_at(t + dt, palms)
        self._named()
        cov = self._J.T @ self._P_next @ self._J
        for name, sd in zip((*JOINTS, *JOINT_RATES), np.ravel(palms.sd(t + dt)), strict=True):
            i = NAMED.index(name)
            cov[i, i] += sd**2
        return self._y.copy(), cov

    def all_named(self, t: float, palms: PalmTracker) -> FloatArray:
        return self.bank.values(self._palms_at(t, palms), self._rig)

    def outline(self, member: int) -> tuple[FloatArray, FloatArray]:
        at = shape_map.Z.SHAPE
        return self.bank.x[member, at:].copy(), self._whole(member)[at:, at:].copy()

    def as_shape_map(self, member: int) -> FloatArray:
        x, P = self.bank.x[member], self.bank.P[member]
        return x if len(x) == shape_map.N else smoother_outline(x, P)[0]

    def belief(self, member: int) -> tuple[FloatArray, FloatArray]:
        return self.bank.x[member].copy(), self.bank.P[member].copy()

    def _palms_at(self, t: float, palms: PalmTracker) -> FloatArray:
        motion = palms.at(t)
        motion[:2] += self.rig_error.angles()
        return motion

    def _whole(self, member: int) -> FloatArray:
        P: FloatArray = self.bank.P[member]
        return P if self.spread is None else P + self.spread @ self.spread.T
