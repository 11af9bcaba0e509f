"""The live observer of a pivoting grasp on a slide: a filter that rolls with the body, by an outline that is claimed.

Where the pivot passes over the contact the height tells nothing of the orientation, so nothing is inverted. The body is
light against friction and follows it within a millisecond: the slip u is that at which friction gives the torque that
the lever e leaves open, and ω0 = (u − Ẋ)/h_P. What that is off by is a state beside ψ; height and reading correct both.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from palmd.events import Event, PadSample, PalmSample
from palmd.observer.pivot.accepted import GAP_S, GATE, AcceptedOutline, Gripper
from palmd.observer.pivot.live import NIS_BEGIN, PivotObserver, Present
from palmd.observer.smoothing import SmoothingOfOne
from palmd.system.pivot import PivotAnswer, PivotRig

PAST_S = 20.0  # of events that are kept: an answer is about a time that is gone
CATCH_UP = 30  # of them at a tick
BEGIN_SD = 3e-3  # of ψ, as an answer has it (rad)
RATE_SD, RATE_LASTS_S = 0.15, 0.3  # by what rolling is off (rad/s), and for how long
FORCE_SHARE = 0.01  # by what the force is off where the body turns unevenly


class RollFilter:
    """ψ (rad) and what the rate of rolling is off by (rad/s): an extended Kalman filter. Safe in the loop."""

    def __init__(self, body: AcceptedOutline, rig: PivotRig, psi: float, t: float) -> None:
        """At an answer's orientation and time."""
        self._body, self._rig = body, rig
        self._t, self.psi, self._off = t, psi, 0.0
        self._P = np.diag([BEGIN_SD**2, RATE_SD**2])
        self._gripper: Gripper | None = None
        self._omega0 = 0.0

    def take(self, event: Event) -> float | None:
        """One event, in the order of time or nearly; the normalised square of what a reading missed by, else None."""
        if isinstance(event, PalmSample):
            if self._gripper is None:
                self._gripper = Gripper(event, slides=True)
            else:
                self._gripper.take(event)
            self._move_on(event.t_sample)
            psi = self.psi + self._omega0 * (event.t_sample - self._t)
            at = self._body.at(psi)
            x, z = event.angles
            if math.isfinite(z):
                self._correct(self._body.height(x, z) - at.h, -at.e, self._rig.arm_noise**2 + at.h_sd**2)
            return None
        if not isinstance(event, PadSample) or self._gripper is None:
            return None
        self._move_on(event.t_sample)
        psi = self.psi + self._omega0 * (event.t_sample - self._t)
        at, (x, vx, _) = self._body.at(psi), self._gripper.at(event.t_sample)[0]
        miss = event.s - self._body.reading(x, vx, at.e, at.h2, self._omega0)
        return self._correct(miss, -at.h2, self._rig.pad.reading_variance + at.e_sd**2)

    def now(self, t: float) -> Present:
        """At `t` (s), not far from the last event."""
        psi = self.psi + self._omega0 * min(max(t - self._t, -GAP_S), GAP_S)
        at = self._body.at(psi)
        psi_sd, omega0_sd = np.sqrt(np.diagonal(self._P))
        e_sd = math.hypot(at.e_sd, at.h2 * psi_sd)
        force = self._body.slide_force(at, psi, self._omega0)
        z_sd = math.hypot(at.h_sd, at.e * psi_sd)
        return Present(at, psi, float(psi_sd), self._omega0, float(omega0_sd), e_sd, force, z_sd)

    def _move_on(self, t: float) -> None:
        """To `t` (s), where that is later."""
        dt = t - self._t
        if dt <= 0.0 or self._gripper is None:
            return
        self._t = t
        self.psi += self._omega0 * dt
        fade = math.exp(-dt / RATE_LASTS_S)
        self._off *= fade
        F = np.array([[1.0, dt], [0.0, fade]])
        self._P = F @ self._P @ F.T
        self._P[1, 1] += RATE_SD**2 * (1.0 - fade * fade)
        self._omega0 = self._rolling() + self._off

    def _rolling(self) -> float:
        """The rate at which friction gives the torque that is wanted (rad/s)."""
        if self._gripper is None:
            return 0.0
        body, at, omega0 = self._body, self._body.at(self.psi), self._omega0
        _, vx, ax = self._gripper.at(self._t)[0]
        force = body.slide_force(at, self.psi, omega0)
        rest = body.resisting(self.psi, omega0, 0.0, ax, at.h2 * omega0**2)
        return (body.slip(at, self.psi, omega0, (at.e - rest / force) / at.h, ax) - vx) / at.h

    def _correct(self, miss: float, by_psi: float, variance: float) -> float:
        """By a measurement that missed by so much and moves with ψ by `by_psi`; what is far out is left."""
        column = self._P[:, 0] * by_psi
        spread = by_psi * float(column[0]) + variance
        nis = miss * miss / spread
        if nis < GATE:
            gain = column / spread
            self.psi += float(gain[0]) * miss
            self._off += float(gain[1]) * miss
            self._omega0 += float(gain[1]) * miss
            self._P = self._P - np.outer(gain, column)
            self._P = (self._P + self._P.T) / 2
        return nis


