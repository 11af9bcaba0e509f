"""The emulated serial lines: pacing at line rate (pure), and the pseudo-terminals or sockets the host opens (I/O)."""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import select
import socket
import termios
import tty
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
    """One direction of a line: a byte takes ten bit times, and waits for those before it. Pure."""

    def __init__(self, baud: int) -> None:
        self.byte_s = 10.0 / baud
        self._bytes: deque[tuple[float, int]] = deque()
        self._t_free = 0.0
        self._t_next = -math.inf  # of the next burst

    def send(self, data: bytes, t: float) -> None:
        """Hands over bytes at t (s); the first one has arrived one byte time later, if the line is free."""
        t_done = max(t, self._t_free)
        for byte in data:
            t_done += self.byte_s
            self._bytes.append((t_done, byte))
        self._t_free = t_done

    @property
    def waiting(self) -> int:
        """How many bytes have not arrived yet."""
        return len(self._bytes)

    def take(self, t: float, burst_s: float = 0.0) -> bytes:
        """The bytes that have arrived by t (s); held back until `burst_s` after the last burst, where that is not 0."""
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


class PtyLine:
    """One pseudo-terminal under a steady name: a link that points to it as long as it is plugged in.

    Never blocks. Bytes for a host that has not opened the port are lost, as on a real line; bytes exchanged
    at another baud than the device's come out as noise.
    """

    edges = True  # of its descriptor tell what has come

    def __init__(self, link: Path, baud: int | None, rng: np.random.Generator) -> None:
        """Without a `baud` it stands for a device that is no serial line."""
        self.path = link
        self.bytes_sent = 0
        self.bytes_lost = 0
        self.bytes_heard = 0
        self._baud, self._rng = baud, rng
        self._master: int | None = None
        self._attached = False

    @property
    def plugged(self) -> bool:
        """Whether the port exists at the moment."""
        return self._master is not None

    @property
    def fileno(self) -> int:
        """The descriptor to poll, −1 while the port does not exist."""
        return -1 if self._master is None else self._master

    def plug(self) -> None:
        """Makes the port appear; does nothing if it is there."""
        if self._master is not None:
            return
        master, slave = os.openpty()
        tty.setraw(slave)
        self._master = master
        os.set_blocking(master, False)
        _packet_mode(master)
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        self.path.symlink_to(os.ttyname(slave))
        os.close(slave)

    def unplug(self) -> None:
        """Makes the port vanish under the host's hands; does nothing if it is gone."""
        if self._master is None:
            return
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        os.close(self._master)
        self._master, self._attached = None, False

    def read(self, events: int) -> tuple[bytes, bool]:
        """What the host has written, and whether it has opened or flushed the port, given poll()'s events."""
        self._attached = not events & select.POLLHUP
        out, flushed = b"", False
        while self._master is not None and events & (select.POLLIN | select.POLLPRI):
            try:
                packet = os.read(self._master, READ_BYTES)
            except OSError:  # nothing more to read, or nobody at the other end any longer
                break
            if packet[0] == 0:
                out += packet[1:]
                self.bytes_heard += len(packet) - 1
            else:
                flushed = flushed or bool(packet[0] & _FLUSHED)
        return self._as_heard(out), flushed

    def write(self, data: bytes) -> bytes:
        """Offers bytes to the host; returns those that the pseudo-terminal took, as the host will read them."""
        if not data:
            return b""
        said, written = self._as_heard(data), 0
        if self._master is not None and self._attached:
            with contextlib.suppress(OSError):
                written = os.write(self._master, said)
        self.bytes_sent += written
        self.bytes_lost += len(data) - written
        return said[:written]

    def _as_heard(self, data: bytes) -> bytes:
        if not data or self._master is None or self._baud is None or self._host_baud() == self._baud:
            return data
        return bytes(self._rng.integers(0, 256, len(data), dtype=np.uint8))

    def _host_baud(self) -> int | None:
        assert self._master is not None
        return _BAUD_OF.get(termios.tcgetattr(self._master)[_OSPEED])


