"""Which conditions of the fault table hold, judged from the drivers and the motion. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

from palmd.daemon.drivers import ArmDriver
from palmd.devices.actuator import ArmState
from palmd.devices.health import ErrorShare
from palmd.devices.pad import PadDriver
from palmd.quantities import NIS_BAND

LOOK_S = 0.5
"""How often the counters are judged; a verdict stands until the next."""

NIS_MEMORY_S = 2.0
OVERRUNS_MOST, OVERRUN_MEMORY_S = 10, 1.0

_BY_STATE = {
    ArmState.ESTOP: "arm-estop",
    ArmState.FAULT: "arm-fault",
    ArmState.POWER_OFF: "arm-power-off",
    ArmState.MANUAL: "arm-manual",
    ArmState.UNCALIBRATED: "arm-uncalibrated",
    ArmState.READY: "arm-left-tracking",
    ArmState.DECELERATING: "arm-left-tracking",
}


class PadDiagnostics:
    """One pad's conditions."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._needed = False

    def conditions(self, pad: PadDriver, under_way: bool, held: bool, look: bool) -> Iterator[str]:
        """The codes that hold; with `look`, the counters are judged anew.

        A touch can only be missed once it has been felt in the motion that is `under_way`; and it is missed for as long
        as the state is `held`, though another plan be in hand by then.
        """
        self._needed &= under_way or held
        for condition in pad.health(look):
            yield f"{self._name}-{condition}"
        if not pad.is_open:
            yield f"{self._name}-port"
        elif pad.touching:
            self._needed = under_way
        elif self._needed and pad.touch_end is not None:
            yield f"{self._name}-{pad.touch_end}"
        else:
            yield f"{self._name}-untouched"


class ArmDiagnostics:
    """The arm's conditions."""

    def conditions(self, arm: ArmDriver, t: float, commanded: bool, look: bool) -> Iterator[str]:
        """The codes that hold at `t` (s); `commanded` says whether the arm ought to be following."""
        host = arm.host
        for condition in host.health(look):
            yield f"arm-{condition}"
        if not arm.is_open:
            yield "arm-port"
        elif host.lost(t):
            yield "arm-link-lost" if arm.linked_since_open else "arm-mute"
        elif host.tracking:
            if host.frozen(t):
                yield "arm-late"
            if host.state is ArmState.HOLD:
                yield "arm-held"
        elif host.state in _BY_STATE:
            code = _BY_STATE[host.state]
            if commanded or code != "arm-left-tracking":
                yield code


class LoopDiagnostics:
    """Missed deadlines, the last by `late_s` and `why` as far as that is known, and samples that came too late."""

    def __init__(self) -> None:
        self._overruns: deque[float] = deque(maxlen=OVERRUNS_MOST)
        self._late = ErrorShare(0.0, 5)
        self._too_late = False
        self.late_s = 0.0
        self.why = ""

    def overran(self, t: float, late_s: float, why: str = "") -> None:
        """The tick that ended at `t` (s) did so `late_s` after its deadline, so that others were skipped."""
        self._overruns.append(t)
        self.late_s, self.why = late_s, why

    def conditions(self, t: float, late_dropped: int, look: bool) -> Iterator[str]:
        """The codes that hold at `t` (s)."""
        if look:
            self._too_late = self._late.exceeded(late_dropped, late_dropped)
        if self._too_late:
            yield "samples-too-late"
        if self._overruns and t - self._overruns[-1] <= OVERRUN_MEMORY_S:
            yield "loop-overrun"
            if len(self._overruns) == OVERRUNS_MOST and t - self._overruns[0] <= OVERRUN_MEMORY_S:
                yield "loop-overruns"

    def evidence(self, code: str) -> str:
        """What speaks for one of its codes."""
        if code == "samples-too-late":
            return f"{self._late.new_errors} in the last {LOOK_S:g} s"
        often = f"{OVERRUNS_MOST} times within {OVERRUN_MEMORY_S:g} s, " if code == "loop-overruns" else ""
        why = f"; in the second before, {self.why}" if self.why else ""
        return f"{often}the last time a tick ended {self.late_s * 1e3:.0f} ms after its deadline{why}"


class NisDiagnostics:
    """Whether an observer's normalised innovations squared, 1 on average when the model is right, stay outside a band.

    The estimate's own mean is over a quarter of a second and begins anew with each start; this one is slower.
    """

    def __init__(self) -> None:
        self._mean = 1.0
        self._t = math.inf

    @property
    def evidence(self) -> str:
        """What speaks for its code."""
        low, high = NIS_BAND
        return f"their mean squared miss is {self._mean:.2f} of what is expected, the limits are {low:g} and {high:g}"

    def conditions(self, nis: float, moving: bool, t: float) -> Iterator[str]:
        """The codes that hold at `t` (s); `nis` is NaN while no observer runs.

        Palms at rest ask nothing of the model, and resting pads repeat one rounded reading: only motion is judged.
        """
        since = max(t - self._t, 0.0)
        self._t = t
        if not moving:
            self._mean = 1.0
        elif math.isfinite(nis):
            self._mean += (nis - self._mean) * -math.expm1(-since / NIS_MEMORY_S)
        if not NIS_BAND[0] <= self._mean <= NIS_BAND[1]:
            yield "estimate-inconsistent"
