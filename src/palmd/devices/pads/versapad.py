"""`kind: versapad`: a Logitech/Interlink VersaPad on a serial line."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from typing import Literal, cast

from palmd.config.pads import VersaPadConfig
from palmd.devices.handshake import Handshake
from palmd.devices.health import SERIAL_PAD_LIMITS, ErrorShares, bytes_since, last_report
from palmd.devices.pad import SILENT_INTERVALS, HostLine, PadFactory
from palmd.devices.port import Port
from palmd.devices.versapad import IN_USE, PadCalibration, PadPacket, PadReceiver, PressureFormat
from palmd.events import PadLift, PadSample
from palmd.messages import PadView

log = logging.getLogger(__name__)


class VersaPad:
    """`PadDriver` of one VersaPad. `in_break`: the start-up requests that the line be in break."""

    def __init__(self, number: int, config: VersaPadConfig) -> None:
        """Create the driver; nothing is opened yet."""
        pressure = PressureFormat(
            config.pressure.byte, config.pressure.mask, config.pressure.shift, config.pressure.invert
        )
        calibration = PadCalibration(
            number,
            config.zero_mm,
            config.counts_per_mm,
            config.newtons_per_count,
            config.axis,
            cast(Literal[1, -1], config.sign),
            config.length_mm,
            pressure.full_scale,
            config.corrections_mm,
            config.across,
        )
        self.is_open = False
        self.in_break = False
        self.touch_end: Literal["lifted", "silent"] | None = None
        self._receiver = PadReceiver(calibration, config.baud, pressure)
        self._number: int = number
        self._config = config
        self._position = math.nan, math.nan
        self._bytes_at_packet = 0
        self._handshake: Handshake | None = None
        self._handshake_error: str | None = None
        self._break_set = False  # whether the port is set to break
        self._error_shares = ErrorShares(SERIAL_PAD_LIMITS)

    @property
    def touching(self) -> bool:
        """Whether the object touches the pad according to the reports so far."""
        return self._receiver.touch.touching

    @property
    def starting(self) -> bool:
        """Whether the handshake is under way."""
        return self._handshake is not None

    @property
    def diagnosis(self) -> str | None:
        """The handshake was not answered, or the bytes received are no reports."""
        if self._handshake_error is not None:
            return self._handshake_error
        if discarded := self._receiver.counters.bytes_discarded:
            return f"{discarded} bytes, but no report among them at {self._config.baud} baud: check pad and baud rate"
        return None

    def port(self) -> Port:
        """The serial line."""
        return Port(f"pad{self._number}", self._config.port, self._config.baud)

    def opened(self, t: float) -> None:
        """Handle the opening of the port at `t` (s)."""
        self.is_open = True
        self._handshake_error = None
        self._handshake = Handshake(self._config.handshake, t)

    def lost(self, t: float) -> list[PadLift]:
        """Handle the loss of the port at `t` (s)."""
        self.is_open = self.in_break = self._break_set = False
        self._handshake = None
        self._receiver.decoder.reset()
        lift = self._receiver.poll(math.inf)
        return [] if lift is None else [self._end_touch(PadLift(t, self._number), "silent")]

    def tend(self, port: HostLine, t: float) -> None:  # noqa: ARG002
        """Set or clear the line's break condition."""
        if self.in_break is not self._break_set and isinstance(port, Port):
            port.set_break(self.in_break)
            self._break_set = self.in_break

    def feed(self, data: bytes, t: float) -> list[PadSample | PadLift]:
        """Return the events in the bytes read at `t` (s)."""
        self._step_handshake(data, t)
        counters = self._receiver.counters
        packets = counters.packets
        events = self._receiver.feed(data, t)
        if counters.packets > packets:
            self._bytes_at_packet = counters.bytes
        for event in events:
            if isinstance(event, PadLift):
                self._end_touch(event, "lifted")
            else:
                across = math.nan if event.across is None else event.across
                self._position, self.touch_end = (event.s, across), None
        return events

    def poll(self, t: float, turning_rad_s: float = 0.0) -> list[PadLift]:  # noqa: ARG002
        """Return the lift-off if the pad has been silent for too long at `t` (s). Once a tick."""
        self._step_handshake(b"", t)
        lift = self._receiver.poll(t)
        return [] if lift is None else [self._end_touch(lift, "silent")]

    def reports(self, data: bytes, t: float) -> list[PadPacket]:
        """Return the packets in the bytes read at `t` (s)."""
        self._step_handshake(data, t)
        return self._receiver.decoder.feed(data, t)

    def view(self, t: float) -> PadView:
        """Return what is published of the pad at `t` (s)."""
        latest = self._receiver.latest
        if latest is None:
            return PadView()
        s, across = self._position
        return PadView(s, latest.pressure, t - latest.t_first, self.touching, latest.batched, across)

    def health(self, refresh: bool) -> Iterator[str]:
        """Yield the active fault conditions, without the pad's name."""
        if refresh:
            counters = self._receiver.counters
            self._error_shares.update(
                {
                    "garbled": (counters.bytes, counters.bytes_discarded),
                    "out-of-range": (counters.packets, counters.out_of_range),
                    "batched": (counters.packets, 2 * counters.batches),  # two packets or more in each
                }
            )
        yield from self._error_shares
        if self._handshake_error is not None:
            yield "handshake"

    def evidence(self, condition: str, t: float) -> str:
        """Return the measurements behind a condition at `t` (s)."""
        match condition:
            case "silent":
                touch, since = self._receiver.touch, bytes_since(self._bytes_since_packet)
                limit_s = SILENT_INTERVALS * touch.mean_interval_s if self._bytes_since_packet else touch.patience_s
                if self._receiver.decoder.foreign:
                    return f"{self._last_packet(t)}; {since}, and no pad's, not even a damaged one's"
                return f"{self._last_packet(t)}, the limit is {limit_s * 1e3:.0f} ms; {since}"
            case "lifted":
                return f"{self._last_packet(t)} and reports the lift-off: bit {IN_USE:#04x} (in use) of byte 0 is 0"
            case "untouched":
                return f"{self._last_packet(t)}; {bytes_since(self._bytes_since_packet)}"
            case "handshake":
                return self._handshake_error or ""
        return self._error_shares.text(condition)

    def counts(self) -> dict[str, int]:
        """All counters since the start, by name."""
        return self._receiver.counters.as_dict()

    def _last_packet(self, t: float) -> str:
        latest = self._receiver.latest
        return last_report(None if latest is None else latest.t_first, t)

    @property
    def _bytes_since_packet(self) -> int:
        return self._receiver.counters.bytes - self._bytes_at_packet

    def _step_handshake(self, data: bytes, t: float) -> None:
        """Advance the start-up."""
        handshake = self._handshake
        if handshake is None:
            return
        self.in_break = handshake.step(t, data)
        if handshake.done:
            self._handshake = None
            if handshake.error is not None:
                self._handshake_error = handshake.error
                log.warning("pad%d: %s", self._number, handshake.error)

    def _end_touch(self, lift: PadLift, how: Literal["lifted", "silent"]) -> PadLift:
        self._position, self.touch_end = (math.nan, math.nan), how
        return lift


DRIVER: PadFactory = VersaPad
COUNTER_NAMES = ("bytes", "packets", "bytes_discarded")
