"""Base class of pads on a serial line that report continuously, touched or not."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Generic, Literal, Protocol, TypeVar

from palmd.config.pads import PadBase
from palmd.devices.health import SERIAL_PAD_LIMITS, ErrorShares, bytes_since, last_report
from palmd.devices.pad import MARGIN_MM, SILENT_INTERVALS, HostLine, PadReport, TouchTracker, counts_to_mm
from palmd.devices.port import Port
from palmd.events import PadLift, PadSample
from palmd.messages import PadView


class SerialCounters(Protocol):
    """Counters that the decoder of such a pad must have."""

    bytes: int
    packets: int
    discarded: int
    batched: int
    out_of_range: int

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


class SerialPad(ABC, Generic[Report, Counters]):
    """`PadDriver` of one such pad. Subclasses decide whether a report has a position, and diagnose the line."""

    starting = False

    def __init__(
        self, number: int, config: PadBase, baud: int, decoder: PadDecoder[Report], counters: Counters, report_s: float
    ) -> None:
        """`counters` are the decoder's; report_s: time between two reports of a touch. Nothing is opened yet."""
        self.is_open = False
        self.touch_end: Literal["lifted", "silent"] | None = None
        self._number, self._base, self._baud = number, config, baud
        self._decoder, self._counters = decoder, counters
        self._touch = TouchTracker(number, report_s)
        self._latest: Report | None = None
        self._s = math.nan
        self._bytes_at_packet = 0
        self._error_shares = ErrorShares(SERIAL_PAD_LIMITS)

    @property
    def touching(self) -> bool:
        """Whether the object touches the pad according to the reports so far."""
        return self._touch.touching

    @property
    @abstractmethod
    def diagnosis(self) -> str | None:
        """Likely reason why no report has arrived; see `PadDriver`."""

    @abstractmethod
    def _has_position(self, report: Report) -> bool:
        """Whether a report of a touch has a position."""

    @abstractmethod
    def _is_saturated(self, report: Report) -> bool:
        """Whether a report is saturated: its force is a lower bound."""

    def port(self) -> Port:
        """The serial line."""
        return Port(f"pad{self._number}", self._base.port, self._baud)

    def opened(self, t: float) -> None:  # noqa: ARG002
        """Handle the opening of the port."""
        self.is_open = True

    def lost(self, t: float) -> list[PadLift]:
        """Handle the loss of the port at `t` (s)."""
        self.is_open = False
        self._decoder.reset()
        lift = self._touch.poll(math.inf)
        return [] if lift is None else [self._end_touch(PadLift(t, self._number), "silent")]

    def tend(self, port: HostLine, t: float) -> None:
        """Do nothing: most pads send reports unasked."""

    def feed(self, data: bytes, t: float) -> list[PadSample | PadLift]:
        """Return the events in the bytes read at `t` (s)."""
        events: list[PadSample | PadLift] = []
        self._touch.bytes_received(t)
        for report in self.reports(data, t):
            lift = self._touch.report(report)
            if lift is not None:
                events.append(self._end_touch(lift, "lifted"))
            elif report.in_use and (sample := self._sample(report)) is not None:
                self._s, self.touch_end = sample.s, None
                events.append(sample)
        return events

    def poll(self, t: float, turning_rad_s: float = 0.0) -> list[PadSample | PadLift]:  # noqa: ARG002
        """Return the lift-off if the pad has been silent for too long at `t` (s). Once a tick."""
        lift = self._touch.poll(t)
        return [] if lift is None else [self._end_touch(lift, "silent")]

    def reports(self, data: bytes, t: float) -> Sequence[Report]:
        """Return the reports in the bytes read at `t` (s), touched or not."""
        reports = self._decoder.feed(data, t)
        if reports:
            self._latest, self._bytes_at_packet = reports[-1], self._counters.bytes
        return reports

    def view(self, t: float) -> PadView:
        """Return what is published of the pad at `t` (s)."""
        latest = self._latest
        if latest is None:
            return PadView()
        return PadView(self._s, latest.pressure, t - latest.t_first, self.touching, latest.batched)

    def health(self, refresh: bool) -> Iterator[str]:
        """Yield the active fault conditions, without the pad's name."""
        if refresh:
            counters = self._counters
            self._error_shares.update(
                {
                    "garbled": (counters.bytes, counters.discarded),
                    "out-of-range": (counters.packets, counters.out_of_range),
                    "batched": (counters.packets, counters.batched),
                }
            )
        yield from self._error_shares

    def evidence(self, condition: str, t: float) -> str:
        """Return the measurements behind a condition at `t` (s)."""
        last = last_report(None if self._latest is None else self._latest.t_first, t)
        match condition:
            case "silent":
                count = self._counters.bytes - self._bytes_at_packet
                limit_s = SILENT_INTERVALS * self._touch.mean_interval_s if count else self._touch.patience_s
                return f"{last}, the limit is {limit_s * 1e3:.0f} ms; {bytes_since(count)}"
            case "lifted":
                return f"{last} and reports the lift-off"
            case "untouched":
                return last
        return self._error_shares.text(condition)

    def counts(self) -> dict[str, int]:
        """All counters since the start, by name."""
        return self._counters.as_dict()

    def _sample(self, report: Report) -> PadSample | None:
        config = self._base
        s_mm = counts_to_mm(config, report.x_counts)
        if not (self._has_position(report) and 0.0 < s_mm <= config.length_mm + MARGIN_MM):
            self._counters.out_of_range += 1
            return None
        newtons = report.pressure * config.newtons_per_count
        force, at_least = (None, newtons) if self._is_saturated(report) else (newtons, None)
        return PadSample(report.t_first, self._number, s_mm * 1e-3, force, at_least=at_least)

    def _end_touch(self, lift: PadLift, how: Literal["lifted", "silent"]) -> PadLift:
        self._s, self.touch_end = math.nan, how
        return lift
