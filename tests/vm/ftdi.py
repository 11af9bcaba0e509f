"""An FT232R outside QEMU, connected through its `usb-redir` device, with functions that QEMU's `usb-serial` lacks.

It holds bytes for its latency timer as the chip does, and marks bytes with a break, parity or framing error. It is
connected to a pseudo-terminal of the emulated rig, which gets the guest's baud rate.

Sources: usbredir's protocol, version 0.7 (only the three capabilities named below); for the chip's requests, Linux's
drivers/usb/serial/ftdi_sio.h.
"""

import contextlib
import os
import select
import socket
import struct
import termios
import threading
import time
import tty
from enum import IntEnum
from pathlib import Path

BREAK, FRAMING, PARITY, OVERRUN = 0x10, 0x08, 0x04, 0x02  # of the line status
PACKET = 64
HELD_MOST = 256  # further bytes that the guest does not request are lost
_EMPTY = 0x60  # of the line status: nothing left to send
_VENDOR, _PRODUCT, _RELEASE = 0x0403, 0x6001, 0x0600
_IN, _OUT = 0x81, 0x02
_HELLO_HEAD, _HEAD = struct.Struct("<III"), struct.Struct("<IIQ")  # type, length, id
_CONTROL = struct.Struct("<BBBBHHH")  # endpoint, request, its type, status, value, index, length
_BULK = struct.Struct("<BBHI")  # endpoint, status, length, stream
_CAPABILITIES = 1 << 1 | 1 << 4 | 1 << 5  # device version and packet size are sent, ids are long
_CANCELLED, _STALL = 1, 4
_FULL_SPEED, _BULK_KIND = 1, 2
_EIGHTHS = (0, 3, 2, 4, 1, 5, 6, 7)  # the chip's codes for eighths of its divisor
_ISPEED, _OSPEED = 4, 5


class _Kind(IntEnum):
    """Types of usbredir's packets."""

    HELLO = 0
    CONNECT = 1
    INTERFACES = 4
    ENDPOINTS = 5
    SET_CONFIGURATION = 6
    GET_CONFIGURATION = 7
    CONFIGURATION = 8
    SET_ALTERNATE = 9
    GET_ALTERNATE = 10
    ALTERNATE = 11
    CANCEL = 21
    CONTROL = 100
    BULK = 101


class _Chip(IntEnum):
    """Requests to the chip."""

    RESET = 0
    MODEM = 1
    FLOW = 2
    BAUD = 3
    DATA = 4
    POLL_MODEM = 5
    SET_LATENCY = 9
    GET_LATENCY = 10


_DEVICE = struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x200, 0, 0, 0, 8, _VENDOR, _PRODUCT, _RELEASE, 1, 2, 3, 1)
_CONFIG = (
    struct.pack("<BBHBBBBB", 9, 2, 32, 1, 1, 0, 0xA0, 45)
    + struct.pack("<BBBBBBBBB", 9, 4, 0, 0, 2, 0xFF, 0xFF, 0xFF, 2)
    + b"".join(struct.pack("<BBBBHB", 7, 5, endpoint, _BULK_KIND, PACKET, 0) for endpoint in (_IN, _OUT))
)


