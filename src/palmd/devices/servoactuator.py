"""Actuator of two servos of one make on one bus that turn the palms about a fixed hinge."""

from __future__ import annotations

from collections.abc import Iterator

from palmd.config.arms import ServosConfig
from palmd.devices.actuator import Reach
from palmd.devices.health import ErrorShares, Limits
from palmd.devices.port import Port
from palmd.devices.servobus import ServoMake
from palmd.devices.servohost import FREEZE_S, LOST_S, ServoHost

HEALTH_LIMITS: Limits = {"garbled": (0.05, 10, "packets")}
FAULT_CODES = frozenset(
    {"voltage", "hot", "encoder", "shock", "overload", "watchdog", "refused", "restarted", "set-up"}
)


class ServoActuator(ServoHost):
    """`Actuator` for servos of any make."""

    def __init__(self, config: ServosConfig, make: ServoMake) -> None:
        """Create the driver; nothing is opened yet."""
        super().__init__(config.baud, config.servos, make)
        self._config = config
        self._error_shares = ErrorShares(HEALTH_LIMITS)

    @property
    def reach(self) -> Reach | None:
        """None: servo limits are angles, and are set from the configuration."""
        return None

    def port(self) -> Port:
        """The serial line."""
        return Port("arm", self._config.port, self._config.baud)

    def health(self, refresh: bool) -> Iterator[str]:
        """Yield the servos' fault conditions, and `garbled` if too many packets are damaged."""
        if refresh:
            bus, missed = self.counters.bus, self.counters.missed
            self._error_shares.update({"garbled": (bus.packets + missed, bus.crc_errors + missed)})
        yield from self._error_shares
        yield from (f"servo-{code}" for code in self.faults if code in FAULT_CODES)

    def evidence(self, condition: str, t: float) -> str:
        """Return the measurements behind a condition at `t` (s)."""
        match condition:
            case "late" | "link-lost":
                limit_s = FREEZE_S if condition == "late" else LOST_S
                return f"the last reading is {self.age(t) * 1e3:.0f} ms old, the limit is {limit_s * 1e3:.0f} ms"
            case "mute":
                return f"{self.counters.bus.bytes} bytes have come since the start"
            case "garbled":
                return self._error_shares.text(condition)
        return self.faults.get(condition.removeprefix("servo-"), "")

    def counts(self) -> dict[str, float]:
        """All counters of the bus since the start."""
        return self.counters.as_dict()
