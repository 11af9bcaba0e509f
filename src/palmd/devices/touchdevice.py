"""Description of an input device by the kernel: whether palmd supports it, and its units. Pure.

    position      resolution in units/mm
    pressure      resolution in units/gram, 0 where the pressure is no force

Source: Linux include/uapi/linux/input.h and input-event-codes.h, Documentation/input/event-codes.rst,
drivers/hid/hid-input.c (hidinput_calc_abs_res).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from palmd.devices import evdev
from palmd.devices.evdev import Coordinate, Protocol

SEMI_MT, POINTING_STICK, ACCELEROMETER, PRESSUREPAD = 0x03, 0x05, 0x06, 0x07
"""INPUT_PROP_…"""

REL_X = 0x00
BTN_TOOL_PEN, BTN_TOOL_FINGER = 0x140, 0x145
KEY_A = 0x1E
NEWTONS_PER_GRAM = 9.80665e-3

_MT_PLACEHOLDER = evdev.MT_SLOT - 1  # also present in gamepads that number their axes consecutively


class AxisRange(NamedTuple):
    """Range of one axis: smallest and largest value, and resolution (1/mm or 1/gram; 0: unknown)."""

    minimum: int
    maximum: int
    resolution: int


@dataclass(frozen=True, slots=True)
class TouchDevice:
    """An input device as its driver describes it."""

    name: str
    axes: Mapping[int, AxisRange]
    keys: frozenset[int]
    properties: frozenset[int] = frozenset()
    relative_axes: frozenset[int] = frozenset()
    """Relative axes, as of a mouse."""

    @property
    def protocol(self) -> Protocol | None:
        """Protocol of its contacts; None if it reports none."""
        if evdev.MT_SLOT in self.axes and _MT_PLACEHOLDER not in self.axes:
            return Protocol.SLOTS if {evdev.MT_X, evdev.MT_Y} & self.axes.keys() else None
        if _MT_PLACEHOLDER not in self.axes and {evdev.MT_X, evdev.MT_Y} & self.axes.keys():
            return Protocol.PACKETS
        if evdev.BTN_TOUCH in self.keys and {evdev.ABS_X, evdev.ABS_Y} & self.axes.keys():
            return Protocol.SINGLE
        return None

    @property
    def reports_boxes(self) -> bool:
        """Whether only the bounding box of two contacts is reported."""
        return SEMI_MT in self.properties

    @property
    def is_pressure_pad(self) -> bool:
        """Whether it measures the contact force."""
        return PRESSUREPAD in self.properties or self.newtons_per_count is not None

    def axis(self, coordinate: Coordinate) -> AxisRange | None:
        """Range of a coordinate in the device's protocol; None if there is none."""
        single, several = (evdev.ABS_X, evdev.MT_X) if coordinate == "x" else (evdev.ABS_Y, evdev.MT_Y)
        return self.axes.get(single if self.protocol is Protocol.SINGLE else several)

    def counts_per_mm(self, coordinate: Coordinate) -> float | None:
        """Scale of a coordinate (1/mm); None if the driver does not report it."""
        axis = self.axis(coordinate)
        return float(axis.resolution) if axis is not None and axis.resolution > 0 else None

    @property
    def newtons_per_count(self) -> float | None:
        """Force (N) of one count of pressure; None if the driver does not report it."""
        several = self.protocol is not Protocol.SINGLE and evdev.MT_PRESSURE in self.axes
        axis = self.axes.get(evdev.MT_PRESSURE if several else evdev.ABS_PRESSURE)
        return NEWTONS_PER_GRAM / axis.resolution if axis is not None and axis.resolution > 0 else None


def unsupported(device: TouchDevice, coordinate: Coordinate) -> str | None:
    """Return why a device cannot be used as a pad, None if it can."""
    if device.protocol is None or {POINTING_STICK, ACCELEROMETER} & device.properties:
        return f"is {_kind(device)} and no touch device"
    if BTN_TOOL_PEN in device.keys and BTN_TOOL_FINGER not in device.keys and device.protocol is Protocol.SINGLE:
        return "is a pen tablet: it senses its pen only"
    if device.protocol is Protocol.SLOTS and evdev.MT_TRACKING_ID not in device.axes:
        return "reports contacts in slots without tracking ids (ABS_MT_TRACKING_ID), which palmd does not support"
    if device.axis(coordinate) is None:
        return f"has no axis {coordinate}: configure the pad's other axis"
    return None


def _kind(device: TouchDevice) -> str:
    if POINTING_STICK in device.properties:
        return "a pointing stick"
    if ACCELEROMETER in device.properties:
        return "an accelerometer"
    if REL_X in device.relative_axes:
        return "a mouse"
    if KEY_A in device.keys:
        return "a keyboard"
    if {evdev.ABS_X, evdev.ABS_Y} & device.axes.keys():
        return "a pointer, joystick or gamepad"
    return "something else"
