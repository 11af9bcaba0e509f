"""Which palm an object sticks to, and a first estimate of it, by filters with different sequences of palms. Pure.

Where friction has no dither an object nearly always sticks to one palm and slips along the other, in a direction set by
the palms' motion (`model.rolling`). Given the stuck palm, the object's turn follows from the palms and the outline, and
an extended Kalman filter estimates the outline from contacts and forces. The stuck palm is not measured, and where
friction is small forces alone do not determine it either. So every few steps each filter is continued with either palm,
and the filters that explain all readings best are kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.rolling import SLIPS_SIGN, Lying, normal_forces
from palmd.model.smoothing import ORDER, C, R
from palmd.observer.factor import Prior
from palmd.observer.force_gain import DRIFT_S, HYSTERESIS, HYSTERESIS_S
from palmd.observer.record import Record
from palmd.system.mechanism import JOINTS, OPENING, PALMS, directions

FRICTION, FRICTION_SD = 0.25, 0.15
STANDING = 1.5e-2  # rad/s: palms that turn against each other no faster may stand, or turn the other way
STEP_S, DECISION_STEPS = 0.02, 3  # of the filters; until the palm may change, while little is known of the object
KEPT = 48  # filters, the same
CHANGE_COST = 8.0  # of twice the log-likelihood: it changes once or twice a second
TURN_SD, CREEP_SD = 6e-3, 2e-4  # rad, at a change, which is somewhere between two decisions; and at each step
ALIKE_RAD = 1e-3  # filters of one palm whose ψ differ by less go the same way from now on
MASS_SD = 0.1  # relative, of what a frictionless object of these forces would have
CONTACT_SD, FORCE_SD = 3e-5, 0.02  # m and relative: what the filters leave out
UNDERWEIGHTED = 0.2  # of what a filter is unsure of a reading, as noise besides: it is linearised far from the answer
DITHERED_S = 2 * DECISION_STEPS * STEP_S
"""Time between two reversals of ω2, below which the palm that changes with each of them is not found (derivation: two
decisions). A plan's dither of 10 Hz turns the palms to and fro while they would else stand."""
LOST = 1.0  # in ln mass and in ln radius, from where filters begin: beyond, one has diverged
MOST_NIS = 8.0  # of a reading, on the average of a step: whatever a blow does there
HOPELESS, HOPELESS_S = 1.4, 2.0  # of the squared normalised residuals' mean: no motion is one that sticks

SHAPE = slice(1, 2 + 2 * ORDER)  # after ψ
STANDOFF = slice(SHAPE.stop, SHAPE.stop + len(PALMS))  # of the palms' surfaces (m)
LN_MASS = slice(STANDOFF.stop, STANDOFF.stop + len(PALMS))  # as each pad weighs it
MU1, MU2 = range(LN_MASS.stop, LN_MASS.stop + 2)
SIZE = MU2 + 1
MASS_INDICES = np.arange(LN_MASS.start, LN_MASS.stop)
_CONTACT_STATE = slice(SHAPE.start, STANDOFF.stop)  # states that determine the contacts
_OF_STANDOFFS = slice(C.RIG + R.STANDOFF, C.RIG + R.STANDOFF + len(PALMS))  # among the constants of `model.smoothing`
_LITTLE = 1e-6

Palms = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class StuckGuess:
    """The stuck palm (0 or 1) at each node of a record, and the object that explains the readings.

    outline: coefficients (m), with ψ = 0 at the first node; mass (kg); mu: mean friction of both palms; asymmetry: (μ1
    − μ2)/(μ1 + μ2). explained_until: end (s) of the explained readings.
    """

    palms: Palms
    outline: FloatArray
    mass: float
    mu: float
    asymmetry: float
    explained_until: float


@dataclass(frozen=True, slots=True)
class _Filters:
    """Filters for m sequences of palms: mean (m, SIZE), covariance, the palm now and at each decision, and the costs.

    cost: twice the negative log-likelihood, including changes. nis: sum of the squared normalised residuals only.
    """

    x: FloatArray
    covariance: FloatArray
    palm: Palms
    past: Palms
    cost: FloatArray
    nis: FloatArray

    def which(self, kept: Palms) -> _Filters:
        return _Filters(*(getattr(self, name)[kept] for name in self.__slots__))


