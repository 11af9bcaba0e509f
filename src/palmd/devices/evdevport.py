"""A device of the kernel's input layer as something to read: opened for oneself, stamped by the monotonic clock.

Where the path is no input device (a pipe, a pseudo-terminal) the same records are read from it as they come.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import struct
import time

from palmd.devices import evdev
from palmd.devices.evdev import RECORD, Record
from palmd.devices.port import ReopenedPort

READ_RECORDS = 64
CLOCK, GRAB = 0x400445A0, 0x40044590
_ABS_INFO = struct.Struct("<6i")  # value, least, most, fuzz, flat, resolution
_KEY_BYTES = 96
_KEYS = 0x80000000 | _KEY_BYTES << 16 | 0x4518
_AXES = (evdev.ABS_X, evdev.ABS_Y, evdev.ABS_PRESSURE)
_SLOT_AXES = (evdev.MT_TRACKING_ID, evdev.MT_X, evdev.MT_Y, evdev.MT_PRESSURE)


class EvdevPort(ReopenedPort):
    """See `DevicePort`: whole records are read where it is a device. Every call returns at once."""

    read_bytes = READ_RECORDS * RECORD.size

    def __init__(self, name: str, path: str, retry_s: float = 0.5) -> None:
        """As any `ReopenedPort`."""
        super().__init__(name, path, retry_s)
        self._is_device = False

    def _open(self) -> int:
        fd, self._is_device = _open(self.path)
        return fd

    def _explain(self, failure: Exception) -> str:
        return _explain(self.path, failure)

    def write(self, data: bytes) -> None:
        """A pad is told nothing."""
        self.counters.bytes_dropped += len(data)

    def look(self) -> None:
        """The kernel counts nothing here."""

    def snapshot(self) -> bytes:
        """The device's present state as records of one frame; empty where it cannot be asked."""
        if self._fd is None or not self._is_device:
            return b""
        try:
            records = [*_slots(self._fd), *_single(self._fd), (evdev.EV_SYN, evdev.SYN_REPORT, 0)]
        except OSError:  # unplugged meanwhile: the next read says so
            return b""
        return evdev.encode(records, time.monotonic())

    def resolution(self, axis: int) -> tuple[int, int, int] | None:
        """Least and largest value of an axis, and its units for each mm (0: not told); None where it is not told."""
        if self._fd is None or not self._is_device:
            return None
        info = _abs_info(self._fd, axis)
        return None if info is None else (info[1], info[2], info[5])


def _open(path: str) -> tuple[int, bool]:
    """The descriptor, and whether it is an input device."""
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        fcntl.ioctl(fd, CLOCK, struct.pack("<i", time.CLOCK_MONOTONIC))
    except OSError as failure:
        if failure.errno in (errno.ENOTTY, errno.EINVAL):
            return fd, False
        os.close(fd)
        raise
    try:
        fcntl.ioctl(fd, GRAB, 1)
    except OSError:
        os.close(fd)
        raise
    return fd, True


def _single(fd: int) -> list[Record]:
    keys = bytearray(_KEY_BYTES)
    fcntl.ioctl(fd, _KEYS, keys)
    touched = keys[evdev.BTN_TOUCH // 8] >> evdev.BTN_TOUCH % 8 & 1
    axes = [(code, _abs_info(fd, code)) for code in _AXES]
    return [
        (evdev.EV_KEY, evdev.BTN_TOUCH, touched),
        *((evdev.EV_ABS, code, info[0]) for code, info in axes if info is not None),
    ]


def _slots(fd: int) -> list[Record]:
    info = _abs_info(fd, evdev.MT_SLOT)
    if info is None:
        return []
    count = min(info[2] + 1, evdev.MANY_SLOTS)
    form = struct.Struct(f"<{count + 1}i")
    found: list[Record] = []
    values = {}
    for code in _SLOT_AXES:
        buffer = bytearray(form.pack(code, *(0,) * count))
        with contextlib.suppress(OSError):
            fcntl.ioctl(fd, 0x80000000 | form.size << 16 | 0x450A, buffer)
            values[code] = form.unpack(buffer)[1:]
    for slot in range(count):
        found.append((evdev.EV_ABS, evdev.MT_SLOT, slot))
        found += [(evdev.EV_ABS, code, each[slot]) for code, each in values.items()]
    found.append((evdev.EV_ABS, evdev.MT_SLOT, info[0]))
    return found


def _abs_info(fd: int, axis: int) -> tuple[int, ...] | None:
    buffer = bytearray(_ABS_INFO.size)
    try:
        fcntl.ioctl(fd, 0x80184540 + axis, buffer)
    except OSError:
        return None
    return _ABS_INFO.unpack(buffer)


def _explain(path: str, failure: Exception) -> str:
    match getattr(failure, "errno", None):
        case errno.ENOENT:
            return f"no such device {path}: check the plug and the configured name (ls /dev/input/by-path)"
        case errno.EACCES | errno.EPERM:
            return f"no permission to open {path}: add this user to the group input (sudo usermod -aG input $USER)"
        case errno.EBUSY:
            return f"{path} is grabbed by another program: end it (sudo fuser -v {path} names it)"
        case errno.ENODEV | errno.ENXIO | errno.EIO:
            return f"nothing is connected behind {path}: check the plug"
        case _:
            return f"{path} cannot be read as an input device: {getattr(failure, 'strerror', None) or failure}"
