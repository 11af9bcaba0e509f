"""Serial ports that never block, never raise on a bad line, and come back after unplugging."""

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
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

import serial

READ_BYTES = 4096
"""As much as a terminal ever holds ready."""

PTY_MAJORS = range(136, 144)

_IFLAG, _CC = 0, 6
_TIOCGICOUNT = 0x545D
_ICOUNTER = struct.Struct("11i36x")  # struct serial_icounter_struct: four of the modem's lines, rx, tx, then errors
FAILURES = (OSError, ValueError, termios.error)  # termios.error is no OSError; pyserial lets it through


@dataclass(slots=True)
class PortCounters:
    """What has passed through a port: bytes read, written, dropped for a full buffer; openings and losses.

    The last four are the kernel's own account of the line since it was opened first: a framing error is mostly a wrong
    baud, an overrun a machine too slow for its line. A pseudo-terminal keeps none.
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

    def as_dict(self) -> dict[str, int]:
        """Return every count by name."""
        return asdict(self)


class DevicePort(Protocol):
    """Whatever a device is behind: opened again when it has gone, read without waiting, written whole; never raises.

    A serial line is `Port`; another kind of device brings its own. What `read` gives is for its driver alone.
    """

    path: str
    error: str | None
    counters: PortCounters

    @property
    def is_open(self) -> bool:
        """Whether it can be read and written."""

    def fileno(self) -> int:
        """The file descriptor, for waiting on. Raises ValueError if it is not open."""

    def poll_open(self, t: float) -> bool:
        """Open it if it is shut and a try is due at `t` (s, monotonic); return whether it is open."""

    def read(self) -> bytes:
        """What has arrived, empty if nothing has."""

    def write(self, data: bytes) -> None:
        """Send `data`, or drop and count it."""

    def look(self) -> None:
        """Bring the counters up to date with what the kernel counts, where it does."""

    def close(self) -> None:
        """Shut it."""


class ReopenedPort(ABC):
    """What is the same of every `DevicePort`: when it is opened, how it is read, what is said when it has gone."""

    read_bytes = READ_BYTES
    """At most at a time."""

    def __init__(self, name: str, path: str, retry_s: float) -> None:
        """`name` is for messages, `path` the device (links are followed).

        While it is shut, `poll_open` tries again every `retry_s` seconds. Nothing is opened yet.
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
        """Open it and return its descriptor; raises one of `FAILURES`."""

    @abstractmethod
    def _explain(self, failure: Exception) -> str:
        """One line on why it could not be opened and what to do about it."""

    @property
    def is_open(self) -> bool:
        """Whether it can be read and written."""
        return self._fd is not None

    def fileno(self) -> int:
        """Return the file descriptor, for waiting on. Raises ValueError if it is not open."""
        if self._fd is None:
            raise ValueError(f"{self.name}: port is not open")
        return self._fd

    def poll_open(self, t: float) -> bool:
        """Open it if it is shut and a try is due at `t` (s, monotonic); return whether it is open."""
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
        """Return what has arrived, empty if nothing has. What has hung up is shut at once.

        One portion, so that a flood on one port cannot hold up the others. It is no more than the kernel has ready:
        reading on until there is nothing would wait for a thread of the kernel, see `PortWaiter`.
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
        if not data:  # the end of the file and not of the data
            self._lose(None)
        self.counters.bytes_read += len(data)
        return data

    def close(self) -> None:
        """Shut it; the next `poll_open` opens it again."""
        if self._fd is not None:
            with contextlib.suppress(OSError):
                self._shut(self._fd)
            self._fd = None
            self.error = f"{self.name}: {self.path} has been closed"

    def _shut(self, fd: int) -> None:
        """May raise OSError."""
        os.close(fd)

    def _lose(self, failure: OSError | None) -> None:
        self.close()
        self.counters.losses += 1
        cause = f" ({failure.strerror})" if failure is not None else ""
        self.error = f"{self.name}: {self.path} was lost{cause}: check the plug; it is tried again by itself"


class Port(ReopenedPort):
    """One serial port, 8N1, opened exclusively and again whenever it has gone; or a UNIX socket that carries its bytes.

    `error` says in one line why the port is not open and what to do, None while it is. Every call returns at
    once, so all are safe inside the 100 Hz loop; opening takes a system call or ten.
    """

    def __init__(self, name: str, path: str, baud: int, retry_s: float = 0.5) -> None:
        """As any `ReopenedPort`, `baud` in bit/s."""
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

    def look(self) -> None:
        """Add to the counters what the kernel has counted since the last look: an ioctl, for once a second or so."""
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
        """Send `data` (whole lines), or drop and count it where the kernel's buffer is full.

        If only a part fits, the rest goes out before the next data, so that lines stay whole.
        """
        rest = self._unsent
        written = self._put(rest + data)
        if written > len(rest):
            self._unsent = (rest + data)[written:]
        else:
            self._unsent = rest[written:] if self.is_open else b""
            self.counters.bytes_dropped += len(data)

    def set_break(self, active: bool) -> None:
        """Hold the line in break, or end it; without effect where the port cannot."""
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
            termios.tcflush(self.fileno(), termios.TCOFLUSH)  # else closing may wait for it to drain
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
        attributes[_IFLAG] &= ~termios.BRKINT  # a break reads as NUL, it does not flush the queues
        attributes[_CC][termios.VMIN] = 1  # so that reading nothing fails with EAGAIN and b"" means hang-up
        attributes[_CC][termios.VTIME] = 0
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
        if os.major(os.fstat(fd).st_rdev) not in PTY_MAJORS:
            # The lock is advisory, this is not. A pseudo-terminal would keep it beyond our death, for as long
            # as its other side is open.
            fcntl.ioctl(fd, termios.TIOCEXCL)
        with contextlib.suppress(*FAILURES, NotImplementedError):
            port.set_low_latency_mode(True)
    except BaseException:
        port.close()
        raise
    return port


def _line_errors(fd: int) -> tuple[int, int, int, int]:
    """The kernel's counts of breaks, framing errors, parity errors and overruns; zeros where it keeps none."""
    told = bytearray(_ICOUNTER.size)
    try:
        fcntl.ioctl(fd, _TIOCGICOUNT, told)
    except OSError:
        return (0, 0, 0, 0)
    *_, framing, overruns, parity, breaks, at_terminal = _ICOUNTER.unpack(told)
    return breaks, framing, parity, overruns + at_terminal


