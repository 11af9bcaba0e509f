"""Live observer of a pivoting grasp on a slide: a filter of the rolling motion with an accepted outline.

Where the pivot passes over the contact the height does not determine the orientation, so that it is not inverted. The
body's inertia is small against friction, which it follows within a millisecond: the slip u is that at which friction
balances the torque, and ω0 = (u − Ẋ)/h_P. The error of that rate is a state beside ψ; height and reading correct both.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from palmd.events import Event, PadSample, PalmSample
from palmd.observer.pivot.accepted import GAP_S, GATE, AcceptedOutline, Gripper
from palmd.observer.pivot.live import NIS_INITIAL, PivotObserver, Present
from palmd.observer.smoothing import SmoothingOfOne
from palmd.system.pivot import PivotAnswer, PivotRig

PAST_S = 40.0  # events kept, because an answer is about an earlier time, on a busy machine much earlier
CATCH_UP = 30  # old events per tick that a new filter takes
INITIAL_PSI_SD = 3e-3  # rad; 1σ of ψ in an answer
RATE_SD, RATE_CORRELATION_S = 0.15, 0.3  # 1σ of the rolling rate's error (rad/s) and its correlation time
FORCE_SHARE = 0.01  # relative 1σ of the force from neglected angular acceleration


class RollFilter:
    """Extended Kalman filter of ψ (rad) and the error of the rolling rate (rad/s). Safe in the loop."""

    def __init__(self, body: AcceptedOutline, rig: PivotRig, psi: float, t: float) -> None:
        """Start at an answer's orientation (rad) and time (s)."""
        self._body, self._rig = body, rig
        self._t, self.psi, self._rate_error = t, psi, 0.0
        self._P = np.diag([INITIAL_PSI_SD**2, RATE_SD**2])
        self._gripper: Gripper | None = None
        self._omega0 = 0.0

    def take(self, event: Event) -> float | None:
        """Take one event, about in order of time; returns the NIS of a pad's reading, else None."""
        if isinstance(event, PalmSample):
            if self._gripper is None:
                self._gripper = Gripper(event, slides=True)
            else:
                self._gripper.take(event)
            self._propagate(event.t_sample)
            psi = self.psi + self._omega0 * (event.t_sample - self._t)
            at = self._body.at(psi)
            x, z = event.angles
            if math.isfinite(z):
                self._correct(self._body.height(x, z) - at.h, -at.e, self._rig.arm_noise**2 + at.h_sd**2)
            return None
        if not isinstance(event, PadSample) or self._gripper is None:
            return None
        self._propagate(event.t_sample)
        psi = self.psi + self._omega0 * (event.t_sample - self._t)
        at, (x, vx, _) = self._body.at(psi), self._gripper.at(event.t_sample)[0]
        innovation = event.s - self._body.reading(x, vx, at.e, at.h2, self._omega0)
        return self._correct(innovation, -at.h2, self._rig.pad.reading_variance + at.e_sd**2)

    def now(self, t: float) -> Present:
        """State at `t` (s), near the last event."""
        psi = self.psi + self._omega0 * min(max(t - self._t, -GAP_S), GAP_S)
        at = self._body.at(psi)
        psi_sd, omega0_sd = np.sqrt(np.diagonal(self._P))
        e_sd = math.hypot(at.e_sd, at.h2 * psi_sd)
        force = self._body.slide_force(at, psi, self._omega0)
        z_sd = math.hypot(at.h_sd, at.e * psi_sd)
        return Present(at, psi, float(psi_sd), self._omega0, float(omega0_sd), e_sd, force, z_sd)

    def _propagate(self, t: float) -> None:
        """Propagate to `t` (s) if that is later."""
        dt = t - self._t
        if dt <= 0.0 or self._gripper is None:
            return
        self._t = t
        self.psi += self._omega0 * dt
        fade = math.exp(-dt / RATE_CORRELATION_S)
        self._rate_error *= fade
        F = np.array([[1.0, dt], [0.0, fade]])
        self._P = F @ self._P @ F.T
        self._P[1, 1] += RATE_SD**2 * (1.0 - fade * fade)
        self._omega0 = self._rolling_rate() + self._rate_error

    def _rolling_rate(self) -> float:
        """Rolling rate (rad/s) at which friction balances the torque."""
        if self._gripper is None:
            return 0.0
        body, at, omega0 = self._body, self._body.at(self.psi), self._omega0
        _, vx, ax = self._gripper.at(self._t)[0]
        force = body.slide_force(at, self.psi, omega0)
        rest = body.resisting(self.psi, omega0, 0.0, ax, at.h2 * omega0**2)
        return (body.slip(at, self.psi, omega0, (at.e - rest / force) / at.h, ax) - vx) / at.h

    def _correct(self, innovation: float, by_psi: float, variance: float) -> float:
        """Update with an innovation; `by_psi`: derivative of the prediction. Rejects outliers; returns the NIS."""
        column = self._P[:, 0] * by_psi
        spread = by_psi * float(column[0]) + variance
        nis = innovation * innovation / spread
        if nis < GATE:
            gain = column / spread
            self.psi += float(gain[0]) * innovation
            self._rate_error += float(gain[1]) * innovation
            self._omega0 += float(gain[1]) * innovation
            self._P = self._P - np.outer(gain, column)
            self._P = (self._P + self._P.T) / 2
        return nis


