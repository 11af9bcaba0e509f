"""`kind: evdev`: any touch device that the kernel's input layer knows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

from palmd.config.pads import EvdevConfig
from palmd.devices.evdev import EvdevReader
from palmd.devices.evdevport import LOOK, EvdevPort, asked
from palmd.devices.health import Limits, Shares, last_report
from palmd.devices.pad import MARGIN_MM, HostLine, InspectedPad, PadFactory, PadRemark, PadReport, place_mm
from palmd.devices.touchdevice import unsupported
from palmd.devices.touchunits import Units, unit_remarks, with_reported_units
from palmd.events import PadLift, PadSample
from palmd.messages import PadView

STILL_S = 0.030
"""A contact that has said nothing for so long is where it was: it is said again, as often as this."""

DOUBTED_S = 0.030
"""A device that does not tell its state within so long, after the kernel has dropped what it said, has gone."""

STUCK_RAD, STUCK_S = math.radians(6.0), 0.15
"""A device that has said nothing for so long, while the palms turned by so much, has fallen silent."""

JUDGED: Limits = {"out-of-range": (0.2, 10, "frames"), "foreign-clock": (0.2, 10, "frames")}


class Evdev:
    """One input device; see `PadDriver`."""

    starting = False

    def __init__(self, number: int, config: EvdevConfig) -> None:
        """Nothing is opened yet."""
        self.is_open = False
        self.touching = False
        self.parted: Literal["lifted", "silent"] | None = None
        self._number, self._config = number, config
        self._reader = EvdevReader(needed=(config.axis,))
        self._port: EvdevPort | None = None
        self._in_use = Units(config, None)
        self._latest: PadReport | None = None
        self._sample: PadSample | None = None
        self._t_polled = self._t_doubted = math.inf
        self._turned = 0.0  # by how much the palms have since the device last spoke (rad)
        self._state: list[PadReport] = []  # what the device's state said, when it was last read
        self._shares = Shares(JUDGED)

    @property
    def complaint(self) -> str | None:
        """That it sends events without a touch, or that its units are not known."""
        counters = self._reader.counters
        if self._in_use.missing is not None:
            return self._in_use.missing
        if counters.not_touching and self._latest is None:
            return (
                f"{counters.not_touching} frames with contacts that do not touch: they hover, are palms of hands, or"
                " the device keeps BTN_TOUCH at 0"
            )
        if counters.frames and self._latest is None:
            return f"{counters.frames} events, but no touch among them: is {self._config.port} the touch device?"
        return None

    def port(self) -> EvdevPort:
        """The input device."""
        self._port = EvdevPort(f"pad{self._number}", self._config.port, axis=self._config.axis)
        return self._port

    def opened(self, t: float) -> None:  # noqa: ARG002
        """The device has been opened; its state is read next, for something may touch it already."""
        self.is_open = True
        self._reader.forget()
        device = None if self._port is None else self._port.device
        self._in_use = Units(self._config, device)
        self._reader.has_state = device is not None
        if device is not None:
            self._reader.protocol, self._reader.bounding_box = device.protocol, device.reports_boxes

    def lost(self, t: float) -> list[PadLift]:
        """The device has gone at `t` (s)."""
        self.is_open = False
        self._reader.reset()
        return self._part(t, "silent")

    def tend(self, port: HostLine, t: float) -> None:  # noqa: ARG002
        """Read the device's state where it is not known: when it has been opened, and after each overflow."""
        if not (self._reader.wants_state and isinstance(port, EvdevPort)):
            return
        self._reader.wants_state = False
        if state := port.snapshot():
            self._state += self._reader.restore(state)

    def feed(self, data: bytes, t: float) -> list[PadSample | PadLift]:
        """Take what was read at `t` (s)."""
        dropped = self._reader.counters.dropped
        reports = self._reader.feed(data, t)
        if self._reader.counters.dropped > dropped and not reports:
            self._t_doubted, self._sample = t, None  # a lift-off may be lost: the device's state is read
        if data:
            self._turned = 0.0
        return self._events(reports)

    def _events(self, reports: list[PadReport]) -> list[PadSample | PadLift]:
        events: list[PadSample | PadLift] = []
        for report in reports:
            self._latest, self._t_doubted = report, math.inf
            if not report.in_use:
                events += self._part(report.t_first, "lifted")
            elif (sample := self._calibrated(report)) is not None:
                self.touching, self.parted, self._sample = True, None, sample
                events.append(sample)
        return events

    def poll(self, t: float, turning_rad_s: float = 0.0) -> list[PadSample | PadLift]:
        """What the device said of its state, or that the contact is where it was at `t` (s). Once a tick."""
        self._turned += turning_rad_s * max(t - self._t_polled, 0.0)
        self._t_polled = t
        if self._state:
            state, self._state = self._state, []
            return self._events(state)
        if t - self._t_doubted > DOUBTED_S:
            self._t_doubted = math.inf
            return [*self._part(t, "silent")]
        last = self._sample
        if not self.touching or last is None or t - last.t_sample < STILL_S:
            return []
        if self._latest is not None and self._turned > STUCK_RAD and t - self._latest.t_first > STUCK_S:
            return [*self._part(t, "silent")]
        self._sample = PadSample(t, last.pad, last.s, last.force)
        return [self._sample]

    def reports(self, data: bytes, t: float) -> list[PadReport]:
        """The reports in what was read at `t` (s), after those of the state that was read before."""
        state, self._state = self._state, []
        return [*state, *self._reader.feed(data, t)]

    def view(self, t: float) -> PadView:
        """What is to be told of the pad at `t` (s)."""
        latest, sample = self._latest, self._sample
        if latest is None:
            return PadView()
        s = sample.s if sample is not None and self.touching else math.nan
        return PadView(s, latest.pressure, t - latest.t_first, self.touching, latest.batched)

    def health(self, look: bool) -> Iterator[str]:
        """The conditions that hold, without the pad's name."""
        if look:
            counters = self._reader.counters
            self._shares.look(
                {
                    "out-of-range": (counters.frames, counters.out_of_range),
                    "foreign-clock": (counters.frames, counters.foreign_clock),
                }
            )
        yield from self._shares

    def evidence(self, condition: str, t: float) -> str:
        """What speaks for a condition at `t` (s)."""
        last = last_report(None if self._latest is None else self._latest.t_first, t)
        match condition:
            case "silent":
                if self._turned > STUCK_RAD:
                    return f"{last}, and the palms have turned by {math.degrees(self._turned):.0f}° since"
                return f"{last}; then the device went, or the kernel dropped what it had said"
            case "lifted":
                return f"{last} and says so"
            case "untouched":
                return last
        return self._shares.told(condition)

    def counts(self) -> dict[str, int]:
        """What has passed since the start, by cause."""
        return self._reader.counters.as_dict()

    def _calibrated(self, report: PadReport) -> PadSample | None:
        config, units = self._config, self._in_use
        if units.missing is not None:
            return None
        counts = report.x_counts if config.axis == "x" else report.y_counts
        s_mm = place_mm(units, counts)
        if not 0.0 < s_mm <= config.length_mm + MARGIN_MM:
            self._reader.counters.out_of_range += 1
            return None
        gain = units.newtons_per_count
        force = report.pressure * gain if config.pressure and gain is not None else None
        return PadSample(report.t_first, self._number, s_mm * 1e-3, force)

    def _part(self, t: float, how: Literal["lifted", "silent"]) -> list[PadLift]:
        if not self.touching:
            return []
        self.touching, self._sample, self.parted = False, None, how
        return [PadLift(t, self._number)]


NOTE = (
    "a capacitive pad (touchpads, touch screens) feels no plastic, wood or ungrounded metal: cover the object with"
    " conductive foil or tape and ground it, or use a pad that feels force"
)
"""Nothing that a device reports says whether it is capacitive."""


def inspect(config: EvdevConfig) -> InspectedPad:
    """What the kernel says of the device, which is opened for that but not grabbed. See `inspect_pad`."""
    try:
        device = asked(config.port)
    except OSError:  # not there, or not for this user: its port says so
        device = None
    note = PadRemark("senses", "ok", NOTE)
    if device is None:
        return InspectedPad(config, (note,))
    if reason := unsupported(device, config.axis):
        remark = PadRemark("device", "missing", f"{config.port} ({device.name}) {reason}", mend=LOOK)
        return InspectedPad(config, (remark,))
    pressed = ", a pressure pad" if device.is_pressure_pad else ""
    found = PadRemark("device", "ok", f"{device.name}, {device.protocol}{pressed}")
    return InspectedPad(with_reported_units(config, device), (found, *unit_remarks(config, device), note))


DRIVER: PadFactory = Evdev
