"""Whether two records, each in a gauge of its own, are of the same object, and how one outline is turned. Pure.

What each record's readings tell is a quadratic cost of the smoother's constants. Were the object the same, turned by δ,
both costs would add up; were it another, each would stand alone with what is believed of any object. Integrated over
the constants these are Gaussian integrals, so the evidence of each δ against "another object" is known in closed form
(Jaynes 2003, chapter 20). Where two outlines have been felt nowhere alike, no δ stands out, and nothing is joined.
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

DIRECTIONS = 240  # turns looked at
STEP_RAD = math.tau / DIRECTIONS
APART_RAD = 0.15  # from which on two turns are two answers
CERTAIN = 10.0  # nats by which one turn must stand out from all others and from another object
REFINEMENTS = 4
_TURNS: FloatArray = np.arange(DIRECTIONS, dtype=np.float64) * STEP_RAD
_OUTLINE = slice(C.SHAPE, CONSTANTS)


@dataclass(frozen=True, slots=True)
class Felt:
    """What a record's readings tell of the constants, without a prior, and which normals were touched."""

    information: Factor
    touched: Marks

    def turned(self, turn: float) -> Felt:
        """The same in a gauge in which ψ is larger by `turn` (rad)."""
        R, old = _turning(turn), self.information
        moved = Factor(R @ old.about, old.cost, R @ old.matrix @ R.T, R @ old.side, old.scale)
        return Felt(moved, turned_marks(self.touched, turn))


@dataclass(frozen=True, slots=True)
class Match:
    """What one record tells in the gauge of another, in which ψ is larger by `turn` (rad)."""

    felt: Felt
    turn: float


def matched(known: Felt, now: Felt, prior: Factor, turn: float | None = None) -> Match | None:
    """What `known` tells in the gauge of `now`; None if it may be another object, or lie in several ways.

    `prior` is what is believed of any object. turn (rad): about that of the gauges where the object is the same.
    """
    rest = now.information.plus(prior)
    if turn is None:
        turn = _certain_turn(known.information, now.information, rest, prior)
    if turn is None:
        return None
    for _ in range(REFINEMENTS):
        turn += _further(known.turned(turn).information, rest)
    found = known.turned(turn)
    return Match(Felt(of_any_small_turn(found.information)[0], found.touched), turn)


def _certain_turn(known: Factor, now: Factor, rest: Factor, prior: Factor) -> float | None:
    """The turn that stands out from all others and from another object; None where none does."""
    alone, weights = _weight_apart(known, now, prior), _weights(known, rest)
    best = int(np.argmax(weights))
    away = np.abs(np.remainder(_TURNS - _TURNS[best] + math.pi, math.tau) - math.pi) > APART_RAD
    if weights[best] - max(alone, float(weights[away].max())) < CERTAIN:
        return None
    return float(_TURNS[best])


def _weights(known: Factor, rest: Factor) -> FloatArray:
    """For each of `_TURNS` the log of the integral over the constants and over turns about it, of which all are likely.

    As `_weight` of both costs together, for all turns at once.
    """
    free, turns_told = of_any_small_turn(known)
    R = _turnings()
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
    return weights - 0.5 * math.log1p(turns_told) - math.log(DIRECTIONS)


def of_any_small_turn(known: Factor) -> tuple[Factor, float]:
    """`known` with its gauge open within a step, and how much more narrowly its readings tell that.

    To first order a turn by ε moves the outline's coefficients along their own derivative.
    """
    along = _along(known)
    pull = known.matrix @ along
    told = float(along @ pull)
    share = 1.0 / (told + STEP_RAD**-2.0)
    lean = float(along @ known.side)
    matrix = known.matrix - share * np.outer(pull, pull)
    return Factor(
        known.about, known.cost - share * lean**2, matrix, known.side - share * lean * pull, known.scale
    ), told * STEP_RAD**2


def _further(known: Factor, rest: Factor) -> float:
    """By how much the likeliest turn lies further than the present one (rad)."""
    free = of_any_small_turn(known)[0].plus(rest)
    p = free.about + free.solved(free.side)
    along = _along(known)
    pull = known.matrix @ along
    lean = float(along @ known.side) - float(pull @ (p - known.about))
    return float(-lean / (along @ pull + STEP_RAD**-2.0))


def _turning(turn: float) -> FloatArray:
    """Maps the constants to those in a gauge in which ψ is larger by `turn` (rad)."""
    R = np.eye(CONSTANTS)
    R[_OUTLINE, _OUTLINE] = shape.turned(turn, ORDER)
    return R


@cache
def _turnings() -> FloatArray:
    """`_turning` of each of `_TURNS`."""
    return np.stack([_turning(float(turn)) for turn in _TURNS])


def _along(known: Factor) -> FloatArray:
    """d/dε of the constants when the outline turns by ε (1/rad), the coefficients of h(θ + ε)."""
    along = np.zeros(CONSTANTS)
    h = 1e-6
    coefficients = known.about[_OUTLINE]
    along[_OUTLINE] = (shape.turned(h, ORDER) - shape.turned(-h, ORDER)) @ coefficients / (2 * h)
    return along


def _weight_apart(one: Factor, other: Factor, prior: Factor) -> float:
    """As `_weight` of two objects on one rig, less that of one object's prior.

    The rig's constants are the same in both records, so that what either tells of them is held against neither.
    """
    first, second = (told.plus(prior).moved(_on_the_rig(told.about, other.about)) for told in (one, other))
    rig = prior.without(_OUTLINE).without(slice(0, C.RIG)).moved(other.about[RIG])
    inner, outer = (each.without(_OUTLINE).without(slice(0, C.RIG)) for each in (first, second))
    return (
        _weight(first) - _weight(inner) + _weight(second) - _weight(outer)
        + _weight(inner.plus(outer).less(rig)) - _weight(prior) + _weight(rig)
    )  # fmt: skip


def _on_the_rig(p: FloatArray, other: FloatArray) -> FloatArray:
    """The constants p with the rig's of another's."""
    moved = p.copy()
    moved[RIG] = other[RIG]
    return moved


def _weight(cost: Factor) -> float:
    """log ∫ exp(−cost/2), without the powers of 2π."""
    return -0.5 * (cost.cost - cost.strain() + cost.log_determinant())
