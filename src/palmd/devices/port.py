"""Serial ports that never block, never raise on a bad line, and reopen after unplugging."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import math
import os
import select
import socket
import struct
import termios
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import serial

from palmd.devices.health import Counters

READ_BYTES = 4096
"""The size of a terminal's buffer in the kernel."""

PTY_MAJORS = range(136, 144)

_IFLAG, _CC = 0, 6
_TIOCGICOUNT = 0x545D
_ICOUNTER = struct.Struct("11i36x")  # struct serial_icounter_struct: four modem lines, rx, tx, then errors
FAILURES = (OSError, ValueError, termios.error)  # termios.error is no OSError, and pyserial raises it


class PortUnavailableError(Exception):
    """A port cannot be opened or was lost; the text has reason and what to do."""


@dataclass(slots=True)
class PortCounters(Counters):
    """Counters of a port: bytes read, written and dropped because of a full buffer; openings and losses.

    The last four are the kernel's counts of the line since it was opened first: framing errors mostly mean a wrong
    baud rate, overruns a machine too slow for the line. Pseudo-terminals have none.
    """

    bytes_read: int = 0
    bytes_written: int = 0
    bytes_dropped: int = 0
    opens: int = 0
    losses: int = 0
    breaks: int = 0
    framing_errors: int = 0
    parity_errors: int = 0
    overruns: int = 0


class DevicePort(Protocol):
    """Port of a device: reopened after a loss, non-blocking, and none of its calls raises.

    `Port` is a serial line; other kinds of devices have their own. Only the device's driver interprets what `read`
    returns.
    """

    path: str
    error: str | None
    counters: PortCounters

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""

    def fileno(self) -> int:
        """Return the file descriptor, for waiting. Raises ValueError if the port is not open."""

    def poll_open(self, t: float) -> bool:
        """Open the port if it is closed and an attempt is due at `t` (s, monotonic); return whether it is open."""

    def read(self) -> bytes:
        """Return the bytes received, empty if there are none."""

    def write(self, data: bytes) -> None:
        """Send `data`, or drop and count it."""

    def update_counters(self) -> None:
        """Update the counters from the kernel's, if there are any."""

    def close(self) -> None:
        """Close the port."""


class ReopenedPort(ABC):
    """Base class of device ports: opening and reopening, reading, and the error text."""

    read_bytes = READ_BYTES
    """Largest size of one read."""

    def __init__(self, name: str, path: str, retry_s: float = 0.5) -> None:
        """`name` is for messages, `path` the device (links are followed).

        While the port is closed, `poll_open` tries every `retry_s` seconds. Nothing is opened yet.
        """
        self.name = name
        self.path = path
        self.error: str | None = f"{name}: {path} has not been opened yet"
        self.counters = PortCounters()
        self._retry_s = retry_s
        self._t_retry = -math.inf
        self._fd: int | None = None

    @abstractmethod
    def _open(self) -> int:
        """Open the device and return its file descriptor; raises one of `FAILURES`."""

    @abstractmethod
    def _explain(self, failure: Exception) -> str:
        """Return one line on why the device could not be opened, and what to do."""

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._fd is not None

    def fileno(self) -> int:
        """Return the file descriptor, for waiting. Raises ValueError if the port is not open."""
        if self._fd is None:
            raise ValueError(f"{self.name}: port is not open")
        return self._fd

    def poll_open(self, t: float) -> bool:
        """Open the port if it is closed and an attempt is due at `t` (s, monotonic); return whether it is open."""
        if self._fd is None and t >= self._t_retry:
            self._t_retry = t + self._retry_s
            try:
                self._fd = self._open()
            except FAILURES as failure:
                self.error = f"{self.name}: {self._explain(failure)}"
            else:
                self.error = None
                self.counters.opens += 1
        return self.is_open

    def read(self) -> bytes:
        """Return the bytes received, empty if there are none; close the port at once after a hang-up.

        Only one block is read, so that a flood on one port cannot delay the others, and no more than the kernel has
        ready: reading until there is nothing left would wait for a kernel thread, see `PortWaiter`.
        """
        if self._fd is None:
            return b""
        try:
            data = os.read(self._fd, self.read_bytes)
        except BlockingIOError:
            return b""
        except OSError as failure:
            self._lose(failure)
            return b""
        if not data:  # end of file: the device has hung up
            self._lose(None)
        self.counters.bytes_read += len(data)
        return data

    def close(self) -> None:
        """Close the port; the next `poll_open` opens it again."""
        if self._fd is not None:
            with contextlib.suppress(OSError):
                self._shut(self._fd)
            self._fd = None
            self.error = f"{self.name}: {self.path} has been closed"

    def _shut(self, fd: int) -> None:
        """Close the descriptor; may raise OSError."""
        os.close(fd)

    def _lose(self, failure: OSError | None) -> None:
        self.close()
        self.counters.losses += 1
        cause = f" ({failure.strerror})" if failure is not None else ""
        self.error = f"{self.name}: {self.path} was lost{cause}: check the plug; palmd reopens it automatically"


