"""Which palm an object sticks to, and what it is like, by filters that each take one sequence of palms for true. Pure.

Where friction has no dither an object nearly always sticks to one palm and slips along the other, which way is the
palms' doing (`model.rolling`). Given which, how it turns follows from the palms and the outline, and an extended Kalman
filter tells the outline from contacts and forces. Which, nobody says, and where friction is small forces alone do not
either; so every few steps each filter goes on with either palm, and those that have explained all readings best are
kept.
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
LOST = 1.0  # in ln mass and in ln radius, from where filters begin: beyond, one has diverged
MOST_NIS = 8.0  # of a reading, on the average of a step: whatever a blow does there
HOPELESS, HOPELESS_S = 1.4, 2.0  # of the squared normalised residuals' mean: no motion is one that sticks

SHAPE = slice(1, 2 + 2 * ORDER)  # after ψ
STANDOFF = slice(SHAPE.stop, SHAPE.stop + len(PALMS))  # of the palms' surfaces (m)
LN_MASS = slice(STANDOFF.stop, STANDOFF.stop + len(PALMS))  # as each pad weighs it
MU1, MU2 = range(LN_MASS.stop, LN_MASS.stop + 2)
SIZE = MU2 + 1
WEIGHED = np.arange(LN_MASS.start, LN_MASS.stop)
_LIES = slice(SHAPE.start, STANDOFF.stop)  # what tells where it touches
_OF_STANDOFFS = slice(C.RIG + R.STANDOFF, C.RIG + R.STANDOFF + len(PALMS))  # among the constants of `model.smoothing`
_LITTLE = 1e-6

Palms = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class StuckGuess:
    """The palm stuck to (0 or 1) at each node of a record, and the object that explains the readings so.

    outline: coefficients (m), turned so that ψ = 0 at the first node; mass (kg); mu is the mean of both palms' friction
    and asymmetry (μ1 − μ2)/(μ1 + μ2). explained: until when (s) the readings are, rather than not.
    """

    palms: Palms
    outline: FloatArray
    mass: float
    mu: float
    asymmetry: float
    explained: float


@dataclass(frozen=True, slots=True)
class _Filters:
    """Those of m sequences of palms: mean (m, SIZE), covariance, the palm now and at each decision, and the costs.

    cost: twice the negative log-likelihood, of changes too; nis: of the squared normalised residuals alone.
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
    """What filters begin with: mean (SIZE) and covariance, and what pads' gains vary by in a step (2).

    kept: filters; decision_steps: until the next time the palm may change.
    """

    x: FloatArray
    covariance: FloatArray
    wanders: FloatArray
    kept: int = KEPT
    decision_steps: int = DECISION_STEPS


def blind(record: Record, prior: Prior, asymmetry_sd: float, gain_stds: Sequence[float] = (0.0, 0.0)) -> FilterStart:
    """As little as is known beforehand. Raises ValueError where a pad tells no force.

    prior: of the constants of `model.smoothing`. asymmetry_sd: of what is believed of the palms' friction, 0 where both
    rub alike. gain_stds: of each pad's forces, relative, all along.
    """
    x, covariance = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    x[SHAPE], x[LN_MASS], x[MU1:] = prior.mean[C.SHAPE :], math.log(_mass(record)), FRICTION
    covariance[SHAPE, SHAPE] = np.diag(prior.sd[C.SHAPE :] ** 2)
    covariance[STANDOFF, STANDOFF] = np.diag(prior.sd[_OF_STANDOFFS] ** 2)
    covariance[LN_MASS, LN_MASS] = MASS_SD**2 + np.diag(np.square(gain_stds))
    apart = (FRICTION * asymmetry_sd) ** 2
    covariance[MU1:, MU1:] = FRICTION_SD**2 + apart * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return FilterStart(x, covariance, np.array([_wandering(std) for std in gain_stds]))


