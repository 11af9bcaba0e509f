"""A record laid out for the smoother: the palms on a grid of nodes, and the readings between nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.three_palms.kernels import palm_inputs, reading_geometry
from palmd.observer.three_palms.path import JointPath

Integers = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class PadReadings:
    """Contact readings ordered by time t (S,): pad 0 to 2 (S,), value (S, 2) (m), force (S,) (N or NaN)."""

    t: FloatArray
    pad: Integers
    value: FloatArray
    force: FloatArray

    def within(self, start: float, end: float) -> PadReadings:
        """Readings with start ≤ t < end."""
        first, last = np.searchsorted(self.t, [start, end])
        return PadReadings(self.t[first:last], self.pad[first:last], self.value[first:last], self.force[first:last])


@dataclass(frozen=True, slots=True)
class BodyRecord:
    """K + 1 nodes `spacing` apart from `start`, and S readings between them.

    node_palms (K + 1, 36), middle_palms (K, 36): the palms at the nodes and midway. Of each reading (S,): interval, its
    interval; share, its position in it (0 to 1). geometry: (S, 24).
    """

    start: float
    spacing: float
    node_palms: FloatArray
    middle_palms: FloatArray
    readings: PadReadings
    interval: Integers
    share: FloatArray
    geometry: FloatArray

    @property
    def t(self) -> FloatArray:
        """Times of the nodes (s)."""
        return np.asarray(self.start + self.spacing * np.arange(len(self.node_palms)), dtype=np.float64)

    @property
    def numbers(self) -> int:
        """How many numbers were read, two per reading."""
        return 2 * len(self.readings.t)

    def first(self, intervals: int) -> BodyRecord:
        """The first `intervals` of the record."""
        until = int(np.searchsorted(self.interval, intervals))
        own, theirs = self.readings, slice(until)
        readings = PadReadings(own.t[theirs], own.pad[theirs], own.value[theirs], own.force[theirs])
        of_readings = (self.interval[theirs], self.share[theirs], self.geometry[theirs])
        nodes, middles = self.node_palms[: intervals + 1], self.middle_palms[:intervals]
        return BodyRecord(self.start, self.spacing, nodes, middles, readings, *of_readings)


def lay_out(path: JointPath, readings: PadReadings, start: float, intervals: int, spacing: float) -> BodyRecord:
    """Lay out a record of `intervals` from `start` (s)."""
    nodes: FloatArray = np.asarray(start + spacing * np.arange(intervals + 1), dtype=np.float64)
    middle: FloatArray = np.asarray(nodes[:-1] + spacing / 2, dtype=np.float64)
    inside = readings.within(start, nodes[-1])
    interval = np.minimum(((inside.t - start) / spacing).astype(np.int64), intervals - 1)
    return BodyRecord(
        start,
        spacing,
        palm_inputs(path.palms(nodes)),
        palm_inputs(path.palms(middle)),
        inside,
        interval,
        (inside.t - nodes[interval]) / spacing,
        reading_geometry(path.palms(inside.t), inside.pad),
    )
