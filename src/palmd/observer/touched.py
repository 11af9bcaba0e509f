"""Which outward normals of the object a palm has been in contact with."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.named import NAMED

NORMAL_BINS = 72
_PSI, _PHI1, _PHI2 = (NAMED.index(name) for name in ("psi", "phi1", "phi2"))

Marks = npt.NDArray[np.bool_]


class TouchMarks:
    """Marks on `NORMAL_BINS` normals, in the gauge of the filter that leads; safe inside the loop."""

    def __init__(self, marks: Marks | None = None, leader: int = -1):
        """`marks` made before, in the gauge of filter `leader`; none by default."""
        self.marks: Marks = np.zeros(NORMAL_BINS, dtype=np.bool_) if marks is None else marks.copy()
        self._leader = leader
        self._last_normals: tuple[float, float] | None = None

    def mark(self, leader: int, y: FloatArray, all_psi: Callable[[], FloatArray]) -> None:
        """Mark the normals (3.1) touched since the last call; filter `leader` has the values `y` of `NAMED`.

        `all_psi` gives ψ of every filter (rad), for when another one has taken the lead: what was touched before has
        other names in its gauge.
        """
        if leader != self._leader:
            if self._leader >= 0:
                psi = all_psi()
                turn = psi[leader] - psi[self._leader]
                self.marks = np.roll(self.marks, -round(turn / (2 * math.pi) * NORMAL_BINS))
            else:
                self.marks[:] = False
            self._leader, self._last_normals = leader, None
        theta1 = float(y[_PHI1] - y[_PSI]) - math.pi / 2
        theta2 = float(y[_PHI1] + y[_PHI2] - y[_PSI]) - 3 * math.pi / 2
        width = 2 * math.pi / NORMAL_BINS
        for now, before in zip((theta1, theta2), self._last_normals or (theta1, theta2), strict=True):
            first, last = sorted((now, before))
            for bin_ in range(math.floor(first / width), math.floor(last / width) + 1):
                self.marks[bin_ % NORMAL_BINS] = True
        self._last_normals = theta1, theta2

    def renumber(self, kept: npt.NDArray[np.intp]) -> None:
        """The bank has dropped filters: `kept` are the former numbers of those that stay."""
        place = np.flatnonzero(kept == self._leader)
        self._leader = int(place[0]) if len(place) else -1

    @property
    def fraction(self) -> float:
        """Share of the normals that are marked."""
        return float(self.marks.mean())
