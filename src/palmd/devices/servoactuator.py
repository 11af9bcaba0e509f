"""Two servos of one make on one bus, which turn the palms about a fixed hinge: what is the same of every make."""

from __future__ import annotations

from collections.abc import Iterator

from palmd.config.arms import ServosConfig
from palmd.devices.actuator import Reach
from palmd.devices.health import Limits, ErrorShares
from palmd.devices.port import Port
from palmd.devices.servobus import ServoMake
from palmd.devices.servohost import FREEZE_S, LOST_S, ServoHost

HEALTH_LIMITS: Limits = {"garbled": (0.05, 10, "packets")}
TABLED = frozenset({"voltage", "hot", "encoder", "shock", "overload", "watchdog", "refused", "restarted", "set-up"})


class ServoActuator(ServoHost):
    """The host of the servos on its serial line; see `Actuator`."""

    def __init__(self, config: ServosConfig, make: ServoMake) -> None:
        """Nothing is opened yet."""
        super().__init__(config.baud, config.servos, make)
        self._config = config
        self._error_shares = ErrorShares(HEALTH_LIMITS)

    @property
    def reach(self) -> Reach | None:
        """None: a servo's limits are angles, and are set from the configuration."""
        return None

    def port(self) -> Port:
        """The serial line."""
        return Port("arm", self._config.port, self._config.baud)

    def health(self, refresh: bool) -> Iterator[str]:
        """What is wrong with servos, and whether too many packets are damaged."""
        if refresh:
            bus, missed = self.counters.bus, self.counters.missed
            self._error_shares.update({"garbled": (bus.packets + missed, bus.crc_errors + missed)})
        yield from self._error_shares
        yield from (f"servo-{code}" for code in self.trouble if code in TABLED)

    def evidence(self, condition: str, t: float) -> str:
        """What speaks for a condition at `t` (s)."""
        match condition:
            case "late" | "link-lost":
                limit_s = FREEZE_S if condition == "late" else LOST_S
                return f"all servos answered last {self.age(t) * 1e3:.0f} ms ago, the limit is {limit_s * 1e3:.0f} ms"
            case "mute":
                return f"{self.counters.bus.bytes} bytes have come since the start"
            case "garbled":
                return self._error_shares.text(condition)
        return self.trouble.get(condition.removeprefix("servo-"), "")

    def counts(self) -> dict[str, float]:
        """What has passed on the bus since the start."""
        return self.counters.as_dict()