class Adapter:
    """Plugged in on creation, unplugged by `close`; `latency_ms` is set by the guest."""

    def __init__(self, socket_path: Path, terminal: Path, serial: str) -> None:
        """QEMU listens at `socket_path`; `terminal` is the far end of the line."""
        self.latency_ms = 16
        self.marked = 0
        self._texts = ("FTDI", "FT232R USB UART", serial)
        self._head = _HELLO_HEAD
        self._marks: list[int] = []
        self._waiting: list[int] = []  # unanswered requests for data
        self._held = bytearray()
        self._t_held = 0.0
        self._line = os.open(terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._line)
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(socket_path))
        self._over = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Unplugs it."""
        self._over = True
        self._thread.join()
        self._socket.close()
        os.close(self._line)

    def mark(self, error: int, count: int = 1) -> None:
        """The next `count` bytes, each in its own packet, carry this error (a break is a NUL)."""
        self._marks += [error] * count

    def _run(self) -> None:
        self._send(_Kind.HELLO, 0, b"palmd's FT232R".ljust(64, b"\0") + struct.pack("<I", _CAPABILITIES))
        with contextlib.suppress(ConnectionError):
            while not self._over:
                ready, _, _ = select.select([self._socket, self._line], [], [], 1e-3)
                if self._socket in ready:
                    self._hear()
                if self._line in ready:
                    self._read()
                self._pass_on()

    def _send(self, kind: int, number: int, body: bytes) -> None:
        head = _HELLO_HEAD if kind == _Kind.HELLO else _HEAD
        self._socket.sendall(head.pack(kind, len(body), number) + body)

    def _receive(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            part = self._socket.recv(size - len(data))
            if not part:
                raise ConnectionError
            data += part
        return data

    def _hear(self) -> None:
        head, self._head = self._head, _HEAD  # only the first one, a hello, has a short head
        kind, length, number = head.unpack(self._receive(head.size))
        body = self._receive(length)
        match kind:
            case _Kind.HELLO:
                self._introduce()
            case _Kind.SET_CONFIGURATION | _Kind.GET_CONFIGURATION:
                self._send(_Kind.CONFIGURATION, number, bytes((0, 1)))
            case _Kind.SET_ALTERNATE | _Kind.GET_ALTERNATE:
                self._send(_Kind.ALTERNATE, number, bytes((0, 0, 0)))
            case _Kind.CANCEL:
                if number in self._waiting:
                    self._waiting.remove(number)
                self._send(_Kind.BULK, number, _BULK.pack(_IN, _CANCELLED, 0, 0))
            case _Kind.CONTROL:
                self._control(number, body)
            case _Kind.BULK:
                endpoint, _, length, stream = _BULK.unpack_from(body)
                if endpoint == _IN:
                    self._waiting.append(number)
                    return
                with contextlib.suppress(OSError):
                    os.write(self._line, body[_BULK.size :])
                self._send(_Kind.BULK, number, _BULK.pack(endpoint, 0, length, stream))

    def _introduce(self) -> None:
        classes = bytes(32), b"\xff".ljust(32, b"\0"), b"\xff".ljust(32, b"\0"), b"\xff".ljust(32, b"\0")
        self._send(_Kind.INTERFACES, 0, struct.pack("<I", 1) + b"".join(classes))
        kinds, sizes = bytearray(b"\xff" * 32), [0] * 32
        kinds[0], kinds[16] = 0, 0
        for endpoint in (_IN, _OUT):
            index = (endpoint & 0x80) >> 3 | endpoint & 0x0F
            kinds[index], sizes[index] = _BULK_KIND, PACKET
        self._send(_Kind.ENDPOINTS, 0, bytes(kinds) + bytes(64) + struct.pack("<32H", *sizes))
        self._send(_Kind.CONNECT, 0, struct.pack("<BBBBHHH", _FULL_SPEED, 0, 0, 0, _VENDOR, _PRODUCT, _RELEASE))

    def _control(self, number: int, body: bytes) -> None:
        endpoint, request, kind, _, value, index, length = _CONTROL.unpack_from(body)
        answer = self._standard(request, value) if kind & 0x60 == 0 else self._vendor(request, kind, value, index)
        status, data = (_STALL, b"") if answer is None else (0, answer[:length])
        said = len(data) if kind & 0x80 else length
        self._send(_Kind.CONTROL, number, _CONTROL.pack(endpoint, request, kind, status, value, index, said) + data)

    def _standard(self, request: int, value: int) -> bytes | None:
        """A descriptor, or the power status; None for unknown requests."""
        if request == 0:
            return bytes((1, 0))
        match value >> 8 if request == 6 else 0:
            case 1:
                return _DEVICE
            case 2:
                return _CONFIG
            case 3:
                number = value & 0xFF
                text = struct.pack("<H", 0x409) if number == 0 else self._texts[number - 1].encode("utf-16-le")
                return bytes((len(text) + 2, 3)) + text
        return None

    def _vendor(self, request: int, kind: int, value: int, index: int) -> bytes | None:
        if kind & 0x80:
            return {_Chip.GET_LATENCY: bytes((self.latency_ms,)), _Chip.POLL_MODEM: bytes((1, _EMPTY))}.get(request)
        match request:
            case _Chip.BAUD:
                eighths = _EIGHTHS.index(value >> 14 | (index & 1) << 2)
                self._set_baud(24e6 / ((value & 0x3FFF) * 8 + eighths))
            case _Chip.SET_LATENCY:
                self.latency_ms = value
            case _Chip.RESET if value in (0, 1):
                self._held.clear()
                termios.tcflush(self._line, termios.TCIFLUSH)
        return b"" if request <= _Chip.DATA or request == _Chip.SET_LATENCY else None

    def _set_baud(self, baud: float) -> None:
        nearest = min((b for b in (9600, 19200, 38400, 57600, 115200)), key=lambda each: abs(each - baud))
        attributes = termios.tcgetattr(self._line)
        attributes[_ISPEED] = attributes[_OSPEED] = getattr(termios, f"B{nearest}")
        termios.tcsetattr(self._line, termios.TCSANOW, attributes)

    def _read(self) -> None:
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._line, 4096)
            if not self._held:
                self._t_held = time.monotonic()
            self._held += data
            del self._held[:-HELD_MOST]

    def _pass_on(self) -> None:
        """Answers requests: full packets at once, partial ones when the latency timer has expired."""
        while self._waiting and self._held:
            if self._marks:
                error, data = self._marks.pop(0), bytes(self._held[:1])
                del self._held[:1]
                self._packet(error, b"\0" if error == BREAK else data)
                self.marked += 1
            elif len(self._held) >= PACKET - 2 or time.monotonic() - self._t_held >= self.latency_ms * 1e-3:
                data = bytes(self._held[: PACKET - 2])
                del self._held[: PACKET - 2]
                self._packet(0, data)
            else:
                return

    def _packet(self, errors: int, data: bytes) -> None:
        body = bytes((1, _EMPTY | errors)) + data
        self._send(_Kind.BULK, self._waiting.pop(0), _BULK.pack(_IN, 0, len(body), 0) + body)
