"""Least squares of an object that sticks to one palm and slips along the other, on a record of readings. Pure.

Unknown are the constants: coefficients of h, ln ρ, ln m, μ and, where the stuck palm changes, by how much the object
turned in that moment. Between two changes ψ is what keeps Q1 or Q2 (`model.rolling`), so it needs no nodes
and no process noise; its derivatives follow from the implicit function theorem.
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
from palmd.model.smoothing import ORDER, C
from palmd.observer.factor import Prior
from palmd.observer.palm_path import PalmPath
from palmd.observer.record import Record
from palmd.observer.stuck_palms import STANDING, Palms, likeliest
from palmd.system.mechanism import JOINTS, OPENING, directions

SHAPE = slice(0, 2 * ORDER + 1)
LN_RHO, LN_MASS, MU, TURNS = range(SHAPE.stop, SHAPE.stop + 4)
FRICTION, FRICTION_SD = 0.25, 0.15
TURN_SD, MUCH = 5e-3, 2.0  # rad, while both contacts slip; sigmas
BLIND_S = 0.015  # before and after a change, in which forces tell of blows
GATE = 16.0  # squared normalised residual beyond which a reading's pull falls off
NEWTON_STEPS, NEWTON_RAD = 12, 1e-11
ITERATIONS, LEAST_DAMPING, MOST_DAMPING, WORTH = 25, 1e-9, 1e6, 1e-3
MOST_PULL, MOST_SPIN = 2.0, 60.0  # m/s², rad/s²: accelerations beyond are of moments
CHANGE_COST = 12.0
_STEP = 1e-6


@dataclass(frozen=True, slots=True)
class Rolling:
    """From `start` (s) on the object sticks to `palm` (0 or 1)."""

    palm: int
    start: float


@dataclass(frozen=True, slots=True)
class DryFit:
    """A minimum: constants z as in the module, their normal matrix, ψ at the record's nodes, and how well it explains.

    chi2, force_chi2: per reading, of those that are no outliers; strain: what prior knowledge costs. asked: the largest
    share of force readings' friction, over normal force, where the object sticks.
    """

    z: FloatArray
    matrix: FloatArray
    psi: FloatArray
    cost: float
    chi2: float
    force_chi2: float
    outliers: float
    strain: float
    settled: bool
    asked: float


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

    def __init__(self, record: Record, path: PalmPath, prior: Prior, phases: Sequence[Rolling]):
        self.record, self.prior, self.phases = record, prior, phases
        contact_t = record.t[record.contact_step] + record.contact_offset
        force_t = record.t[record.force_step] + record.force_offset
        self._t, index = np.unique(np.concatenate([record.t, contact_t, force_t]), return_inverse=True)
        self._nodes, self._contacts, self._forces = np.split(index, np.cumsum([len(record.t), len(contact_t)]))
        self._palms = path.at(self._t)
        starts = np.array([phase.start for phase in phases])
        self._edges = path.at(np.append(starts, self._t[-1]))
        cuts = np.append(np.searchsorted(self._t, starts), len(self._t))
        cuts[0] = 0
        self._spans = [slice(*each) for each in pairwise(cuts.tolist())]
        self._stuck = np.repeat([phase.palm for phase in phases], np.diff(cuts))
        self._palms_signs = np.where(self._stuck, SLIPS_SIGN[0], SLIPS_SIGN[1]) * np.sign(self._palms[:, 3])
        apart = np.abs(force_t[:, None] - starts[None, 1:]).min(axis=1, initial=math.inf)
        moving = np.abs(self._palms[self._forces, 3]) > STANDING
        self._weight = (moving & (apart > BLIND_S)) * record.force_weight
        self.size = TURNS + len(phases) - 1

    def begun(self, shape_of: FloatArray, mass: float, mu: float) -> FloatArray:
        """z of an object of this outline."""
        z = np.zeros(self.size)
        z[SHAPE], z[LN_MASS], z[MU] = shape_of, math.log(mass), mu
        z[LN_RHO] = self.prior.mean[C.LN_RHO] + math.log(shape_of[0])
        return z

    def fit(self, z: FloatArray) -> DryFit:
        """By Levenberg's and Marquardt's method from z; raises LinAlgError where there is no minimum."""
        now, damping, settled = self._terms(z), 1e-3, False
        for _ in range(ITERATIONS):
            matrix, side = self._normal(now)
            while damping < MOST_DAMPING:
                step = np.linalg.solve(matrix + damping * np.diag(np.diagonal(matrix)), side)
                then = self._terms(z + step)
                if then.cost < now.cost + _STEP:
                    break
                damping *= 8.0
            else:
                break
            settled = now.cost - then.cost < WORTH
            z, now, damping = z + step, then, max(0.1 * damping, LEAST_DAMPING)
            if settled:
                break
        return self._found(z, now, settled)

    def stuck_anew(self, fit: DryFit) -> list[Rolling]:
        """The likeliest sequence of stuck palms, the object being that of the fit."""
        record, z = self.record, fit.z
        psi, _ = self._followed(z)
        costs = np.zeros((2, len(record.t)))
        for palm in (0, 1):
            stuck = np.full(len(self._t), palm)
            forces = self._normal_forces(z, psi, self._motion(z, psi), stuck)
            predicted = np.where(record.force_pad == 1, *(each[self._forces] for each in forces)) * math.exp(z[LN_MASS])
            nis = (record.force_value - predicted) ** 2 / record.force_variance
            moving = np.abs(self._palms[self._forces, 3]) > STANDING
            np.add.at(costs[palm], record.force_step, np.minimum(nis, GATE) * moving * record.force_weight)
        return phases_of(likeliest(costs, CHANGE_COST), record.t)

    def without_the_strained(self, fit: DryFit) -> list[Rolling]:
        """The phases less the one that asks the object to turn most at its ends, where that is much."""
        turns = np.square(fit.z[TURNS:])
        strain = turns[:-1] + turns[1:]
        if not strain.max(initial=0.0) > (MUCH * TURN_SD) ** 2:
            return list(self.phases)
        worst = 1 + int(np.argmax(strain))
        return [*self.phases[:worst], *self.phases[worst + 2 :]]

    def turned_sd(self, fit: DryFit, covariance: FloatArray) -> float:
        """One-sigma of ψ at the last node (rad)."""
        last = self._followed(fit.z)[1][self._nodes[-1]]
        return math.sqrt(float(last @ covariance @ last))

    # -- the terms of the cost ----------------------------------------------------------------------------

    def _normal(self, terms: _Terms) -> tuple[FloatArray, FloatArray]:
        return terms.jacobian.T @ terms.jacobian, terms.jacobian.T @ terms.residual

    def _terms(self, z: FloatArray) -> _Terms:
        psi, slope = self._followed(z)
        parts = self._contact_terms(z, psi, slope), self._force_terms(z, psi, slope), self._prior_terms(z)
        cost = sum(part.cost for part in parts)
        return _Terms(
            np.concatenate([part.residual for part in parts]), np.concatenate([part.jacobian for part in parts]),
            cost if math.isfinite(cost) else math.inf, parts[0].chi2, parts[0].outliers,
        )  # fmt: skip

    def _found(self, z: FloatArray, terms: _Terms, settled: bool) -> DryFit:
        psi, slope = self._followed(z)
        forces, strain = self._force_terms(z, psi, slope), self._prior_terms(z).cost
        motion = self._motion(z, psi)
        palms, ratio = self._palms, z[MU] * self._palms_signs
        pressed = self._normal_forces(z, psi, motion, self._stuck)
        asked = np.abs(friction_asked(self._stuck, ratio, palms, motion[:2], pressed))[self._forces]
        asked = np.append(asked[self._weight > 0.0], 0.0)
        return DryFit(
            z, self._normal(terms)[0], psi[self._nodes], terms.cost, terms.chi2, forces.chi2,
            max(terms.outliers, forces.outliers), strain, settled, float(np.quantile(asked, 0.99, method="nearest")),
        )  # fmt: skip

    def _followed(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """ψ at all times, and its derivatives by z."""
        shape_of = z[SHAPE]
        psi, slope = np.empty(len(self._t)), np.zeros((len(self._t), self.size))
        at, moved = 0.0, np.zeros(self.size)
        for number, (phase, span) in enumerate(zip(self.phases, self._spans, strict=True)):
            if number:
                turn = TURNS + number - 1
                at, moved = at + z[turn], moved.copy()
                moved[turn] += 1.0
            first = Lying.at(self._edges[number : number + 1], np.array([at]), ORDER)
            rows = first.kept(phase.palm)
            kept = first.kept_slope(phase.palm, shape_of)[0] * moved
            kept[SHAPE] += rows[0]
            palms = np.vstack([self._palms[span], self._edges[number + 1 : number + 2]])
            where, lying = _kept(palms, at, float(rows[0] @ shape_of), phase.palm, shape_of)
            by = np.repeat(kept[None], len(where), axis=0)
            by[:, SHAPE] -= lying.kept(phase.palm)
            by /= lying.kept_slope(phase.palm, shape_of)[:, None]
            psi[span], slope[span], at, moved = where[:-1], by[:-1], float(where[-1]), by[-1]
        return psi, slope

    def _contact_terms(self, z: FloatArray, psi: FloatArray, slope: FloatArray) -> _Terms:
        record, shape_of, at = self.record, z[SHAPE], self._contacts
        lying = Lying.at(self._palms[at], psi[at], ORDER)
        first = record.contact_pad == 1
        rows = np.where(first[:, None], lying.contact(0), lying.contact(1))
        turned = np.where(first, *(lying.contact_slope(palm, shape_of) for palm in (0, 1)))
        jacobian = turned[:, None] * slope[at]
        jacobian[:, SHAPE] += rows
        sd = np.sqrt(record.contact_variance)
        return _gated((record.contact_value - rows @ shape_of) / sd, jacobian / sd[:, None], record.contact_weight)

    def _force_terms(self, z: FloatArray, psi: FloatArray, slope: FloatArray) -> _Terms:
        record, at, mass = self.record, self._forces, math.exp(z[LN_MASS])
        pull_x, pull_y, alpha = (each[at] for each in self._motion(z, psi))
        palms, stuck, first = self._palms[at], self._stuck[at], record.force_pad == 1
        lying = Lying.at(palms, psi[at], ORDER)
        felt: list[Any] = [*(rows @ z[SHAPE] for rows in (*lying.h, *lying.slope)), z[MU], z[LN_RHO]]

        def told(values: list[Any]) -> FloatArray:
            *lying_so, mu, ln_rho = values
            ratio, spun = mu * self._palms_signs[at], math.exp(2.0 * ln_rho) * alpha
            h, slopes = (lying_so[0], lying_so[1]), (lying_so[2], lying_so[3])
            forces = normal_forces(stuck, ratio, palms, h, slopes, (pull_x, pull_y), spun)
            return mass * np.where(first, *forces)

        value = told(felt)
        gains = [(told([*felt[:i], felt[i] + _STEP, *felt[i + 1 :]]) - value) / _STEP for i in range(len(felt))]
        turned, jacobian = np.zeros(len(at)), np.zeros((len(at), self.size))
        for gain, rows, then in zip(gains, (*lying.h, *lying.slope), (*lying.slope, *lying.bend), strict=False):
            turned -= gain * (then @ z[SHAPE])
            jacobian[:, SHAPE] += gain[:, None] * rows
        jacobian += turned[:, None] * slope[at]
        jacobian[:, MU], jacobian[:, LN_RHO], jacobian[:, LN_MASS] = gains[4], gains[5], value
        sd = np.sqrt(record.force_variance)
        return _gated((record.force_value - value) / sd, jacobian / sd[:, None], self._weight)

    def _prior_terms(self, z: FloatArray) -> _Terms:
        prior = self.prior
        rho_sd = prior.sd[C.LN_RHO]
        residual = np.concatenate([
            (prior.mean[C.SHAPE :] - z[SHAPE]) / prior.sd[C.SHAPE :],
            [(prior.mean[C.LN_RHO] + math.log(z[0]) - z[LN_RHO]) / rho_sd if z[0] > 0.0 else math.inf],
            [(FRICTION - z[MU]) / FRICTION_SD], -z[TURNS:] / TURN_SD,
        ])  # fmt: skip
        jacobian = np.zeros((len(residual), self.size))
        jacobian[SHAPE, SHAPE] = np.diag(1.0 / prior.sd[C.SHAPE :])
        jacobian[SHAPE.stop, [LN_RHO, 0]] = 1.0 / rho_sd, -1.0 / (z[0] * rho_sd)
        jacobian[SHAPE.stop + 1, MU] = 1.0 / FRICTION_SD
        jacobian[SHAPE.stop + 2 :, TURNS:] = np.eye(self.size - TURNS) / TURN_SD
        return _Terms(residual, jacobian, float(residual @ residual), 0.0, 0.0)

    # -- motion -------------------------------------------------------------------------------------------

    def _motion(self, z: FloatArray, psi: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """At all times: acceleration of the COM less gravity, along X and Y (m/s²), and α0 (rad/s²)."""
        record, at = self.record, self._nodes
        palms, h = self._palms[at], [rows @ z[SHAPE] for rows in Lying.at(self._palms[at], psi[at], ORDER).h]
        one, two = directions(palms[:, : len(JOINTS)].T)
        opening = np.sin(palms[:, OPENING])
        gravity, arm = record.rig[:2]
        x = (h[0] * np.cos(two) + h[1] * np.cos(one)) / opening - arm * np.cos(one)
        y = (h[0] * np.sin(two) + h[1] * np.sin(one)) / opening - arm * np.sin(one)
        limits = MOST_PULL, MOST_PULL, MOST_SPIN
        pull_x, pull_y, alpha = (
            np.interp(self._t, record.t, np.clip(np.gradient(np.gradient(each, record.t), record.t), -most, most))
            for each, most in zip((x, y, psi[at]), limits, strict=True)
        )
        return pull_x, pull_y + gravity, alpha

    def _normal_forces(
        self, z: FloatArray, psi: FloatArray, motion: tuple[FloatArray, FloatArray, FloatArray], stuck: Palms
    ) -> tuple[FloatArray, FloatArray]:
        lying = Lying.at(self._palms, psi, ORDER)
        h, slope = ((rows[0] @ z[SHAPE], rows[1] @ z[SHAPE]) for rows in (lying.h, lying.slope))
        ratio = z[MU] * np.where(stuck, SLIPS_SIGN[0], SLIPS_SIGN[1]) * np.sign(self._palms[:, 3])
        spun = math.exp(2.0 * z[LN_RHO]) * motion[2]
        return normal_forces(stuck, ratio, self._palms, h, slope, motion[:2], spun)


def phases_of(stuck: Palms, t: FloatArray) -> list[Rolling]:
    """The phases of a palm (0 or 1) at each of the times `t`."""
    changes = np.flatnonzero(np.diff(stuck)) + 1
    starts = [float(t[0]), *(0.5 * (t[changes] + t[changes - 1])).tolist()]
    return [Rolling(int(stuck[at]), start) for at, start in zip([0, *changes.tolist()], starts, strict=True)]


def _kept(palms: FloatArray, psi: float, value: float, palm: int, shape_of: FloatArray) -> tuple[FloatArray, Lying]:
    """ψ at which Q1 or Q2 has this value, by Newton's method from psi (rad)."""
    at = np.full(len(palms), psi)
    for _ in range(NEWTON_STEPS):
        lying = Lying.at(palms, at, ORDER)
        step = (value - lying.kept(palm) @ shape_of) / lying.kept_slope(palm, shape_of)
        if not np.abs(step).max(initial=0.0) > NEWTON_RAD:
            break
        at += np.clip(step, -0.3, 0.3)
    return at, lying


def _gated(residual: FloatArray, jacobian: FloatArray, weight: FloatArray) -> _Terms:
    """Terms of readings, robust: beyond the gate a reading's cost grows as a logarithm."""
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
