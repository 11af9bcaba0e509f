"""The interface of all touch pad drivers, and the lookup of the configured one.

A kind `K` consists of `palmd/devices/pads/K.py`, which defines `DRIVER`, and of a model in `palmd.config` with
`kind: Literal["K"]`. Daemon, bring-up and calibration use this interface only.
"""

from __future__ import annotations

import importlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

import numpy as np

from palmd.devices.health import ErrorShares, Limits, last_report
from palmd.events import FloatArray, PadLift, PadSample
from palmd.messages import PadView

if TYPE_CHECKING:
    from palmd.config.pads import PadConfig
    from palmd.devices.port import DevicePort

MARGIN_MM = 1.0
"""Tolerance beyond the pad's end, for errors of the zero."""

SILENT_INTERVALS = 5
"""The touch has ended after a silence of so many mean intervals between reports."""

DEAD_INTERVALS = 2.5
PAUSE_REPORTS, PAUSE_FACTOR, PAUSE_MARGIN_S = 400, 1.2, 0.004
"""If no byte arrives at all, the touch ends earlier: after `PAUSE_FACTOR` times the longest pause within the last
`PAUSE_REPORTS` reports plus `PAUSE_MARGIN_S` for the adapter, less the report's time on the line, but not before
`DEAD_INTERVALS` mean intervals."""


@dataclass(frozen=True, slots=True)
class PadReport:
    """One report of a pad in counts.

    `t_first` is when its first byte arrived, `t_recv` when it was read completely (s, monotonic). `batched`: several
    reports came in one read, so `t_first` is back-dated only.
    """

    t_first: float
    t_recv: float
    x_counts: int
    y_counts: int
    pressure: int
    in_use: bool
    batched: bool


class PadScale(Protocol):
    """Conversion of a pad's counts to millimetres; the names are those of the configuration's keys."""

    @property
    def zero_mm(self) -> float: ...
    @property
    def sign(self) -> int: ...
    @property
    def counts_per_mm(self) -> float: ...
    @property
    def length_mm(self) -> float: ...
    @property
    def corrections_mm(self) -> Sequence[float]: ...


class FixedScale(NamedTuple):
    """`PadScale` of a pad in the loop: a configuration computes its corrections on each access."""

    zero_mm: float
    sign: int
    counts_per_mm: float
    length_mm: float
    corrections_mm: Sequence[float]

    @classmethod
    def of(cls, pad: PadScale) -> FixedScale:
        """Copy a pad's scale."""
        return cls(pad.zero_mm, pad.sign, pad.counts_per_mm, pad.length_mm, pad.corrections_mm)


def counts_to_mm(pad: PadScale, counts: float) -> float:
    """Distance (mm) of a reading from the hinge: linear scale plus correction curve. Safe in the loop."""
    straight = pad.zero_mm + pad.sign * counts / pad.counts_per_mm
    curve = pad.corrections_mm
    if not curve:
        return straight
    last = len(curve) - 1
    at = min(max(straight / pad.length_mm, 0.0), 1.0) * last
    before = min(int(at), last - 1)
    return straight + curve[before] + (at - before) * (curve[before + 1] - curve[before])


def position_mm(pad: PadScale, counts: float) -> float | None:
    """Distance (mm) of a reading from the hinge; None if it is not on the pad: no contact. Safe in the loop."""
    s_mm = counts_to_mm(pad, counts)
    return s_mm if 0.0 < s_mm <= pad.length_mm + MARGIN_MM else None


def linear_mm(pad: PadScale, s_mm: FloatArray) -> FloatArray:
    """Inverse of the correction curve: the linear distances for which `counts_to_mm` gave `s_mm` (n,)."""
    if not pad.corrections_mm:
        return s_mm
    line = np.linspace(0.0, pad.length_mm, len(pad.corrections_mm))
    curve = np.array(pad.corrections_mm)
    return np.asarray(s_mm - np.interp(s_mm, line + curve, curve))


class HostLine(Protocol):
    """Port to which a pad's driver writes."""

    def write(self, data: bytes) -> None:
        """Send `data`, or drop and count it."""


TouchEnd = Literal["lifted", "silent"]
"""How a touch ended: by a report, or by silence."""


