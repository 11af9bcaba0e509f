"""Coverage: which outward normals of the object have been in contact with a palm."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.outputs import NAMED
from palmd.system.arcs import FLAT, tangents
from palmd.system.mechanism import CONTACTS, JOINTS, normal_directions

NORMAL_BINS = 72
RECENT_S = 10.0
_WIDTH = 2 * math.pi / NORMAL_BINS
_PSI = NAMED.index("psi")
_ANGLES, _CONTACTS = ([NAMED.index(name) for name in names] for names in (JOINTS, CONTACTS))

Marks = npt.NDArray[np.bool_]


class Coverage:
    """Marks on `NORMAL_BINS` normals, in the gauge of the leading filter; safe in the loop."""

    def __init__(self, marks: Marks | None = None, leader: int = -1, curvatures: Sequence[float] = FLAT):
        """`marks`: earlier marks, in the gauge of filter `leader`; none by default. `curvatures` of the palms (1/m)."""
        self._curvatures = curvatures
        self.marks: Marks = np.zeros(NORMAL_BINS, dtype=np.bool_) if marks is None else marks.copy()
        self._leader = leader
        self._marked = int(np.count_nonzero(self.marks))
        self._last_bins: list[int] = []  # of both contacts; empty after a change of the leader
        self._recent: deque[tuple[float, int]] = deque()  # time (s) at which a bin was first marked

    def mark(self, t: float, leader: int, y: Sequence[float] | FloatArray, all_psi: Callable[[], FloatArray]) -> None:
        """Mark the normals (3.1) passed since the last call.

        t: time (s). leader: number of the leading filter; y: its values of `NAMED`.
        all_psi: returns ψ of every filter (rad). It is called when another filter takes the lead: then the marks are
        turned to its gauge.
        """
        self._turn_to(leader, all_psi)
        normals = _normals(y, self._curvatures)
        bins = [math.floor(normal / _WIDTH) for normal in normals]
        if bins != self._last_bins:  # else both are marked already
            for now, before in zip(bins, self._last_bins or bins, strict=True):
                for bin_ in range(min(now, before), max(now, before) + 1):
                    if not self.marks[bin_ % NORMAL_BINS]:
                        self.marks[bin_ % NORMAL_BINS] = True
                        self._recent.append((t, bin_ % NORMAL_BINS))
            self._last_bins, self._marked = bins, int(np.count_nonzero(self.marks))
        while self._recent and self._recent[0][0] < t - RECENT_S:
            self._recent.popleft()

    def renumber(self, kept: npt.NDArray[np.intp]) -> None:
        """Update the leader's number after filters were dropped; `kept`: former numbers of those that stay."""
        place = np.flatnonzero(kept == self._leader)
        self._leader = int(place[0]) if len(place) else -1

    def since(self, t: float, leader: int, all_psi: Callable[[], FloatArray]) -> Marks:
        """The normals first touched after `t` (s), at most `RECENT_S` ago, in the gauge of filter `leader`."""
        self._turn_to(leader, all_psi)
        marks = np.zeros(NORMAL_BINS, dtype=np.bool_)
        marks[[bin_ for when, bin_ in self._recent if when > t]] = True
        return marks

    @property
    def fraction(self) -> float:
        """Marked share of the normals."""
        return self._marked / NORMAL_BINS

    def _turn_to(self, leader: int, all_psi: Callable[[], FloatArray]) -> None:
        if leader == self._leader:
            return
        if self._leader >= 0:
            psi = all_psi()
            by = -round((psi[leader] - psi[self._leader]) / _WIDTH)
            self.marks = np.roll(self.marks, by)
            self._recent = deque((t, (bin_ + by) % NORMAL_BINS) for t, bin_ in self._recent)
        else:
            self.marks[:] = False
            self._recent.clear()
        self._leader, self._last_bins = leader, []


def _normals(y: Sequence[float] | FloatArray, curvatures: Sequence[float]) -> tuple[float, ...]:
    """θ1, θ2 (3.1) in rad, on any branch, from values of `NAMED`."""
    joints: Sequence[float] = [float(y[at]) for at in _ANGLES]
    if any(curvatures):
        joints = tangents(joints, [float(y[at]) for at in _CONTACTS], curvatures)
    return normal_directions(joints, float(y[_PSI]))


def contact_bins(y: FloatArray, curvatures: Sequence[float] = FLAT) -> list[int]:
    """The bins of both contacts, from values of `NAMED`."""
    return [math.floor(theta / _WIDTH) % NORMAL_BINS for theta in _normals(y, curvatures)]


def marks_of(normals: FloatArray) -> Marks:
    """Marks on the normals passed by `normals` (n, 2): θ1 and θ2 (3.1) in order of time (rad, on any branch)."""
    marks = np.zeros(NORMAL_BINS, dtype=np.bool_)
    for bins in np.floor(normals / _WIDTH).astype(np.intp).T:
        lows, highs = np.minimum(bins[:-1], bins[1:]), np.maximum(bins[:-1], bins[1:])
        for low, high in {*zip(lows.tolist(), highs.tolist(), strict=True)}:
            marks[np.arange(low, high + 1) % NORMAL_BINS] = True
        marks[bins % NORMAL_BINS] = True
    return marks


def turned_marks(marks: Marks, turn: float) -> Marks:
    """The marks in a gauge in which ψ is larger by `turn` (rad)."""
    return np.roll(marks, -round(turn / _WIDTH))
