"""Set-point timer: a first-order phase lock that schedules set-points in the middle of the controller's cycles."""

from __future__ import annotations

from palmd.devices.armlink import SETPOINT_BYTES
from palmd.devices.arrival import byte_time

GAIN = 1 / 8
"""Gain of the phase lock: jitter is averaged over about 15 cycles."""

STEP_MAX_S = 0.25e-3
"""Largest correction (s) of the phase by one answer, and of one period; limits the effect of outliers."""

EARLY_SHARE = 1 / 32
"""Fraction of a period by which an answer may seem to precede its cycle because of jitter."""


def wrap_phase(t: float, period: float) -> float:
    """Return `t` (s) modulo `period`, in [-period/2, period/2]."""
    return t - round(t / period) * period


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


class SetPointTimer:
    """Schedules set-points.

    The controller answers a set-point at the start of the cycle that uses it, so the first bytes of the answers
    show its phase. A set-point whose last byte arrives half a period later has the largest margin to both cycle
    edges. A first-order lock with clipped steps tracks the phase: a drift of 200 ppm causes an error of 26 µs, a late
    answer at most `STEP_MAX_S`. Missed periods are skipped, never caught up.
    """

    def __init__(self, baud: int, period_s: float, t_answer: float) -> None:
        """Initialise the phase by the first byte of an answer at `t_answer` (s)."""
        self.period_s = period_s
        self._lead_s = period_s / 2 - (SETPOINT_BYTES + 1) * byte_time(baud)  # + 1: the answer's first byte
        self._t_cycle = t_answer
        self._t_slot = t_answer + self._lead_s + period_s  # the answer itself takes half a period to arrive

    @property
    def t_next(self) -> float:
        """Time (s) at which the next set-point is due."""
        return self._t_slot

    def answered(self, t_first: float) -> None:
        """Correct the phase by a set-point's answer, whose first byte arrived at `t_first` (s)."""
        error = wrap_phase(t_first - self._t_cycle, self.period_s)
        self._t_cycle = t_first - error + _clip(GAIN * error, STEP_MAX_S)

    def cycle_before(self, t: float) -> float:
        """Return the start (s) of the latest cycle whose answer can have arrived by `t` (s)."""
        early = EARLY_SHARE * self.period_s
        return t + early - (t + early - self._t_cycle) % self.period_s

    def skip(self, t: float) -> int:
        """Advance to the slot nearest to `t` (s) if the current one has passed; return the number of missed slots."""
        missed = max(0, round((t - self._t_slot) / self.period_s))
        self._t_slot += missed * self.period_s
        return missed

    def sent(self) -> None:
        """Record that the due set-point was sent: the next slot is one period later, plus the phase correction."""
        t_next = self._t_slot + self.period_s
        error = wrap_phase(self._t_cycle + self._lead_s - t_next, self.period_s)
        self._t_slot = t_next + _clip(error, STEP_MAX_S)
