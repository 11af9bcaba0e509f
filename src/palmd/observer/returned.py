"""A known object that is put back: sought as what it was, turned somehow, before anything else is. Not for the loop.

What was felt of it says all but how it lies and how it moves, so that a second or two of readings may be enough; a
blind search needs several, and two that agree.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from palmd.model.smoothing import CONSTANTS, C
from palmd.observer.beginning import with_any_node
from palmd.observer.data_segment import DataSegment
from palmd.observer.factor import of_constants
from palmd.observer.follower import PATIENCE, Answer, Follower
from palmd.observer.matching import Felt, of_any_small_turn
from palmd.observer.noise import with_scatter
from palmd.observer.normal_equations import Guess
from palmd.observer.search import PLACED_S, Search, explained
from palmd.observer.smoother import Budget, Fit
from palmd.system.description import RigDescription

WAYS = 3  # to lie that are followed to the end of the readings
OUTLINE_SD_M = 1e-4  # of the outline where ways to lie are looked for


def returned(known: Felt, segment: DataSegment, rig: RigDescription, budget: Budget) -> Follower | None:
    """Who follows it through all of `segment`; None where these readings may be of another object, or lie in two ways.

    What was never felt of it may be anything, so that to explain them is not enough: it is joined as `Follower.join`
    joins what was felt before.
    """
    search = Search(segment, with_scatter(rig, segment.pads), PATIENCE, budget=budget)
    for fit in _ways_to_lie(known, search)[:WAYS]:
        psi = float(fit.guess.x[0, 0])
        told = of_any_small_turn(known.turned(-psi).told)[0]
        p = fit.guess.p.copy()
        p[C.SHAPE :] = told.about[C.SHAPE :]
        finding = search.knowing(replace(search.prior, told=told)).resumed([Guess(fit.guess.x - [psi, 0.0], p)])
        if finding is None or len(finding.record.t) < len(search.record.t):
            continue
        if finding.fits[0].settled and explained(finding.fits[0], finding.record):
            follower = Follower(Answer(search, finding))
            return follower if follower.join([known]) is not None else None
    return None


def _ways_to_lie(known: Felt, search: Search) -> list[Fit]:
    """Those that explain the first readings, the likeliest first."""
    record, p = search.record.until(float(search.record.t[0]) + PLACED_S), known.told.about
    placed = search.knowing(with_any_node(known.told.plus(of_constants(search.prior, p))))
    smoother = placed.smoother(record)
    fits = []
    for psi in search.orientations(p[C.SHAPE :], OUTLINE_SD_M**2 * np.eye(CONSTANTS - C.SHAPE)):
        start = Guess(np.tile([psi, 0.0], (len(record.t), 1)), p)
        fit = smoother.fit(start, search.noise)
        if explained(fit, record):
            fits.append(fit)
    return sorted(fits, key=lambda fit: fit.cost)