def stuck_guess(record: Record, beginning: FilterStart) -> StuckGuess | float:
    """The likeliest; where nothing that sticks explains all readings, until when (s) they are explained.

    Of the rig the palms' standoffs are told with the object, the rest is taken as it is described.
    """
    pull = _pull(record, float(beginning.x[SHAPE.start]))
    filters = _begun(beginning)
    stride = max(round(STEP_S / float(record.dt[0])), 1)
    ends = np.append(np.arange(0, len(record.t) - 1, stride), len(record.t) - 1)
    read, explained, least = 0, float(record.t[0]), 0.0
    for number, (start, end) in enumerate(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)):
        if number % beginning.decision_steps == 0:
            filters = _decided(_best(filters, beginning.kept)) if number else filters
            excess = float(filters.nis.min()) - HOPELESS * read
            if excess < least:
                explained, least = float(record.t[start]), excess
            if excess > 0.0 and record.t[start] > record.t[0] + HOPELESS_S:
                return explained
            filters = replace(filters, past=np.column_stack([filters.past, filters.palm]))
        before = filters.x[:, 0]
        filters = _rolled(filters, record.palms[start], record.palms[end])
        filters.covariance[:, WEIGHED, WEIGHED] += beginning.wanders
        part = record.between(start, end)
        read += part.readings
        if part.readings:
            filters = _learned(filters, part, before, (pull[0][start:end], pull[1][start:end]))
            filters = filters.which(np.flatnonzero(_going(filters, beginning.x)))
            if not len(filters.cost):
                return explained
    best = filters.which(np.array([int(np.argmin(filters.cost))]))
    x = best.x[0]
    at_nodes = np.repeat(best.past[0], beginning.decision_steps * stride)[: len(record.t) - 1]
    mu = 0.5 * float(x[MU1] + x[MU2])
    palms, asymmetry = np.append(at_nodes, at_nodes[-1]), 0.5 * float(x[MU1] - x[MU2]) / mu
    return StuckGuess(palms, x[SHAPE], math.exp(x[LN_MASS].mean()), mu, asymmetry, explained)


def _wandering(std: float) -> float:
    """The variance of what a gain of this `std`, and a play, add in a step; 0 of a pad whose gain is known."""
    return 2.0 * STEP_S * (std**2 / DRIFT_S + HYSTERESIS**2 / HYSTERESIS_S) if std else 0.0


def _begun(beginning: FilterStart) -> _Filters:
    """One filter for each palm."""
    palm, none = np.array([0, 1]), np.zeros(2)
    x, covariance = np.tile(beginning.x, (2, 1)), np.tile(beginning.covariance, (2, 1, 1))
    return _Filters(x, covariance, palm, np.zeros((2, 0), np.intp), none, none)


def _decided(filters: _Filters) -> _Filters:
    """Each goes on as it did, and with the other palm."""
    turned = filters.covariance.copy()
    turned[:, 0, 0] += TURN_SD**2
    changed = replace(filters, palm=1 - filters.palm, covariance=turned, cost=filters.cost + CHANGE_COST)
    both = (np.concatenate([getattr(each, name) for each in (filters, changed)]) for name in filters.__slots__)
    return _Filters(*both)


def _best(filters: _Filters, count: int) -> _Filters:
    """The `count` best, without those that go the same way as a better one."""
    ordered = filters.which(np.argsort(filters.cost, kind="stable"))
    psi, palm = ordered.x[:, 0], ordered.palm
    alike = (np.abs(psi[:, None] - psi) < ALIKE_RAD) & (palm[:, None] == palm)
    return ordered.which(np.flatnonzero(~np.tril(alike, -1).any(axis=1))[:count])


