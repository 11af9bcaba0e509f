"""An emulated touch device as the kernel's own: made by `/dev/uinput`, opened by the host as any input device (I/O)."""

from __future__ import annotations

import contextlib
import fcntl
import os
import struct
from pathlib import Path

from palmd.devices import evdev
from palmd.rig.padkinds.evdev import FARTHEST, PRESSURE_MAX

UINPUT = Path("/dev/uinput")
SYSFS, DEVICES = Path("/sys/devices/virtual/input"), Path("/dev/input")
NAME = "palmd emulated pad"
RANGES = {
    evdev.ABS_X: (-FARTHEST, FARTHEST),
    evdev.ABS_Y: (-FARTHEST, FARTHEST),
    evdev.ABS_PRESSURE: (0, PRESSURE_MAX),
}

_CREATE, _DESTROY = 0x5501, 0x5502
_SETUP, _ABS_SETUP = 0x405C5503, 0x401C5504
_EVENT_BIT, _KEY_BIT, _AXIS_BIT = 0x40045564, 0x40045565, 0x40045567
_SYSNAME_BYTES = 64
_SYSNAME = 0x8000552C | _SYSNAME_BYTES << 16
_SETUP_FORM = struct.Struct("<4H80sI")  # bus, vendor, product, version, name, force feedback
_ABS_FORM = struct.Struct("<Hxx6i")  # axis; value, least, most, fuzz, flat, resolution
_VIRTUAL = 0x06  # the bus


def available() -> bool:
    """Whether input devices can be made here."""
    return os.access(UINPUT, os.W_OK)


class UinputLine:
    """An input device under a steady name, with the face of a `PtyLine`: a link that points to it as long as it exists.

    The kernel dates what is written itself, drops what says nothing new, and has no `SYN_DROPPED` from outside.
    """

    edges = True

    def __init__(self, link: Path) -> None:
        self.path = link
        self.bytes_sent = self.bytes_lost = self.bytes_heard = 0
        self._fd: int | None = None

    @property
    def plugged(self) -> bool:
        """Whether the device exists at the moment."""
        return self._fd is not None

    @property
    def fileno(self) -> int:
        """The descriptor to poll, −1 while the device does not exist."""
        return -1 if self._fd is None else self._fd

    def plug(self) -> None:
        """Makes the device appear; does nothing if it is there. Raises OSError where the kernel refuses."""
        if self._fd is not None:
            return
        fd = os.open(UINPUT, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            _describe(fd)
            fcntl.ioctl(fd, _CREATE)
            device = DEVICES / _event_of(fd)
        except BaseException:
            os.close(fd)
            raise
        self._fd = fd
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        self.path.symlink_to(device)

    def unplug(self) -> None:
        """Makes the device vanish under the host's hands; does nothing if it is gone."""
        if self._fd is None:
            return
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        with contextlib.suppress(OSError):
            fcntl.ioctl(self._fd, _DESTROY)
        os.close(self._fd)
        self._fd = None

    def read(self, events: int) -> tuple[bytes, bool]:  # noqa: ARG002
        """An input device is told nothing, and does not learn who opens it."""
        return b"", False

    def write(self, data: bytes) -> bytes:
        """Hands records to the kernel; returns those that it took."""
        if not data or self._fd is None:
            self.bytes_lost += len(data)
            return b""
        written = 0
        with contextlib.suppress(OSError):
            written = os.write(self._fd, data)
        self.bytes_sent += written
        self.bytes_lost += len(data) - written
        return data[:written]


def _describe(fd: int) -> None:
    """A touch device with one contact."""
    for kind in (evdev.EV_SYN, evdev.EV_KEY, evdev.EV_ABS):
        fcntl.ioctl(fd, _EVENT_BIT, kind)
    fcntl.ioctl(fd, _KEY_BIT, evdev.BTN_TOUCH)
    for axis, (least, most) in RANGES.items():
        fcntl.ioctl(fd, _AXIS_BIT, axis)
        fcntl.ioctl(fd, _ABS_SETUP, _ABS_FORM.pack(axis, 0, least, most, 0, 0, 0))
    fcntl.ioctl(fd, _SETUP, _SETUP_FORM.pack(_VIRTUAL, 0, 0, 1, NAME.encode(), 0))


def _event_of(fd: int) -> str:
    """The device's name in /dev/input."""
    buffer = bytearray(_SYSNAME_BYTES)
    fcntl.ioctl(fd, _SYSNAME, buffer)
    folder = SYSFS / buffer.rstrip(b"\0").decode()
    for entry in sorted(folder.glob("event*")):
        return entry.name
    raise OSError(f"the kernel has made no event device for {folder.name}")
