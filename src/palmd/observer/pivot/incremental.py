"""The smoother of a live pivoting grasp: all that was felt lately, reconstructed anew as it grows. Not for the loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palmd.events import Event, PadSample, PalmSample
from palmd.observer.pivot.reconstruct import ONE_SIDE, PivotReconstruction, reconstruct, refused
from palmd.observer.pivot.record import GAP_S, LEAST_READINGS
from palmd.score import score_outline
from palmd.system.pivot import GripperSample, PivotAnswer, PivotEvent, PivotRig

WINDOW_S = {"rigid": 90.0, "float": 20.0}  # of readings, what is older is forgotten
LEAST_S = 3.0  # of touching, before anything is tried
PERIOD_S = 1.0
CLAIMED_M = 5e-5  # one-sigma of the outline, were the rig known, that readings must tell it to: more are to come
LATENCY_S = 0.5  # that a simulated one takes
AGREE_S, AGREE_M = 4.0, 1e-4  # of more readings on a slide, from which the same outline must come again


class IncrementalPivotSmoother:
    """Gathers events; `answer` reconstructs what there is, from the first reading of the window on."""

    def __init__(self, rig: PivotRig) -> None:
        self._rig, self._slides = rig, rig.vertical == "float"
        self._events: list[PivotEvent] = []
        self._pads = 0
        self._before: tuple[float, PivotReconstruction] | None = None  # the first that all since then agree with

    def add(self, events: Sequence[Event]) -> None:
        """Events of some ticks."""
        self._events += [each for event in events if (each := as_logged(event, slides=self._slides)) is not None]
        if self._events:
            begin = self._events[-1].t_sample - WINDOW_S[self._rig.vertical]
            if self._events[0].t_sample < begin - PERIOD_S:
                self._events = [event for event in self._events if event.t_sample >= begin]

    def answer(self) -> PivotAnswer | None:
        """What the readings tell, or why they do not; None before there is anything to say or after nothing new."""
        if self._slides:
            self._set_down_last()
        readings = [event.t_sample for event in self._events if isinstance(event, PadSample)]
        if not readings or readings[-1] - readings[0] < LEAST_S or len(readings) == self._pads:
            return None
        self._pads = len(readings)
        if not self._slides and (why := self._one_sided()):
            return answer_of(refused(why), readings[-1])
        found = reconstruct(self._events, self._rig)
        if self._slides and found.converged and not self._comes_again(found, readings[-1]):
            found = refused("an outline was found, and is claimed when more readings tell the same")
        return answer_of(found, readings[-1])

    def _comes_again(self, found: PivotReconstruction, t: float) -> bool:
        """Whether all that was found for some seconds agrees: how far a body rolled is told by its friction alone.

        From little of a roll another outline may come that explains it as well, and does not last.
        """
        before = self._before
        if before is None or not _agree(before[1], found):
            self._before = t, found
            return False
        return t - before[0] >= AGREE_S

    def _set_down_last(self) -> None:
        """Forget what was felt before a slide's body was set down: how it was turned meanwhile nothing tells."""
        began = before = -math.inf
        for event in self._events:
            if isinstance(event, PadSample):
                began = began if event.t_sample - before < GAP_S["float"] else event.t_sample
                before = event.t_sample
        self._events = [event for event in self._events if not isinstance(event, PadSample) or event.t_sample >= began]

    def _one_sided(self) -> str:
        """Why no fit is worth its time: all readings are of one side of the dead centre; empty where they are not."""
        x, ahead = math.nan, []
        for event in self._events:
            if isinstance(event, GripperSample):
                x = event.x
            elif math.isfinite(event.s - x):
                ahead.append(event.s - x > 0.0)
        share = min(sum(ahead), len(ahead) - sum(ahead))
        return ONE_SIDE if share < LEAST_READINGS else ""


def _agree(before: PivotReconstruction, found: PivotReconstruction) -> bool:
    """Whether an outline is found again where it was felt before, turned as it may be."""
    if before.h is None or found.h is None:
        return False
    return score_outline(found.theta, before.h, before.touched, found.h).e_h < AGREE_M


def as_logged(event: Event, *, slides: bool) -> PivotEvent | None:
    """An event of the daemon as logs of the pivoting grasp have it; None for the end of a contact.

    slides: what is planned along z is the slide's stop, and not the pivot.
    """
    if isinstance(event, PadSample):
        return event
    if isinstance(event, PalmSample):
        (x, z), (vx, vz), (ax, az) = event.angles, event.rates or (None, None), event.accelerations or (None, None)
        return GripperSample(event.t_sample, x, z, vx, ax, *((None, None) if slides else (vz, az)))
    return None


def answer_of(found: PivotReconstruction, t: float) -> PivotAnswer:
    """A reconstruction of readings until `t` (s), for the loop."""
    none = np.zeros(0)
    if found.converged and found.told_m > CLAIMED_M:
        why = f"the outline is told to {found.told_m * 1e3:.2f} mm so far: it is claimed from {CLAIMED_M * 1e3:g} mm on"
        return PivotAnswer(t, False, why, math.nan, none, np.zeros((0, 0)), none, none)
    claims = found.converged and found.h_sd is not None and found.touched is not None
    if not claims or found.p is None or found.covariance is None or found.h_sd is None or found.touched is None:
        return PivotAnswer(t, False, found.reason, math.nan, none, np.zeros((0, 0)), none, none)
    at = float(found.t[-1])
    return PivotAnswer(
        at, True, "", float(found.psi[-1]), found.p, found.covariance, found.h_sd, found.touched.astype(np.float64)
    )


def as_fed(event: PivotEvent, *, slides: bool = False) -> Event:
    """An event of a log as a daemon has it: the gripper's as that of two joints, x and z (m).

    slides: no plan tells the height's rate, and a daemon's that of the stop is not gone by.
    """
    if isinstance(event, PadSample):
        return event
    if slides:
        event = replace(event, vz=0.0, az=0.0)
    planned = None if event.vx is None or event.vz is None else (event.vx, event.vz)
    second = None if event.ax is None or event.az is None else (event.ax, event.az)
    height = math.nan if event.z is None else event.z
    return PalmSample(event.t_sample, (event.x, height), planned, second)


class SimulatedSmoothing:
    """The smoother as it would run beside the loop: its answer comes a fixed time after it was begun."""

    def __init__(self, rig: PivotRig, period_s: float = PERIOD_S) -> None:
        """Begun every `period_s`; an infinite one has none."""
        self._smoother, self._period = IncrementalPivotSmoother(rig), period_s
        self._next = -math.inf if math.isfinite(period_s) else math.inf
        self._ready: tuple[float, PivotAnswer | None] | None = None

    def submit(self, t: float, events: Sequence[Event]) -> None:
        """Take the tick's events, and begin when it is time."""
        self._smoother.add(events)
        if t >= self._next and self._ready is None:
            self._next = t + self._period
            self._ready = (t + LATENCY_S, self._smoother.answer())

    def collect(self, t: float) -> PivotAnswer | None:
        """What was begun at least the latency ago."""
        if self._ready is None or t < self._ready[0]:
            return None
        answer, self._ready = self._ready[1], None
        return answer
