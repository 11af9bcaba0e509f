"""A segment of readings, laid out as arrays on a grid of nodes for the smoother. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray, PadSample
from palmd.model.outputs import CURVATURE_INPUTS, rig_inputs
from palmd.model.smoothing import CONTACT_INPUTS, FORCE_INPUTS, STEP_INPUTS
from palmd.observer.median import median
from palmd.observer.noise import rates
from palmd.observer.palm_path import PalmPath
from palmd.observer.palms import RESTING_RAD_S, repetitions
from palmd.system.description import RigDescription
from palmd.system.mechanism import PALMS

IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]
NO_FORCES = (0.0,) * len(PALMS)
"""Largest force (N) measured by each pad so far, when nothing is known."""

WITHIN_S = 1e-9  # tolerance of a span's ends for nodes
MEDIAN_OF = 15  # forces of a pad, for the level of each
LEAST_FORCE_N = 0.05  # below it a force indicates little more than touch


@dataclass(frozen=True, slots=True)
class Record:
    """Nodes at times `t` (K + 1), the palms there, and each reading with the step in which it falls.

    palms (K + 1, 6): φ1, φ2, ω1, ω2, α1, α2. Readings are in order of time.
    *_offset: time into the step. *_weight: of each reading, 1 except at rest.
    contact_force: initially from the readings (`_contact_forces`), 0 on pads without force.
    contact_has_force: whether the pad measured a force, which it does not beyond its scale.
    gap_steps: steps between parts, over which the motion is unknown (`within`).
    discrepancy (K + 1): uncertainty of ω0 by the model besides the process noise ((rad/s)²/s) in the step that begins
    there, initially 0. force_discrepancy: variance of each force by the model besides its noise (N²), initially 0.
    contact_map: effect (m) of each constant of the pads' maps (`observer.pad_map`), which follow those of the kernels,
    on each contact.
    """

    t: FloatArray
    palms: FloatArray
    rig: FloatArray
    pad_lengths: FloatArray
    contact_step: IntArray
    contact_offset: FloatArray
    contact_pad: FloatArray
    contact_palms: FloatArray
    contact_force: FloatArray
    contact_has_force: BoolArray
    contact_value: FloatArray
    contact_variance: FloatArray
    contact_weight: FloatArray
    force_step: IntArray
    force_offset: FloatArray
    force_pad: FloatArray
    force_palms: FloatArray
    force_value: FloatArray
    force_variance: FloatArray
    force_weight: FloatArray
    gap_steps: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    discrepancy: FloatArray = field(default_factory=lambda: np.zeros(0))
    contact_map: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    force_discrepancy: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """By default the model has no discrepancy, and pads have no map."""
        if not len(self.discrepancy):
            object.__setattr__(self, "discrepancy", np.zeros(len(self.t)))
        if not len(self.contact_map):
            object.__setattr__(self, "contact_map", np.zeros((len(self.contact_step), 0)))
        if not len(self.force_discrepancy):
            object.__setattr__(self, "force_discrepancy", np.zeros(len(self.force_step)))

    @property
    def dt(self) -> FloatArray:
        """Length of each step (s)."""
        return np.diff(self.t)

    @property
    def contact_t(self) -> FloatArray:
        """Time of each contact reading (s)."""
        return self.t[self.contact_step] + self.contact_offset

    @property
    def force_t(self) -> FloatArray:
        """Time of each force reading (s)."""
        return self.t[self.force_step] + self.force_offset

    @property
    def total_force_variance(self) -> FloatArray:
        """Variance of each force reading about the model's (N²)."""
        return self.force_variance + self.force_discrepancy

    @property
    def readings(self) -> int:
        """Number of readings of contacts and forces."""
        return len(self.contact_value) + len(self.force_value)

    def until(self, t: float) -> Record:
        """The part of the record up to `t`, at least one step."""
        return self.steps(max(int(np.searchsorted(self.t, t, side="right")) - 1, 1))

    def steps(self, steps: int) -> Record:
        """The first `steps` steps of the record."""
        return self.between(0, steps)

    def between(self, first: int, last: int) -> Record:
        """The steps from node `first` to node `last`."""
        c = slice(*np.searchsorted(self.contact_step, (first, last)))
        f = slice(*np.searchsorted(self.force_step, (first, last)))
        return Record(
            self.t[first : last + 1], self.palms[first : last + 1], self.rig, self.pad_lengths,
            self.contact_step[c] - first, self.contact_offset[c], self.contact_pad[c], self.contact_palms[c],
            self.contact_force[c], self.contact_has_force[c],
            self.contact_value[c], self.contact_variance[c], self.contact_weight[c],
            self.force_step[f] - first, self.force_offset[f], self.force_pad[f], self.force_palms[f],
            self.force_value[f], self.force_variance[f], self.force_weight[f],
            self.gap_steps[(self.gap_steps >= first) & (self.gap_steps < last)] - first,
            self.discrepancy[first : last + 1], self.contact_map[c], self.force_discrepancy[f],
        )  # fmt: skip

    @property
    def spans(self) -> list[tuple[float, float]]:
        """Time span (s) of each part between gaps."""
        last = [*self.gap_steps, len(self.dt)]
        return [(float(self.t[i]), float(self.t[j])) for i, j in zip([0, *self.gap_steps + 1], last, strict=True)]

    def within(self, spans: Sequence[tuple[float, float]]) -> Record:
        """The parts in `spans` (s, in order), as one record with gaps in between."""
        at = [np.searchsorted(self.t, (start - WITHIN_S, end + WITHIN_S)) for start, end in spans]
        return concatenated_records([self.between(int(first), int(last) - 1) for first, last in at])

    def with_contact_forces(self, force: FloatArray) -> Record:
        """The record with contact forces `force` (N), scaled to the measured ones; unchanged where none is measured."""
        scales = [
            median(self.contact_force[of_pad] / force[of_pad])
            for pad in PALMS
            if (of_pad := (self.contact_pad == pad) & self.contact_has_force & (force > LEAST_FORCE_N)).any()
        ]
        if not scales:
            return self
        contact_force = np.mean(scales) * np.maximum(force, 0.0)
        return replace(self, contact_force=np.where(self.contact_force > 0.0, contact_force, 0.0))

    def step_inputs(self, rows: int) -> FloatArray:
        """Last input of the kernel `step` for each step, padded to `rows`."""
        dt = self.dt
        inputs = np.zeros((rows, STEP_INPUTS))
        n = len(dt)
        inputs[:n, 0] = dt
        inputs[:n, 1:7] = self.palms[:-1]
        inputs[:n, 7:9] = np.diff(self.palms[:, 4:], axis=0) / dt[:, None]
        inputs[:n, 9:-2], inputs[:n, -2:] = self.rig, self.pad_lengths
        inputs[self.gap_steps] = inputs[n:] = inputs[0]  # any valid input
        return inputs

    def contact_inputs(self, rows: int) -> FloatArray:
        """Last input of the kernel `contact` for each contact reading, padded to `rows`."""
        inputs = np.ones((rows, CONTACT_INPUTS))
        n = len(self.contact_step)
        inputs[:n, 0], inputs[:n, 1] = self.dt[self.contact_step], self.contact_offset
        inputs[:n, 2], inputs[:n, 3:7] = self.contact_pad, self.contact_palms[:, :4]
        inputs[:n, 7], inputs[:n, 8:10] = self.contact_force, self.rig[CURVATURE_INPUTS]
        inputs[:n, 10:] = self.pad_lengths
        return inputs

    def force_inputs(self, rows: int) -> FloatArray:
        """Last input of the kernel `force` for each force reading, padded to `rows`."""
        return self._force_inputs(rows, self.force_step, self.force_offset, self.force_pad, self.force_palms)

    def contact_force_inputs(self, rows: int) -> FloatArray:
        """As `force_inputs`, for the force at each contact reading."""
        return self._force_inputs(rows, self.contact_step, self.contact_offset, self.contact_pad, self.contact_palms)

    def _force_inputs(
        self, rows: int, step: IntArray, offset: FloatArray, pad: FloatArray, palms: FloatArray
    ) -> FloatArray:
        inputs = np.ones((rows, FORCE_INPUTS))
        n = len(step)
        inputs[:n, 0], inputs[:n, 1], inputs[:n, 2] = self.dt[step], offset, pad
        inputs[:n, 3:9], inputs[:n, 9:-2], inputs[:n, -2:] = palms, self.rig, self.pad_lengths
        return inputs


