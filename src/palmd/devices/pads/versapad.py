"""`kind: versapad`: a Logitech/Interlink VersaPad on a serial line."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence

from palmd.config.pads import VersaPadConfig
from palmd.devices.handshake import Handshake
from palmd.devices.health import bytes_since
from palmd.devices.pad import MARGIN_MM, HostLine, PadFactory
from palmd.devices.port import Port
from palmd.devices.serialpad import SerialPad
from palmd.devices.versapad import IN_USE, PadCounters, PadPacket, PressureFormat, VersaPadDecoder
from palmd.events import PadLift, PadSample

log = logging.getLogger(__name__)


class VersaPad(SerialPad[PadPacket, PadCounters]):
    """`PadDriver` of one VersaPad. `in_break`: the start-up requests that the line be in break."""

    def __init__(self, number: int, config: VersaPadConfig) -> None:
        pressure = PressureFormat(**config.pressure.model_dump())
        self._versapad = decoder = VersaPadDecoder(config.baud, pressure)
        # at its highest rate the pad sends packets without pauses
        super().__init__(number, config, config.baud, decoder, decoder.counters, config.report_s, config.report_s)
        self.in_break = False
        self._config = config
        self._pressure_max = pressure.full_scale
        self._middle_across = config.across
        self._handshake: Handshake | None = None
        self._handshake_error: str | None = None
        self._break_set = False  # whether the port is set to break

    @property
    def starting(self) -> bool:
        """Whether the handshake is under way."""
        return self._handshake is not None

    @property
    def diagnosis(self) -> str | None:
        """The handshake was not answered, or the bytes received are no reports."""
        if self._handshake_error is not None:
            return self._handshake_error
        if discarded := self._counters.discarded:
            return f"{discarded} bytes, but no report among them at {self._config.baud} baud: check pad and baud rate"
        return None

    def opened(self, t: float) -> None:
        """Handle the opening of the port at `t` (s); the handshake is next."""
        super().opened(t)
        self._handshake_error = None
        self._handshake = Handshake(self._config.handshake, t)

    def lost(self, t: float) -> list[PadLift]:
        """Handle the loss of the port at `t` (s), which ends the handshake."""
        self.in_break = self._break_set = False
        self._handshake = None
        return super().lost(t)

    def tend(self, port: HostLine, t: float) -> None:  # noqa: ARG002
        """Set or clear the line's break condition."""
        if self.in_break is not self._break_set and isinstance(port, Port):
            port.set_break(self.in_break)
            self._break_set = self.in_break

    def poll(self, t: float, turning_rad_s: float = 0.0) -> list[PadSample | PadLift]:
        """As `SerialPad.poll`, and advance the handshake."""
        self._step_handshake(b"", t)
        return super().poll(t, turning_rad_s)

    def reports(self, data: bytes, t: float) -> Sequence[PadPacket]:
        """Return the packets in the bytes read at `t` (s), and advance the handshake."""
        self._step_handshake(data, t)
        return super().reports(data, t)

    def health(self, refresh: bool) -> Iterator[str]:
        """Yield the active fault conditions; `handshake` if it failed."""
        yield from super().health(refresh)
        if self._handshake_error is not None:
            yield "handshake"

    def evidence(self, condition: str, t: float) -> str:
        """Return the measurements behind a condition at `t` (s)."""
        text = super().evidence(condition, t)
        match condition:
            case "lifted":
                return f"{text}: bit {IN_USE:#04x} (in use) of byte 0 is 0"
            case "untouched":
                return f"{text}; {bytes_since(self._bytes_since_packet)}"
            case "handshake":
                return self._handshake_error or ""
        return text

    def _silence(self, last: str) -> str:
        if self._is_foreign:
            return f"{last}; {bytes_since(self._bytes_since_packet)}, and no pad's, not even a damaged one's"
        return super()._silence(last)

    @property
    def _is_foreign(self) -> bool:
        return self._versapad.foreign

    def _is_saturated(self, report: PadPacket) -> bool:
        return report.pressure >= self._pressure_max

    def _offset_mm(self, report: PadPacket) -> float:
        """Distance from the middle across the palm, in the direction of the counts."""
        return (report.y_counts if self._config.axis == "x" else report.x_counts) / self._config.counts_per_mm

    def _has_position(self, report: PadPacket) -> bool:
        return self._middle_across is None or abs(self._offset_mm(report)) <= 0.5 * self._config.length_mm + MARGIN_MM

    def _across(self, report: PadPacket) -> float | None:
        if self._middle_across is None:
            return None
        middle_mm, sign = self._middle_across
        return (middle_mm + sign * self._offset_mm(report)) * 1e-3

    def _step_handshake(self, data: bytes, t: float) -> None:
        handshake = self._handshake
        if handshake is None:
            return
        self.in_break = handshake.step(t, data)
        if handshake.done:
            self._handshake = None
            if handshake.error is not None:
                self._handshake_error = handshake.error
                log.warning("pad%d: %s", self._number, handshake.error)


DRIVER: PadFactory = VersaPad
COUNTER_NAMES = ("bytes", "packets", "bytes_discarded")