def _rolled(filters: _Filters, palms: FloatArray, then: FloatArray) -> _Filters:
    """After the palms' motion from `palms` to `then`: each turns so that Q1 or Q2 stays as it is."""
    x, covariance = filters.x.copy(), filters.covariance.copy()
    lies, second = x[:, _LIES], filters.palm[:, None] == 1
    count = len(x)

    def kept(where: FloatArray, psi: FloatArray) -> tuple[FloatArray, FloatArray]:
        lying = Lying.at(np.tile(where, (count, 1)), psi, ORDER)
        first, other = (np.hstack([lying.kept(palm), lying.standing_off(palm)]) for palm in (0, 1))
        slope = _times(np.where(second, lying.kept_turned(1), lying.kept_turned(0)), x[:, SHAPE])
        return np.where(second, other, first), slope

    rows, slope = kept(palms, x[:, 0])
    value, psi = _times(rows, lies), x[:, 0]
    for _ in range(2):  # by Newton's method
        rows_then, slope_then = kept(then, psi)
        psi = psi + np.clip((value - _times(rows_then, lies)) / slope_then, -0.3, 0.3)
    by = np.zeros((count, SIZE))
    by[:, 0], by[:, _LIES] = slope / slope_then, (rows - rows_then) / slope_then[:, None]
    turned = np.einsum("ni,nij->nj", by, covariance)
    covariance[:, 0], covariance[:, :, 0] = turned, turned
    covariance[:, 0, 0] = _times(turned, by) + CREEP_SD**2
    x[:, 0] = psi
    return replace(filters, x=x, covariance=covariance)


def _learned(filters: _Filters, part: Record, before: FloatArray, pull: tuple[FloatArray, FloatArray]) -> _Filters:
    """After the readings of a step of the record, at the beginning of which ψ was `before`; `pull` as in `_pull`."""
    x, covariance = filters.x, filters.covariance
    lasts = float(part.t[-1] - part.t[0])

    def psi_at(step: npt.NDArray[np.intp], offset: FloatArray) -> FloatArray:
        share = (part.t[step] + offset - part.t[0]) / lasts
        at: FloatArray = before[:, None] + share * (x[:, :1] - before[:, None])
        return at

    pulled = pull[0][part.force_step], pull[1][part.force_step]
    contacts = _contacts(filters, part, psi_at(part.contact_step, part.contact_offset))
    forces = _forces(filters, part, psi_at(part.force_step, part.force_offset), pulled)
    foretold, by = (np.concatenate(each, axis=1) for each in zip(contacts, forces, strict=True))
    moving = np.abs(part.force_palms[:, len(JOINTS) + OPENING]) > STANDING
    noise = np.concatenate([
        (part.contact_variance + CONTACT_SD**2) / np.maximum(part.contact_weight, _LITTLE),
        (part.force_variance + (FORCE_SD * part.force_value) ** 2) / np.maximum(part.force_weight * moving, _LITTLE),
    ])  # fmt: skip
    miss = np.concatenate([part.contact_value, part.force_value]) - foretold
    told = by @ covariance
    spread = told @ by.transpose(0, 2, 1)
    unsure = np.einsum("nmm->nm", spread)  # a view: the diagonals
    unsure += UNDERWEIGHTED * unsure + noise
    gain = np.linalg.solve(spread, told)
    nis = np.einsum("nm,nm->n", miss, np.linalg.solve(spread, miss[:, :, None])[:, :, 0])
    nis = np.minimum(nis, MOST_NIS * part.readings)
    covariance = covariance - told.transpose(0, 2, 1) @ gain
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))  # what rounding makes of it else grows and grows
    return replace(
        filters, x=x + np.einsum("nms,nm->ns", gain, miss), covariance=covariance,
        cost=filters.cost + nis + np.linalg.slogdet(spread)[1], nis=filters.nis + nis,
    )  # fmt: skip


def _going(filters: _Filters, begun: FloatArray) -> npt.NDArray[np.bool_]:
    """Which have not diverged from x as they were `begun`."""
    mass, radius = filters.x[:, LN_MASS] - begun[LN_MASS], filters.x[:, SHAPE.start] / begun[SHAPE.start]
    going: npt.NDArray[np.bool_] = (np.abs(mass).max(axis=1) < LOST) & (
        np.abs(np.log(np.maximum(radius, _LITTLE))) < LOST
    )
    return going & np.isfinite(filters.cost)