class SocketLine:
    """A line with the face of a `PtyLine` on a UNIX socket: bytes are with the host as soon as they are written.

    A pseudo-terminal's wait for a thread of the kernel, tenths of a second where other programs want the processors. A
    socket has no baud and no break. One host at a time, others wait for it to go. Bytes without a host are lost.
    """

    edges = False

    def __init__(self, path: Path) -> None:
        self.path = path
        self.bytes_sent = self.bytes_lost = self.bytes_heard = 0
        self._door: socket.socket | None = None
        self._host: socket.socket | None = None
        self._ready: select.epoll | None = None  # is the host, or the door where there is none

    @property
    def plugged(self) -> bool:
        """Whether the port exists at the moment."""
        return self._door is not None

    @property
    def fileno(self) -> int:
        """The descriptor to poll, −1 while the port does not exist."""
        return -1 if self._ready is None else self._ready.fileno()

    def plug(self) -> None:
        """Makes the port appear; does nothing if it is there. Raises OSError where the path is too long for one."""
        if self._door is not None:
            return
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        door = socket.socket(socket.AF_UNIX)
        try:
            door.bind(str(self.path))
            door.listen()
        except BaseException:
            door.close()
            raise
        door.setblocking(False)
        self._door, self._ready = door, select.epoll()
        self._ready.register(door, select.EPOLLIN)

    def unplug(self) -> None:
        """Makes the port vanish under the host's hands; does nothing if it is gone."""
        if self._door is None or self._ready is None:
            return
        self._ready.close()
        self._door.close()
        self._door = self._ready = None
        self.path.unlink(missing_ok=True)
        if self._host is not None:
            self._host.close()
            self._host = None

    def read(self, events: int) -> tuple[bytes, bool]:
        """What the host has written, and whether it has opened the port, given poll()'s events."""
        if not events or self._door is None or self._ready is None:
            return b"", False
        if self._host is None:
            return b"", self._take_host(self._door, self._ready)
        try:
            out = self._host.recv(READ_BYTES)
        except BlockingIOError:
            return b"", False
        except OSError:
            out = b""
        if not out:
            self._host.close()
            self._host = None
            self._ready.register(self._door, select.EPOLLIN)
        self.bytes_heard += len(out)
        return out, False

    def write(self, data: bytes) -> bytes:
        """Offers bytes to the host; returns those that the socket took."""
        written = 0
        if data and self._host is not None:
            with contextlib.suppress(OSError):
                written = self._host.send(data)
        self.bytes_sent += written
        self.bytes_lost += len(data) - written
        return data[:written]

    def _take_host(self, door: socket.socket, ready: select.epoll) -> bool:
        try:
            host, _ = door.accept()
        except OSError:  # nobody at the door
            return False
        host.setblocking(False)
        ready.unregister(door)  # who comes next has to wait
        ready.register(host, select.EPOLLIN)
        self._host = host
        return True


class LineWaiter:
    """What poll() would say of several descriptors; one system call for all that a host has opened.

    poll() itself would wait for a thread of the kernel, see `PortWaiter`; edge-triggered epoll does not. That a host
    opens a pseudo-terminal is no edge, but of one that none has opened there is nothing to wait for.
    """

    def __init__(self) -> None:
        self._edges = select.epoll()
        self._unopened: set[int] = set()

    def watch(self, fd: int, *, edges: bool = True) -> None:
        """Take a descriptor in, told by its `edges`, as a pseudo-terminal is, or not; of −1 there is nothing."""
        if fd < 0:
            return
        self._edges.register(fd, _EVENTS | (select.EPOLLET if edges else 0))
        if edges:
            self._unopened.add(fd)

    def forget(self, fd: int) -> None:
        """Leave one out, before it is closed."""
        if fd < 0:
            return
        self._edges.unregister(fd)
        self._unopened.discard(fd)

    def ready(self) -> dict[int, int]:
        """The events of each that has any; where a host is, each is told once, and what has come must be read."""
        events = dict(self._edges.poll(0))
        self._unopened |= {fd for fd, event in events.items() if event & select.POLLHUP}
        for fd in tuple(self._unopened):
            events[fd] = _polled(fd)
            if not events[fd] & select.POLLHUP:
                self._unopened.discard(fd)
        return events


def _polled(fd: int) -> int:
    poll = select.poll()
    poll.register(fd, _EVENTS)
    return dict(poll.poll(0)).get(fd, 0)


def _packet_mode(master: int) -> None:
    """Asks for a status byte before each read's data, so that a flush by the host can be seen."""
    fcntl.ioctl(master, termios.TIOCPKT, b"\x01\x00\x00\x00")
