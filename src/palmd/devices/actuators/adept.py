"""`kind: adept`: a V+ program on an Adept controller, connected by a serial line."""

from __future__ import annotations

from collections.abc import Iterator

from palmd.config.arms import AdeptConfig
from palmd.devices.actuator import ActuatorFactory, ArmPose, Outgoing, Pose, Reach
from palmd.devices.armhost import FAULT_S, FREEZE_S, ArmHost
from palmd.devices.armlink import error_text
from palmd.devices.health import ErrorShares, Limits
from palmd.devices.port import Port

HEALTH_LIMITS: Limits = {"garbled": (0.05, 10, "lines")}


class Adept(ArmHost):
    """`Actuator` that speaks the arm link."""

    def __init__(self, config: AdeptConfig) -> None:
        """Nothing is opened yet."""
        super().__init__(config.baud)
        self._config = config
        self._error_shares = ErrorShares(HEALTH_LIMITS)

    @property
    def reach(self) -> Reach | None:
        """The limits in the controller's hello reply."""
        hello = self.hello
        if hello is None:
            return None
        return Reach(hello.x_min_m, hello.x_max_m, hello.y_min_m, hello.y_max_m, hello.v_max_m_s, hello.a_max_m_s2)

    @property
    def error(self) -> str:
        """Code and meaning of the last error line."""
        return "" if self.last_error is None else error_text(self.last_error)

    def poll(self, t: float, target: ArmPose | None) -> Outgoing:
        """As `ArmHost.poll`; targets other than poses of the tool are ignored."""
        return super().poll(t, target if isinstance(target, Pose) else None)

    def port(self) -> Port:
        """The serial line."""
        return Port("arm", self._config.port, self._config.baud)

    def health(self, refresh: bool) -> Iterator[str]:
        """Yield `garbled` if too many lines are damaged."""
        if refresh:
            line = self.counters.line
            errors = line.crc_errors + line.unframed + line.overlong
            self._error_shares.update({"garbled": (line.lines + errors, errors)})
        yield from self._error_shares

    def evidence(self, condition: str, t: float) -> str:
        """Return the measurements behind a condition at `t` (s)."""
        match condition:
            case "late":
                return self._silence(t, FREEZE_S)
            case "link-lost":
                return f"{self.link_loss}: {self._silence(t, FAULT_S)}"
            case "mute":
                return f"{self.counters.line.bytes} bytes have come since the start"
            case "garbled":
                return self._error_shares.text(condition)
        if self.state is None:
            return ""
        return f"its line A reports state {self.state} ({self.state.name})" + (
            f", error {self.error}" * bool(self.error)
        )

    def _silence(self, t: float, limit_s: float) -> str:
        count, lines = self.since_last_report
        came = (
            f"{count} bytes have come since, with {lines} whole lines in them" if count else "not a byte has come since"
        )
        return f"its last answer is {self.age(t) * 1e3:.0f} ms old, the limit is {limit_s * 1e3:.0f} ms; {came}"

    def counts(self) -> dict[str, float]:
        """All counters of the link since the start."""
        return self.counters.as_dict()


DRIVER: ActuatorFactory = Adept
