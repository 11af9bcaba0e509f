"""Smoother of a live pivoting grasp: reconstructs the recent readings again as they grow. Not for the loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palmd.events import Event, PadSample, PalmSample
from palmd.observer.pivot.reconstruct import LEAST_PATH_M, ONE_SIDE, PivotReconstruction, reconstruct
from palmd.observer.pivot.record import GAP_S, LEAST_READINGS
from palmd.observer.smoothing import SimulatedSmoothingOfOne
from palmd.score import score_outline
from palmd.system.pivot import GripperSample, PivotAnswer, PivotEvent, PivotRig
from palmd.system.reasons import Code, Reason

WINDOW_S = {"rigid": 90.0, "float": 20.0}  # length of the readings that are kept
LEAST_S = 3.0  # contact before anything is tried
PERIOD_S = 1.0
CONFIRMING_S = 4.2  # period of answers that take longer than `PERIOD_S`, so that the next one can confirm an outline
ACCEPTED_M = 5e-5  # largest 1σ of an accepted outline on an exactly known rig; more readings improve it
LATENCY_S = 0.5  # of a simulated smoother
UNCONFIRMED = Reason(Code.UNCONFIRMED, "an outline was found; it is accepted once more readings confirm it")
AGREE_S, AGREE_M = 4.0, 1e-4  # on a slide: time for which all outlines must agree, and their largest RMS difference


class IncrementalPivotSmoother:
    """Collects events; `answer` reconstructs those of the window."""

    def __init__(self, rig: PivotRig) -> None:
        self._rig, self._slides = rig, rig.vertical == "float"
        self._events: list[PivotEvent] = []
        self._pads = 0
        self._took_s = 0.0  # duration of the latest reconstruction
        self._t_answer = -math.inf  # time of the last event in the latest answer
        # time and result of the first reconstruction with which all later ones agree
        self._before: tuple[float, PivotReconstruction] | None = None

    def add(self, events: Sequence[Event]) -> None:
        """Add the events of some ticks; drop those before the window."""
        self._events += [each for event in events if (each := to_log_event(event, slides=self._slides)) is not None]
        if self._events:
            begin = self._events[-1].t_sample - WINDOW_S[self._rig.vertical]
            if self._events[0].t_sample < begin - PERIOD_S:
                self._events = [event for event in self._events if event.t_sample >= begin]

    def answer(self) -> PivotAnswer | None:
        """Estimate from the readings, accepted or with the reason why not; None without enough or new readings."""
        if self._slides:
            self._drop_before_set_down()
        readings = [event.t_sample for event in self._events if isinstance(event, PadSample)]
        if not readings or readings[-1] - readings[0] < LEAST_S or len(readings) == self._pads:
            return None
        if self._slides and not self._has_moved():
            return None
        self._pads, self._t_answer = len(readings), self._events[-1].t_sample
        if not self._slides and self._is_one_sided():
            return answer_of(PivotReconstruction(False, ONE_SIDE), readings[-1])
        found = reconstruct(self._events, self._rig)
        self._took_s = found.seconds
        if self._slides and found.converged and not self._is_confirmed(found, readings[-1]):
            found = PivotReconstruction(False, UNCONFIRMED)
        return answer_of(found, readings[-1])

    @property
    def period_s(self) -> float:
        """Shortest time from the start of the latest answer to the next (s)."""
        return CONFIRMING_S if self._slides and self._took_s > PERIOD_S else PERIOD_S

    def _is_confirmed(self, found: PivotReconstruction, t: float) -> bool:
        """Whether all outlines of the last `AGREE_S` agree.

        On a slide the distance rolled is determined by friction only: after a short roll, another outline may explain
        the readings as well, but not for long.
        """
        before = self._before
        if before is None or not _agree(before[1], found):
            self._before = t, found
            return False
        return t - before[0] >= AGREE_S

    def _drop_before_set_down(self) -> None:
        """Drop readings from before the body on a slide was set down: its turn meanwhile is not observable."""
        set_down = before = -math.inf
        for event in self._events:
            if isinstance(event, PadSample):
                set_down = set_down if event.t_sample - before < GAP_S["float"] else event.t_sample
                before = event.t_sample
        self._events = [
            event for event in self._events if not isinstance(event, PadSample) or event.t_sample >= set_down
        ]

    def _has_moved(self) -> bool:
        """Whether the arm has moved along the pad since the latest answer, as far as is known.

        At rest a body on a slide shows nothing new, and the readings that determined its outline leave the window.
        """
        if math.isinf(self._t_answer):
            return True
        since = [event for event in self._events if event.t_sample > self._t_answer]
        places = [event.x for event in since if isinstance(event, GripperSample)]
        return not places or max(places) - min(places) > LEAST_PATH_M

    def _is_one_sided(self) -> bool:
        """Whether all readings are on one side of the dead centre, so that a fit would be rejected."""
        x, ahead = math.nan, []
        for event in self._events:
            if isinstance(event, GripperSample):
                x = event.x
            elif math.isfinite(event.s - x):
                ahead.append(event.s - x > 0.0)
        return min(sum(ahead), len(ahead) - sum(ahead)) < LEAST_READINGS


def _agree(before: PivotReconstruction, found: PivotReconstruction) -> bool:
    """Whether two outlines agree where the first was touched, up to a rotation."""
    if before.h is None or found.h is None:
        return False
    return score_outline(found.theta, before.h, before.touched, found.h).e_h < AGREE_M


def to_log_event(event: Event, *, slides: bool) -> PivotEvent | None:
    """Convert an event of the daemon to one of the pivoting grasp's logs; None for the end of a contact.

    slides: the plan along z is that of the slide's stop, not of the pivot, and is dropped.
    """
    if isinstance(event, PadSample):
        return event
    if isinstance(event, PalmSample):
        (x, z), (vx, vz), (ax, az) = event.angles, event.rates or (None, None), event.accelerations or (None, None)
        return GripperSample(event.t_sample, x, z, vx, ax, *((None, None) if slides else (vz, az)))
    return None


def answer_of(found: PivotReconstruction, t: float) -> PivotAnswer:
    """Convert a reconstruction of readings until `t` (s) to an answer for the loop."""
    none, reason = np.zeros(0), found.reason
    if found.converged and found.outline_sd_m > ACCEPTED_M:
        sd = f"the outline's standard deviation is {found.outline_sd_m * 1e3:.2f} mm"
        reason = Reason(Code.NOT_SHARP, f"{sd}; {ACCEPTED_M * 1e3:g} mm is accepted")
    if reason or found.p is None or found.covariance is None or found.h_sd is None or found.touched is None:
        return PivotAnswer(t, False, reason, math.nan, none, np.zeros((0, 0)), none, none, reason.code)
    at = float(found.t[-1])
    return PivotAnswer(
        at, True, "", float(found.psi[-1]), found.p, found.covariance, found.h_sd, found.touched.astype(np.float64)
    )


def as_fed(event: PivotEvent, *, slides: bool = False) -> Event:
    """Convert an event of a log to one of the daemon; the gripper's joints are x and z (m).

    slides: the height follows no plan, so that its planned rate is set to 0.
    """
    if isinstance(event, PadSample):
        return event
    if slides:
        event = replace(event, vz=0.0, az=0.0)
    planned = None if event.vx is None or event.vz is None else (event.vx, event.vz)
    second = None if event.ax is None or event.az is None else (event.ax, event.az)
    height = math.nan if event.z is None else event.z
    return PalmSample(event.t_sample, (event.x, height), planned, second)


class SimulatedSmoothing(SimulatedSmoothingOfOne[PivotAnswer]):
    """Simulates the smoother beside the loop, with a fixed latency."""

    def __init__(self, rig: PivotRig, period_s: float = PERIOD_S) -> None:
        """A reconstruction begins every `period_s`; never if that is infinite."""
        smoother = IncrementalPivotSmoother(rig)
        super().__init__(smoother.add, smoother.answer, lambda *_: LATENCY_S, period_s)
