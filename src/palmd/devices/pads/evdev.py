"""`kind: evdev`: any touch device of the kernel's input layer."""

from __future__ import annotations

import math
from collections.abc import Mapping

from palmd.config.pads import EvdevConfig
from palmd.devices.evdev import EvdevReader
from palmd.devices.evdevport import LIST_COMMAND, EvdevPort, query_device
from palmd.devices.health import Limits
from palmd.devices.pad import (
    HostLine,
    InspectedPad,
    PadDriver,
    PadFactory,
    PadRemark,
    PadReport,
    TouchEnd,
    position_mm,
)
from palmd.devices.touchdevice import unsupported
from palmd.devices.touchunits import Units, unit_remarks, with_reported_units
from palmd.events import PadLift, PadSample

REPEAT_S = 0.030
"""A contact at rest is not reported; after this silence (s) its last sample is repeated, with this period."""

STATE_TIMEOUT_S = 0.030
"""Time (s) after an overflow of the kernel's buffer within which the device's state must be read; else it is lost."""

SILENT_TURN_RAD, SILENT_TURN_S = math.radians(6.0), 0.15
"""A device that is silent for this time (s) while the palms turn by this angle (rad) is considered silent."""

HEALTH_LIMITS: Limits = {"out-of-range": (0.2, 10, "frames"), "foreign-clock": (0.2, 10, "frames")}