@dataclass(frozen=True, slots=True)
class FilterStart:
    """Start of the filters: mean (SIZE) and covariance, and the variance added to the pads' gains in a step (2).

    kept: number of filters. decision_steps: between times at which the palm may change.
    """

    x: FloatArray
    covariance: FloatArray
    wanders: FloatArray
    kept: int = KEPT
    decision_steps: int = DECISION_STEPS


def blind(record: Record, prior: Prior, asymmetry_sd: float, gain_stds: Sequence[float] = (0.0, 0.0)) -> FilterStart:
    """Start from the prior. Raises ValueError where a pad measures no force.

    prior: of the constants of `model.smoothing`. asymmetry_sd: 1σ of the palms' friction asymmetry, 0 where friction is
    equal. gain_stds: relative gain error of each pad's forces.
    """
    x, covariance = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    x[SHAPE], x[LN_MASS], x[MU1:] = prior.mean[C.SHAPE :], math.log(_mass(record)), FRICTION
    covariance[SHAPE, SHAPE] = np.diag(prior.sd[C.SHAPE :] ** 2)
    covariance[STANDOFF, STANDOFF] = np.diag(prior.sd[_OF_STANDOFFS] ** 2)
    covariance[LN_MASS, LN_MASS] = MASS_SD**2 + np.diag(np.square(gain_stds))
    asymmetry_variance = (FRICTION * asymmetry_sd) ** 2
    covariance[MU1:, MU1:] = FRICTION_SD**2 + asymmetry_variance * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return FilterStart(x, covariance, np.array([_wandering(std) for std in gain_stds]))


def dithered(record: Record) -> FloatArray:
    """Times (s) of reversals of ω2 that follow each other within `DITHERED_S`.

    With each the direction of slip changes, and with it the stuck palm may, which differs from what slow motion asks.
    """
    opening = np.sign(record.palms[:, len(JOINTS) + OPENING])
    reversals = record.t[np.flatnonzero(np.diff(opening)) + 1]
    quick = np.diff(reversals, prepend=-math.inf, append=math.inf) < DITHERED_S
    times: FloatArray = reversals[quick[:-1] | quick[1:]]
    return times


def without_dithered_forces(record: Record) -> Record:
    """The record in which forces between such reversals do not count."""
    reversals = np.concatenate([[-math.inf], dithered(record), [math.inf]])
    after = np.searchsorted(reversals, record.force_t)
    return replace(record, force_weight=record.force_weight * (reversals[after] - reversals[after - 1] >= DITHERED_S))


def stuck_guess(record: Record, start: FilterStart) -> StuckGuess | float:
    """The likeliest guess; or until when (s) the readings are explained, where no sequence of stuck palms explains all.

    Of the rig, the palms' standoffs are estimated with the object; the rest is taken as described.
    """
    pull, reversals = _pull(record, float(start.x[SHAPE.start])), dithered(record)
    filters = _initial_filters(start)
    stride = max(round(STEP_S / float(record.dt[0])), 1)
    ends = np.append(np.arange(0, len(record.t) - 1, stride), len(record.t) - 1)
    readings, explained_until, least = 0, float(record.t[0]), 0.0
    for number, (step_start, step_end) in enumerate(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)):
        if number % start.decision_steps == 0:
            filters = _branched(_best(filters, start.kept)) if number else filters
            excess = float(filters.nis.min()) - HOPELESS * readings
            if excess < least:
                explained_until, least = float(record.t[step_start]), excess
            if excess > 0.0 and record.t[step_start] > record.t[0] + HOPELESS_S:
                return explained_until
            filters = replace(filters, past=np.column_stack([filters.past, filters.palm]))
        before = filters.x[:, 0]
        filters = _rolled(filters, record.palms[step_start], record.palms[step_end])
        filters.covariance[:, MASS_INDICES, MASS_INDICES] += start.wanders
        part = record.between(step_start, step_end)
        filters.covariance[:, 0, 0] += TURN_SD**2 * np.ptp(np.searchsorted(reversals, part.t[[0, -1]]))
        readings += part.readings
        if part.readings:
            filters = _learned(filters, part, before, (pull[0][step_start:step_end], pull[1][step_start:step_end]))
            filters = filters.which(np.flatnonzero(_not_diverged(filters, start.x)))
            if not len(filters.cost):
                return explained_until
    best = filters.which(np.array([int(np.argmin(filters.cost))]))
    x = best.x[0]
    at_nodes = np.repeat(best.past[0], start.decision_steps * stride)[: len(record.t) - 1]
    mu = 0.5 * float(x[MU1] + x[MU2])
    palms, asymmetry = np.append(at_nodes, at_nodes[-1]), 0.5 * float(x[MU1] - x[MU2]) / mu
    return StuckGuess(palms, x[SHAPE], math.exp(x[LN_MASS].mean()), mu, asymmetry, explained_until)


