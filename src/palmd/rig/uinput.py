"""An emulated touch device that the kernel provides: made with `/dev/uinput`, opened like any input device (I/O)."""

from __future__ import annotations

import contextlib
import fcntl
import os
import struct
from pathlib import Path

from palmd.devices import evdev
from palmd.rig.line import EmulatedLine
from palmd.rig.padkinds.evdev import POSITION_LIMIT, PRESSURE_MAX

UINPUT = Path("/dev/uinput")
SYSFS, DEVICES = Path("/sys/devices/virtual/input"), Path("/dev/input")
NAME = "palmd emulated pad"
RANGES = {
    evdev.ABS_X: (-POSITION_LIMIT, POSITION_LIMIT),
    evdev.ABS_Y: (-POSITION_LIMIT, POSITION_LIMIT),
    evdev.ABS_PRESSURE: (0, PRESSURE_MAX),
}

_CREATE, _DESTROY = 0x5501, 0x5502
_SETUP, _ABS_SETUP = 0x405C5503, 0x401C5504
_EVENT_BIT, _KEY_BIT, _AXIS_BIT = 0x40045564, 0x40045565, 0x40045567
_SYSNAME_BYTES = 64
_SYSNAME = 0x8000552C | _SYSNAME_BYTES << 16
_SETUP_FORM = struct.Struct("<4H80sI")  # bus, vendor, product, version, name, force feedback
_ABS_FORM = struct.Struct("<Hxx6i")  # axis; value, least, most, fuzz, flat, resolution
_VIRTUAL = 0x06  # bus type


def available() -> bool:
    """Whether input devices can be created here."""
    return os.access(UINPUT, os.W_OK)


class UinputLine(EmulatedLine):
    """An input device under a fixed path: a link to the device while it exists.

    The kernel sets the time stamps itself, drops events that change nothing, and rejects `SYN_DROPPED` from outside.
    """

    def plug(self) -> None:
        """Create the device; does nothing if it exists. Raises OSError if the kernel refuses."""
        if self._fd is not None:
            return
        fd = os.open(UINPUT, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            _set_up(fd)
            fcntl.ioctl(fd, _CREATE)
            device = DEVICES / _event_name(fd)
        except BaseException:
            os.close(fd)
            raise
        self._fd = fd
        self._link_to(device)

    def unplug(self) -> None:
        if self._fd is None:
            return
        self.path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            fcntl.ioctl(self._fd, _DESTROY)
        os.close(self._fd)
        self._fd = None

    def read(self, events: int) -> tuple[bytes, bool]:  # noqa: ARG002
        """Nothing: an input device receives no data, and is not notified when it is opened."""
        return b"", False

    def _send(self, data: bytes) -> int:
        return os.write(self._fd, data) if self._fd is not None else 0


def _set_up(fd: int) -> None:
    """Configure a touch device with one contact."""
    for kind in (evdev.EV_SYN, evdev.EV_KEY, evdev.EV_ABS):
        fcntl.ioctl(fd, _EVENT_BIT, kind)
    fcntl.ioctl(fd, _KEY_BIT, evdev.BTN_TOUCH)
    for axis, (low, high) in RANGES.items():
        fcntl.ioctl(fd, _AXIS_BIT, axis)
        fcntl.ioctl(fd, _ABS_SETUP, _ABS_FORM.pack(axis, 0, low, high, 0, 0, 0))
    fcntl.ioctl(fd, _SETUP, _SETUP_FORM.pack(_VIRTUAL, 0, 0, 1, NAME.encode(), 0))


def _event_name(fd: int) -> str:
    """The device's name in /dev/input."""
    buffer = bytearray(_SYSNAME_BYTES)
    fcntl.ioctl(fd, _SYSNAME, buffer)
    folder = SYSFS / buffer.rstrip(b"\0").decode()
    for entry in sorted(folder.glob("event*")):
        return entry.name
    raise OSError(f"the kernel has made no event device for {folder.name}")
