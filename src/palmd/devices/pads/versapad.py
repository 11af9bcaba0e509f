"""`kind: versapad`: a Logitech/Interlink VersaPad on a serial line."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from typing import Literal, cast

from palmd.config.pads import VersaPadConfig
from palmd.devices.handshake import Handshake
from palmd.devices.health import SERIAL_PAD, Shares, bytes_since, last_report
from palmd.devices.pad import SILENT_INTERVALS, HostLine, PadFactory
from palmd.devices.port import Port
from palmd.devices.versapad import IN_USE, PadCalibration, PadPacket, PadReceiver, PressureFormat
from palmd.events import PadLift, PadSample
from palmd.messages import PadView

log = logging.getLogger(__name__)


class VersaPad:
    """One pad's line; see `PadDriver`. `in_break` says whether its start-up wants the line in break."""

    def __init__(self, number: int, config: VersaPadConfig) -> None:
        """Nothing is opened yet."""
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
        self.parted: Literal["lifted", "silent"] | None = None
        self._receiver = PadReceiver(calibration, config.baud, pressure)
        self._number: int = number
        self._config = config
        self._place = math.nan, math.nan
        self._bytes_at_packet = 0
        self._handshake: Handshake | None = None
        self._unanswered: str | None = None
        self._held = False  # in break, as the port has been told
        self._shares = Shares(SERIAL_PAD)

    @property
    def touching(self) -> bool:
        """Whether the object touches the pad, as far as is known."""
        return self._receiver.touch.touching

    @property
    def starting(self) -> bool:
        """Whether the handshake is under way."""
        return self._handshake is not None

    @property
    def complaint(self) -> str | None:
        """That the handshake was not answered, or that what came was no report."""
        if self._unanswered is not None:
            return self._unanswered
        if discarded := self._receiver.counters.bytes_discarded:
            return f"{discarded} bytes, but no report among them at {self._config.baud} baud: is it a pad?"
        return None

    def port(self) -> Port:
        """The serial line."""
        return Port(f"pad{self._number}", self._config.port, self._config.baud)

    def opened(self, t: float) -> None:
        """The port has been opened at `t` (s)."""
        self.is_open = True
        self._unanswered = None
        self._handshake = Handshake(self._config.handshake, t)

    def lost(self, t: float) -> list[PadLift]:
        """The port has gone at `t` (s)."""
        self.is_open = self.in_break = self._held = False
        self._handshake = None
        self._receiver.decoder.reset()
        lift = self._receiver.poll(math.inf)
        return [] if lift is None else [self._part(PadLift(t, self._number), "silent")]

    def tend(self, port: HostLine, t: float) -> None:  # noqa: ARG002
        """Hold the line in break, or end that."""
        if self.in_break is not self._held and isinstance(port, Port):
            port.set_break(self.in_break)
            self._held = self.in_break

    def feed(self, data: bytes, t: float) -> list[PadSample | PadLift]:
        """Take bytes read at `t` (s)."""
        self._shake(data, t)
        counters = self._receiver.counters
        packets = counters.packets
        events = self._receiver.feed(data, t)
        if counters.packets > packets:
            self._bytes_at_packet = counters.bytes
        for event in events:
            if isinstance(event, PadLift):
                self._part(event, "lifted")
            else:
                beside = math.nan if event.across is None else event.across
                self._place, self.parted = (event.s, beside), None
        return events

    def poll(self, t: float, turning_rad_s: float = 0.0) -> list[PadLift]:  # noqa: ARG002
        """The lift-off that silence tells of at `t` (s). Once a tick."""
        self._shake(b"", t)
        lift = self._receiver.poll(t)
        return [] if lift is None else [self._part(lift, "silent")]

    def reports(self, data: bytes, t: float) -> list[PadPacket]:
        """The packets in the bytes read at `t` (s)."""
        self._shake(data, t)
        return self._receiver.decoder.feed(data, t)

    def view(self, t: float) -> PadView:
        """What is to be told of the pad at `t` (s)."""
        latest = self._receiver.latest
        if latest is None:
            return PadView()
        s, across = self._place
        return PadView(s, latest.pressure, t - latest.t_first, self.touching, latest.batched, across)

    def health(self, look: bool) -> Iterator[str]:
        """The conditions that hold, without the pad's name."""
        if look:
            counters = self._receiver.counters
            self._shares.look(
                {
                    "garbled": (counters.bytes, counters.bytes_discarded),
                    "out-of-range": (counters.packets, counters.out_of_range),
                    "batched": (counters.packets, 2 * counters.batches),  # two packets or more in each
                }
            )
        yield from self._shares
        if self._unanswered is not None:
            yield "handshake"

    def evidence(self, condition: str, t: float) -> str:
        """What speaks for a condition at `t` (s)."""
        match condition:
            case "silent":
                touch, since = self._receiver.touch, bytes_since(self._bytes_come)
                limit_s = SILENT_INTERVALS * touch.mean_interval_s if self._bytes_come else touch.patience_s
                if self._receiver.decoder.foreign:
                    return f"{self._last_packet(t)}; {since}, and no pad's, not even a damaged one's"
                return f"{self._last_packet(t)}, the limit is {limit_s * 1e3:.0f} ms; {since}"
            case "lifted":
                return f"{self._last_packet(t)} and says so: bit {IN_USE:#04x} (in use) of its first byte is 0"
            case "untouched":
                return f"{self._last_packet(t)}; {bytes_since(self._bytes_come)}"
            case "handshake":
                return self._unanswered or ""
        return self._shares.told(condition)

    def counts(self) -> dict[str, int]:
        """What has passed since the start, by cause."""
        return self._receiver.counters.as_dict()

    def _last_packet(self, t: float) -> str:
        latest = self._receiver.latest
        return last_report(None if latest is None else latest.t_first, t)

    @property
    def _bytes_come(self) -> int:
        return self._receiver.counters.bytes - self._bytes_at_packet

    def _shake(self, data: bytes, t: float) -> None:
        """Let the start-up go on."""
        handshake = self._handshake
        if handshake is None:
            return
        self.in_break = handshake.step(t, data)
        if handshake.done:
            self._handshake = None
            if handshake.error is not None:
                self._unanswered = handshake.error
                log.warning("pad%d: %s", self._number, handshake.error)

    def _part(self, lift: PadLift, how: Literal["lifted", "silent"]) -> PadLift:
        self._place, self.parted = (math.nan, math.nan), how
        return lift


DRIVER: PadFactory = VersaPad
COUNTED = ("bytes", "packets", "bytes_discarded")