def _wandering(std: float) -> float:
    """Variance added in a step by a gain of this `std` and by play; 0 for a pad of known gain."""
    return 2.0 * STEP_S * (std**2 / DRIFT_S + HYSTERESIS**2 / HYSTERESIS_S) if std else 0.0


def _initial_filters(start: FilterStart) -> _Filters:
    """One filter for each palm."""
    palm, none = np.array([0, 1]), np.zeros(2)
    x, covariance = np.tile(start.x, (2, 1)), np.tile(start.covariance, (2, 1, 1))
    return _Filters(x, covariance, palm, np.zeros((2, 0), np.intp), none, none)


def _branched(filters: _Filters) -> _Filters:
    """Each filter continued with its palm, and with the other one."""
    turned = filters.covariance.copy()
    turned[:, 0, 0] += TURN_SD**2
    changed = replace(filters, palm=1 - filters.palm, covariance=turned, cost=filters.cost + CHANGE_COST)
    both = (np.concatenate([getattr(each, name) for each in (filters, changed)]) for name in filters.__slots__)
    return _Filters(*both)


def _best(filters: _Filters, count: int) -> _Filters:
    """The `count` best filters, without duplicates of a better one."""
    ordered = filters.which(np.argsort(filters.cost, kind="stable"))
    psi, palm = ordered.x[:, 0], ordered.palm
    alike = (np.abs(psi[:, None] - psi) < ALIKE_RAD) & (palm[:, None] == palm)
    return ordered.which(np.flatnonzero(~np.tril(alike, -1).any(axis=1))[:count])


def _rolled(filters: _Filters, palms: FloatArray, then: FloatArray) -> _Filters:
    """The filters after the palms' motion from `palms` to `then`: each turns so that Q1 or Q2 stays constant."""
    x, covariance = filters.x.copy(), filters.covariance.copy()
    contact_state, second = x[:, _CONTACT_STATE], filters.palm[:, None] == 1
    count = len(x)

    def constraint(palms_at: FloatArray, psi: FloatArray) -> tuple[FloatArray, FloatArray]:
        lying = Lying.at(np.tile(palms_at, (count, 1)), psi, ORDER)
        rows_first, other = (np.hstack([lying.kept(palm), lying.standing_off(palm)]) for palm in (0, 1))
        slope_before = _row_products(np.where(second, lying.kept_turned(1), lying.kept_turned(0)), x[:, SHAPE])
        return np.where(second, other, rows_first), slope_before

    rows, slope_before = constraint(palms, x[:, 0])
    value, psi = _row_products(rows, contact_state), x[:, 0]
    for _ in range(2):  # by Newton's method
        rows_then, slope_then = constraint(then, psi)
        psi = psi + np.clip((value - _row_products(rows_then, contact_state)) / slope_then, -0.3, 0.3)
    jacobian = np.zeros((count, SIZE))
    jacobian[:, 0], jacobian[:, _CONTACT_STATE] = slope_before / slope_then, (rows - rows_then) / slope_then[:, None]
    psi_row = np.einsum("ni,nij->nj", jacobian, covariance)
    covariance[:, 0], covariance[:, :, 0] = psi_row, psi_row
    covariance[:, 0, 0] = _row_products(psi_row, jacobian) + CREEP_SD**2
    x[:, 0] = psi
    return replace(filters, x=x, covariance=covariance)