@dataclass(slots=True)
class _CatchingUp:
    """A new accepted outline, its filter, and the events that the filter has still to take."""

    body: AcceptedOutline
    roll: RollFilter
    events: deque[Event]


class RollingObserver(PivotObserver):
    """See the module and `PivotObserver`. A new answer's filter catches up with `CATCH_UP` events a tick."""

    def __init__(self, rig: PivotRig, smoothing: SmoothingOfOne[PivotAnswer]) -> None:
        super().__init__(rig, smoothing)
        self._history: deque[Event] = deque()
        self._catching_up: _CatchingUp | None = None
        self._roll: RollFilter | None = None

    def feed(self, event: Event) -> None:
        """See `PivotObserver.feed`."""
        dropped = self.late_dropped
        super().feed(event)
        if self.late_dropped > dropped:
            return
        self._history.append(event)
        while self._history[0].t_sample < event.t_sample - PAST_S:
            self._history.popleft()
        if self._catching_up is not None:
            self._catching_up.events.append(event)
        if self._roll is not None and isinstance(event, PalmSample):
            self._roll.take(event)

    def improve(self, t: float) -> PivotAnswer | None:
        """See `PivotObserver.improve`."""
        answer = super().improve(t)
        catching_up = self._catching_up
        if catching_up is not None:
            for _ in range(min(CATCH_UP, len(catching_up.events))):
                catching_up.roll.take(catching_up.events.popleft())
            if not catching_up.events:
                self._body, self._roll, self._catching_up = catching_up.body, catching_up.roll, None
                self._psi, self._nis = catching_up.roll.psi, NIS_INITIAL
        return answer

    def _track(self, sample: PadSample, step: float) -> None:
        if self._roll is not None and (nis := self._roll.take(sample)) is not None:
            self._psi = self._roll.psi
            self._update_nis(nis, step)

    def _lift(self) -> None:
        super()._lift()
        self._roll = self._catching_up = None

    def _take_answer(self, answer: PivotAnswer) -> None:
        super()._take_answer(answer)
        if not answer.accepted:
            self._roll = self._catching_up = None

    def _start_tracking(self, answer: PivotAnswer) -> None:
        is_forgotten = not self._history or self._history[0].t_sample > answer.t - GAP_S
        if self._roll is not None and is_forgotten and answer.t >= self._contact_start:
            return  # too late to start from: the outline in use keeps tracking
        body = AcceptedOutline(answer, self._rig)
        if answer.t < self._contact_start or not self._recent or is_forgotten:
            self._body, self._psi, self._roll, self._catching_up = body, None, None, None
            return
        events = deque(event for event in self._history if event.t_sample > answer.t - GAP_S)
        self._catching_up = _CatchingUp(body, RollFilter(body, self._rig, answer.psi, answer.t), events)

    def _present(self, t: float, body: AcceptedOutline, psi: float, z_sd: float) -> Present | None:
        del body, psi, z_sd
        return None if self._roll is None else self._roll.now(t)

    def _lever_share(self, now: Present) -> float:
        del now
        return FORCE_SHARE
