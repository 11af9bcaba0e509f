"""The longest part of a record in which nothing is missing: both pads and the arm report all the time. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean

import numpy as np

from palmd.events import Event, FloatArray, PadLift, PadSample, PalmSample
from palmd.observer.median import median
from palmd.system.mechanism import PALMS

PAD_GAP_S = 0.4  # a pad silent for longer: the object may have left the palm
ARM_GAP_S = 0.3  # the palms' motion is not guessed across more
SUSPICIOUS_GAP_S = 0.08  # between readings, in which an object may have been changed for another
ARM = 0  # among the numbers of the pads
LEAD_S = 0.5  # of the arm's reports before both pads feel the object
STILL_RAD = 5e-3  # palms that move by less tell nothing of what turns with them
REST_SIGMAS = 6.0  # of a pad's noise, beyond which it reads another place
REST_KEPT_S, REST_TRIMMED_S = 1.0, 3.0  # of a rest at an end: what of it stays, and the shortest that is trimmed
STARVED_S, STARVED = 0.06, 3.0  # without a report of the arm, and that in usual intervals: it had to stand, and stepped


@dataclass(frozen=True, slots=True)
class DataSegment:
    """Events in order of time, each once: between `start` and `end` (s) no gap is longer than the limits above."""

    start: float
    end: float
    pads: tuple[PadSample, ...]
    palms: tuple[PalmSample, ...]

    @property
    def lasts(self) -> float:
        """How long it is (s)."""
        return self.end - self.start

    def events(self) -> list[Event]:
        """All of them in order of time, the arm's report first where times are equal."""
        return sorted((*self.palms, *self.pads), key=lambda event: event.t_sample)

    @property
    def most_forces(self) -> tuple[float, ...]:
        """What each pad has told at most (N), 0 where it tells none."""
        told = [(sample.pad, sample.force or 0.0) for sample in self.pads]
        return tuple(max((force for pad, force in told if pad == number), default=0.0) for number in PALMS)

    @property
    def steady_since(self) -> float:
        """From when on no gap, in which the arm must have stood, bears on how the palms move (s); at least `start`."""
        if len(self.palms) < 2:
            return self.start
        t = np.array([sample.t_sample for sample in self.palms])
        apart = np.diff(t)
        ends = t[1:][apart > max(STARVED_S, STARVED * median(apart))]
        return max(float(ends[-1]) + LEAD_S, self.start) if len(ends) else self.start

    def trimmed(self, noise: float) -> DataSegment:
        """Without most of a long rest at either end, of which nothing more is learned.

        It moves while the palms are away from where they rest, and while a pad reads another place than in its rest: by
        `REST_SIGMAS` of `noise` (m) in the median of five readings. `REST_KEPT_S` of a rest stay.
        """
        places = [
            (np.array([sample.t_sample for sample in self.palms]), np.array([sample.angles for sample in self.palms])),
            *(
                _places([sample for sample in self.pads if sample.pad == number], STILL_RAD / (REST_SIGMAS * noise))
                for number in PALMS
            ),
        ]
        first = min(_first_away(t, place) for t, place in places)
        last = -min(_first_away(-t[::-1], place[::-1]) for t, place in places)
        start, end = first - REST_KEPT_S, last + REST_KEPT_S
        if not math.isfinite(first):  # it rests all the time
            return self
        trimmed = self if start - self.start < REST_TRIMMED_S else self.since(start)
        return trimmed if self.end - end < REST_TRIMMED_S else trimmed.until(end)

    def until(self, t: float) -> DataSegment:
        """What was before `t` (s)."""
        return DataSegment(self.start, t, tuple(sample for sample in self.pads if sample.t_sample <= t), self.palms)

    def since(self, t: float) -> DataSegment:
        """What was from `t` (s) on, with the arm's reports of a moment before."""
        palms = tuple(sample for sample in self.palms if sample.t_sample >= t - LEAD_S)
        return DataSegment(t, self.end, tuple(sample for sample in self.pads if sample.t_sample >= t), palms)