def _learned(filters: _Filters, part: Record, before: FloatArray, pull: tuple[FloatArray, FloatArray]) -> _Filters:
    """The filters after the readings of a step, at the beginning of which ψ was `before`; `pull` as in `_pull`."""
    x, covariance = filters.x, filters.covariance
    duration = float(part.t[-1] - part.t[0])

    def psi_at(step: npt.NDArray[np.intp], offset: FloatArray) -> FloatArray:
        share = (part.t[step] + offset - part.t[0]) / duration
        at: FloatArray = before[:, None] + share * (x[:, :1] - before[:, None])
        return at

    pulled = pull[0][part.force_step], pull[1][part.force_step]
    contacts = _contacts(filters, part, psi_at(part.contact_step, part.contact_offset))
    forces = _forces(filters, part, psi_at(part.force_step, part.force_offset), pulled)
    predicted, jacobian = (np.concatenate(each, axis=1) for each in zip(contacts, forces, strict=True))
    moving = np.abs(part.force_palms[:, len(JOINTS) + OPENING]) > STANDING
    noise = np.concatenate([
        (part.contact_variance + CONTACT_SD**2) / np.maximum(part.contact_weight, _LITTLE),
        (part.force_variance + (FORCE_SD * part.force_value) ** 2) / np.maximum(part.force_weight * moving, _LITTLE),
    ])  # fmt: skip
    innovation = np.concatenate([part.contact_value, part.force_value]) - predicted
    gain_numerator = jacobian @ covariance
    spread = gain_numerator @ jacobian.transpose(0, 2, 1)
    diagonal = np.einsum("nmm->nm", spread)  # a view: the diagonals
    diagonal += UNDERWEIGHTED * diagonal + noise
    gain = np.linalg.solve(spread, gain_numerator)
    nis = np.einsum("nm,nm->n", innovation, np.linalg.solve(spread, innovation[:, :, None])[:, :, 0])
    nis = np.minimum(nis, MOST_NIS * part.readings)
    covariance = covariance - gain_numerator.transpose(0, 2, 1) @ gain
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))  # what rounding makes of it else grows and grows
    return replace(
        filters, x=x + np.einsum("nms,nm->ns", gain, innovation), covariance=covariance,
        cost=filters.cost + nis + np.linalg.slogdet(spread)[1], nis=filters.nis + nis,
    )  # fmt: skip


def _not_diverged(filters: _Filters, start_x: FloatArray) -> npt.NDArray[np.bool_]:
    """Which filters have not diverged from their start `start_x`."""
    mass, radius = filters.x[:, LN_MASS] - start_x[LN_MASS], filters.x[:, SHAPE.start] / start_x[SHAPE.start]
    kept: npt.NDArray[np.bool_] = (np.abs(mass).max(axis=1) < LOST) & (
        np.abs(np.log(np.maximum(radius, _LITTLE))) < LOST
    )
    return kept & np.isfinite(filters.cost)


