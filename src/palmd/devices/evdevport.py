"""A device of the kernel's input layer as something to read: opened for oneself, stamped by the monotonic clock.

Where the path is no input device (a pipe, a pseudo-terminal) the same records are read from it as they come.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import math
import os
import struct
import time

from palmd.devices import evdev
from palmd.devices.evdev import RECORD, Record
from palmd.devices.port import PortCounters

READ_RECORDS = 64
CLOCK, GRAB = 0x400445A0, 0x40044590
_ABS_INFO = struct.Struct("<6i")  # value, least, most, fuzz, flat, resolution
_KEY_BYTES = 96
_KEYS = 0x80000000 | _KEY_BYTES << 16 | 0x4518
_AXES = (evdev.ABS_X, evdev.ABS_Y, evdev.ABS_PRESSURE)
_SLOT_AXES = (evdev.MT_TRACKING_ID, evdev.MT_X, evdev.MT_Y, evdev.MT_PRESSURE)


class EvdevPort:
    """See `DevicePort`. Every call returns at once."""

    def __init__(self, name: str, path: str, retry_s: float = 0.5) -> None:
        """`name` is for messages, `path` the device; links are followed. Nothing is opened yet."""
        self.name, self.path = name, path
        self.error: str | None = f"{name}: {path} has not been opened yet"
        self.counters = PortCounters()
        self._retry_s, self._t_retry = retry_s, -math.inf
        self._fd: int | None = None
        self._is_device = False

    @property
    def is_open(self) -> bool:
        """Whether it can be read."""
        return self._fd is not None

    def fileno(self) -> int:
        """The file descriptor. Raises ValueError if it is not open."""
        if self._fd is None:
            raise ValueError(f"{self.name}: it is not open")
        return self._fd

    def poll_open(self, t: float) -> bool:
        """Open it if it is shut and a try is due at `t` (s, monotonic); return whether it is open."""
        if self._fd is None and t >= self._t_retry:
            self._t_retry = t + self._retry_s
            try:
                self._fd, self._is_device = _open(self.path)
            except OSError as failure:
                self.error = f"{self.name}: {_explain(self.path, failure)}"
            else:
                self.error = None
                self.counters.opens += 1
        return self.is_open

    def read(self) -> bytes:
        """What has come, whole records where it is a device; a device that has gone is shut."""
        if self._fd is None:
            return b""
        try:
            data = os.read(self._fd, READ_RECORDS * RECORD.size)
        except BlockingIOError:
            return b""
        except OSError as failure:
            self._lose(failure)
            return b""
        if not data:
            self._lose(None)
        self.counters.bytes_read += len(data)
        return data

    def write(self, data: bytes) -> None:
        """A pad is told nothing."""
        self.counters.bytes_dropped += len(data)

    def look(self) -> None:
        """The kernel counts nothing here."""

    def close(self) -> None:
        """Shut it."""
        if self._fd is not None:
            with contextlib.suppress(OSError):
                os.close(self._fd)
            self._fd = None
            self.error = f"{self.name}: {self.path} has been closed"

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

    def _lose(self, failure: OSError | None) -> None:
        self.close()
        self.counters.losses += 1
        cause = f" ({failure.strerror})" if failure is not None else ""
        self.error = f"{self.name}: {self.path} was lost{cause}: check the plug; it is tried again by itself"


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


def _explain(path: str, failure: OSError) -> str:
    match failure.errno:
        case errno.ENOENT:
            return f"no such device {path}: check the plug and the configured name (ls /dev/input/by-path)"
        case errno.EACCES | errno.EPERM:
            return f"no permission to open {path}: add this user to the group input (sudo usermod -aG input $USER)"
        case errno.EBUSY:
            return f"{path} is grabbed by another program: end it (sudo fuser -v {path} names it)"
        case errno.ENODEV | errno.ENXIO | errno.EIO:
            return f"nothing is connected behind {path}: check the plug"
        case _:
            return f"{path} cannot be read as an input device: {failure.strerror}"
