"""A device of the kernel's input layer as a `DevicePort`: grabbed, with timestamps of the monotonic clock.

A device that is no touch device is refused before it is grabbed. If the path is no input device (a pipe, a
pseudo-terminal), the same records are read from it unchanged.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import struct
import time

from palmd.devices import evdev
from palmd.devices.evdev import RECORD, Coordinate, Protocol, Record
from palmd.devices.port import ReopenedPort
from palmd.devices.touchdevice import AxisRange, TouchDevice, unsupported

READ_RECORDS = 64
CLOCK, GRAB = 0x400445A0, 0x40044590
STATE_TRIES = 4
LIST_COMMAND = "ls -l /dev/input/by-path"
_ABS_INFO = struct.Struct("<6i")  # value, least, most, fuzz, flat, resolution
_KEY_BYTES, _AXIS_BYTES, _REL_BYTES, _PROPERTY_BYTES, _NAME_BYTES = 96, 8, 2, 4, 256
_KEYS = 0x80000000 | _KEY_BYTES << 16 | 0x4518
_HAS_KEYS = 0x80000000 | _KEY_BYTES << 16 | 0x4521
_HAS_MOVES = 0x80000000 | _REL_BYTES << 16 | 0x4522
_HAS_AXES = 0x80000000 | _AXIS_BYTES << 16 | 0x4523
_PROPERTIES = 0x80000000 | _PROPERTY_BYTES << 16 | 0x4509
_NAME = 0x80000000 | _NAME_BYTES << 16 | 0x4506
_NO_DEVICE = (errno.ENOTTY, errno.EINVAL)
_AXES = (evdev.ABS_X, evdev.ABS_Y, evdev.ABS_PRESSURE, evdev.ABS_DISTANCE)
_SLOT_AXES = (
    evdev.MT_TRACKING_ID, evdev.MT_X, evdev.MT_Y, evdev.MT_PRESSURE, evdev.MT_DISTANCE, evdev.MT_TOOL_TYPE,
)  # fmt: skip


class UnsupportedDeviceError(ValueError):
    """An input device that is no pad; the text has device, reason and what to do."""


class EvdevPort(ReopenedPort):
    """`DevicePort` of an input device, which is read in complete records. Every call returns at once."""

    read_bytes = READ_RECORDS * RECORD.size

    def __init__(self, name: str, path: str, axis: Coordinate = "x") -> None:
        """See `ReopenedPort`; the device must have `axis`."""
        super().__init__(name, path)
        self._axis = axis
        self.device: TouchDevice | None = None
        """The kernel's description; None while it is closed, and if it is no input device."""

    def _open(self) -> int:
        self.device = None
        fd = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
        try:
            self.device = describe_device(fd)
            if self.device is not None:
                if (reason := unsupported(self.device, self._axis)) is not None:
                    text = f"{self.path} ({self.device.name}) {reason}: {LIST_COMMAND} shows the devices"
                    raise UnsupportedDeviceError(text)
                fcntl.ioctl(fd, CLOCK, struct.pack("<i", time.CLOCK_MONOTONIC))
                fcntl.ioctl(fd, GRAB, 1)
        except BaseException:
            self.device = None
            os.close(fd)
            raise
        return fd

    def _explain(self, failure: Exception) -> str:
        return _explain(self.path, failure)

    def write(self, data: bytes) -> None:
        """Drop and count `data`: a pad accepts none."""
        self.counters.bytes_dropped += len(data)

    def update_counters(self) -> None:
        """Do nothing: the kernel has no counters for input devices."""

    def snapshot(self) -> bytes:
        """Return the device's current state as the records of one frame; empty if it cannot be read.

        Pending records are older and are discarded. If records arrive meanwhile, the state is read again, so that no
        older record is read after the state.
        """
        if self._fd is None or self.device is None:
            return b""
        try:
            for _ in range(STATE_TRIES):
                self._discard_pending()
                state = (*_slots(self._fd, self.device), *_single(self._fd, self.device))
                records = [*state, (evdev.EV_SYN, evdev.SYN_REPORT, 0)]
                if not select.select((self._fd,), (), (), 0)[0]:
                    break
        except OSError:  # unplugged meanwhile: the next read reports it
            return b""
        return evdev.encode(records, time.monotonic())

    def _discard_pending(self) -> None:
        assert self._fd is not None
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self._fd, self.read_bytes):
                self.counters.bytes_read += len(data)


def query_device(path: str) -> TouchDevice | None:
    """Open an input device without grabbing it and return its description; None if it is no input device.

    Raises OSError if it cannot be opened.
    """
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        return describe_device(fd)
    finally:
        os.close(fd)


def describe_device(fd: int) -> TouchDevice | None:
    """Return the kernel's description of an open input device; None if it is no input device."""
    try:
        axes = _bits(fd, _HAS_AXES, _AXIS_BYTES)
    except OSError as failure:
        if failure.errno in _NO_DEVICE:
            return None
        raise
    infos = ((axis, _abs_info(fd, axis)) for axis in axes)
    name, properties = bytearray(_NAME_BYTES), frozenset[int]()
    with contextlib.suppress(OSError):
        fcntl.ioctl(fd, _NAME, name)
    with contextlib.suppress(OSError):
        properties = _bits(fd, _PROPERTIES, _PROPERTY_BYTES)
    return TouchDevice(
        name.partition(b"\0")[0].decode(errors="replace"),
        {axis: AxisRange(info[1], info[2], info[5]) for axis, info in infos if info is not None},
        _bits(fd, _HAS_KEYS, _KEY_BYTES),
        properties,
        _bits(fd, _HAS_MOVES, _REL_BYTES),
    )


def _bits(fd: int, request: int, size: int) -> frozenset[int]:
    buffer = bytearray(size)
    fcntl.ioctl(fd, request, buffer)
    return frozenset(i for i in range(8 * size) if buffer[i // 8] >> i % 8 & 1)


def _single(fd: int, device: TouchDevice) -> list[Record]:
    """Return the state of the single-touch axes that the device has; for missing ones the kernel returns 0."""
    there = [code for code in _AXES if code in device.axes]
    records = [(evdev.EV_ABS, code, info[0]) for code in there if (info := _abs_info(fd, code)) is not None]
    if evdev.BTN_TOUCH in device.keys:
        records.append((evdev.EV_KEY, evdev.BTN_TOUCH, int(evdev.BTN_TOUCH in _bits(fd, _KEYS, _KEY_BYTES))))
    return records


def _slots(fd: int, device: TouchDevice) -> list[Record]:
    info = _abs_info(fd, evdev.MT_SLOT)
    if info is None or device.protocol is not Protocol.SLOTS:
        return []
    count = min(info[2] + 1, evdev.MAX_SLOTS)
    form = struct.Struct(f"<{count + 1}i")
    found: list[Record] = []
    values = {}
    for code in (each for each in _SLOT_AXES if each in device.axes):
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
    if isinstance(failure, UnsupportedDeviceError):
        return str(failure)
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