def _contacts(filters: _Filters, part: Record, psi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Predicted contact readings at ψ (m, readings), and their derivatives (m, readings, SIZE)."""
    count = psi.shape[1]
    lying = Lying.at(np.tile(part.contact_palms, (len(psi), 1)), psi.ravel(), ORDER)
    on_first = np.tile(part.contact_pad == 1, len(psi))[:, None]
    one, two = (np.hstack([lying.contact(palm), lying.standing_off(palm)]) for palm in (0, 1))
    rows = np.where(on_first, one, two)
    turned_rows = np.where(on_first, lying.contact_turned(0), lying.contact_turned(1))
    contact_state = np.repeat(filters.x[:, _CONTACT_STATE], count, axis=0)
    jacobian = np.zeros((psi.size, SIZE))
    jacobian[:, 0], jacobian[:, _CONTACT_STATE] = (
        _row_products(turned_rows, contact_state[:, : turned_rows.shape[1]]),
        rows,
    )
    return _row_products(rows, contact_state).reshape(psi.shape), jacobian.reshape(*psi.shape, SIZE)


def _forces(
    filters: _Filters, part: Record, psi: FloatArray, pull: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """As `_contacts`, for forces; the object's angular acceleration is neglected."""
    of_each = np.repeat(np.arange(len(psi)), psi.shape[1])
    stuck, x = filters.palm[of_each], filters.x[of_each]
    lying = Lying.at(np.tile(part.force_palms, (len(psi), 1)), psi.ravel(), ORDER)
    on_first, each = np.tile(part.force_pad == 1, len(psi)), np.arange(psi.size)
    mass_index = np.where(on_first, LN_MASS.start, LN_MASS.start + 1)
    mass = np.exp(x[each, mass_index])
    pull_x, pull_y = (np.tile(each, len(psi)) for each in pull)
    signs = np.where(stuck, SLIPS_SIGN[0], SLIPS_SIGN[1]) * np.sign(lying.palms[:, len(JOINTS) + OPENING])
    friction_index = np.where(stuck, MU1, MU2)
    shape_rows = (*lying.h, *lying.slope)
    inputs: list[FloatArray] = [*(_row_products(rows, x[:, SHAPE]) for rows in shape_rows), x[each, friction_index]]

    def predict(values: list[FloatArray]) -> FloatArray:
        h1, h2, slope1, slope2, mu = values
        no_spin = np.zeros(psi.size)
        both = normal_forces(stuck, mu * signs, lying.palms, (h1, h2), (slope1, slope2), (pull_x, pull_y), no_spin)
        forces: FloatArray = mass * np.where(on_first, *both)
        return forces

    predicted = predict(inputs)
    slopes = [
        (predict([*inputs[:i], inputs[i] + _LITTLE, *inputs[i + 1 :]]) - predicted) / _LITTLE
        for i in range(len(inputs))
    ]
    jacobian = np.zeros((psi.size, SIZE))
    for slope, rows, slope_rows in zip(slopes, shape_rows, (*lying.slope, *map(lying.bend, (0, 1))), strict=False):
        jacobian[:, SHAPE] += slope[:, None] * rows
        jacobian[:, 0] -= slope * _row_products(slope_rows, x[:, SHAPE])
    jacobian[each, mass_index], jacobian[each, friction_index] = predicted, slopes[4]
    return predicted.reshape(psi.shape), jacobian.reshape(*psi.shape, SIZE)


def _row_products(rows: FloatArray, columns: FloatArray) -> FloatArray:
    """Row-wise scalar product."""
    product: FloatArray = np.einsum("ij,ij->i", rows, columns)
    return product


def _pull(record: Record, radius: float) -> tuple[FloatArray, FloatArray]:
    """Acceleration of a circle's centre less gravity at the nodes, along X and Y (m/s²)."""
    one, two = directions(record.palms[:, : len(JOINTS)].T)
    lever = radius / np.sin(record.palms[:, OPENING])
    gravity, arm = record.rig[:2]
    x, y = (
        lever * (np.cos(two) + np.cos(one)) - arm * np.cos(one),
        lever * (np.sin(two) + np.sin(one)) - arm * np.sin(one),
    )
    pull_x, pull_y = (np.gradient(np.gradient(each, record.t), record.t) for each in (x, y))
    return pull_x, pull_y + gravity


def _mass(record: Record) -> float:
    """Mass of a frictionless object with these forces (kg)."""
    t = record.force_t
    total_force = sum(
        np.interp(record.t, t[mine], record.force_value[mine]) for mine in (record.force_pad == p for p in PALMS)
    )
    first, second = directions(record.palms[:, : len(JOINTS)].T)
    per_mass = float(record.rig[0]) * (np.sin(second) + np.sin(first)) / np.sin(record.palms[:, OPENING])
    return float(np.median(total_force / per_mass))
