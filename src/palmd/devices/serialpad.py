"""Base class of pads on a serial line."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Generic, Protocol, TypeVar

from palmd.config.pads import PadBase
from palmd.devices.health import SERIAL_PAD_LIMITS, bytes_since
from palmd.devices.pad import SILENT_INTERVALS, FixedScale, PadDriver, PadReport, TouchEnd, TouchTracker, position_mm
from palmd.devices.port import Port
from palmd.events import PadLift, PadSample

MIN_PACKET_BYTES = 8  # fewer may be the rest of a packet


class SerialCounters(Protocol):
    """Counters that the decoder of such a pad must have."""

    bytes: int
    packets: int
    out_of_range: int

    @property
    def discarded(self) -> int:
        """Bytes outside packets."""

    @property
    def batched(self) -> int:
        """Packets that came in one read with others."""

    def as_dict(self) -> dict[str, int]:
        """All counters by name."""


Report = TypeVar("Report", bound=PadReport)
Report_co = TypeVar("Report_co", bound=PadReport, covariant=True)
Counters = TypeVar("Counters", bound=SerialCounters)


class PadDecoder(Protocol[Report_co]):
    """Turns a pad's bytes into reports."""

    def feed(self, data: bytes, t_recv: float) -> Sequence[Report_co]:
        """Process the bytes read at `t_recv` (s) and return the reports that they complete."""

    def reset(self) -> None:
        """Discard buffered bytes after an interruption of the line."""


class SerialPad(PadDriver, Generic[Report, Counters]):
    """`PadDriver` of one such pad. Subclasses decide what a report means, and diagnose the line."""

    def __init__(
        self,
        number: int,
        config: PadBase,
        baud: int,
        decoder: PadDecoder[Report],
        counters: Counters,
        report_s: float,
        sending_s: float = 0.0,
    ) -> None:
        """`counters` are the decoder's; report_s, sending_s: see `TouchTracker`. Nothing is opened yet."""
        super().__init__(number, SERIAL_PAD_LIMITS)
        self._base, self._baud = config, baud
        self._scale = FixedScale.of(config)
        self._decoder, self._counters = decoder, counters
        self._touch = TouchTracker(number, report_s, sending_s)
        self._bytes_at_packet = 0

    @property
    def touching(self) -> bool:
        return self._touch.touching

    @property
    def _is_foreign(self) -> bool:
        """Whether the bytes since the last report cannot be this pad's."""
        return False

    def _has_position(self, report: Report) -> bool:  # noqa: ARG002
        """Whether a report of a touch has a position on the pad, apart from that along the palm."""
        return True

    def _across(self, report: Report) -> float | None:  # noqa: ARG002
        """Position across the palm (m), None if the pad reads none."""
        return None

    @abstractmethod
    def _is_saturated(self, report: Report) -> bool:
        """Whether a report is saturated: its force is a lower bound."""

    def port(self) -> Port:
        return Port(f"pad{self._number}", self._base.port, self._baud)

    def lost(self, t: float) -> list[PadLift]:
        self.is_open = False
        self._decoder.reset()
        lift = self._touch.poll(math.inf)
        return [] if lift is None else [self._end_touch(PadLift(t, self._number), "silent")]

    def feed(self, data: bytes, t: float) -> list[PadSample | PadLift]:
        events: list[PadSample | PadLift] = []
        if data:
            self._touch.bytes_received(t)
        for report in self.reports(data, t):
            lift = self._touch.report(report)
            if lift is not None:
                events.append(self._end_touch(lift, "lifted"))
            elif report.in_use and (sample := self._calibrated(report)) is not None:
                self._sample, self.touch_end = sample, None
                events.append(sample)
        return events

    def poll(self, t: float, turning_rad_s: float = 0.0) -> list[PadSample | PadLift]:  # noqa: ARG002
        """Return the lift-off if the pad has been silent for too long at `t` (s), or another device sends."""
        lift = self._touch.poll(t, gone=self._is_foreign)
        return [] if lift is None else [self._end_touch(lift, "silent")]

    def reports(self, data: bytes, t: float) -> Sequence[Report]:
        reports = self._decoder.feed(data, t)
        if reports:
            self._latest, self._bytes_at_packet = reports[-1], self._counters.bytes
        return reports

    def counts(self) -> dict[str, int]:
        return self._counters.as_dict()

    @property
    def _bytes_since_packet(self) -> int:
        return self._counters.bytes - self._bytes_at_packet

    def _errors(self) -> Mapping[str, tuple[int, int]]:
        counters = self._counters
        return {
            "garbled": (counters.bytes, counters.discarded),
            "out-of-range": (counters.packets, counters.out_of_range),
            "batched": (counters.packets, counters.batched),
        }

    def finding(self, condition: str) -> str:
        if condition != "silent" or (self._bytes_since_packet < MIN_PACKET_BYTES and not self._is_foreign):
            return super().finding(condition)
        return "foreign" if self._is_foreign else "unreadable"

    def _silence(self, last: str) -> str:
        since = self._bytes_since_packet
        limit_s = SILENT_INTERVALS * self._touch.mean_interval_s if since else self._touch.patience_s
        return f"{last}, the limit is {limit_s * 1e3:.0f} ms; {bytes_since(since)}"

    def _calibrated(self, report: Report) -> PadSample | None:
        """Return the contact in a report of a touch (s in m, force in N), or None if it is not on the pad.

        At full scale the pressure is only a lower bound, so the sample has no force.
        """
        s_mm = position_mm(self._scale, report.x_counts if self._base.axis == "x" else report.y_counts)
        if s_mm is None or not self._has_position(report):
            self._counters.out_of_range += 1
            return None
        newtons = report.pressure * self._base.newtons_per_count
        force, at_least = (None, newtons) if self._is_saturated(report) else (newtons, None)
        return PadSample(report.t_first, self._number, s_mm * 1e-3, force, self._across(report), at_least)

    def _end_touch(self, lift: PadLift, how: TouchEnd) -> PadLift:
        self._sample, self.touch_end = None, how
        return lift
