"""Judge from drivers and motion which conditions of the fault table hold. Pure."""

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
"""How often the counters are judged; a verdict holds until the next."""

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
    """Conditions of one pad."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._needed = False

    def conditions(self, pad: PadDriver, under_way: bool, held: bool, look: bool) -> Iterator[str]:
        """The codes that hold; with `look`, the counters are judged again.

        A contact counts as lost only if it existed during the motion that is `under_way`; it stays lost while the state
        is `held`, even if another plan has been loaded.
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
    """Conditions of the arm."""

    def conditions(self, arm: ArmDriver, t: float, commanded: bool, look: bool) -> Iterator[str]:
        """The codes that hold at `t` (s); `commanded` says whether the arm should be following set-points."""
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
    """Missed deadlines, the last by `late_s` with the reason `why` if known, and samples that arrived too late."""

    def __init__(self) -> None:
        self._overruns: deque[float] = deque(maxlen=OVERRUNS_MOST)
        self._late = ErrorShare(0.0, 5)
        self._too_late = False
        self.late_s = 0.0
        self.why = ""

    def overran(self, t: float, late_s: float, why: str = "") -> None:
        """Record that the tick ending at `t` (s) was `late_s` after its deadline, so later ticks were skipped."""
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
        """Evidence for one of its codes, in words."""
        if code == "samples-too-late":
            return f"{self._late.new_errors} in the last {LOOK_S:g} s"
        often = f"{OVERRUNS_MOST} times within {OVERRUN_MEMORY_S:g} s, " if code == "loop-overruns" else ""
        why = f"; in the second before, {self.why}" if self.why else ""
        return f"{often}the last time a tick ended {self.late_s * 1e3:.0f} ms after its deadline{why}"


class NisDiagnostics:
    """Test whether an observer's mean NIS, 1 if the model is right, stays within `NIS_BAND`.

    The mean in the estimate covers a quarter of a second and restarts with each start of the observer; this one is
    slower.
    """

    def __init__(self) -> None:
        self._mean = 1.0
        self._t = math.inf

    @property
    def evidence(self) -> str:
        """Evidence for its code, in words."""
        low, high = NIS_BAND
        return f"the mean NIS is {self._mean:.2f} (1 expected), the limits are {low:g} and {high:g}"

    def conditions(self, nis: float, moving: bool, t: float) -> Iterator[str]:
        """The codes that hold at `t` (s); `nis` is NaN while no observer runs.

        Only motion is judged: palms at rest do not test the model, and pads at rest repeat one rounded reading.
        """
        since = max(t - self._t, 0.0)
        self._t = t
        if not moving:
            self._mean = 1.0
        elif math.isfinite(nis):
            self._mean += (nis - self._mean) * -math.expm1(-since / NIS_MEMORY_S)
        if not NIS_BAND[0] <= self._mean <= NIS_BAND[1]:
            yield "estimate-inconsistent"