@dataclass(slots=True)
class _Coming:
    """An outline that is claimed of a time gone by, and the events since then that its filter has still to see."""

    body: AcceptedOutline
    roll: RollFilter
    events: deque[Event]


class RollingObserver(PivotObserver):
    """See the module, and `PivotObserver`. A new answer is followed from its own time on, so many events a tick."""

    def __init__(self, rig: PivotRig, smoothing: SmoothingOfOne[PivotAnswer]) -> None:
        super().__init__(rig, smoothing)
        self._past: deque[Event] = deque()
        self._coming: _Coming | None = None
        self._roll: RollFilter | None = None

    def feed(self, event: Event) -> None:
        """As `PivotObserver.feed`."""
        dropped = self.late_dropped
        super().feed(event)
        if self.late_dropped > dropped:
            return
        self._past.append(event)
        while self._past[0].t_sample < event.t_sample - PAST_S:
            self._past.popleft()
        if self._coming is not None:
            self._coming.events.append(event)
        if self._roll is not None and isinstance(event, PalmSample):
            self._roll.take(event)

    def improve(self, t: float) -> PivotAnswer | None:
        """As `PivotObserver.improve`."""
        answer = super().improve(t)
        coming = self._coming
        if coming is not None:
            for _ in range(min(CATCH_UP, len(coming.events))):
                coming.roll.take(coming.events.popleft())
            if not coming.events:
                self._body, self._roll, self._coming = coming.body, coming.roll, None
                self._psi, self._nis = coming.roll.psi, NIS_BEGIN
        return answer

    def _follow(self, sample: PadSample, step: float) -> None:
        if self._roll is not None and (nis := self._roll.take(sample)) is not None:
            self._psi = self._roll.psi
            self._judge(nis, step)

    def _lift(self) -> None:
        super()._lift()
        self._roll = self._coming = None

    def _take(self, answer: PivotAnswer) -> None:
        super()._take(answer)
        if not answer.claimed:
            self._roll = self._coming = None

    def _begin(self, answer: PivotAnswer) -> None:
        body = AcceptedOutline(answer, self._rig)
        if answer.t < self._t_touched or not self._felt or self._past[0].t_sample > answer.t - GAP_S:
            self._body, self._psi, self._roll, self._coming = body, None, None, None
            return
        events = deque(event for event in self._past if event.t_sample > answer.t - GAP_S)
        self._coming = _Coming(body, RollFilter(body, self._rig, answer.psi, answer.t), events)

    def _present(self, t: float, body: AcceptedOutline, psi: float, z_sd: float) -> Present | None:
        del body, psi, z_sd
        return None if self._roll is None else self._roll.now(t)

    def _lever_share(self, now: Present) -> float:
        del now
        return FORCE_SHARE
