"""Extend the fit of a record backwards to the record's first node. Pure.

How an object moves at first cannot be predicted. Where it is released in haste, a search that starts there often ends
in a wrong minimum next to the right one. So the constants are determined from the rest of the record first; the motion
before it is then fitted in short windows, each before the last one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from palmd.events import FloatArray
from palmd.model import shape
from palmd.model.compiled import Library
from palmd.model.smoothing import CONSTANTS, NODE, ORDER, C
from palmd.observer.factor import SIZE, Factor
from palmd.observer.normal_equations import LOOSENED, Guess
from palmd.observer.record import Record
from palmd.observer.smoother import Fit, Smoother

# steps of the first window, doubled after each success; least steps, to which a failing window is halved
FIRST_STEPS, LEAST_STEPS = 20, 5
OVERLAP = 50  # steps of the motion known already, at a window's end
ITERATIONS = 12  # of each fit of a window: its minimum is near
ANYWHERE_RAD, ANY_SPIN = 10.0, 10.0  # 1σ of a window's first node (rad, rad/s): it is not part of the gauge


def extended_backwards(
    library: Library,
    whole: Record,
    rest: Fit,
    known: Factor,
    explained: Callable[[Fit, Record], bool],
) -> Guess | None:
    """Extend `rest`, the fit of the last nodes of `whole`, to its first node; None where a window is not explained.

    known: knowledge of the constants from the rest of the record.
    explained: whether a fit explains the readings of its record.
    Higher process noise in the first iterations (`LOOSENED`) is tried second only: with it the fit may settle in a
    wrong minimum next to the right one.
    """
    for loosened in ((), LOOSENED):
        guess = _extended(library, whole, rest, known, explained, loosened)
        if guess is not None:
            return guess
    return None


def _extended(
    library: Library,
    whole: Record,
    rest: Fit,
    known: Factor,
    explained: Callable[[Fit, Record], bool],
    loosened: tuple[float, ...],
) -> Guess | None:
    x, p, steps = rest.guess.x, rest.guess.p, len(whole.dt)
    first, more = steps + 1 - len(x), FIRST_STEPS
    end = min(first + OVERLAP, steps)
    while first > 0:
        begin = max(first - more, 0)
        window = whole.between(begin, end)
        start = Guess(_prepended(x[: end - first + 1], window, first - begin), p)
        smoother = Smoother(library, window, known)
        for times in loosened:
            start = smoother.fit(start, rest.noise.noisier(times), ITERATIONS).guess
        fit = smoother.fit(start, rest.noise, ITERATIONS)
        if fit.settled and explained(fit, window):
            x, p = np.concatenate([fit.guess.x, x[end - first + 1 :]]), fit.guess.p
            first, more = begin, 2 * more
        elif more > LEAST_STEPS:
            more //= 2
        else:
            return None
    return with_zero_orientation(Guess(x, p))


def with_zero_orientation(guess: Guess) -> Guess:
    """The same fit with ψ = 0 at the first node; ψ is gauge, so the outline is rotated instead."""
    psi, p = float(guess.x[0, 0]), guess.p.copy()
    p[C.SHAPE :] = shape.turned(-psi, ORDER) @ p[C.SHAPE :]
    return Guess(guess.x - [psi, 0.0], p)


def knowledge_of_constants(p: FloatArray, covariance: FloatArray, scale: FloatArray) -> Factor:
    """Knowledge of the constants from an estimate `p` and its covariance; the node after them is free.

    scale: as in `Knowledge`. Raises LinAlgError as `np.linalg.inv`.
    """
    matrix = np.zeros((CONSTANTS, CONSTANTS))
    matrix[:] = np.linalg.inv(covariance[:CONSTANTS, :CONSTANTS])
    return with_free_node(Factor(p, 0.0, matrix, np.zeros(CONSTANTS), scale))


def with_free_node(known: Factor) -> Factor:
    """Knowledge of the constants, extended by a node of unknown state (`ANYWHERE_RAD`, `ANY_SPIN`)."""
    matrix, side = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    matrix[:CONSTANTS, :CONSTANTS], side[:CONSTANTS] = known.matrix, known.side
    matrix[CONSTANTS:, CONSTANTS:] = np.diag([ANYWHERE_RAD**-2, ANY_SPIN**-2])
    return Factor(np.concatenate([known.about, np.zeros(NODE)]), known.cost, matrix, side, known.scale)


def _prepended(x: FloatArray, window: Record, more: int) -> FloatArray:
    """Nodes `x`, preceded by `more` nodes that turn at the rate of the first one."""
    psi, omega0 = x[0]
    earlier = np.stack([psi + omega0 * (window.t[:more] - window.t[more]), np.full(more, omega0)], axis=1)
    return np.concatenate([earlier, x])