class Port(ReopenedPort):
    """Serial port, 8N1, opened exclusively and reopened after a loss; or a UNIX socket with the same bytes.

    `error` is one line on why the port is not open and what to do, None while it is open. Every call returns at
    once and is safe inside the 100 Hz loop; opening takes about ten system calls.
    """

    def __init__(self, name: str, path: str, baud: int, retry_s: float = 0.5) -> None:
        """See `ReopenedPort`; `baud` in bit/s."""
        super().__init__(name, path, retry_s)
        self._baud = baud
        self._end: serial.Serial | socket.socket | None = None
        self._line = (0, 0, 0, 0)
        self._unsent = b""

    def _open(self) -> int:
        self._end = _connect(self.path) if Path(self.path).is_socket() else _open(self.path, self._baud)
        fd = int(self._end.fileno())
        self._line = _line_errors(fd)
        return fd

    def _shut(self, fd: int) -> None:
        del fd
        self._unsent = b""
        if self._end is not None:
            self._end.close()

    def _explain(self, failure: Exception) -> str:
        return explain(self.path, failure)

    def update_counters(self) -> None:
        """Add the kernel's counts since the last update to the counters (one ioctl; call about once a second)."""
        if self._fd is None:
            return
        before, self._line = self._line, _line_errors(self._fd)
        breaks, framing, parity, overruns = (now - then for now, then in zip(self._line, before, strict=True))
        counters = self.counters
        counters.breaks += breaks
        counters.framing_errors += framing
        counters.parity_errors += parity
        counters.overruns += overruns

    def write(self, data: bytes) -> None:
        """Send `data` (complete lines), or drop and count it if the kernel's buffer is full.

        If only a part fits, the rest is sent before the next data, so that lines stay complete.
        """
        rest = self._unsent
        written = self._put(rest + data)
        if written > len(rest):
            self._unsent = (rest + data)[written:]
        else:
            self._unsent = rest[written:] if self.is_open else b""
            self.counters.bytes_dropped += len(data)

    def set_break(self, active: bool) -> None:
        """Set or clear the line's break condition; no effect on other ports."""
        if self._fd is not None and isinstance(self._end, serial.Serial):
            with contextlib.suppress(*FAILURES):
                self._end.break_condition = active

    def _put(self, data: bytes) -> int:
        if self._fd is None or not data:
            return 0
        try:
            written = os.write(self._fd, data)
        except BlockingIOError:
            return 0
        except OSError as failure:
            self._lose(failure)
            return 0
        self.counters.bytes_written += written
        return written

    def _lose(self, failure: OSError | None) -> None:
        with contextlib.suppress(*FAILURES):
            termios.tcflush(self.fileno(), termios.TCOFLUSH)  # else closing may wait for the output to drain
        super()._lose(failure)


