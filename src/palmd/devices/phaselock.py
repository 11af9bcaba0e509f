"""The set-point timer: an absolute grid of the controller's period, slid to land in mid-cycle."""

from __future__ import annotations

from palmd.devices.armlink import SETPOINT_BYTES
from palmd.devices.arrival import byte_time

GAIN = 1 / 8
"""Share of each observed phase error that corrects the estimate: jitter is averaged over some 15 cycles."""

STEP_MAX_S = 0.25e-3
"""The most that one answer may move the estimate, or one period differ from the nominal: outliers lose."""

EARLY = 1 / 32
"""Of a period: how much sooner than its cycle an answer may seem to have left, by jitter."""


def wrap_phase(t: float, period: float) -> float:
    """Return `t` (s) less whole periods, in [-period/2, period/2]."""
    return t - round(t / period) * period


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


class SetPointTimer:
    """Says when to send a set-point.

    The controller answers a set-point at the start of the cycle that takes it, so the answers' first bytes
    show its phase. A set-point whose last byte arrives half a period later is farthest from both edges. A
    first-order lock of clipped steps follows the phase: a drift of 200 ppm costs it 26 µs, a late answer
    `STEP_MAX_S` at most. Where the timer is late, the periods missed are skipped, never made up for.
    """

    def __init__(self, baud: int, period_s: float, t_answer: float) -> None:
        """Start with the first byte of an answer at `t_answer` (s), the best guess of the phase so far."""
        self.period_s = period_s
        self._lead_s = period_s / 2 - (SETPOINT_BYTES + 1) * byte_time(baud)  # 1: the answer's first byte
        self._t_cycle = t_answer
        self._t_slot = t_answer + self._lead_s + period_s  # the answer itself takes half a period to arrive

    @property
    def t_next(self) -> float:
        """When the next set-point is due (s)."""
        return self._t_slot

    def answered(self, t_first: float) -> None:
        """A set-point's answer began to arrive at `t_first` (s)."""
        error = wrap_phase(t_first - self._t_cycle, self.period_s)
        self._t_cycle = t_first - error + _clip(GAIN * error, STEP_MAX_S)

    def cycle_before(self, t: float) -> float:
        """When (s) the last cycle began in which an answer can have left that has come by `t` (s)."""
        early = EARLY * self.period_s
        return t + early - (t + early - self._t_cycle) % self.period_s

    def skip(self, t: float) -> int:
        """Move to the slot nearest to `t` (s) if the present one has gone by; return how many were missed."""
        missed = max(0, round((t - self._t_slot) / self.period_s))
        self._t_slot += missed * self.period_s
        return missed

    def sent(self) -> None:
        """The set-point due has been sent: set the next slot, one period on but for the correction."""
        t_next = self._t_slot + self.period_s
        error = wrap_phase(self._t_cycle + self._lead_s - t_next, self.period_s)
        self._t_slot = t_next + _clip(error, STEP_MAX_S)