def _contacts(filters: _Filters, part: Record, psi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What the pads should read at ψ (m, readings), and its derivatives (m, readings, SIZE)."""
    count = psi.shape[1]
    lying = Lying.at(np.tile(part.contact_palms, (len(psi), 1)), psi.ravel(), ORDER)
    first = np.tile(part.contact_pad == 1, len(psi))[:, None]
    one, two = (np.hstack([lying.contact(palm), lying.standing_off(palm)]) for palm in (0, 1))
    rows = np.where(first, one, two)
    turned = np.where(first, lying.contact_turned(0), lying.contact_turned(1))
    lies = np.repeat(filters.x[:, _LIES], count, axis=0)
    by = np.zeros((psi.size, SIZE))
    by[:, 0], by[:, _LIES] = _times(turned, lies[:, : turned.shape[1]]), rows
    return _times(rows, lies).reshape(psi.shape), by.reshape(*psi.shape, SIZE)


def _forces(
    filters: _Filters, part: Record, psi: FloatArray, pull: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """As `_contacts`, of forces; what spins the object is left out."""
    of_each = np.repeat(np.arange(len(psi)), psi.shape[1])
    stuck, x = filters.palm[of_each], filters.x[of_each]
    lying = Lying.at(np.tile(part.force_palms, (len(psi), 1)), psi.ravel(), ORDER)
    first, each = np.tile(part.force_pad == 1, len(psi)), np.arange(psi.size)
    weighed = np.where(first, LN_MASS.start, LN_MASS.start + 1)
    mass = np.exp(x[each, weighed])
    pull_x, pull_y = (np.tile(each, len(psi)) for each in pull)
    signs = np.where(stuck, SLIPS_SIGN[0], SLIPS_SIGN[1]) * np.sign(lying.palms[:, len(JOINTS) + OPENING])
    rubs = np.where(stuck, MU1, MU2)
    lies = (*lying.h, *lying.slope)
    felt: list[FloatArray] = [*(_times(rows, x[:, SHAPE]) for rows in lies), x[each, rubs]]

    def told(values: list[FloatArray]) -> FloatArray:
        h1, h2, slope1, slope2, mu = values
        unspun = np.zeros(psi.size)
        both = normal_forces(stuck, mu * signs, lying.palms, (h1, h2), (slope1, slope2), (pull_x, pull_y), unspun)
        pressed: FloatArray = mass * np.where(first, *both)
        return pressed

    value = told(felt)
    gains = [(told([*felt[:i], felt[i] + _LITTLE, *felt[i + 1 :]]) - value) / _LITTLE for i in range(len(felt))]
    by = np.zeros((psi.size, SIZE))
    for gain, rows, then in zip(gains, lies, (*lying.slope, *map(lying.bend, (0, 1))), strict=False):
        by[:, SHAPE] += gain[:, None] * rows
        by[:, 0] -= gain * _times(then, x[:, SHAPE])
    by[each, weighed], by[each, rubs] = value, gains[4]
    return value.reshape(psi.shape), by.reshape(*psi.shape, SIZE)


def _times(rows: FloatArray, columns: FloatArray) -> FloatArray:
    """Row by row."""
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
    """Of a frictionless object whose forces these are (kg)."""
    t = record.force_t
    pressed = sum(
        np.interp(record.t, t[mine], record.force_value[mine]) for mine in (record.force_pad == p for p in PALMS)
    )
    first, second = directions(record.palms[:, : len(JOINTS)].T)
    per_mass = float(record.rig[0]) * (np.sin(second) + np.sin(first)) / np.sin(record.palms[:, OPENING])
    return float(np.median(pressed / per_mass))