class PadDriver(ABC):
    """Driver of one pad: bytes in, events out. No I/O except in `port` and what it opens; safe in the loop.

    `touch_end` is how the last touch ended; None while touching or before any touch.
    """

    def __init__(self, number: int, limits: Limits) -> None:
        """`limits` are those of the conditions that follow from counters. Nothing is opened yet."""
        self.is_open = False
        self.touch_end: TouchEnd | None = None
        self._number = number
        self._latest: PadReport | None = None
        self._sample: PadSample | None = None  # the last one of the present touch
        self._error_shares = ErrorShares(limits)

    @property
    @abstractmethod
    def touching(self) -> bool:
        """Whether the object touches the pad according to the reports so far."""

    @property
    def starting(self) -> bool:
        """Whether the pad is still starting up."""
        return False

    @property
    @abstractmethod
    def diagnosis(self) -> str | None:
        """Likely reason why no report has arrived, derived from the line's counters; None if none is known."""

    @abstractmethod
    def port(self) -> DevicePort:
        """Return the pad's port, not yet opened."""

    def opened(self, t: float) -> None:  # noqa: ARG002
        """Handle the opening of the port at `t` (s)."""
        self.is_open = True

    @abstractmethod
    def lost(self, t: float) -> list[PadLift]:
        """Handle the loss of the port at `t` (s)."""

    def tend(self, port: HostLine, t: float) -> None:  # noqa: B027
        """Serve the open port at `t` (s), once a tick: start-up, and requests to pads that are polled."""

    @abstractmethod
    def feed(self, data: bytes, t: float) -> list[PadSample | PadLift]:
        """Return the events in the bytes read at `t` (s)."""

    @abstractmethod
    def poll(self, t: float, turning_rad_s: float = 0.0) -> Sequence[PadSample | PadLift]:
        """Return the events that follow from silence at `t` (s), once a tick: a lift-off, or a repeated sample.

        turning_rad_s: rate of the faster palm; on a turning palm no contact stays at one position for long.
        """

    @abstractmethod
    def reports(self, data: bytes, t: float) -> Sequence[PadReport]:
        """Return the uncalibrated reports in the bytes read at `t` (s); replaces `feed` in bring-up and calibration."""

    def view(self, t: float) -> PadView:
        """Return what is published of the pad at `t` (s)."""
        latest, sample = self._latest, self._sample
        if latest is None:
            return PadView()
        s = math.nan if sample is None else sample.s
        across = math.nan if sample is None or sample.across is None else sample.across
        return PadView(s, latest.pressure, t - latest.t_first, self.touching, latest.batched, across)

    def health(self, refresh: bool) -> Iterator[str]:
        """Yield the active fault conditions, without the pad's name; `refresh`: evaluate the counters again first."""
        if refresh:
            self._error_shares.update(self._errors())
        yield from self._error_shares

    def evidence(self, condition: str, t: float) -> str:
        """Return the measurements behind a condition at `t` (s): byte, age, limit. May be empty."""
        last = last_report(None if self._latest is None else self._latest.t_first, t)
        match condition:
            case "silent":
                return self._silence(last)
            case "lifted":
                return f"{last} and reports the lift-off"
            case "untouched":
                return last
        return self._error_shares.text(condition)

    def finding(self, condition: str) -> str:
        """Return what came over the line of a silent pad, as a code: mute, unreadable or foreign; else empty."""
        return "mute" if condition == "silent" else ""

    @abstractmethod
    def counts(self) -> dict[str, int]:
        """All counters since the start, by name."""

    @abstractmethod
    def _errors(self) -> Mapping[str, tuple[int, int]]:
        """Total and errors since the start, for each condition of the limits."""

    @abstractmethod
    def _silence(self, last: str) -> str:
        """Evidence of `silent`; `last` is the age of the last report as text."""


PadFactory = Callable[[int, Any], PadDriver]
"""Creates a pad driver from the pad's number and the configuration of its kind."""


def make_pad(number: int, config: PadConfig) -> PadDriver:
    """Create the driver of a configured pad."""
    factory: PadFactory = _of_kind(config.kind, "DRIVER")
    return factory(number, config)


def _of_kind(kind: str, name: str, default: Any = None) -> Any:
    """What the module of a kind of pad defines under this name."""
    return getattr(importlib.import_module(f"palmd.devices.pads.{kind}"), name, default)


@dataclass(frozen=True, slots=True)
class PadRemark:
    """Finding about a pad's device: subject, verdict, text and fix.

    `key` is the configuration's key concerned.
    """

    what: str
    verdict: Literal["ok", "missing", "mismatch"]
    text: str
    key: str = "port"
    fix: str = ""


