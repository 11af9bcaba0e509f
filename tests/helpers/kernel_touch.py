"""Input devices for tests: described by a fake kernel, or created through /dev/uinput."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import struct
import time
from dataclasses import dataclass, field
from pathlib import Path

UINPUT = Path("/dev/uinput")
ABS_FORM, SETUP_FORM = struct.Struct("<Hxx6i"), struct.Struct("<4H80sI")
RECORD = struct.Struct("<qqHHi")

X, Y, PRESSURE, DISTANCE = 0x00, 0x01, 0x18, 0x19
SLOT, MT_X, MT_Y, TOOL, ID, MT_PRESSURE, MT_DISTANCE = 0x2F, 0x35, 0x36, 0x37, 0x39, 0x3A, 0x3B
TOUCH, FINGER, PEN, LEFT = 0x14A, 0x145, 0x140, 0x110
POINTER, SEMI_MT, PRESSUREPAD = 0, 3, 7


def events(*changes):
    """Records of one frame, (type, code, value) each, with its SYN_REPORT."""
    seconds, microseconds = divmod(time.monotonic_ns() // 1000, 1_000_000)
    return b"".join(RECORD.pack(seconds, microseconds, *each) for each in (*changes, (0, 0, 0)))


@dataclass
class FakeKernel:
    """Answers the ioctls of an input device whose state a test sets; passes everything else to the real kernel.

    `axes`: code to (value, minimum, maximum, resolution). `slots`: code to one value per slot.
    """

    name: str = "a test pad"
    axes: dict[int, tuple[int, int, int, int]] = field(default_factory=dict)
    keys: set[int] = field(default_factory=set)
    pressed: set[int] = field(default_factory=set)
    properties: set[int] = field(default_factory=set)
    moves: set[int] = field(default_factory=set)
    slots: dict[int, list[int]] = field(default_factory=dict)
    asked: list[int] = field(default_factory=list)
    grabbed: int = 0

    def install(self, monkeypatch, module):
        """Replaces the kernel's functions in the module."""
        monkeypatch.setattr(module.fcntl, "ioctl", self)
        return self

    def __call__(self, _fd, request, argument=0):
        kind, number, size = request >> 8 & 0xFF, request & 0xFF, request >> 16 & 0x3FFF
        if kind != ord("E"):
            raise OSError(errno.ENOTTY, "not a typewriter")
        self.asked.append(number)
        if request == 0x40044590:
            self.grabbed += argument
        elif number == 0x06:
            argument[:] = self.name.encode().ljust(size, b"\0")
        elif number == 0x09:
            _set_bits(argument, self.properties)
        elif number == 0x0A:
            (code,) = struct.unpack_from("<i", argument)
            if code not in self.slots:
                raise OSError(errno.EINVAL, "no such axis")
            struct.pack_into(f"<{len(self.slots[code])}i", argument, 4, *self.slots[code])
        elif number == 0x18:
            _set_bits(argument, self.pressed)
        elif number in (0x20, 0x21, 0x22, 0x23):
            _set_bits(argument, ({0, 1, 2, 3}, self.keys, self.moves, self.axes)[number - 0x20])
        elif 0x40 <= number < 0x80:
            if not self.axes:
                raise OSError(errno.EINVAL, "no axes")
            value, least, most, resolution = self.axes.get(number - 0x40, (0, 0, 0, 0))  # as the kernel does
            struct.pack_into("<6i", argument, 0, value, least, most, 0, 0, resolution)
        return 0


def _set_bits(buffer, codes):
    for code in codes:
        if code // 8 < len(buffer):
            buffer[code // 8] |= 1 << code % 8


def devices_can_be_made():
    """Whether uinput works for this user; the device node alone does not prove it."""
    try:
        os.close(os.open(UINPUT, os.O_RDWR | os.O_NONBLOCK))
    except OSError:
        return False
    return True


class KernelDevice:
    """A device that the kernel has created; `path` is what a program opens."""

    def __init__(self, axes, keys=(), properties=(), moves=(), name="palmd test device"):
        """`axes`: code to (minimum, maximum, resolution)."""
        self._fd = os.open(UINPUT, os.O_RDWR | os.O_NONBLOCK)
        for bit, codes in ((0x40045565, keys), (0x40045567, axes), (0x40045566, moves), (0x4004556E, properties)):
            for code in codes:
                fcntl.ioctl(self._fd, bit, code)
        for kind, codes in ((1, keys), (2, moves), (3, axes)):
            if codes:
                fcntl.ioctl(self._fd, 0x40045564, kind)
        for code, (least, most, resolution) in axes.items():
            fcntl.ioctl(self._fd, 0x401C5504, ABS_FORM.pack(code, 0, least, most, 0, 0, resolution))
        fcntl.ioctl(self._fd, 0x405C5503, SETUP_FORM.pack(3, 1, 1, 1, name.encode(), 0))
        fcntl.ioctl(self._fd, 0x5501)
        made = bytearray(64)
        fcntl.ioctl(self._fd, 0x8040552C, made)
        folder = Path("/sys/devices/virtual/input") / made.rstrip(b"\0").decode()
        self.path = str(Path("/dev/input") / next(each.name for each in folder.glob("event*")))
        for _ in range(100):
            if Path(self.path).exists():
                break
            time.sleep(0.02)

    def send(self, *changes):
        """Sends one frame."""
        os.write(self._fd, events(*changes))

    def close(self):
        """Unplugs the device."""
        with contextlib.suppress(OSError):
            fcntl.ioctl(self._fd, 0x5502)
        os.close(self._fd)
