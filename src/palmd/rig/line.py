"""Emulated serial lines: pacing at line rate (pure), and the pseudo-terminals or sockets that the host opens (I/O)."""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import select
import socket
import termios
import tty
from abc import ABC, abstractmethod
from collections import deque
from pathlib import Path

import numpy as np

from palmd.config.fields import BAUDS, SERVO_BAUDS

READ_BYTES = 4096
_OSPEED = 5
_BAUD_OF = {getattr(termios, f"B{baud}"): baud for baud in sorted({*BAUDS, *SERVO_BAUDS})}
_EVENTS = select.POLLIN | select.POLLPRI
_FLUSHED = 0x01  # TIOCPKT_FLUSHREAD: the host has flushed its input, as it does on opening


class Wire:
    """One direction of a line: a byte takes ten bit times and queues behind those before it. Pure."""

    def __init__(self, baud: int) -> None:
        self.byte_s = 10.0 / baud
        self._bytes: deque[tuple[float, int]] = deque()
        self._t_free = 0.0
        self._t_next = -math.inf  # earliest time of the next burst

    def send(self, data: bytes, t: float) -> None:
        """Queue bytes at t (s); the first arrives one byte time later if the line is free."""
        t_done = max(t, self._t_free)
        for byte in data:
            t_done += self.byte_s
            self._bytes.append((t_done, byte))
        self._t_free = t_done

    @property
    def waiting(self) -> int:
        """Number of bytes that have not arrived yet."""
        return len(self._bytes)

    def take(self, t: float, burst_s: float = 0.0) -> bytes:
        """The bytes that have arrived by t (s), in bursts at least `burst_s` apart if that is positive."""
        if burst_s > 0.0:
            if t < self._t_next:
                return b""
            self._t_next = t + burst_s
        waiting = self._bytes
        if not waiting or waiting[0][0] > t:
            return b""
        out = bytearray()
        while waiting and waiting[0][0] <= t:
            out.append(waiting.popleft()[1])
        return bytes(out)


class EmulatedLine(ABC):
    """A port under a fixed path while it is plugged in. Never blocks; bytes that no host takes are lost."""

    edge_triggered = True
    """Whether its descriptor is polled edge-triggered, see `LineWaiter`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.bytes_sent = self.bytes_lost = self.bytes_heard = 0
        self._fd: int | None = None

    @property
    def plugged(self) -> bool:
        """Whether the port exists at present."""
        return self._fd is not None

    @property
    def fileno(self) -> int:
        """The descriptor to poll, −1 while the port does not exist."""
        return -1 if self._fd is None else self._fd

    @abstractmethod
    def plug(self) -> None:
        """Create the port; does nothing if it exists. Raises OSError if that is not possible."""

    @abstractmethod
    def unplug(self) -> None:
        """Remove the port even if the host has it open; does nothing if it does not exist."""

    @abstractmethod
    def read(self, events: int) -> tuple[bytes, bool]:
        """What the host has written, and whether it has opened or flushed the port, given poll()'s events."""

    def write(self, data: bytes) -> bytes:
        """Offer bytes to the host; returns those that were accepted, as the host will read them."""
        if not data:
            return b""
        received, written = self._as_received(data), 0
        with contextlib.suppress(OSError):
            written = self._send(received)
        self.bytes_sent += written
        self.bytes_lost += len(data) - written
        return received[:written]

    def _as_received(self, data: bytes) -> bytes:
        """The bytes as the host will read them."""
        return data

    @abstractmethod
    def _send(self, data: bytes) -> int:
        """Number of bytes accepted, 0 without a host; may raise OSError."""

    def _link_to(self, target: str | Path) -> None:
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(target)


class PtyLine(EmulatedLine):
    """A pseudo-terminal under a fixed path: a link that points to it while it is plugged in.

    Bytes for a host that has not opened the port are lost, as on a real line; bytes exchanged at a baud rate other than
    the device's become noise.
    """

    def __init__(self, link: Path, baud: int | None, rng: np.random.Generator) -> None:
        """Without a `baud` it represents a device that has no serial line."""
        super().__init__(link)
        self._baud, self._rng = baud, rng
        self._attached = False

    def plug(self) -> None:
        if self._fd is not None:
            return
        self._fd, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._fd, False)
        # packet mode: a status byte precedes each read's data, so that a flush by the host can be detected
        fcntl.ioctl(self._fd, termios.TIOCPKT, b"\x01\x00\x00\x00")
        self._link_to(os.ttyname(slave))
        os.close(slave)

    def unplug(self) -> None:
        if self._fd is None:
            return
        self.path.unlink(missing_ok=True)
        os.close(self._fd)
        self._fd, self._attached = None, False

    def read(self, events: int) -> tuple[bytes, bool]:
        self._attached = not events & select.POLLHUP
        out, flushed = b"", False
        while self._fd is not None and events & (select.POLLIN | select.POLLPRI):
            try:
                packet = os.read(self._fd, READ_BYTES)
            except OSError:  # nothing more to read, or the host has closed the port
                break
            if packet[0] == 0:
                out += packet[1:]
                self.bytes_heard += len(packet) - 1
            else:
                flushed = flushed or bool(packet[0] & _FLUSHED)
        return self._as_received(out), flushed

    def _send(self, data: bytes) -> int:
        return os.write(self._fd, data) if self._fd is not None and self._attached else 0

    def _as_received(self, data: bytes) -> bytes:
        if not data or self._fd is None or self._baud is None or self._host_baud() == self._baud:
            return data
        return bytes(self._rng.integers(0, 256, len(data), dtype=np.uint8))

    def _host_baud(self) -> int | None:
        assert self._fd is not None
        return _BAUD_OF.get(termios.tcgetattr(self._fd)[_OSPEED])


