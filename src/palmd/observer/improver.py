"""The smoother beside a live observer: from the readings so far, a better filter than the bank could grow.

A filter keeps what it made of each reading when it came; the smoother looks at all of them again with what is known
now. Its posterior at the last node is a Gaussian belief about the shape map's state, so a filter can start from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.events import Event, FloatArray, RigDescription
from palmd.model import shape
from palmd.model.smoothing import CONSTANTS, C
from palmd.observer.search import Finding, Search, doubt, merged
from palmd.observer.smoother import Fit, Guess, Smoother
from palmd.observer.stretch import longest_stretch

LEAST_S = 1.0  # of readings, before which the bank is as good
PATIENCE = 2  # windows that may fail: an answer that hard to find comes too late
STARTS = 3  # of the bank's filters that the smoother follows up
BANK_READS_S = 2.0
CHALLENGE = 2.0  # by how much the record grows from one blind search to the next

# Where each state of the shape map stands among (constants, last node) of the smoother.
_FROM = np.concatenate(
    [
        [CONSTANTS, CONSTANTS + 1, C.LN_RHO, C.MU, C.LN_DITHER, C.DAMPING],
        C.SHAPE + np.arange(shape.COEFFICIENTS),
    ]
).astype(np.intp)


@dataclass(frozen=True, slots=True)
class Improvement:
    """A belief about the shape map's state at time `t` (s): mean (21) and covariance (21, 21)."""

    t: float
    x: FloatArray
    P: FloatArray


class Improver:
    """Smooths the readings of one object again and again as they grow; not for use inside the loop.

    Each answer starts the next one, so most calls cost a few iterations.
    """

    def __init__(self, rig: RigDescription, seed: int = 0):
        """Deterministic for a given seed and the same calls."""
        self._rig = rig
        self._seed = seed
        self._start: float | None = None
        self._guesses: tuple[Guess, ...] = ()
        self._challenge_s = 0.0

    def improve(self, events: Sequence[Event]) -> Improvement | None:
        """What all `events` of the object so far tell about its state at their end; None while that is in doubt."""
        stretch = longest_stretch(events)
        if stretch is None or stretch.end - stretch.start < LEAST_S:
            return None
        search = Search(stretch, self._rig, PATIENCE)
        finding: Finding | None = None
        if self._guesses and stretch.start == self._start:
            finding = search.resumed(self._guesses)
        else:
            self._challenge_s = 0.0
        seconds = stretch.end - stretch.start
        if finding is None or seconds >= self._challenge_s or doubt(finding.fits[0], finding):
            # a window that has grown may have been led into a valley next to the right one
            self._seed += 1
            finding = merged(finding, search.blind(min(BANK_READS_S, seconds), STARTS, self._seed))
            self._challenge_s = CHALLENGE * seconds
        if finding is None:
            self._guesses = ()
            return None
        self._start, self._guesses = stretch.start, tuple(fit.guess for fit in finding.fits)
        best = finding.fits[0]
        return None if doubt(best, finding) else _improvement(search, finding, best)


def _improvement(search: Search, finding: Finding, best: Fit) -> Improvement | None:
    try:
        posterior = Smoother(search.library, finding.record, search.prior).posterior(best)
    except np.linalg.LinAlgError:
        return None
    everything = np.concatenate([best.guess.p, best.guess.x[-1]])
    x, P = everything[_FROM], posterior.covariance[np.ix_(_FROM, _FROM)]
    return Improvement(float(finding.record.t[-1]), x, P)
