"""`kind: adept`: a V+ program on an Adept controller, on a serial line."""

from __future__ import annotations

from collections.abc import Iterator

from palmd.config.arms import AdeptConfig
from palmd.devices.actuator import ActuatorFactory, Place, Pose, Reach, Sent
from palmd.devices.armhost import FAULT_S, FREEZE_S, ArmHost
from palmd.devices.armlink import error_text
from palmd.devices.health import Limits, Shares
from palmd.devices.port import Port

JUDGED: Limits = {"garbled": (0.05, 10, "lines")}


class Adept(ArmHost):
    """The arm link's host on its serial line; see `Actuator`."""

    def __init__(self, config: AdeptConfig) -> None:
        """Nothing is opened yet."""
        super().__init__(config.baud)
        self._config = config
        self._shares = Shares(JUDGED)

    @property
    def reach(self) -> Reach | None:
        """The limits in the controller's hello."""
        hello = self.hello
        if hello is None:
            return None
        return Reach(hello.x_min_m, hello.x_max_m, hello.y_min_m, hello.y_max_m, hello.v_max_m_s, hello.a_max_m_s2)

    @property
    def error(self) -> str:
        """The code of the last error line, and what it means."""
        return "" if self.last_error is None else error_text(self.last_error)

    def poll(self, t: float, target: Place | None) -> Sent:
        """As `ArmHost.poll`; it takes poses of the tool only."""
        return super().poll(t, target if isinstance(target, Pose) else None)

    def port(self) -> Port:
        """The serial line."""
        return Port("arm", self._config.port, self._config.baud)

    def health(self, look: bool) -> Iterator[str]:
        """Whether too many lines are damaged."""
        if look:
            line = self.counters.line
            spoilt = line.crc_errors + line.unframed + line.overlong
            self._shares.look({"garbled": (line.lines + spoilt, spoilt)})
        yield from self._shares

    def evidence(self, condition: str, t: float) -> str:
        """What speaks for a condition at `t` (s)."""
        match condition:
            case "late":
                return self._silence(t, FREEZE_S)
            case "link-lost":
                return f"{self.unlinked}: {self._silence(t, FAULT_S)}"
            case "mute":
                return f"{self.counters.line.bytes} bytes have come since the start"
            case "garbled":
                return self._shares.told(condition)
        if self.state is None:
            return ""
        return f"its line A says state {self.state} ({self.state.name})" + (f", error {self.error}" * bool(self.error))

    def _silence(self, t: float, limit_s: float) -> str:
        count, lines = self.unanswering
        came = (
            f"{count} bytes have come since, with {lines} whole lines in them" if count else "not a byte has come since"
        )
        return f"its last answer is {self.age(t) * 1e3:.0f} ms old, the limit is {limit_s * 1e3:.0f} ms; {came}"

    def counts(self) -> dict[str, float]:
        """What has passed on the link since the start."""
        return self.counters.as_dict()


DRIVER: ActuatorFactory = Adept
