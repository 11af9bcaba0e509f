"""Re-identification: test whether the last object is back at an unknown orientation. Not for use inside the loop.

Its constants are known, only orientation and motion are not, so that a few seconds of readings can suffice. A blind
search needs longer, and a second search that confirms it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from palmd.model.smoothing import C
from palmd.observer.backward_extension import with_free_node
from palmd.observer.data_segment import DataSegment
from palmd.observer.factor import marginal_of_constants
from palmd.observer.fixed_lag_smoother import PATIENCE, FixedLagSmoother, Solution
from palmd.observer.matching import ObjectInformation, with_turn_marginalised
from palmd.observer.noise import with_scatter
from palmd.observer.normal_equations import Guess
from palmd.observer.search import PLACED_S, Search, explained
from palmd.observer.smoother import Budget, Fit
from palmd.system.description import RigDescription

MOST_ORIENTATIONS = 3  # fitted to all readings at most (choice: the budget usually ends earlier)
OFFSETS_RAD = (0.0, -0.1, 0.1)  # starts about the last orientation (choice: 1 rad/s for 0.1 s; the fits move on)


def reidentified(
    known: ObjectInformation, segment: DataSegment, rig: RigDescription, budget: Budget, psi: float | None = None
) -> FixedLagSmoother | None:
    """A fixed-lag smoother of the `known` object over all of `segment`; None if it is not confirmed.

    A fit to the readings is not enough: an outline is free where it was not touched, so that a wrong orientation may
    fit as well. `FixedLagSmoother.join` compares the evidence with other orientations and other objects. psi (rad): the
    approximate orientation of an object that lost contact too briefly to have been exchanged; then a fit is enough.
    Raises LinAlgError if the normal equations are singular.
    """
    search = Search(segment, with_scatter(rig, segment.pads), PATIENCE, budget=budget)
    for fit in _orientations(known, search, psi)[:MOST_ORIENTATIONS]:
        turn = -float(fit.guess.x[0, 0])
        information = with_turn_marginalised(known.turned(turn).information)[0]
        p = fit.guess.p.copy()
        p[C.SHAPE :] = information.about[C.SHAPE :]
        prior = replace(search.prior, information=information)
        finding = search.with_knowledge(prior).resumed([Guess(fit.guess.x + np.array([turn, 0.0]), p)])
        if finding is None or not search.covers(finding):
            continue
        if finding.fits[0].settled and explained(finding.fits[0], finding.record):
            fixed_lag = FixedLagSmoother(Solution(search, finding))
            return fixed_lag if fixed_lag.join([known], None if psi is None else turn) is not None else None
    return None


def _orientations(known: ObjectInformation, search: Search, psi: float | None) -> list[Fit]:
    """Accepted fits of the first readings from the likeliest orientations; lowest cost first."""
    record, p = search.record.until(float(search.record.t[0]) + PLACED_S), known.information.about
    prior = with_free_node(known.information.plus(marginal_of_constants(search.prior, p)))
    smoother = search.with_knowledge(prior).smoother(record)
    likely = search.orientations(p[C.SHAPE :]) if psi is None else psi + np.array(OFFSETS_RAD)
    starts = (Guess(np.tile([each, 0.0], (len(record.t), 1)), p) for each in likely)
    fits = (smoother.fit(start, search.noise) for start in starts)
    return sorted((fit for fit in fits if explained(fit, record)), key=lambda fit: fit.cost)