class Evdev(PadDriver):
    """`PadDriver` of one input device."""

    def __init__(self, number: int, config: EvdevConfig) -> None:
        super().__init__(number, HEALTH_LIMITS)
        self._config = config
        self._touching = False
        self._reader = EvdevReader(needed=(config.axis,))
        self._port: EvdevPort | None = None
        self._units = Units(config, None)
        self._t_polled = self._t_overflow = math.inf
        self._turned = 0.0  # turn of the palms since the device's last report (rad)
        self._state_reports: list[PadReport] = []  # reports from the device's state, when it was last read

    @property
    def touching(self) -> bool:
        return self._touching

    @property
    def diagnosis(self) -> str | None:
        """The units are unknown, or there are events without a touch."""
        counters = self._reader.counters
        if self._units.missing is not None:
            return self._units.missing
        if counters.not_touching and self._latest is None:
            return (
                f"{counters.not_touching} frames have contacts that do not touch: they hover, are palms of hands, or"
                " the device keeps BTN_TOUCH at 0"
            )
        if counters.frames and self._latest is None:
            return f"{counters.frames} events, but no touch among them: is {self._config.port} the touch device?"
        return None

    def port(self) -> EvdevPort:
        self._port = EvdevPort(f"pad{self._number}", self._config.port, axis=self._config.axis)
        return self._port

    def opened(self, t: float) -> None:
        """Handle the opening of the device; its state is read next, since it may be touched already."""
        super().opened(t)
        self._reader.forget()
        device = None if self._port is None else self._port.device
        self._units = Units(self._config, device)
        self._reader.has_state = device is not None
        if device is not None:
            self._reader.protocol, self._reader.bounding_box = device.protocol, device.reports_boxes

    def lost(self, t: float) -> list[PadLift]:
        """Handle the loss of the device at `t` (s)."""
        self.is_open = False
        self._reader.reset()
        return self._end_touch(t, "silent")

    def tend(self, port: HostLine, t: float) -> None:  # noqa: ARG002
        """Read the device's state if it is unknown: after opening and after each overflow."""
        if not (self._reader.wants_state and isinstance(port, EvdevPort)):
            return
        self._reader.wants_state = False
        if state := port.snapshot():
            self._state_reports += self._reader.restore(state)

    def feed(self, data: bytes, t: float) -> list[PadSample | PadLift]:
        dropped = self._reader.counters.dropped
        reports = self._reader.feed(data, t)
        if self._reader.counters.dropped > dropped and not reports:
            self._t_overflow, self._sample = t, None  # a lift-off may be lost: read the device's state
        if data:
            self._turned = 0.0
        return self._events(reports)

    def _events(self, reports: list[PadReport]) -> list[PadSample | PadLift]:
        events: list[PadSample | PadLift] = []
        for report in reports:
            self._latest, self._t_overflow = report, math.inf
            if not report.in_use:
                events += self._end_touch(report.t_first, "lifted")
            elif (sample := self._calibrated(report)) is not None:
                self._touching, self.touch_end, self._sample = True, None, sample
                events.append(sample)
        return events

    def poll(self, t: float, turning_rad_s: float = 0.0) -> list[PadSample | PadLift]:
        """Return the events in the device's state, or repeat the last sample at `t` (s). Once a tick."""
        self._turned += turning_rad_s * max(t - self._t_polled, 0.0)
        self._t_polled = t
        if self._state_reports:
            state, self._state_reports = self._state_reports, []
            return self._events(state)
        if t - self._t_overflow > STATE_TIMEOUT_S:
            self._t_overflow = math.inf
            return [*self._end_touch(t, "silent")]
        last = self._sample
        if not self.touching or last is None or t - last.t_sample < REPEAT_S:
            return []
        if self._latest is not None and self._turned > SILENT_TURN_RAD and t - self._latest.t_first > SILENT_TURN_S:
            return [*self._end_touch(t, "silent")]
        self._sample = PadSample(t, last.pad, last.s, last.force)
        return [self._sample]

    def reports(self, data: bytes, t: float) -> list[PadReport]:
        """Return the reports in the bytes read at `t` (s), after those of the state read before."""
        state, self._state_reports = self._state_reports, []
        return [*state, *self._reader.feed(data, t)]

    def _errors(self) -> Mapping[str, tuple[int, int]]:
        counters = self._reader.counters
        return {
            "out-of-range": (counters.frames, counters.out_of_range),
            "foreign-clock": (counters.frames, counters.foreign_clock),
        }

    def _silence(self, last: str) -> str:
        if self._turned > SILENT_TURN_RAD:
            return f"{last}, and the palms have turned by {math.degrees(self._turned):.0f}° since"
        return f"{last}; then the device was lost, or the kernel dropped its events"

    def counts(self) -> dict[str, int]:
        return self._reader.counters.as_dict()

    def _calibrated(self, report: PadReport) -> PadSample | None:
        config, units = self._config, self._units
        if units.missing is not None:
            return None
        counts = report.x_counts if config.axis == "x" else report.y_counts
        s_mm = position_mm(units, counts)
        if s_mm is None:
            self._reader.counters.out_of_range += 1
            return None
        gain = units.newtons_per_count
        force = report.pressure * gain if config.pressure and gain is not None else None
        return PadSample(report.t_first, self._number, s_mm * 1e-3, force)

    def _end_touch(self, t: float, how: TouchEnd) -> list[PadLift]:
        if not self.touching:
            return []
        self._touching, self._sample, self.touch_end = False, None, how
        return [PadLift(t, self._number)]


NOTE = (
    "a capacitive pad (touchpads, touch screens) does not sense plastic, wood or ungrounded metal: cover the object"
    " with conductive foil or tape and ground it, or use a pad that senses force"
)
"""Shown for every device, since devices do not report whether they are capacitive."""


def inspect(config: EvdevConfig) -> InspectedPad:
    """Inspect the device by the kernel's description; it is opened but not grabbed. See `inspect_pad`."""
    try:
        device = query_device(config.port)
    except OSError:  # missing, or no permission: reported by its port
        device = None
    note = PadRemark("senses", "ok", NOTE)
    if device is None:
        return InspectedPad(config, (note,))
    if reason := unsupported(device, config.axis):
        remark = PadRemark("device", "missing", f"{config.port} ({device.name}) {reason}", fix=LIST_COMMAND)
        return InspectedPad(config, (remark,))
    pressed = ", a pressure pad" if device.is_pressure_pad else ""
    found = PadRemark("device", "ok", f"{device.name}, {device.protocol}{pressed}")
    return InspectedPad(with_reported_units(config, device), (found, *unit_remarks(config, device), note))


DRIVER: PadFactory = Evdev
