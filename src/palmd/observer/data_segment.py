"""Parts of a record without gaps, in which both pads and the arm report all the time. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean

import numpy as np

from palmd.events import Event, FloatArray, PadLift, PadSample, PalmSample
from palmd.observer.median import median
from palmd.system.mechanism import PALMS

PAD_GAP_S = 0.4  # longest silence of a pad within a segment; after more the object may have left the palm
ARM_GAP_S = 0.3  # longest silence of the arm within a segment; the palms' motion is not interpolated over more
SUSPICIOUS_GAP_S = 0.08  # shortest gap between readings in which the object may have been exchanged
ARM = 0  # the arm's key beside the pads' numbers
LEAD_S = 0.5  # arm reports kept from before both pads are touched
STILL_RAD = 5e-3  # smaller palm motions carry no information about an object that turns with a palm
REST_SIGMAS = 6.0  # pad noise sigmas; a larger change is a change of position
REST_KEPT_S, REST_TRIMMED_S = 1.0, 3.0  # rest kept at either end, and shortest rest that is trimmed
STARVED_S, STARVED = 0.06, 3.0  # gap in the arm's reports, in s and in median intervals, in which the arm had to stop


@dataclass(frozen=True, slots=True)
class DataSegment:
    """Events in order of time without duplicates; between `start` and `end` (s) no gap exceeds the limits above."""

    start: float
    end: float
    pads: tuple[PadSample, ...]
    palms: tuple[PalmSample, ...]

    @property
    def lasts(self) -> float:
        """Duration (s)."""
        return self.end - self.start

    def events(self) -> list[Event]:
        """All of them in order of time, the arm's report first where times are equal."""
        return sorted((*self.palms, *self.pads), key=lambda event: event.t_sample)

    @property
    def most_forces(self) -> tuple[float, ...]:
        """Largest force of each pad (N), 0 for a pad without forces."""
        forces = [(sample.pad, sample.force or 0.0) for sample in self.pads]
        return tuple(max((force for pad, force in forces if pad == number), default=0.0) for number in PALMS)

    @property
    def steady_since(self) -> float:
        """Time (s), at least `start`, after which the palms' motion is not affected by gaps in the arm's reports.

        In a gap longer than `STARVED_S` and `STARVED` median intervals the arm had to stop.
        """
        if len(self.palms) < 2:
            return self.start
        t = np.array([sample.t_sample for sample in self.palms])
        intervals = np.diff(t)
        ends = t[1:][intervals > max(STARVED_S, STARVED * median(intervals))]
        return max(float(ends[-1]) + LEAD_S, self.start) if len(ends) else self.start

    def trimmed(self, noise: float) -> DataSegment:
        """Without most of a long rest at either end, which carries no more information.

        It moves while the palms are away from their resting angles, and while a pad's position differs from its resting
        position by `REST_SIGMAS` of `noise` (m) in the median of five readings. `REST_KEPT_S` of a rest are kept.
        """
        positions = [
            (np.array([sample.t_sample for sample in self.palms]), np.array([sample.angles for sample in self.palms])),
            *(
                _positions([sample for sample in self.pads if sample.pad == number], STILL_RAD / (REST_SIGMAS * noise))
                for number in PALMS
            ),
        ]
        first = min(_first_away(t, position) for t, position in positions)
        last = -min(_first_away(-t[::-1], position[::-1]) for t, position in positions)
        start, end = first - REST_KEPT_S, last + REST_KEPT_S
        if not math.isfinite(first):  # it rests all the time
            return self
        trimmed = self if start - self.start < REST_TRIMMED_S else self.since(start)
        return trimmed if self.end - end < REST_TRIMMED_S else trimmed.until(end)

    def until(self, t: float) -> DataSegment:
        """The part before `t` (s)."""
        return DataSegment(self.start, t, tuple(sample for sample in self.pads if sample.t_sample <= t), self.palms)

    def since(self, t: float) -> DataSegment:
        """The part from `t` (s) on, with the arm's reports of `LEAD_S` before."""
        palms = tuple(sample for sample in self.palms if sample.t_sample >= t - LEAD_S)
        return DataSegment(t, self.end, tuple(sample for sample in self.pads if sample.t_sample >= t), palms)