def data_segments(events: Sequence[Event], pad_gap_s: float = PAD_GAP_S) -> list[DataSegment]:
    """All of them, in order of time."""
    ordered = sorted((event for event in events if _finite(event)), key=_place)
    found: list[DataSegment | None] = []
    pads: list[PadSample] = []
    palms: list[PalmSample] = []
    at_once: list[PadSample] = []  # the last pad's readings of one stamp

    def close() -> None:
        found.append(_trimmed(pads, palms))
        pads.clear()
        palms.clear()

    limits = dict.fromkeys(PALMS, pad_gap_s) | {ARM: ARM_GAP_S}
    shortest = min(limits.values())
    last = dict.fromkeys(limits, math.inf)  # when each was heard last; infinity before that
    for event in ordered:
        if isinstance(event, PadLift):
            close()
            continue
        source = event.pad if isinstance(event, PadSample) else ARM
        if event.t_sample == last[source]:  # twice the same, or several of one stamp
            if isinstance(event, PadSample) and event not in at_once:
                at_once.append(event)
                pads[-1] = _mean(at_once)
            continue
        if event.t_sample - min(last.values()) > shortest and any(
            event.t_sample - t > limits[key] for key, t in last.items()
        ):
            close()
            last = dict.fromkeys(last, math.inf)
        last[source] = event.t_sample
        if isinstance(event, PadSample):
            pads.append(event)
            at_once = [event]
        else:
            palms.append(event)
    close()
    return [segment for segment in found if segment is not None]


def _mean(readings: Sequence[PadSample]) -> PadSample:
    """What the readings of one batch say that were stamped together.

    Any one of them instead, chosen by its value, would be the latest or the earliest as the contact moves: a bias.
    """
    s, first = fmean(each.s for each in readings), readings[0]
    saturated = [each.at_least for each in readings if each.at_least is not None]
    if saturated:
        return replace(first, s=s, force=None, at_least=max(saturated))
    forces = [each.force for each in readings if each.force is not None]
    return replace(first, s=s, force=fmean(forces) if forces else None)


def longest_segment(events: Sequence[Event]) -> DataSegment | None:
    """The longest one, None if there is no time at all at which both pads and the arm report."""
    return max(data_segments(events), key=lambda segment: segment.lasts, default=None)


def _trimmed(pads: list[PadSample], palms: list[PalmSample]) -> DataSegment | None:
    """What lies between the first time at which all have reported and the last at which all still do.

    The arm's reports of a moment before that stay: they tell how the palms moved at the start.
    """
    sources = [[sample.t_sample for sample in pads if sample.pad == number] for number in PALMS]
    sources.append([sample.t_sample for sample in palms])
    if not all(sources):
        return None
    start, end = max(times[0] for times in sources), min(times[-1] for times in sources)
    inside = tuple(sample for sample in pads if start <= sample.t_sample <= end)
    about = tuple(sample for sample in palms if sample.t_sample >= start - LEAD_S)
    return DataSegment(start, end, inside, about) if inside and end > start else None


def _places(samples: Sequence[PadSample], scale: float) -> tuple[FloatArray, FloatArray]:
    """Times and places of a pad's readings, medians of five, in units of which `STILL_RAD` is much."""
    t, s = np.array([sample.t_sample for sample in samples]), np.array([sample.s for sample in samples])
    if len(s) < 5:
        return t[:0], s[:0, None]
    five = np.lib.stride_tricks.sliding_window_view(s, 5)
    return t[2:-2], np.partition(five, 2, axis=1)[:, 2:3] * scale


def _first_away(t: FloatArray, place: FloatArray) -> float:
    """When (s) something is away from where it was first; infinity where it never is."""
    if not len(t):
        return math.inf
    begun = [median(column) for column in place[:50].T]
    away = np.flatnonzero((np.abs(place - begun) > STILL_RAD).any(axis=1))
    return float(t[away[0]]) if len(away) else math.inf


def _place(event: Event) -> tuple[float, ...]:
    """By time, and where times are equal in an order that does not depend on how the events were given."""
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
