"""A pad on a serial line that reports all the time, touched or not: what is the same of every such kind."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Generic, Literal, Protocol, TypeVar

from palmd.config.pads import PadBase
from palmd.devices.health import SERIAL_PAD, Shares, bytes_since, last_report
from palmd.devices.pad import MARGIN_MM, SILENT_INTERVALS, HostLine, PadReport, TouchTracker, place_mm
from palmd.devices.port import Port
from palmd.events import PadLift, PadSample
from palmd.messages import PadView


class SerialCounters(Protocol):
    """What a decoder of such a pad counts at least."""

    bytes: int
    packets: int
    discarded: int
    batched: int
    out_of_range: int

    def as_dict(self) -> dict[str, int]:
        """Every count by name."""


Report = TypeVar("Report", bound=PadReport)
Report_co = TypeVar("Report_co", bound=PadReport, covariant=True)
Counters = TypeVar("Counters", bound=SerialCounters)


class PadDecoder(Protocol[Report_co]):
    """Turns a pad's bytes into reports."""

    def feed(self, data: bytes, t_recv: float) -> Sequence[Report_co]:
        """Take the bytes read at `t_recv` (s) and return the reports they complete."""

    def reset(self) -> None:
        """The line has been interrupted."""


class SerialPad(ABC, Generic[Report, Counters]):
    """One pad's line; see `PadDriver`. A kind says where a report lies, and what may be wrong with its line."""

    starting = False

    def __init__(
        self, number: int, config: PadBase, baud: int, decoder: PadDecoder[Report], counters: Counters, report_s: float
    ) -> None:
        """`counters` are the decoder's; report_s: from one report of a touch to the next. Nothing is opened yet."""
        self.is_open = False
        self.parted: Literal["lifted", "silent"] | None = None
        self._number, self._base, self._baud = number, config, baud
        self._decoder, self._counters = decoder, counters
        self._touch = TouchTracker(number, report_s)
        self._latest: Report | None = None
        self._s = math.nan
        self._bytes_at_packet = 0
        self._shares = Shares(SERIAL_PAD)

    @property
    def touching(self) -> bool:
        """Whether the object touches the pad, as far as is known."""
        return self._touch.touching

    @property
    @abstractmethod
    def complaint(self) -> str | None:
        """Why it may be that no report has come; see `PadDriver`."""

    @abstractmethod
    def _is_place(self, report: Report) -> bool:
        """Whether a report of a touch has a place."""

    @abstractmethod
    def _is_bounded(self, report: Report) -> bool:
        """Whether a report saturates: its force is a lower bound."""

    def port(self) -> Port:
        """The serial line."""
        return Port(f"pad{self._number}", self._base.port, self._baud)

    def opened(self, t: float) -> None:  # noqa: ARG002
        """The port has been opened."""
        self.is_open = True

    def lost(self, t: float) -> list[PadLift]:
        """The port has gone at `t` (s)."""
        self.is_open = False
        self._decoder.reset()
        lift = self._touch.poll(math.inf)
        return [] if lift is None else [self._part(PadLift(t, self._number), "silent")]

    def tend(self, port: HostLine, t: float) -> None:
        """Most pads speak by themselves."""

    def feed(self, data: bytes, t: float) -> list[PadSample | PadLift]:
        """Take bytes read at `t` (s)."""
        events: list[PadSample | PadLift] = []
        self._touch.heard(t)
        for report in self.reports(data, t):
            lift = self._touch.report(report)
            if lift is not None:
                events.append(self._part(lift, "lifted"))
            elif report.in_use and (sample := self._sample(report)) is not None:
                self._s, self.parted = sample.s, None
                events.append(sample)
        return events

    def poll(self, t: float, turning_rad_s: float = 0.0) -> list[PadSample | PadLift]:  # noqa: ARG002
        """The end of the touch if the pad has been silent for too long at `t` (s). Once a tick."""
        lift = self._touch.poll(t)
        return [] if lift is None else [self._part(lift, "silent")]

    def reports(self, data: bytes, t: float) -> Sequence[Report]:
        """The reports in the bytes read at `t` (s), touched or not."""
        reports = self._decoder.feed(data, t)
        if reports:
            self._latest, self._bytes_at_packet = reports[-1], self._counters.bytes
        return reports

    def view(self, t: float) -> PadView:
        """What is published of the pad at `t` (s)."""
        latest = self._latest
        if latest is None:
            return PadView()
        return PadView(self._s, latest.pressure, t - latest.t_first, self.touching, latest.batched)

    def health(self, look: bool) -> Iterator[str]:
        """The conditions that hold, without the pad's name."""
        if look:
            counters = self._counters
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
                come = self._counters.bytes - self._bytes_at_packet
                limit_s = SILENT_INTERVALS * self._touch.mean_interval_s if come else self._touch.patience_s
                return f"{last}, the limit is {limit_s * 1e3:.0f} ms; {bytes_since(come)}"
            case "lifted":
                return f"{last} and says so"
            case "untouched":
                return last
        return self._shares.told(condition)

    def counts(self) -> dict[str, int]:
        """What has passed since the start, by cause."""
        return self._counters.as_dict()

    def _sample(self, report: Report) -> PadSample | None:
        config = self._base
        s_mm = place_mm(config, report.x_counts)
        if not (self._is_place(report) and 0.0 < s_mm <= config.length_mm + MARGIN_MM):
            self._counters.out_of_range += 1
            return None
        newtons = report.pressure * config.newtons_per_count
        force, at_least = (None, newtons) if self._is_bounded(report) else (newtons, None)
        return PadSample(report.t_first, self._number, s_mm * 1e-3, force, at_least=at_least)

    def _part(self, lift: PadLift, how: Literal["lifted", "silent"]) -> PadLift:
        self._s, self.parted = math.nan, how
        return lift
