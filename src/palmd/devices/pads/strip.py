"""`kind: strip`: a force-sensing strip read by a microcontroller on a USB serial port."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

from palmd.config.pads import StripConfig
from palmd.devices.health import SERIAL_PAD, Shares, bytes_since, last_report
from palmd.devices.pad import MARGIN_MM, SILENT_INTERVALS, PadFactory, TouchTracker, place_mm
from palmd.devices.port import DevicePort, Port
from palmd.devices.strip import FORCE_MAX, TOUCHED_S, StripDecoder, StripPacket
from palmd.events import PadLift, PadSample
from palmd.messages import PadView


class Strip:
    """One strip's line; see `PadDriver`."""

    starting = False

    def __init__(self, number: int, config: StripConfig) -> None:
        """Nothing is opened yet."""
        self.is_open = False
        self.parted: Literal["lifted", "silent"] | None = None
        self._number, self._config = number, config
        self._decoder = StripDecoder(config.baud)
        self._touch = TouchTracker(number, TOUCHED_S)
        self._latest: StripPacket | None = None
        self._s = math.nan
        self._bytes_at_packet = 0
        self._shares = Shares(SERIAL_PAD)

    @property
    def touching(self) -> bool:
        """Whether the object touches the strip, as far as is known."""
        return self._touch.touching

    @property
    def complaint(self) -> str | None:
        """That what came was no report, or of another version."""
        counters = self._decoder.counters
        if counters.strange:
            return "its firmware is of another version than palmd: flash that of tools/strip"
        if counters.discarded:
            return f"{counters.discarded} bytes, but no report among them: is it a strip with palmd's firmware?"
        return None

    def port(self) -> Port:
        """The serial line."""
        return Port(f"pad{self._number}", self._config.port, self._config.baud)

    def opened(self, t: float) -> None:  # noqa: ARG002
        """The port has been opened; the firmware talks by itself."""
        self.is_open = True

    def lost(self, t: float) -> list[PadLift]:
        """The port has gone at `t` (s)."""
        self.is_open = False
        self._decoder.reset()
        lift = self._touch.poll(math.inf)
        return [] if lift is None else [self._part(PadLift(t, self._number), "silent")]

    def tend(self, port: DevicePort) -> None:
        """There is no start-up."""

    def feed(self, data: bytes, t: float) -> list[PadSample | PadLift]:
        """Take bytes read at `t` (s)."""
        events: list[PadSample | PadLift] = []
        self._touch.heard(t)
        for packet in self._decoder.feed(data, t):
            self._latest = packet
            self._bytes_at_packet = self._decoder.counters.bytes
            lift = self._touch.report(packet)
            if lift is not None:
                events.append(self._part(lift, "lifted"))
            elif packet.in_use and (sample := self._sample(packet)) is not None:
                self._s, self.parted = sample.s, None
                events.append(sample)
        return events

    def poll(self, t: float, turning_rad_s: float = 0.0) -> list[PadSample | PadLift]:  # noqa: ARG002
        """The loss of touch that silence tells of at `t` (s). Once a tick."""
        lift = self._touch.poll(t)
        return [] if lift is None else [self._part(lift, "silent")]

    def reports(self, data: bytes, t: float) -> list[StripPacket]:
        """The packets in the bytes read at `t` (s), touched ones and the last one before."""
        return self._decoder.feed(data, t)

    def view(self, t: float) -> PadView:
        """What is to be told of the strip at `t` (s)."""
        latest = self._latest
        if latest is None:
            return PadView()
        return PadView(self._s, latest.pressure, t - latest.t_first, self.touching, latest.batched)

    def health(self, look: bool) -> Iterator[str]:
        """The conditions that hold, without the pad's name."""
        if look:
            counters = self._decoder.counters
            self._shares.look(
                {
                    "garbled": (counters.bytes, counters.discarded),
                    "out-of-range": (counters.packets, counters.out_of_range),
                    "batched": (counters.packets, counters.batched),
                }
            )
        yield from self._shares

    def evidence(self, condition: str, t: float) -> str:
        """What speaks for a condition at `t` (s)."""
        last = last_report(None if self._latest is None else self._latest.t_first, t)
        match condition:
            case "silent":
                come = self._decoder.counters.bytes - self._bytes_at_packet
                limit_s = SILENT_INTERVALS * self._touch.mean_interval_s if come else self._touch.patience_s
                return f"{last}, the limit is {limit_s * 1e3:.0f} ms; {bytes_since(come)}"
            case "lifted":
                return f"{last} and says so"
            case "untouched":
                return last
        return self._shares.told(condition)

    def counts(self) -> dict[str, int]:
        """What has passed since the start, by cause."""
        return self._decoder.counters.as_dict()

    def _sample(self, packet: StripPacket) -> PadSample | None:
        config = self._config
        s_mm = place_mm(config, packet.x_counts)
        if not 0.0 < s_mm <= config.length_mm + MARGIN_MM:
            self._decoder.counters.out_of_range += 1
            return None
        bounded = packet.saturated or packet.pressure >= FORCE_MAX  # then it is only a lower bound
        told = packet.pressure * config.newtons_per_count
        force, at_least = (None, told) if bounded else (told, None)
        return PadSample(packet.t_first, self._number, s_mm * 1e-3, force, at_least=at_least)

    def _part(self, lift: PadLift, how: Literal["lifted", "silent"]) -> PadLift:
        self._s, self.parted = math.nan, how
        return lift


DRIVER: PadFactory = Strip