def total_duration(spans: Sequence[tuple[float, float]]) -> float:
    """Total duration (s) of the spans."""
    return sum(end - start for start, end in spans)


def concatenated_records(parts: Sequence[Record]) -> Record:
    """Parts of one record, or records of one rig, in order of time, as one record with gaps in between."""
    first = np.cumsum([0, *(len(part.t) for part in parts)])

    def concatenated(name: str) -> FloatArray:
        return np.concatenate([getattr(part, name) for part in parts])

    def steps(name: str) -> IntArray:
        return np.concatenate([getattr(part, name) + begin for part, begin in zip(parts, first[:-1], strict=True)])

    arrays = [each.name for each in fields(Record) if each.name not in ("rig", "pad_lengths")]
    by_step = ("contact_step", "force_step", "gap_steps")
    whole = {name: steps(name) if name in by_step else concatenated(name) for name in arrays}
    gap_steps = np.sort(np.concatenate([whole["gap_steps"], first[1:-1] - 1]))
    return replace(parts[0], **whole | {"gap_steps": gap_steps})


def lay_out(
    pads: Sequence[PadSample],
    path: PalmPath,
    rig: RigDescription,
    start: float,
    end: float,
    spacing: float,
    resting_since: float = math.inf,
    most_forces: Sequence[float] = NO_FORCES,
) -> Record:
    """Nodes every `spacing` (s) from `start` to `end`, and the readings in between, which must be in order of time.

    resting_since: start (s) of the palms' rest at the path's beginning, if they rested then. most_forces: largest force
    (N) that each pad has measured before; it stands for forces beyond the pad's scale.

    Forces of pads with an uncertain gain are left out: two thousand readings that share one error would outweigh all
    contacts.
    """
    steps = max(1, math.floor((end - start) / spacing + 1e-9))
    t: FloatArray = start + spacing * np.arange(steps + 1, dtype=np.float64)
    inside = [sample for sample in pads if start <= sample.t_sample <= t[-1]]
    times = np.array([sample.t_sample for sample in inside])
    pad = np.array([sample.pad for sample in inside], dtype=np.float64)
    which = pad.astype(np.intp) - 1
    value = np.array([sample.s for sample in inside])
    force = np.array([np.nan if sample.force is None else sample.force for sample in inside])
    step = np.clip(np.searchsorted(t, times, side="right") - 1, 0, steps - 1)
    offset = times - t[step]
    palms = path.at(times) if len(times) else np.zeros((0, 6))
    variance = rig.reading_variances[which]
    for number, sensor in zip(PALMS, rig.pads, strict=True):
        mine = pad == number
        if sensor.stamp_sd > 0.0:
            variance[mine] += (sensor.stamp_sd * rates(times[mine], value[mine])) ** 2 - sensor.blur**2
    weight: FloatArray = np.asarray(1.0 / repetitions(path.resting(times, RESTING_RAD_S, resting_since)))
    has_force = (
        np.isfinite(force)
        & (force > LEAST_FORCE_N)
        & (np.array([sensor.force_gain_std for sensor in rig.pads])[which] == 0.0)
    )
    level = _running_median(force, pad)
    force_variance = rig.force_variances(level, pad)
    return Record(
        t, path.at(t), rig_inputs(rig), np.array([sensor.length for sensor in rig.pads]),
        step, offset, pad, palms, _contact_forces(level, pad, most_forces), level > 0.0, value, variance, weight,
        step[has_force], offset[has_force], pad[has_force], palms[has_force], force[has_force],
        force_variance[has_force], weight[has_force],
    )  # fmt: skip


def _contact_forces(level: FloatArray, pad: FloatArray, largest: Sequence[float]) -> FloatArray:
    """Force on each contact (N), from neighbours in time rather than the reading itself.

    A reading's own noise would bias the contacts' dependence on force towards 0. So would a force of 0 where a pad
    measures none because the force exceeds its scale: there, the largest measured force is used.
    """
    pressing = np.nan_to_num(level)
    for number, earlier in zip(PALMS, largest, strict=True):
        missing = (pad == number) & ~np.isfinite(level)
        pressing[missing] = pressing[pad == number].max(initial=earlier)
    return pressing


def _running_median(force: FloatArray, pad: FloatArray) -> FloatArray:
    width, level = MEDIAN_OF, force.copy()
    for number in PALMS:
        mine = np.flatnonzero((pad == number) & np.isfinite(force))
        if len(mine):
            padded = np.pad(force[mine], width // 2, mode="edge")
            windows = np.lib.stride_tricks.sliding_window_view(padded, width)
            level[mine] = np.partition(windows, width // 2, axis=1)[:, width // 2]
    return level