@dataclass(frozen=True, slots=True)
class InspectedPad:
    """A pad's configuration, with omitted units filled in from its device, and findings about the device."""

    config: PadConfig
    remarks: tuple[PadRemark, ...] = ()


def inspect_pad(config: PadConfig) -> InspectedPad:
    """Inspect a pad's device without grabbing it. It may open the device: not for the loop."""
    found: InspectedPad = _of_kind(config.kind, "inspect", InspectedPad)(config)
    return found


def pad_counter_names(kind: str) -> tuple[str, str, str] | None:
    """Names of a kind's counters of received bytes, of reports and of bytes outside reports; None if it has none."""
    counted: tuple[str, str, str] | None = _of_kind(kind, "COUNTER_NAMES")
    return counted


def pad_note(kind: str) -> str:
    """Note for users who choose this kind of pad; may be empty."""
    note: str = _of_kind(kind, "NOTE", "")
    return note


class TouchTracker:
    """Detects the lift-off on a pad that reports while it is touched: by a report, or by silence.

    Silence is five mean intervals without a report, or a line without any byte for clearly longer than the longest
    pause of the last reports, once there are enough of them. Damaged reports still bring bytes, so the limit of five
    intervals applies, unless the bytes cannot be a pad's at all. The mean is a running one, limited to 1 to 2.5 report
    times, so that a silent pad is detected within 100 ms at 9600 baud.
    """

    GAIN = 1 / 16
    START_REPORTS = 1.6
    MAX_REPORTS = 2.5

    def __init__(self, pad: int, report_s: float, sending_s: float = 0.0) -> None:
        """`report_s` (s) is the shortest time between two reports, of which `sending_s` (s) is spent on the line."""
        self._pad: int = pad
        self._shortest_s = report_s
        self._longest_s = self.MAX_REPORTS * report_s
        self._mean_s = self.START_REPORTS * report_s
        self._sending_s = sending_s
        self._t_first = 0.0
        self._t_recv = 0.0
        self._t_byte = -math.inf
        # longest pause (s) in the last full block of PAUSE_REPORTS, and in the current one
        self._pauses = (math.inf, 0.0)
        self._reports = 0
        self.touching = False

    @property
    def mean_interval_s(self) -> float:
        """Running mean of the time between reports (s)."""
        return self._mean_s

    @property
    def patience_s(self) -> float:
        """How long (s) a line may be without any byte while the pad is touched."""
        shown_s = (
            max(DEAD_INTERVALS * self._mean_s, PAUSE_FACTOR * max(self._pauses) + PAUSE_MARGIN_S) - self._sending_s
        )
        return min(SILENT_INTERVALS * self._mean_s, shown_s)

    def bytes_received(self, t: float) -> None:
        """Record that bytes were read at `t` (s)."""
        self._t_byte = t

    def report(self, report: PadReport) -> PadLift | None:
        """Process a report, in the order received; return the lift-off that it reports, if any."""
        if not report.in_use:
            return self._lift(report.t_first)
        if self.touching:
            self._update_pause(report.t_recv - self._t_recv)
            mean_s = self._mean_s + self.GAIN * (report.t_first - self._t_first - self._mean_s)
            self._mean_s = min(max(mean_s, self._shortest_s), self._longest_s)
        self.touching = True
        self._t_first, self._t_recv = report.t_first, report.t_recv
        return None

    def poll(self, t: float, *, gone: bool = False) -> PadLift | None:
        """Return the lift-off if the pad has been silent for too long at `t` (s), or if it is known to be `gone`."""
        if gone:
            return self._lift(t)
        t_silent = self._t_recv + SILENT_INTERVALS * self._mean_s
        t_dead = math.inf if math.isinf(self._t_byte) else self._t_byte + self.patience_s
        first = min(t_silent, t_dead)
        return self._lift(first) if t >= first else None

    def _update_pause(self, pause_s: float) -> None:
        before, present = self._pauses
        self._pauses = before, max(present, pause_s)
        self._reports += 1
        if self._reports % PAUSE_REPORTS == 0:
            self._pauses = self._pauses[1], 0.0

    def _lift(self, t: float) -> PadLift | None:
        if not self.touching:
            return None
        self.touching = False
        return PadLift(t, self._pad)