class SocketLine(EmulatedLine):
    """A line on a UNIX socket: bytes reach the host as soon as they are written.

    A pseudo-terminal's bytes wait for a kernel thread, for tenths of a second when other programs occupy the
    processors. A socket has no baud rate and no break. One host at a time; others wait until it disconnects. Bytes
    without a host are lost.
    """

    edge_triggered = False

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._listener: socket.socket | None = None
        self._host: socket.socket | None = None
        self._epoll: select.epoll | None = None  # watches the host, or the listening socket if there is none

    def plug(self) -> None:
        """See `EmulatedLine`; the path may be too long for a socket."""
        if self._listener is not None:
            return
        self.path.unlink(missing_ok=True)
        listener = socket.socket(socket.AF_UNIX)
        try:
            listener.bind(str(self.path))
            listener.listen()
        except BaseException:
            listener.close()
            raise
        listener.setblocking(False)
        self._listener, self._epoll = listener, select.epoll()
        self._fd = self._epoll.fileno()
        self._epoll.register(listener, select.EPOLLIN)

    def unplug(self) -> None:
        if self._listener is None or self._epoll is None:
            return
        self._epoll.close()
        self._listener.close()
        self._listener = self._epoll = self._fd = None
        self.path.unlink(missing_ok=True)
        if self._host is not None:
            self._host.close()
            self._host = None

    def read(self, events: int) -> tuple[bytes, bool]:
        if not events or self._listener is None or self._epoll is None:
            return b"", False
        if self._host is None:
            return b"", self._accept_host(self._listener, self._epoll)
        try:
            out = self._host.recv(READ_BYTES)
        except BlockingIOError:
            return b"", False
        except OSError:
            out = b""
        if not out:
            self._host.close()
            self._host = None
            self._epoll.register(self._listener, select.EPOLLIN)
        self.bytes_heard += len(out)
        return out, False

    def _send(self, data: bytes) -> int:
        return self._host.send(data) if self._host is not None else 0

    def _accept_host(self, listener: socket.socket, epoll: select.epoll) -> bool:
        try:
            host, _ = listener.accept()
        except OSError:  # no pending connection
            return False
        host.setblocking(False)
        epoll.unregister(listener)  # further hosts have to wait
        epoll.register(host, select.EPOLLIN)
        self._host = host
        return True


class LineWaiter:
    """Polls several descriptors; one system call serves all that a host has opened.

    poll() itself would wait for a kernel thread, see `PortWaiter`; edge-triggered epoll does not. When a host opens a
    pseudo-terminal epoll sees no edge, so a terminal that no host has opened is polled separately.
    """

    def __init__(self) -> None:
        self._edges = select.epoll()
        self._unopened: set[int] = set()

    def watch(self, fd: int, *, edge_triggered: bool = True) -> None:
        """Add a descriptor, edge-triggered (pseudo-terminals) or not; −1 is ignored."""
        if fd < 0:
            return
        self._edges.register(fd, _EVENTS | (select.EPOLLET if edge_triggered else 0))
        if edge_triggered:
            self._unopened.add(fd)

    def forget(self, fd: int) -> None:
        """Remove a descriptor, before it is closed."""
        if fd < 0:
            return
        self._edges.unregister(fd)
        self._unopened.discard(fd)

    def ready(self) -> dict[int, int]:
        """Events by descriptor; each edge is reported once, so that available data must be read."""
        events = dict(self._edges.poll(0))
        self._unopened |= {fd for fd, event in events.items() if event & select.POLLHUP}
        for fd in tuple(self._unopened):
            events[fd] = _poll_once(fd)
            if not events[fd] & select.POLLHUP:
                self._unopened.discard(fd)
        return events


def _poll_once(fd: int) -> int:
    poll = select.poll()
    poll.register(fd, _EVENTS)
    return dict(poll.poll(0)).get(fd, 0)