def explain(path: str, failure: Exception) -> str:
    """Return one line on why `path` could not be opened and what to do about it."""
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
    """Waits on several ports at once, and never for the kernel.

    Asking a terminal whether it has something to read makes the kernel finish handing over what the driver has brought,
    in a thread of ordinary priority, and wait for that: hundreds of milliseconds on a busy machine, whatever our own
    priority. Edge-triggered epoll asks only once the bytes are there. So every port that is returned must be read.
    """

    def __init__(self, ports: Sequence[DevicePort], clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` gives the time (s) that deadlines are told in."""
        self._ports = ports
        self._clock = clock
        self._epoll = select.epoll()
        self._watched: dict[DevicePort, int] = {}

    def wait(self, t_deadline: float) -> list[DevicePort]:
        """Return the ports where something has come (or that have hung up), or none once `t_deadline` (s) has come.

        select() serves because its time-out has microseconds; those of poll() and epoll have milliseconds only.
        """
        self._watch()
        select.select((self._epoll,), (), (), max(0.0, t_deadline - self._clock()))
        ready = {fd for fd, _ in self._epoll.poll(0)}
        return [port for port in self._ports if port.is_open and port.fileno() in ready]

    def _watch(self) -> None:
        """Take in what has been opened since; the kernel forgets by itself what was shut."""
        for port in self._ports:
            if port.is_open and self._watched.get(port) != port.counters.opens:
                self._watched[port] = port.counters.opens
                self._epoll.register(port.fileno(), select.EPOLLIN | select.EPOLLET)
