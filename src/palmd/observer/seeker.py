"""The search for an unknown object while its readings come in: each answer starts the next. Not for the loop."""

from __future__ import annotations

import numpy as np

from palmd.events import FloatArray
from palmd.model.smoothing import ORDER
from palmd.observer.data_segment import DataSegment
from palmd.observer.follower import PATIENCE, Answer
from palmd.observer.normal_equations import Guess
from palmd.observer.search import Minima, Search, doubt, merged, still
from palmd.system.description import RigDescription

LEAST_S = 1.0  # of readings, before which the bank is as good
STILL_KEPT_S = 2.0  # of readings at rest, when those and what came before tell nothing
# Of each blind search: seconds that a bank reads, and how many of its filters the smoother starts from.
ATTEMPTS = ((2.0, 3), (3.5, 4), (1.2, 8), (5.0, 4))
HINT_SD = 1e-4  # m, of the outline's coefficients
CHALLENGE = 2.0  # by how much the record grows from one blind search to the next
LONGEST_S, KEPT_S = 30.0, 15.0  # of readings in which nothing has been found, and that are kept then


class Seeker:
    """Deterministic for a given seed and the same calls."""

    def __init__(self, rig: RigDescription, seed: int):
        """`seed` draws where blind searches start."""
        self._rig = rig
        self._seed = seed
        self._start: float | None = None
        self._guesses: tuple[Guess, ...] = ()
        self._challenge_s = 0.0
        self._failed = 0
        self._doubtful = True
        self.needs_from = -float("inf")

    def sought(self, segment: DataSegment, hint: FloatArray | None) -> Answer | None:
        """What all readings of `segment` tell; None while that is in doubt. `needs_from`: those before are useless.

        `hint`: constants that a live filter has settled on, in whatever gauge.
        """
        seconds = segment.end - segment.start
        if seconds < LEAST_S:
            return None
        search = Search(segment, self._rig, PATIENCE)
        if still(search.record) or (self._doubtful and search.rested(segment.end) > STILL_KEPT_S):
            self.needs_from = segment.end - STILL_KEPT_S
            return None
        finding: Minima | None = None
        if self._guesses and segment.start == self._start:
            finding = search.resumed(self._guesses)
        else:
            self._challenge_s = 0.0
        if finding is None and hint is not None:
            finding = search.placed(hint, HINT_SD**2 * np.eye(2 * ORDER + 1))
        if finding is None or seconds >= self._challenge_s or doubt(finding.fits[0], finding):
            # a window that has grown may have been led into a valley next to the right one
            reads_s, starts = ATTEMPTS[self._failed % len(ATTEMPTS)]
            self._seed += 1
            finding = merged(finding, search.blind(min(reads_s, seconds), starts, self._seed))
            self._challenge_s = CHALLENGE * seconds
        self._start, self._guesses = segment.start, tuple(fit.guess for fit in finding.fits) if finding else ()
        self._doubtful = finding is None or bool(doubt(finding.fits[0], finding))
        if finding is None or self._doubtful:
            self._failed += seconds > ATTEMPTS[0][0]
            if seconds > LONGEST_S:
                self.needs_from = segment.end - KEPT_S
            return None
        return Answer(search, finding)