def data_segments(events: Sequence[Event], pad_gap_s: float = PAD_GAP_S) -> list[DataSegment]:
    """All segments in order of time."""
    ordered = sorted((event for event in events if _finite(event)), key=_sort_key)
    found: list[DataSegment | None] = []
    pads: list[PadSample] = []
    palms: list[PalmSample] = []
    simultaneous: list[PadSample] = []  # the last pad's readings with one time stamp

    def close() -> None:
        found.append(_trimmed(pads, palms))
        pads.clear()
        palms.clear()

    limits = dict.fromkeys(PALMS, pad_gap_s) | {ARM: ARM_GAP_S}
    shortest = min(limits.values())
    last = dict.fromkeys(limits, math.inf)  # time of each source's last event; infinity before the first
    for event in ordered:
        if isinstance(event, PadLift):
            close()
            continue
        source = event.pad if isinstance(event, PadSample) else ARM
        if event.t_sample == last[source]:  # a duplicate, or one of several with the same time stamp
            if isinstance(event, PadSample) and event not in simultaneous:
                simultaneous.append(event)
                pads[-1] = _mean(simultaneous)
            continue
        if event.t_sample - min(last.values()) > shortest and any(
            event.t_sample - t > limits[key] for key, t in last.items()
        ):
            close()
            last = dict.fromkeys(last, math.inf)
        last[source] = event.t_sample
        if isinstance(event, PadSample):
            pads.append(event)
            simultaneous = [event]
        else:
            palms.append(event)
    close()
    return [segment for segment in found if segment is not None]


def _mean(readings: Sequence[PadSample]) -> PadSample:
    """The mean of readings of one batch with the same time stamp.

    Choosing one of them by its value would choose the latest or the earliest of a moving contact: a bias.
    """
    s, first = fmean(each.s for each in readings), readings[0]
    saturated = [each.at_least for each in readings if each.at_least is not None]
    if saturated:
        return replace(first, s=s, force=None, at_least=max(saturated))
    forces = [each.force for each in readings if each.force is not None]
    return replace(first, s=s, force=fmean(forces) if forces else None)


def longest_segment(events: Sequence[Event]) -> DataSegment | None:
    """The longest segment, None if both pads and the arm never report at the same time."""
    return max(data_segments(events), key=lambda segment: segment.lasts, default=None)


def _trimmed(pads: list[PadSample], palms: list[PalmSample]) -> DataSegment | None:
    """The part between the first time at which all sources have reported and the last at which all still report.

    The arm's reports of `LEAD_S` before that are kept: they determine the palms' motion at the start.
    """
    sources = [[sample.t_sample for sample in pads if sample.pad == number] for number in PALMS]
    sources.append([sample.t_sample for sample in palms])
    if not all(sources):
        return None
    start, end = max(times[0] for times in sources), min(times[-1] for times in sources)
    inside = tuple(sample for sample in pads if start <= sample.t_sample <= end)
    about = tuple(sample for sample in palms if sample.t_sample >= start - LEAD_S)
    return DataSegment(start, end, inside, about) if inside and end > start else None


def _positions(samples: Sequence[PadSample], scale: float) -> tuple[FloatArray, FloatArray]:
    """Times and positions of a pad's readings, medians of five, scaled so that `STILL_RAD` is the threshold."""
    t, s = np.array([sample.t_sample for sample in samples]), np.array([sample.s for sample in samples])
    if len(s) < 5:
        return t[:0], s[:0, None]
    five = np.lib.stride_tricks.sliding_window_view(s, 5)
    return t[2:-2], np.partition(five, 2, axis=1)[:, 2:3] * scale


def _first_away(t: FloatArray, position: FloatArray) -> float:
    """First time (s) at which a position differs from its initial value by `STILL_RAD`; infinity if it never does."""
    if not len(t):
        return math.inf
    initial = [median(column) for column in position[:50].T]
    away = np.flatnonzero((np.abs(position - initial) > STILL_RAD).any(axis=1))
    return float(t[away[0]]) if len(away) else math.inf


def _sort_key(event: Event) -> tuple[float, ...]:
    """Sorts by time, and events of equal times in an order that does not depend on their order in the input."""
    if isinstance(event, PadSample):
        return event.t_sample, 1, event.pad, event.s
    if isinstance(event, PalmSample):
        return event.t_sample, 2, *event.angles
    return event.t_sample, 0, event.pad


def _finite(event: Event) -> bool:
    if isinstance(event, PadSample):
        return math.isfinite(event.t_sample) and math.isfinite(event.s)
    if isinstance(event, PalmSample):
        return all(map(math.isfinite, (event.t_sample, *event.values)))
    return math.isfinite(event.t_sample)
