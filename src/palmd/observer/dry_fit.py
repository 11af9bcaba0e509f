"""Least squares of an object that sticks to one palm and slips along the other, over a record of readings. Pure.

Unknown are the constants: coefficients of h, ln ρ, ln m, μ, those of the rig (`model.smoothing.R`); the object's turn
at each change of the stuck palm; and, where the gains of the pads' forces are uncertain, how each gain wanders
(`observer.force_gain`), in units of its 1σ. Between two changes ψ is the angle that keeps Q1 or Q2 (`model.rolling`)
constant, so it needs no nodes and no process noise; its derivatives follow from the implicit function theorem. Bows and
lags are linearised; the effect of a bow on the rolling is neglected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from palmd.events import FloatArray
from palmd.model.rolling import SLIPS_SIGN, Lying, friction_asked, normal_forces
from palmd.model.smoothing import ORDER, RIG_CONSTANTS, C, R
from palmd.observer import stuck_palms
from palmd.observer.factor import Prior
from palmd.observer.force_gain import HYSTERESIS, hysteresis_position, modes_at
from palmd.observer.palm_path import PalmPath
from palmd.observer.record import LEAST_FORCE_N, Record
from palmd.observer.stuck_palms import FRICTION, FRICTION_SD, MASS_SD, STANDING, FilterStart, Palms
from palmd.system.mechanism import JOINTS, OPENING, PALMS, directions

SHAPE = slice(0, 2 * ORDER + 1)
LN_RHO, LN_MASS, MU = range(SHAPE.stop, SHAPE.stop + 3)
RIG = slice(MU + 1, MU + 1 + RIG_CONSTANTS)
TURNS = RIG.stop
KEPT = 16  # filters that begin with a fit: they know the object
TURN_SD = 5e-3  # rad, while both contacts slip, and for a change that is not where it is thought to be
BLIND_S = 0.015  # before and after a change, in which forces are those of impacts
GATE = 16.0  # squared normalised residual beyond which a reading's pull falls off
NEWTON_STEPS, NEWTON_RAD = 12, 1e-11
ITERATIONS, LEAST_DAMPING, MOST_DAMPING, WORTH = 25, 1e-9, 1e6, 1e-3
SAME_DECIMALS = 9  # of times (s)
SMALL_DECREASE = (
    0.1  # of the cost: where no step lowers it and none promises more, outliers that come and go are in the way
)
MOST_PULL, MOST_SPIN = 2.0, 60.0  # m/s², rad/s²: accelerations beyond are of moments
_STEP = 1e-6
_STANDOFFS = slice(RIG.start + R.STANDOFF, RIG.start + R.STANDOFF + 2)
_TILT, _TURN, ASYMMETRY = (RIG.start + which for which in (R.TILT, R.TURN, R.FRICTION))


@dataclass(frozen=True, slots=True)
class StickPhase:
    """From `start` (s) on the object sticks to `palm` (0 or 1)."""

    palm: int
    start: float


@dataclass(frozen=True, slots=True)
class DryFit:
    """A minimum: constants z (see the module), their normal matrix, ψ at the record's nodes, and how well it fits.

    chi2, force_chi2: per reading, without outliers. prior_cost: cost of the prior.
    friction_ratio: friction over normal force where the object sticks: 99 % quantile of the force readings.
    """

    z: FloatArray
    matrix: FloatArray
    psi: FloatArray
    cost: float
    chi2: float
    force_chi2: float
    outliers: float
    prior_cost: float
    settled: bool
    friction_ratio: float


@dataclass(frozen=True, slots=True)
class _Terms:
    """Normalised residuals, their Jacobian, and the cost, at one z."""

    residual: FloatArray
    jacobian: FloatArray
    cost: float
    chi2: float
    outliers: float


class DryModel:
    """The least-squares problem of one record and one sequence of stuck palms."""

    def __init__(
        self,
        record: Record,
        path: PalmPath,
        prior: Prior,
        phases: Sequence[StickPhase],
        gain_stds: Sequence[float] = (0.0, 0.0),
    ):
        """`prior`: of the constants of `model.smoothing`; `gain_stds`: relative gain error of each pad's forces."""
        self.record, self.prior, self.phases = record, prior, phases
        self._path, self._gain_stds = path, gain_stds
        contact_t, force_t = record.contact_t, record.force_t
        # A node's time and a reading's may differ by rounding alone: no rate can be computed between them.
        times = np.round(np.concatenate([record.t, contact_t, force_t]), SAME_DECIMALS)
        self._t, index = np.unique(times, return_inverse=True)
        self._nodes, self._contacts, self._forces = np.split(index, np.cumsum([len(record.t), len(contact_t)]))
        self._reported = path.at(self._t)
        starts = np.array([phase.start for phase in phases])
        self._edges = path.at(np.append(starts, self._t[-1]))
        cuts = np.append(np.searchsorted(self._t, starts), len(self._t))
        cuts[0] = 0
        self._spans = [slice(*each) for each in pairwise(cuts.tolist())]
        self._stuck = np.repeat([phase.palm for phase in phases], np.diff(cuts))
        time_to_change = np.abs(force_t[:, None] - starts[None, 1:]).min(axis=1, initial=math.inf)
        moving = np.abs(self._reported[self._forces, 3]) > STANDING
        self._weight = (moving & (time_to_change > BLIND_S)) * record.force_weight
        self._gains = [
            (of_pad, modes_at(force_t[of_pad], [(float(record.t[0]), float(record.t[-1]))], std))
            for palm, std in zip(PALMS, gain_stds, strict=True)
            if std and (of_pad := np.flatnonzero(record.force_pad == palm)).size
        ]
        gains = TURNS + len(phases) - 1
        self.size = gains + sum(modes.shape[1] + 1 for _, modes in self._gains)
        self.gains = slice(gains, self.size)

    def with_phases(self, phases: Sequence[StickPhase]) -> DryModel:
        """The problem of the same record and another sequence of stuck palms."""
        return DryModel(self.record, self._path, self.prior, phases, self._gain_stds)

    def initial_constants(self, shape_of: FloatArray, mass: float, mu: float, asymmetry: float) -> FloatArray:
        """Initial z of an object with this outline; `asymmetry`: of the palms' friction."""
        z = np.zeros(self.size)
        z[SHAPE], z[LN_MASS], z[MU], z[ASYMMETRY] = shape_of, math.log(mass), mu, asymmetry
        z[LN_RHO] = self.prior.mean[C.LN_RHO] + math.log(shape_of[0])
        return z

    def fit(self, z: FloatArray) -> DryFit:
        """Levenberg–Marquardt from z; raises LinAlgError where there is no minimum."""
        now, damping, settled = self._terms(z), 1e-3, False
        for _ in range(ITERATIONS):
            matrix, side = self._normal(now)
            while damping < MOST_DAMPING:
                step = np.linalg.solve(matrix + damping * np.diag(np.diagonal(matrix)), side)
                trial = self._terms(z + step)
                if trial.cost < now.cost + _STEP:
                    break
                damping *= 8.0
            else:
                settled = float(side @ np.linalg.solve(matrix, side)) < SMALL_DECREASE
                break
            settled = now.cost - trial.cost < WORTH
            z, now, damping = z + step, trial, max(0.1 * damping, LEAST_DAMPING)
            if settled:
                break
        return self._result(z, now, settled)

    def filter_start(self, fit: DryFit, blind: FilterStart) -> FilterStart:
        """Start of the filters from the fit, with twice its 1σ, instead of from `blind`."""
        z_covariance, jacobian = np.linalg.inv(fit.matrix), np.zeros((len(blind.x), self.size))
        x = np.zeros(len(blind.x))
        x[stuck_palms.LN_MASS], jacobian[stuck_palms.LN_MASS, LN_MASS] = fit.z[LN_MASS], 1.0
        for target, source in ((stuck_palms.SHAPE, SHAPE), (stuck_palms.STANDOFF, _STANDOFFS)):
            x[target], jacobian[target, source] = fit.z[source], np.eye(source.stop - source.start)
        for which, sign in ((stuck_palms.MU1, 1.0), (stuck_palms.MU2, -1.0)):
            x[which] = fit.z[MU] * (1.0 + sign * fit.z[ASYMMETRY])
            jacobian[which, [MU, ASYMMETRY]] = 1.0 + sign * fit.z[ASYMMETRY], sign * fit.z[MU]
        covariance = 4.0 * jacobian @ z_covariance @ jacobian.T
        masses = stuck_palms.LN_MASS
        covariance[masses, masses] += blind.covariance[masses, masses] - MASS_SD**2
        return FilterStart(x, covariance, blind.wanders, KEPT, decision_steps=1)

    def initial_constants_from(self, other: DryFit) -> FloatArray:
        """Initial z with the object and the rig of a fit to other phases."""
        z = np.zeros(self.size)
        z[:TURNS] = other.z[:TURNS]
        return z

    def turned_sd(self, fit: DryFit, covariance: FloatArray) -> float:
        """1σ of ψ at the last node (rad)."""
        last = self._orientation(fit.z)[1][self._nodes[-1]]
        return math.sqrt(float(last @ covariance @ last))

    # -- the terms of the cost ----------------------------------------------------------------------------

    def _normal(self, terms: _Terms) -> tuple[FloatArray, FloatArray]:
        return terms.jacobian.T @ terms.jacobian, terms.jacobian.T @ terms.residual

    def _terms(self, z: FloatArray) -> _Terms:
        psi, slope = self._orientation(z)
        parts = self._contact_terms(z, psi, slope), self._force_terms(z, psi, slope), self._prior_terms(z)
        cost = sum(part.cost for part in parts)
        return _Terms(
            np.concatenate([part.residual for part in parts]), np.concatenate([part.jacobian for part in parts]),
            cost if math.isfinite(cost) else math.inf, parts[0].chi2, parts[0].outliers,
        )  # fmt: skip

    def _result(self, z: FloatArray, terms: _Terms, settled: bool) -> DryFit:
        psi, slope = self._orientation(z)
        forces, prior_cost = self._force_terms(z, psi, slope), self._prior_terms(z).cost
        motion = self._motion(z, psi)
        pressing_forces, ratio = self._normal_forces(z, psi, motion, self._stuck), self._ratio(z, self._stuck)
        ratios = friction_asked(self._stuck, ratio, _palms(self._reported, z), motion[:2], pressing_forces)
        ratios = np.abs(ratios)[self._forces]
        ratios = np.append(ratios[self._weight > 0.0], 0.0)
        return DryFit(
            z, self._normal(terms)[0], psi[self._nodes], terms.cost, terms.chi2, forces.chi2,
            max(terms.outliers, forces.outliers), prior_cost, settled,
            float(np.quantile(ratios, 0.99, method="nearest")),
        )  # fmt: skip

    def _orientation(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """ψ at all times (n), and its derivatives by z (n, size)."""
        shape_of, standoffs = z[SHAPE], z[_STANDOFFS]
        psi, slope = np.empty(len(self._t)), np.zeros((len(self._t), self.size))
        offset, offset_by_z = 0.0, np.zeros(self.size)
        reported, edges = _palms(self._reported, z), _palms(self._edges, z)
        for number, (phase, span) in enumerate(zip(self.phases, self._spans, strict=True)):
            if number:
                turn = TURNS + number - 1
                offset, offset_by_z = offset + z[turn], offset_by_z.copy()
                offset_by_z[turn] += 1.0
            contact = Lying.at(edges[number : number + 1], np.array([offset]), ORDER)
            slope_by_z = _q_slopes(contact, phase.palm, shape_of, standoffs, self.size)[0]
            value = float(_q(contact, phase.palm, shape_of, standoffs)[0])
            slope_by_z += (contact.kept_turned(phase.palm) @ shape_of)[0] * offset_by_z
            palms = np.vstack([reported[span], edges[number + 1 : number + 2]])
            psi_span, lying = _orientation_keeping(palms, offset, value, phase.palm, shape_of, standoffs)
            psi_by_z = slope_by_z - _q_slopes(lying, phase.palm, shape_of, standoffs, self.size)
            psi_by_z /= (lying.kept_turned(phase.palm) @ shape_of)[:, None]
            psi[span], slope[span], offset, offset_by_z = (
                psi_span[:-1],
                psi_by_z[:-1],
                float(psi_span[-1]),
                psi_by_z[-1],
            )
        return psi, slope

    def _contact_terms(self, z: FloatArray, psi: FloatArray, slope: FloatArray) -> _Terms:
        record, at = self.record, self._contacts
        palms, on_first = _palms(self._reported[at], z), record.contact_pad == 1
        spin = np.gradient(psi, self._t)[at]
        lying = Lying.at(palms, psi[at], ORDER)
        pads = [self._contact(lying, palm, z, spin) for palm in (0, 1)]
        value, by_psi = (np.where(on_first, one, two) for one, two in zip(*(pair[:2] for pair in pads), strict=True))
        jacobian = by_psi[:, None] * slope[at] + np.where(on_first[:, None], *(pair[2] for pair in pads))
        sd = np.sqrt(record.contact_variance)
        return _gated((record.contact_value - value) / sd, jacobian / sd[:, None], record.contact_weight)

    def _contact(
        self, lying: Lying, palm: int, z: FloatArray, spin: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Readings of a pad at the times of all contacts, their derivatives by ψ, and those by z at constant ψ.

        spin: rate of ψ (rad/s). Linear in the effects of the rig's constants.
        """
        shape_of, standoffs, rig = z[SHAPE], z[_STANDOFFS], z[RIG]
        s, standoff_slopes = _s(lying, palm, shape_of, standoffs), lying.standing_off(palm)
        by_psi, by_opening = lying.contact_turned(palm) @ shape_of, lying.contact_opened(palm, shape_of, standoffs)
        rates = lying.palms[:, len(JOINTS) : 2 * len(JOINTS)]
        lag_slope = by_psi * (rates[:, 0] - spin) - by_opening * rates[:, OPENING]
        rig_slopes = [(R.ZERO + palm, np.ones(len(s))), (R.SCALE + palm, s), (R.LAG + palm, lag_slope)]
        rig_slopes.append((R.FORCE + palm, self.record.contact_force))
        for bowed, tilt_slope in ((0, -by_psi - by_opening), (1, -by_opening)):
            position = _s(lying, bowed, shape_of, standoffs) / float(self.record.pad_lengths[bowed])
            slope = 4.0 * (1.0 - 2.0 * position) / float(self.record.pad_lengths[bowed])
            rig_slopes.append((R.SAGITTA + bowed, slope * tilt_slope + 4.0 * position**2 * standoff_slopes[:, bowed]))
        rows = np.zeros((len(s), self.size))
        rows[:, SHAPE], rows[:, _STANDOFFS] = lying.contact(palm), standoff_slopes
        rows[:, _TILT], rows[:, _TURN] = -by_psi, by_opening
        for which, by in rig_slopes:
            rows[:, RIG.start + which] = by
            s = s + rig[which] * by
        return s, by_psi, rows

    def _force_terms(self, z: FloatArray, psi: FloatArray, slope: FloatArray) -> _Terms:
        record, at, mass = self.record, self._forces, math.exp(z[LN_MASS])
        pull_x, pull_y, alpha = (each[at] for each in self._motion(z, psi))
        palms, stuck, on_first = _palms(self._reported[at], z), self._stuck[at], record.force_pad == 1
        signs = _signs(palms, stuck)
        lying = Lying.at(palms, psi[at], ORDER)
        inputs: list[Any] = [
            *(rows @ z[SHAPE] for rows in (*lying.h, *lying.slope)),
            z[MU],
            z[LN_RHO],
            0.0,
            0.0,
            z[ASYMMETRY],
        ]

        def predict(values: list[Any]) -> FloatArray:
            *contact, mu, ln_rho, tilt, turn, asymmetry = values
            ratio, spin_term = (
                mu * (1.0 + asymmetry * np.where(stuck, 1.0, -1.0)) * signs,
                math.exp(2.0 * ln_rho) * alpha,
            )
            h, slopes = (contact[0], contact[1]), (contact[2], contact[3])
            corrected = palms + np.array([tilt, turn, 0.0, 0.0, 0.0, 0.0])
            forces = normal_forces(stuck, ratio, corrected, h, slopes, (pull_x, pull_y), spin_term)
            return mass * np.where(on_first, *forces)

        predicted = predict(inputs)
        modes = self._gain_modes(predicted)
        share = 1.0 + modes @ z[self.gains]
        slopes_of_inputs = [
            (predict([*inputs[:i], inputs[i] + _STEP, *inputs[i + 1 :]]) - predicted) / _STEP
            for i in range(len(inputs))
        ]
        jacobian = np.zeros((len(at), self.size))
        by_theta = [np.zeros(len(at)), np.zeros(len(at))]  # by θ of each palm
        shape_rows = zip(
            slopes_of_inputs, (*lying.h, *lying.slope), (*lying.slope, *map(lying.bend, (0, 1))), strict=False
        )
        for i, (slope_of_input, rows, slope_rows) in enumerate(shape_rows):
            by_theta[i % 2] += slope_of_input * (slope_rows @ z[SHAPE])
            jacobian[:, SHAPE] += slope_of_input[:, None] * rows
        by_both = by_theta[0] + by_theta[1]
        jacobian[:, _TILT], jacobian[:, _TURN] = slopes_of_inputs[6] + by_both, slopes_of_inputs[7] + by_theta[1]
        jacobian -= by_both[:, None] * slope[at]
        jacobian[:, MU], jacobian[:, LN_RHO], jacobian[:, LN_MASS] = slopes_of_inputs[4], slopes_of_inputs[5], predicted
        jacobian[:, ASYMMETRY] = slopes_of_inputs[8]
        jacobian *= share[:, None]
        jacobian[:, self.gains] = predicted[:, None] * modes
        sd = np.sqrt(record.force_variance)
        return _gated((record.force_value - share * predicted) / sd, jacobian / sd[:, None], self._weight)

    def _gain_modes(self, force: FloatArray) -> FloatArray:
        """(forces, modes): relative change of the forces (N) by each mode of a pad's gain.

        The derivatives neglect that a mode changes the place in the play.
        """
        columns = np.zeros((len(force), self.gains.stop - self.gains.start))
        column = 0
        for of_pad, modes in self._gains:
            pad_modes = np.column_stack(
                [modes, HYSTERESIS * hysteresis_position(np.maximum(force[of_pad], LEAST_FORCE_N))]
            )
            columns[of_pad, column : column + pad_modes.shape[1]] = pad_modes
            column += pad_modes.shape[1]
        return columns

    def _prior_terms(self, z: FloatArray) -> _Terms:
        prior = self.prior
        rho_sd = prior.sd[C.LN_RHO]
        residual = np.concatenate([
            (prior.mean[C.SHAPE :] - z[SHAPE]) / prior.sd[C.SHAPE :],
            [(prior.mean[C.LN_RHO] + math.log(z[0]) - z[LN_RHO]) / rho_sd if z[0] > 0.0 else math.inf],
            [(FRICTION - z[MU]) / FRICTION_SD], -z[RIG] / prior.sd[C.RIG : C.SHAPE],
            -z[TURNS : self.gains.start] / TURN_SD, -z[self.gains],
        ])  # fmt: skip
        jacobian = np.zeros((len(residual), self.size))
        jacobian[SHAPE, SHAPE] = np.diag(1.0 / prior.sd[C.SHAPE :])
        jacobian[SHAPE.stop, [LN_RHO, 0]] = 1.0 / rho_sd, -1.0 / (z[0] * rho_sd)
        jacobian[SHAPE.stop + 1, MU] = 1.0 / FRICTION_SD
        turns, gains = self.gains.start - TURNS, self.size - self.gains.start
        sd = np.concatenate([prior.sd[C.RIG : C.SHAPE], np.full(turns, TURN_SD), np.ones(gains)])
        jacobian[SHAPE.stop + 2 :, RIG.start :] = np.diag(1.0 / sd)
        return _Terms(residual, jacobian, float(residual @ residual), 0.0, 0.0)

    # -- motion -------------------------------------------------------------------------------------------

    def _motion(self, z: FloatArray, psi: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """At all times: acceleration of the centre of mass less gravity, along X and Y (m/s²), and α0 (rad/s²)."""
        record, at = self.record, self._nodes
        palms = _palms(self._reported[at], z)
        h = [rows @ z[SHAPE] + off for rows, off in zip(Lying.at(palms, psi[at], ORDER).h, z[_STANDOFFS], strict=True)]
        one, two = directions(palms[:, : len(JOINTS)].T)
        opening = np.sin(palms[:, OPENING])
        gravity, arm = record.rig[:2]
        x = (h[0] * np.cos(two) + h[1] * np.cos(one)) / opening - arm * np.cos(one)
        y = (h[0] * np.sin(two) + h[1] * np.sin(one)) / opening - arm * np.sin(one)
        limits = MOST_PULL, MOST_PULL, MOST_SPIN
        pull_x, pull_y, alpha = (
            np.interp(self._t, record.t, np.clip(_second_derivative(each, record.t), -most, most))
            for each, most in zip((x, y, psi[at]), limits, strict=True)
        )
        return pull_x, pull_y + gravity, alpha

    def _normal_forces(
        self, z: FloatArray, psi: FloatArray, motion: tuple[FloatArray, FloatArray, FloatArray], stuck: Palms
    ) -> tuple[FloatArray, FloatArray]:
        palms = _palms(self._reported, z)
        lying = Lying.at(palms, psi, ORDER)
        h, slope = ((rows[0] @ z[SHAPE], rows[1] @ z[SHAPE]) for rows in (lying.h, lying.slope))
        spin_term = math.exp(2.0 * z[LN_RHO]) * motion[2]
        return normal_forces(stuck, self._ratio(z, stuck), palms, h, slope, motion[:2], spin_term)

    def _ratio(self, z: FloatArray, stuck: Palms) -> FloatArray:
        """Ratio of friction to normal force at the slipping contact, along t."""
        ratio: FloatArray = z[MU] * (1.0 + z[ASYMMETRY] * np.where(stuck, 1.0, -1.0)) * _signs(self._reported, stuck)
        return ratio


def _second_derivative(values: FloatArray, t: FloatArray) -> FloatArray:
    """By differences over two steps: the derivative of a derivative over four would miss a fifth of a 10 Hz dither."""
    rates, middles = np.diff(values) / np.diff(t), 0.5 * (t[1:] + t[:-1])
    inner = np.diff(rates) / np.diff(middles)
    return np.concatenate([inner[:1], inner, inner[-1:]])


def _palms(reported: FloatArray, z: FloatArray) -> FloatArray:
    """The reported motion of the palms, its angles corrected by z."""
    corrected = reported.copy()
    corrected[:, :2] += z[[_TILT, _TURN]]
    return corrected


def _signs(palms: FloatArray, stuck: Palms) -> FloatArray:
    signs: FloatArray = np.where(stuck, SLIPS_SIGN[0], SLIPS_SIGN[1]) * np.sign(palms[:, 3])
    return signs


def _s(lying: Lying, palm: int, shape_of: FloatArray, standoffs: FloatArray) -> FloatArray:
    return lying.contact(palm) @ shape_of + lying.standing_off(palm) @ standoffs


def _q(lying: Lying, palm: int, shape_of: FloatArray, standoffs: FloatArray) -> FloatArray:
    """Q1 or Q2 of `model.rolling`."""
    return lying.kept(palm) @ shape_of + lying.standing_off(palm) @ standoffs


def _q_slopes(lying: Lying, palm: int, shape_of: FloatArray, standoffs: FloatArray, size: int) -> FloatArray:
    """Derivatives of Q1 or Q2 by z (n, size), at constant ψ."""
    slopes = np.zeros((len(lying.palms), size))
    slopes[:, SHAPE], slopes[:, _STANDOFFS] = lying.kept(palm), lying.standing_off(palm)
    slopes[:, _TILT] = -(lying.kept_turned(palm) @ shape_of)
    slopes[:, _TURN] = lying.kept_opened(palm, shape_of, standoffs)
    return slopes


def phases_of(stuck: Palms, t: FloatArray, reversals: FloatArray | None = None) -> list[StickPhase]:
    """Phases, from the stuck palm (0 or 1) at each of the times `t`.

    reversals: of `t`, at which a phase begins too: with dithered palms the object may turn there.
    """
    begins = np.diff(stuck) != 0
    if reversals is not None:
        begins |= np.isin(t[1:], reversals)
    changes = np.flatnonzero(begins) + 1
    starts = [float(t[0]), *(0.5 * (t[changes] + t[changes - 1])).tolist()]
    return [StickPhase(int(stuck[at]), start) for at, start in zip([0, *changes.tolist()], starts, strict=True)]


def _orientation_keeping(
    palms: FloatArray, psi: float, value: float, palm: int, shape_of: FloatArray, standoffs: FloatArray
) -> tuple[FloatArray, Lying]:
    """ψ at which Q1 or Q2 has this value, by Newton's method from psi (rad)."""
    at = np.full(len(palms), psi)
    for _ in range(NEWTON_STEPS):
        lying = Lying.at(palms, at, ORDER)
        step = (value - _q(lying, palm, shape_of, standoffs)) / (lying.kept_turned(palm) @ shape_of)
        if not np.abs(step).max(initial=0.0) > NEWTON_RAD:
            break
        at += np.clip(step, -0.3, 0.3)
    return at, lying


def _gated(residual: FloatArray, jacobian: FloatArray, weight: FloatArray) -> _Terms:
    """Robust terms of readings: beyond the gate the cost grows logarithmically."""
    nis, counts = residual**2, weight > 0.0
    median = float(np.median(nis[counts])) if counts.any() else 0.0
    gate = GATE * max(1.0, median / 0.455)
    beyond = nis > gate
    root = np.sqrt(np.where(beyond, gate / np.maximum(nis, gate), 1.0) * weight)
    cost = weight * np.where(beyond, gate * (1.0 + np.log(np.maximum(nis, gate) / gate)), nis)
    inside = counts & ~beyond
    chi2 = float(np.average(nis[inside], weights=weight[inside])) if inside.any() else math.inf
    outliers = float((beyond & counts).sum()) / max(int(counts.sum()), 1)
    return _Terms(root * residual, root[:, None] * jacobian, float(cost.sum()), chi2, outliers)
