"""What every kind of touch pad offers, and how the configured kind is found.

A kind `K` is `palmd/devices/pads/K.py`, which says `DRIVER`, and a model in `palmd.config` with `kind: Literal["K"]`.
Nothing else knows of it: the daemon, the bring-up and the calibration take what stands here.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from palmd.events import FloatArray, PadLift, PadSample

if TYPE_CHECKING:
    from palmd.config.pads import PadConfig
    from palmd.devices.port import DevicePort
    from palmd.messages import PadView

MARGIN_MM = 1.0
"""How far beyond the pad's end a reading may lie, for the zero is never quite right."""

SILENT_INTERVALS = 5
"""A pad that says nothing for so many mean intervals between reports has been let go."""

DEAD_INTERVALS = 2.5
PAUSE_REPORTS, PAUSE_FACTOR, PAUSE_SLACK_S = 400, 1.2, 0.004
"""Sooner, but never before two and a half mean intervals, where nothing at all comes for longer than so many times the
longest time, and a little more for the adapter, that the pad has let pass between two of so many reports, without what
a report itself takes on the line: it is no silence."""


@dataclass(frozen=True, slots=True)
class PadReport:
    """One report of a pad in its own counts.

    `t_first` is when its first byte arrived, `t_recv` when it was read whole (s, monotonic). `batched` says that
    several came in that read, so that `t_first` rests on back-dating alone.
    """

    t_first: float
    t_recv: float
    x_counts: int
    y_counts: int
    pressure: int
    in_use: bool
    batched: bool


class Scaled(Protocol):
    """What makes millimetres of a pad's counts, as the configuration's keys say."""

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


def place_mm(pad: Scaled, counts: float) -> float:
    """How far from the hinge a reading lies: on a straight line, and what the curve adds there. Safe in the loop."""
    straight = pad.zero_mm + pad.sign * counts / pad.counts_per_mm
    curve = pad.corrections_mm
    if not curve:
        return straight
    last = len(curve) - 1
    at = min(max(straight / pad.length_mm, 0.0), 1.0) * last
    before = min(int(at), last - 1)
    return straight + curve[before] + (at - before) * (curve[before + 1] - curve[before])


def straight_mm(pad: Scaled, s_mm: FloatArray) -> FloatArray:
    """What was on the straight line where `place_mm` gave `s_mm` (n,)."""
    if not pad.corrections_mm:
        return s_mm
    line = np.linspace(0.0, pad.length_mm, len(pad.corrections_mm))
    curve = np.array(pad.corrections_mm)
    return np.asarray(s_mm - np.interp(s_mm, line + curve, curve))


class HostLine(Protocol):
    """What a pad's driver writes to."""

    def write(self, data: bytes) -> None:
        """Send `data`, or drop and count it."""


class PadDriver(Protocol):
    """One pad: bytes in, events out, and what is known of it. Pure but for `port`, what it opens; safe in the loop."""

    is_open: bool

    @property
    def touching(self) -> bool:
        """Whether the object touches the pad, as far as is known."""

    @property
    def parted(self) -> Literal["lifted", "silent"] | None:
        """How the last touch ended, None while touching or before any touch."""

    @property
    def starting(self) -> bool:
        """Whether its start-up is under way."""

    @property
    def complaint(self) -> str | None:
        """Why it may be that no report has come, as far as the pad's line tells; None when nothing is wrong with it."""

    def port(self) -> DevicePort:
        """What the pad is behind, shut."""

    def opened(self, t: float) -> None:
        """The port has been opened at `t` (s)."""

    def lost(self, t: float) -> list[PadLift]:
        """The port has gone at `t` (s)."""

    def tend(self, port: HostLine, t: float) -> None:
        """Do at the open port at `t` (s) what a start-up wants, and ask a pad that wants to be asked; once a tick."""

    def feed(self, data: bytes, t: float) -> list[PadSample | PadLift]:
        """The events in the bytes read at `t` (s)."""

    def poll(self, t: float, turning_rad_s: float = 0.0) -> Sequence[PadSample | PadLift]:
        """What silence tells of at `t` (s): a lift-off, or that the contact stays where it is; once a tick.

        turning_rad_s: how fast the faster palm turns: no contact stays where it is for long on a palm that turns.
        """

    def reports(self, data: bytes, t: float) -> Sequence[PadReport]:
        """The reports in the bytes read at `t` (s), uncalibrated: instead of `feed`, for bring-up and calibration."""

    def view(self, t: float) -> PadView:
        """What is to be told of the pad at `t` (s)."""

    def health(self, look: bool) -> Iterator[str]:
        """The conditions of the fault table that hold, without the pad's name; with `look` counters are judged anew."""

    def evidence(self, condition: str, t: float) -> str:
        """What speaks for a condition at `t` (s), without the pad's name: which byte, age, limit. May be empty."""

    def counts(self) -> dict[str, int]:
        """What has passed since the start, by cause."""


