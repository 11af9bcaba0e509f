"""The beginning of a record, sought last: from what the rest of it tells of the object, back to its first node. Pure.

How an object moves at first nothing foretells, and where it is let go in haste a search that begins there ends in a
valley next to the right one. What is known already is found again in short windows, one before the other.
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

FIRST_STEPS, LEAST_STEPS = 20, 5  # by which a window grows at first: more where that was right, fewer where it was not
OVERLAP = 50  # steps of what is known already, at a window's end
ITERATIONS = 12  # of a window: what is right is near
ANYWHERE_RAD, ANY_SPIN = 10.0, 10.0  # one-sigmas of a window's first node (rad, rad/s): it has no part in the gauge


def with_beginning(
    library: Library,
    whole: Record,
    rest: Fit,
    known: Factor,
    explained: Callable[[Fit, Record], bool],
) -> Guess | None:
    """The fit of the last nodes of `whole`, carried back to its first node; None where nothing explains what was there.

    `known`: what the rest tells of the constants. The motion is noisier at first only if nothing is found otherwise,
    since a loose one may settle in the valley next to the right one.
    """
    for loosened in ((), LOOSENED):
        guess = _carried_back(library, whole, rest, known, explained, loosened)
        if guess is not None:
            return guess
    return None


def _carried_back(
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
        start = Guess(_before(x[: end - first + 1], window, first - begin), p)
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
    return from_zero(Guess(x, p))


def from_zero(guess: Guess) -> Guess:
    """The same with ψ = 0 at the first node: that is gauge, and the outline is turned instead."""
    psi, p = float(guess.x[0, 0]), guess.p.copy()
    p[C.SHAPE :] = shape.turned(-psi, ORDER) @ p[C.SHAPE :]
    return Guess(guess.x - [psi, 0.0], p)


def known_of(p: FloatArray, covariance: FloatArray, scale: FloatArray) -> Factor:
    """Constants that are told so, the node before them anywhere; raises LinAlgError as `np.linalg.inv`.

    `scale` as in `Knowledge`.
    """
    matrix = np.zeros((CONSTANTS, CONSTANTS))
    matrix[:] = np.linalg.inv(covariance[:CONSTANTS, :CONSTANTS])
    return with_any_node(Factor(p, 0.0, matrix, np.zeros(CONSTANTS), scale))


def with_any_node(known: Factor) -> Factor:
    """Knowledge of the constants, extended by a node of unknown state (`ANYWHERE_RAD`, `ANY_SPIN`)."""
    matrix, side = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    matrix[:CONSTANTS, :CONSTANTS], side[:CONSTANTS] = known.matrix, known.side
    matrix[CONSTANTS:, CONSTANTS:] = np.diag([ANYWHERE_RAD**-2, ANY_SPIN**-2])
    return Factor(np.concatenate([known.about, np.zeros(NODE)]), known.cost, matrix, side, known.scale)


def _before(x: FloatArray, window: Record, more: int) -> FloatArray:
    """Nodes `x` with so many before them, turning as at the first that is known."""
    psi, omega0 = x[0]
    earlier = np.stack([psi + omega0 * (window.t[:more] - window.t[more]), np.full(more, omega0)], axis=1)
    return np.concatenate([earlier, x])
