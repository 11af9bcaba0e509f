"""Whether two records, each in a gauge of its own, are of the same object, and the turn between their gauges. Pure.

The readings of each record give a quadratic cost of the smoother's constants. If the object is the same, turned by δ,
both costs add up; if it is another one, each has its own constants with the prior of any object. Integrated over the
constants these are Gaussian integrals, so the evidence of each δ against "another object" is known in closed form
(Jaynes 2003, chapter 20). Where the outlines were touched in different parts only, no δ stands out, and nothing is
joined.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from palmd.events import FloatArray
from palmd.model import shape
from palmd.model.smoothing import CONSTANTS, ORDER, RIG, C
from palmd.observer.coverage import Marks, turned_marks
from palmd.observer.factor import Factor

DIRECTIONS = 240  # candidate turns
STEP_RAD = math.tau / DIRECTIONS
APART_RAD = 0.15  # difference from which two turns are distinct answers
CERTAIN = 10.0  # nats by which a turn must exceed all distinct turns and the hypothesis of another object
REFINEMENTS = 4
_TURNS: FloatArray = np.arange(DIRECTIONS, dtype=np.float64) * STEP_RAD
_OUTLINE = slice(C.SHAPE, CONSTANTS)


@dataclass(frozen=True, slots=True)
class ObjectInformation:
    """What a record's readings determine of the constants, without a prior, and which normals were touched."""

    information: Factor
    touched: Marks

    def turned(self, turn: float) -> ObjectInformation:
        """The same in a gauge in which ψ is larger by `turn` (rad)."""
        R, old = _turn_matrix(turn), self.information
        moved = Factor(R @ old.about, old.cost, R @ old.matrix @ R.T, R @ old.side, old.scale)
        return ObjectInformation(moved, turned_marks(self.touched, turn))


@dataclass(frozen=True, slots=True)
class Match:
    """Information of one record in the gauge of another, in which ψ is larger by `turn` (rad)."""

    aligned: ObjectInformation
    turn: float


def matched(known: ObjectInformation, now: ObjectInformation, prior: Factor, turn: float | None = None) -> Match | None:
    """`known` in the gauge of `now`; None if it may be another object, or several turns are possible.

    prior: of any object. turn (rad): approximate turn between the gauges, where the object is known to be the same.
    """
    rest = now.information.plus(prior)
    if turn is None:
        turn = _certain_turn(known.information, now.information, rest, prior)
    if turn is None:
        return None
    for _ in range(REFINEMENTS):
        turn += _turn_step(known.turned(turn).information, rest)
    aligned = known.turned(turn)
    return Match(ObjectInformation(with_turn_marginalised(aligned.information)[0], aligned.touched), turn)


def _certain_turn(known: Factor, now: Factor, rest: Factor, prior: Factor) -> float | None:
    """The turn that exceeds all distinct ones and the hypothesis of another object; None where there is none."""
    weight_apart, weights = _weight_apart(known, now, prior), _weights(known, rest)
    best = int(np.argmax(weights))
    distinct = np.abs(np.remainder(_TURNS - _TURNS[best] + math.pi, math.tau) - math.pi) > APART_RAD
    if weights[best] - max(weight_apart, float(weights[distinct].max())) < CERTAIN:
        return None
    return float(_TURNS[best])