PadFactory = Callable[[int, Any], PadDriver]
"""Takes the pad's number and its kind's configuration."""


def make_pad(number: int, config: PadConfig) -> PadDriver:
    """The driver of a configured pad."""
    factory: PadFactory = importlib.import_module(f"palmd.devices.pads.{config.kind}").DRIVER
    return factory(number, config)


@dataclass(frozen=True, slots=True)
class PadRemark:
    """What the kind of a pad says of its device: of what it speaks, how that stands, what mends it.

    `key` is the configuration's key that it concerns.
    """

    what: str
    verdict: Literal["ok", "missing", "off"]
    says: str
    key: str = "port"
    mend: str = ""


@dataclass(frozen=True, slots=True)
class InspectedPad:
    """A pad's configuration with what its device reports where that was left out, and what is to be said of it."""

    config: PadConfig
    remarks: tuple[PadRemark, ...] = ()


def inspect_pad(config: PadConfig) -> InspectedPad:
    """What a pad's kind finds out without taking the device from anybody; not for the loop, for it may open it."""
    inspect = getattr(importlib.import_module(f"palmd.devices.pads.{config.kind}"), "inspect", None)
    found: InspectedPad = InspectedPad(config) if inspect is None else inspect(config)
    return found


def pad_counted(kind: str) -> tuple[str, str, str] | None:
    """How a kind's counters call the bytes that came, the reports in them, and the bytes in none; None without any."""
    counted: tuple[str, str, str] | None = getattr(
        importlib.import_module(f"palmd.devices.pads.{kind}"), "COUNTED", None
    )
    return counted


def pad_note(kind: str) -> str:
    """What one must know of a kind of pads before choosing it; mostly nothing."""
    note: str = getattr(importlib.import_module(f"palmd.devices.pads.{kind}"), "NOTE", "")
    return note


class TouchTracker:
    """Tells when the object has left a pad that reports while it is touched: a report says so, or silence does.

    Silence of five mean intervals between reports; or a line that is dead for clearly longer than the pad ever paused
    within its last reports, once there are enough of them: damaged reports still bring bytes, and get the patience of
    five, unless they can be no pad's at all. The mean is a running one, held between one report time (the line
    cannot do better) and 2.5, so that a mute pad is noticed within 100 ms at 9600 baud whatever came before.
    """

    GAIN = 1 / 16
    START_REPORTS = 1.6
    MAX_REPORTS = 2.5

    def __init__(self, pad: int, report_s: float, sending_s: float = 0.0) -> None:
        """`report_s` is the time from one report to the next, at least, of which `sending_s` on the line (s)."""
        self._pad: int = pad
        self._shortest_s = report_s
        self._longest_s = self.MAX_REPORTS * report_s
        self._mean_s = self.START_REPORTS * report_s
        self._sending_s = sending_s
        self._t_first = 0.0
        self._t_recv = 0.0
        self._t_byte = -math.inf
        self._pauses = (math.inf, 0.0)  # the longest of the last whole lot of reports, and of the present one (s)
        self._reports = 0
        self.touching = False

    @property
    def mean_interval_s(self) -> float:
        """The running mean of the time between reports."""
        return self._mean_s

    @property
    def patience_s(self) -> float:
        """How long a line may bring nothing at all while the pad is touched."""
        shown_s = max(DEAD_INTERVALS * self._mean_s, PAUSE_FACTOR * max(self._pauses) + PAUSE_SLACK_S) - self._sending_s
        return min(SILENT_INTERVALS * self._mean_s, shown_s)

    def heard(self, t: float) -> None:
        """Any bytes were read at `t` (s)."""
        self._t_byte = t

    def report(self, report: PadReport) -> PadLift | None:
        """Take a report, in the order received; return the lift-off it reports, if any."""
        if not report.in_use:
            return self._lift(report.t_first)
        if self.touching:
            self._note_pause(report.t_recv - self._t_recv)
            mean_s = self._mean_s + self.GAIN * (report.t_first - self._t_first - self._mean_s)
            self._mean_s = min(max(mean_s, self._shortest_s), self._longest_s)
        self.touching = True
        self._t_first, self._t_recv = report.t_first, report.t_recv
        return None

    def poll(self, t: float, *, gone: bool = False) -> PadLift | None:
        """Return the lift-off if the pad has been silent for too long at time `t` (s), or is known to be gone."""
        if gone:
            return self._lift(t)
        t_silent = self._t_recv + SILENT_INTERVALS * self._mean_s
        t_dead = math.inf if math.isinf(self._t_byte) else self._t_byte + self.patience_s
        first = min(t_silent, t_dead)
        return self._lift(first) if t >= first else None

    def _note_pause(self, pause_s: float) -> None:
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