def _connect(path: str) -> socket.socket:
    end = socket.socket(socket.AF_UNIX)
    end.setblocking(False)
    try:
        end.connect(path)
    except BaseException:
        end.close()
        raise
    return end


def _open(path: str, baud: int) -> serial.Serial:
    port = serial.Serial(path, baud, timeout=0, write_timeout=0, exclusive=True)
    try:
        fd = port.fileno()
        attributes = termios.tcgetattr(fd)
        attributes[_IFLAG] &= ~termios.BRKINT  # read a break as NUL, without flushing the queues
        attributes[_CC][termios.VMIN] = 1  # without data reads fail with EAGAIN, and b"" means hang-up
        attributes[_CC][termios.VTIME] = 0
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
        if os.major(os.fstat(fd).st_rdev) not in PTY_MAJORS:
            # pyserial's lock is advisory, this one is not. Not for a pseudo-terminal, which would keep it after this
            # process has ended, as long as its other side is open.
            fcntl.ioctl(fd, termios.TIOCEXCL)
        with contextlib.suppress(*FAILURES, NotImplementedError):
            port.set_low_latency_mode(True)
    except BaseException:
        port.close()
        raise
    return port


def _line_errors(fd: int) -> tuple[int, int, int, int]:
    """Return the kernel's counts of breaks, framing errors, parity errors and overruns; zeros if it has none."""
    buffer = bytearray(_ICOUNTER.size)
    try:
        fcntl.ioctl(fd, _TIOCGICOUNT, buffer)
    except OSError:
        return (0, 0, 0, 0)
    *_, framing, overruns, parity, breaks, at_terminal = _ICOUNTER.unpack(buffer)
    return breaks, framing, parity, overruns + at_terminal


def explain(path: str, failure: Exception) -> str:
    """Return one line on why `path` could not be opened, and what to do."""
    match getattr(failure, "errno", None):
        case errno.ENOENT:
            return f"no such port {path}: check the plug and the configured name"
        case errno.EACCES | errno.EPERM:
            return (
                f"no permission to open {path}: add this user to the group that owns it, usually dialout "
                "(sudo usermod -aG dialout $USER, then log in again)"
            )
        case errno.EBUSY | errno.EAGAIN:
            return f"{path} is held by another process: end it (sudo fuser -v {path} names it)"
        case errno.EIO | errno.ENXIO | errno.ENODEV | errno.ECONNREFUSED:
            return f"nothing is connected behind {path}: check the plug"
        case _:
            return f"{path} cannot be used as a serial port: {failure}"


class PortWaiter:
    """Waits for several ports at once, and never for a kernel thread.

    Polling a terminal makes the kernel flush the driver's buffer in a thread of normal priority and wait for it:
    hundreds of milliseconds on a busy machine, whatever this process's priority. Edge-triggered epoll polls only when
    the bytes have arrived. So every port that `wait` returns must be read.
    """

    def __init__(self, ports: Sequence[DevicePort], clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` returns the time (s) to which deadlines refer."""
        self._ports = ports
        self._clock = clock
        self._epoll = select.epoll()
        self._watched: dict[DevicePort, int] = {}

    def wait(self, t_deadline: float) -> list[DevicePort]:
        """Return the ports that have data or have hung up; empty at `t_deadline` (s).

        select() is used because its timeout has a resolution of microseconds; poll() and epoll have milliseconds.
        """
        self._watch()
        select.select((self._epoll,), (), (), max(0.0, t_deadline - self._clock()))
        ready = {fd for fd, _ in self._epoll.poll(0)}
        return [port for port in self._ports if port.is_open and port.fileno() in ready]

    def _watch(self) -> None:
        """Register ports that have been opened since; the kernel removes closed ones itself."""
        for port in self._ports:
            if port.is_open and self._watched.get(port) != port.counters.opens:
                self._watched[port] = port.counters.opens
                self._epoll.register(port.fileno(), select.EPOLLIN | select.EPOLLET)