def _weights(known: Factor, rest: Factor) -> FloatArray:
    """For each of `_TURNS` the log of the integral over the constants and over equally likely turns about it.

    As `_weight` of the sum of both costs, for all turns at once.
    """
    free, turn_information = with_turn_marginalised(known)
    R = _turn_matrices()
    matrices = R @ free.matrix @ R.transpose(0, 2, 1)
    away = R @ free.about - rest.about  # the costs are expanded about different points
    pulls = (matrices @ away[..., None])[..., 0]
    sides = R @ free.side + pulls + rest.side
    costs = free.cost + rest.cost + ((2.0 * (R @ free.side) + pulls) * away).sum(axis=1)
    scale = 1.0 / np.sqrt(np.diagonal(rest.matrix))
    roots = np.linalg.cholesky((matrices + rest.matrix) * np.outer(scale, scale))
    solved = np.linalg.solve(roots, (sides * scale)[..., None])[..., 0]
    log_determinants = 2.0 * (np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1) - np.log(scale).sum())
    weights: FloatArray = -0.5 * (costs - (solved**2).sum(axis=1) + log_determinants)
    return weights - 0.5 * math.log1p(turn_information) - math.log(DIRECTIONS)


def with_turn_marginalised(known: Factor) -> tuple[Factor, float]:
    """`known` with its gauge free within a step, and the information of its readings about the turn, per step².

    To first order, a turn by ε moves the outline's coefficients along their derivative.
    """
    along = _turn_direction(known)
    pull = known.matrix @ along
    information = float(along @ pull)
    share = 1.0 / (information + STEP_RAD**-2.0)
    slope = float(along @ known.side)
    matrix = known.matrix - share * np.outer(pull, pull)
    return Factor(
        known.about, known.cost - share * slope**2, matrix, known.side - share * slope * pull, known.scale
    ), information * STEP_RAD**2


def _turn_step(known: Factor, rest: Factor) -> float:
    """Gauss–Newton step of the turn towards its likeliest value (rad)."""
    free = with_turn_marginalised(known)[0].plus(rest)
    p = free.about + free.solved(free.side)
    along = _turn_direction(known)
    pull = known.matrix @ along
    slope = float(along @ known.side) - float(pull @ (p - known.about))
    return float(-slope / (along @ pull + STEP_RAD**-2.0))


def _turn_matrix(turn: float) -> FloatArray:
    """Matrix that maps the constants to those in a gauge in which ψ is larger by `turn` (rad)."""
    R = np.eye(CONSTANTS)
    R[_OUTLINE, _OUTLINE] = shape.turned(turn, ORDER)
    return R


@cache
def _turn_matrices() -> FloatArray:
    """`_turn_matrix` of each of `_TURNS`."""
    return np.stack([_turn_matrix(float(turn)) for turn in _TURNS])


def _turn_direction(known: Factor) -> FloatArray:
    """d/dε of the constants when the outline is turned by ε (1/rad): the coefficients of h(θ + ε)."""
    along = np.zeros(CONSTANTS)
    h = 1e-6
    coefficients = known.about[_OUTLINE]
    along[_OUTLINE] = (shape.turned(h, ORDER) - shape.turned(-h, ORDER)) @ coefficients / (2 * h)
    return along


def _weight_apart(one: Factor, other: Factor, prior: Factor) -> float:
    """As `_weight` of two objects on one rig, less that of the prior of one object.

    The rig's constants are the same in both records, so that what either record determines of them counts in both.
    """
    first, second = (
        record_information.plus(prior).moved(_on_the_rig(record_information.about, other.about))
        for record_information in (one, other)
    )
    rig = prior.marginalised(_OUTLINE).marginalised(slice(0, C.RIG)).moved(other.about[RIG])
    inner, outer = (each.marginalised(_OUTLINE).marginalised(slice(0, C.RIG)) for each in (first, second))
    return (
        _weight(first) - _weight(inner) + _weight(second) - _weight(outer)
        + _weight(inner.plus(outer).minus(rig)) - _weight(prior) + _weight(rig)
    )  # fmt: skip


def _on_the_rig(p: FloatArray, other: FloatArray) -> FloatArray:
    """The constants p with the rig's constants of `other`."""
    moved = p.copy()
    moved[RIG] = other[RIG]
    return moved


def _weight(cost: Factor) -> float:
    """log ∫ exp(−cost/2), without the powers of 2π."""
    return -0.5 * (cost.cost - cost.excess() + cost.log_determinant())
